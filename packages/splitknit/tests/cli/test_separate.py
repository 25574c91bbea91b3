"""``splitknit separate``: a folder in, a folder out, one sentence where it cannot."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from checkerboards import checkerboard_patterns
from splitknit.cli.main import main
from splitknit.io.images import read_image, write_image
from splitknit.separation.direct import direct_light
from written_files import read_light_tiff

SIZE = (40, 50)
ROWS, COLUMNS = np.mgrid[: SIZE[0], : SIZE[1]]
DIRECT = 0.2 * (1 + 0.3 * np.sin(ROWS / 9))
GLOBAL = 0.4 + 0.1 * np.cos(COLUMNS / 17)
STEP = 1 / 65535
SHIFTS = [(2 * i, 2 * j) for i in range(5) for j in range(5)]


def stored(light: Any, full: int = 65535) -> Any:
    return np.round(np.clip(light, 0, 1) * full).astype(np.uint16 if full > 255 else np.uint8)


def write(folder: Path, images: dict[str, Any]) -> Path:
    folder.mkdir(exist_ok=True)
    for name, light in images.items():
        write_image(folder / name, stored(light))
    return folder


@pytest.fixture
def boards(tmp_path: Path) -> Path:
    """25 shifted checkerboards over a black level, with a white image, named by their shifts."""
    patterns = checkerboard_patterns(SIZE, 5, SHIFTS)
    images = {
        f"board_{i}_{j}.png": p * DIRECT + 0.5 * GLOBAL + 0.03
        for (i, j), p in zip(SHIFTS, patterns, strict=True)
    }
    images["black.png"] = np.full(SIZE, 0.03)
    images["white.png"] = DIRECT + GLOBAL + 0.03
    return write(tmp_path / "boards", images)


def run(*words: Any) -> int:
    return main(["separate", *map(str, words)])


def refusal(capsys: pytest.CaptureFixture[str], out: Path, *words: Any) -> str:
    """Return the one sentence with which a run is refused; nothing is left behind."""
    before = sorted(out.parent.iterdir())
    assert run(*words, "--out", out) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("splitknit: error: ")
    assert printed.err.count("\n") == 1
    assert sorted(out.parent.iterdir()) == before
    return printed.err


def test_checkerboards_of_a_folder_give_direct_and_global_light(boards, tmp_path, capsys):
    out = tmp_path / "out"
    assert run(boards, "--out", out, "--json") == 0
    facts = json.loads(capsys.readouterr().out)
    direct, metadata = read_light_tiff(out / "direct.tiff")
    global_, _ = read_light_tiff(out / "global.tiff")
    assert np.abs(direct - DIRECT).max() < 3 * STEP
    assert np.abs(global_ - GLOBAL).max() < 4 * STEP
    assert facts["method"] == "checkerboard"
    assert len(facts["images"]) == 25
    assert "black.png" in facts["inputs"]
    assert metadata["inputs"] == facts["inputs"]
    assert facts["findings"] == []
    assert sorted(path.name for path in out.iterdir() if path.name[0] != ".") == sorted(
        facts["files"]
    )
    report = json.loads((out / "report.json").read_text())
    assert (
        report["direct_share"]
        == facts["direct_share"]
        == pytest.approx(np.median(DIRECT / (DIRECT + GLOBAL)), 0.02)
    )
    preview = read_image(out / "direct.png")
    assert preview.shape == (*SIZE, 1)
    assert preview.max() == 255
    first = {name: (out / name).read_bytes() for name in facts["files"] if name != "report.json"}
    assert run(boards, "--out", out) == 0  # ours may be replaced; same input, same bytes
    assert {name: (out / name).read_bytes() for name in first} == first
    assert "direct in the median" in capsys.readouterr().out


def test_the_network_separates_one_photograph(tmp_path, capsys):
    rows, columns = np.mgrid[:96, :96]
    grey = 0.4 + 0.1 * np.sin(rows / 3) * np.cos(columns / 40)
    mask = np.zeros(grey.shape)
    mask[8:90, 4:80] = 1
    colour = grey[..., None] * np.array([1.0, 0.7, 0.5])
    for name, light in (("grey", grey), ("colour", colour)):
        photograph = write(tmp_path / name, {"finger.png": light, "mask.png": mask})
        out = tmp_path / f"out_{name}"
        assert run(photograph, "--out", out, "--method", "network") == 0
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
    assert "1 image separated by network" in capsys.readouterr().out


def test_the_network_takes_one_photograph_and_no_patterns(boards, tmp_path, capsys):
    out = tmp_path / "out"
    assert "takes one photograph, but there are 25 (board_0_0" in refusal(
        capsys, out, boards, "--method", "network"
    )
    words = refusal(capsys, out, boards, "--method", "network", "--alpha", 0.5)
    assert "--alpha is of patterns" in words


def test_patterns_are_estimated_or_read_and_a_mask_is_respected(boards, tmp_path):
    patterns = checkerboard_patterns(SIZE, 5, SHIFTS)
    states = write(tmp_path / "states", {f"s_{k:02}.png": p for k, p in enumerate(patterns)})
    mask = np.zeros(SIZE)
    mask[5:30, 8:40] = 1
    write_image(boards / "mask.png", stored(mask))
    for choice, kind in ((states, "given"), ("estimate", "estimate")):
        out = tmp_path / f"out_{kind}"
        assert run(boards, "--out", out, "--patterns", choice) == 0
        direct, metadata = read_light_tiff(out / "direct.tiff")
        assert np.array_equal(np.isnan(direct), mask == 0)
        assert np.nanmax(np.abs(direct - DIRECT)) < 3 * STEP
        assert metadata["settings"]["separate"]["patterns"] == kind


def test_known_states_need_the_size_of_checks_for_skin(boards, tmp_path, capsys):
    """Skin is where it matters, and what is in the images the verb cannot know; the size alone is
    enough for it."""
    written = {}
    for number, words in enumerate((("--patterns", "estimate"), ("--check-px", 5))):
        out = tmp_path / f"out_{number}"
        assert run(boards, *words, "--out", out, "--json") == 0
        facts = json.loads(capsys.readouterr().out)
        assert ("give check_px for skin" in str(facts["findings"])) == ("--check-px" not in words)
        assert facts["settings"]["separate"]["patterns"] == "estimate"
        written[number] = read_light_tiff(out / "direct.tiff")[0]
        assert np.abs(written[number] - DIRECT).max() < 4 * STEP
    assert not np.array_equal(written[0], written[1])
    assert "5 pixels or more" in refusal(capsys, tmp_path / "x", boards, "--check-px", 4)


def test_negative_global_light_gets_a_note(boards, tmp_path, capsys):
    assert run(boards, "--dark", 0.8, "--out", tmp_path / "out") == 0
    assert "Please note: global light is negative" in capsys.readouterr().out


def test_refusals_of_a_stack_name_the_file(boards, tmp_path, capsys):
    out, board = tmp_path / "out", boards / "board_0_4.png"
    good = board.read_bytes()
    write_image(board, stored(np.full(SIZE, 0.03)))
    assert "image 2 (board_0_4.png) is black" in refusal(capsys, out, boards)
    write_image(board, stored(np.full((40, 51), 0.3)))
    assert "board_0_4.png has 40 x 51 pixels" in refusal(capsys, out, boards)
    board.write_bytes(good[: len(good) // 2])
    assert "board_0_4.png" in refusal(capsys, out, boards)
    board.write_bytes(good)
    write_image(boards / "board_2_0.png", stored(np.full(SIZE, 1.0)))
    assert "saturated" in refusal(capsys, out, boards)
    assert "alpha must lie" in refusal(capsys, out, boards, "--alpha", 0)
    assert "not a folder of patterns" in refusal(
        capsys, out, boards, "--patterns", tmp_path / "none"
    )
    assert "not a folder" in refusal(capsys, out, tmp_path / "none")
    (tmp_path / "empty").mkdir()
    assert "holds no PNG, TIFF or JPEG" in refusal(capsys, out, tmp_path / "empty")
    assert "holds the input itself" in refusal(capsys, boards, boards)


def polarised(root: Path, count: int = 3) -> tuple[Path, Path]:
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
    assert "name one folder" in refusal(capsys, out, parallel, crossed)
    assert "with --out and --encoding alone" in refusal(
        capsys, out, "polarised", parallel, crossed, "--alpha", 0.5
    )
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
        assert run(folder, "--out", out, "--method", "network", *options) == 0
        report = json.loads((out / "report.json").read_text())
        assert report["settings"]["separate"]["encoding"] == encoding
