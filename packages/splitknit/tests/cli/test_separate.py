"""``splitknit separate``: a folder in, a folder out, one sentence where it cannot."""

import json

import numpy as np
import pytest

from splitknit.cli.main import main
from splitknit.io.images import read_image, write_image
from splitknit.separation.direct import direct_light
from written_files import read_light_tiff

SIZE = (40, 50)
ROWS, COLUMNS = np.mgrid[: SIZE[0], : SIZE[1]]
GLOBAL = 0.4 + 0.1 * np.cos(COLUMNS / 17)
STEP = 1 / 65535


def stored(light, full=65535):
    return np.round(np.clip(light, 0, 1) * full).astype(np.uint16 if full > 255 else np.uint8)


def write(folder, images):
    folder.mkdir(exist_ok=True)
    for name, light in images.items():
        write_image(folder / name, stored(light))
    return folder


def run(*words):
    return main(["separate", *map(str, words)])


def refusal(capsys, out, *words):
    """Return the one sentence with which a run is refused; nothing is left behind."""
    before = sorted(out.parent.iterdir())
    assert run(*words, "--out", out) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("splitknit: error: ")
    assert printed.err.count("\n") == 1
    assert sorted(out.parent.iterdir()) == before
    return printed.err


def test_the_network_separates_one_photograph(tmp_path, capsys):
    rows, columns = np.mgrid[:96, :96]
    grey = 0.4 + 0.1 * np.sin(rows / 3) * np.cos(columns / 40)
    mask = np.zeros(grey.shape)
    mask[8:90, 4:80] = 1
    colour = grey[..., None] * np.array([1.0, 0.7, 0.5])
    for name, light in (("grey", grey), ("colour", colour)):
        photograph = write(tmp_path / name, {"finger.png": light, "mask.png": mask})
        out = tmp_path / f"out_{name}"
        assert run(photograph, "--out", out) == 0
        direct, metadata = read_light_tiff(out / "direct.tiff")
        global_, _ = read_light_tiff(out / "global.tiff")
        inside = mask > 0
        assert direct.shape == light.shape
        assert np.isnan(direct[~inside]).all()
        assert (direct[inside] >= 0).all()
        assert (global_[inside] >= -1e-6).all()
        assert np.abs((direct + global_ - light)[inside]).max() < 2 * STEP
        assert metadata["settings"]["separate"]["method"] == "network"
        if name == "grey":
            expected = direct_light(np.where(inside, light, 0)[None])[0]
        else:
            shown = np.where(inside[..., None], light, 0)
            expected = np.moveaxis(direct_light(np.moveaxis(shown, -1, 0)[None])[0], 0, -1)
        assert np.abs(direct - expected)[inside].max() < 1e-3
    assert "of the light is direct in the median" in capsys.readouterr().out


def test_one_photograph_is_taken_from_its_file_or_folder(tmp_path, capsys):
    light = np.broadcast_to(0.3 + 0.1 * np.sin(np.arange(64) / 3), (64, 64))
    folder, out = write(tmp_path / "one", {"finger.png": light}), tmp_path / "out"
    assert run(folder, "--out", out) == run(folder / "finger.png", "--out", tmp_path / "other") == 0
    assert "35 % of the light is direct in the median" in capsys.readouterr().out
    assert (out / "direct.tiff").read_bytes() == (tmp_path / "other/direct.tiff").read_bytes()
    assert "holds the input itself" in refusal(capsys, folder, folder)
    write(folder, {"mask.png": np.ones((32, 64))})
    assert "mask.png has 32 x 64 pixels" in refusal(capsys, tmp_path / "x", folder)
    (folder / "mask.png").unlink()
    write_image(folder / "finger.png", stored(np.zeros((64, 64))))
    assert "finger.png is black" in refusal(capsys, tmp_path / "x", folder)
    write(folder, {"second.png": light})
    assert "holds 2 photographs" in refusal(capsys, tmp_path / "x", folder)
    assert "cannot be read" in refusal(capsys, tmp_path / "x", tmp_path / "none")


def polarised(root, count=3):
    """Photographs through parallel and crossed films: half of the diffuse light each, the specular
    light in one."""
    specular = [0.05 + 0.04 * np.sin(COLUMNS / 2 + k) for k in range(count)]
    parallel = {f"photo_{k}.png": 0.5 * GLOBAL + light for k, light in enumerate(specular)}
    crossed = {f"through_{k}.png": 0.5 * GLOBAL for k in range(count)}
    return write(root / "parallel", parallel), write(root / "crossed", crossed)


def test_polarised_photographs_become_specular_and_diffuse_light(tmp_path, capsys):
    folders, out = polarised(tmp_path), tmp_path / "out"
    assert run("polarised", *folders, "--out", out, "--json") == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["specular_share"] == pytest.approx(0.05 / 0.25, abs=0.03)
    assert sorted(path.name for path in out.iterdir() if path.suffix) == sorted(facts["files"])
    assert set(facts["inputs"]) == {f"parallel/photo_{k}.png" for k in range(3)} | {
        f"crossed/through_{k}.png" for k in range(3)
    }
    for k in range(3):
        specular, diffuse = (
            read_image(out / f"{name}_{k}.png")[..., 0] for name in ("specular", "diffuse")
        )
        assert specular.dtype == diffuse.dtype == np.uint16
        np.testing.assert_allclose(
            specular * STEP, 0.05 + 0.04 * np.sin(COLUMNS / 2 + k), atol=2 * STEP
        )
        np.testing.assert_allclose(diffuse * STEP, 0.5 * GLOBAL, atol=2 * STEP)
    assert read_image(out / "specular.png").dtype == np.uint8
    assert run("polarised", *folders, "--out", out) == 0  # again: an earlier separation is replaced
    assert "3 pairs of photographs" in capsys.readouterr().out
    assert run("polarised", *folders[::-1], "--out", tmp_path / "exchanged") == 0
    assert "were their folders exchanged" in capsys.readouterr().out


def test_polarised_series_that_do_not_match_are_refused(tmp_path, capsys):
    parallel, crossed = polarised(tmp_path)
    out = tmp_path / "out"
    assert "name one photograph" in refusal(capsys, out, parallel, crossed)
    assert "is not a folder" in refusal(capsys, out, "polarised", parallel, tmp_path / "none")
    write(crossed, {"through_1.png": GLOBAL[:20]})
    short = (crossed / "through_1.png").read_bytes()[:50]
    (crossed / "through_1.png").write_bytes(short)  # what its header states
    assert "through_1.png is not of the size" in refusal(
        capsys, out, "polarised", parallel, crossed
    )
    (crossed / "through_1.png").unlink()
    assert "3 photographs and" in refusal(capsys, out, "polarised", parallel, crossed)
    assert "holds the input itself" in refusal(capsys, parallel, "polarised", parallel, crossed)


def test_one_photograph_of_8_bits_is_taken_as_srgb(tmp_path):
    folder = tmp_path / "photograph"
    folder.mkdir()
    pixels = np.random.default_rng(1).integers(90, 140, (64, 64, 3)).astype(np.uint8)
    write_image(folder / "finger.png", pixels)
    for options, encoding in (([], "srgb"), (["--encoding", "linear"], "linear")):
        out = tmp_path / encoding
        assert run(folder, "--out", out, *options) == 0
        report = json.loads((out / "report.json").read_text())
        assert report["settings"]["separate"]["encoding"] == encoding
