"""Photographs through the command line: one command to a surface, one to a capture, and a scale
that is not known."""

import json
import re
import shutil

import numpy as np
import pytest
from PIL import Image

from splitknit.cli.main import main
from splitknit.io.capture import read_capture
from written_files import read_light_tiff

AZIMUTH = 2 * np.pi * np.arange(5) / 5
LIGHTS = np.stack([0.5 * np.cos(AZIMUTH), 0.5 * np.sin(AZIMUTH), np.full(5, 0.87)], axis=1)
RADIUS = 200.0


@pytest.fixture(scope="module")
def photos(tmp_path_factory):
    """A cap of a ball with ridges of 8 pixels all over it, under five lights."""
    root = tmp_path_factory.mktemp("photos")
    rows, columns = np.mgrid[:200, :200]
    x, y = columns - 99.5, 99.5 - rows
    inside = np.hypot(x, y) < 90.0
    height = np.sqrt(np.where(inside, RADIUS**2 - x * x - y * y, 1.0))
    slope_x, slope_y = -x / height + 0.3 * np.cos(2 * np.pi * x / 8.0), -y / height
    normals = np.stack([-slope_x, -slope_y, np.ones_like(x)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    for k, light in enumerate(LIGHTS):
        shade = np.where(inside, np.clip(normals @ light, 0, None), 0.0)
        Image.fromarray(np.rint(shade * 60000).astype(np.uint16)).save(root / f"{k}.png")
    Image.fromarray(inside.astype(np.uint8) * np.uint8(255)).save(root / "mask.png")
    np.savetxt(root / "lights.txt", LIGHTS)
    return root


@pytest.fixture(scope="module")
def result(photos):
    assert main(f"reconstruct --images {photos} --preset ea --out {photos}/result".split()) == 0
    return photos / "result"


@pytest.fixture
def captured(tmp_path):
    """What ``splitknit capture`` leaves: 14 LEDs, ambient images, the session."""
    taken = tmp_path / "real"
    small = ("--scale", "0.1", "--set", "pose.insertion_mm=[26.0, 26.0]")
    assert main([*f"capture --device twin --out {taken}".split(), *small]) == 0
    return taken


def test_photographs_and_captures_are_not_read_through_links(photos, captured, capsys):
    folder = captured.parent / "received"
    shutil.copytree(photos, folder, ignore=shutil.ignore_patterns("result*"))
    words = f"import --images {folder} --out {captured.parent}/out".split()
    for name in ("1.png", "mask.png", "lights.txt"):
        away = captured.parent / name
        (folder / name).rename(away)
        (folder / name).symlink_to(away)
        assert main(words) == 2
        assert f"{name}' is a link inside a folder" in capsys.readouterr().err
        (folder / name).unlink()
        away.rename(folder / name)
    for name in ("capture.json", "rig.json", "white_0.tiff"):
        (captured / name).rename(captured / f"own_{name}")
        (captured / name).symlink_to(captured / f"own_{name}")  # even to a file of the folder
        assert main(f"reconstruct {captured} --out {captured.parent}/out".split()) == 2
        assert f"{name}' is a link inside a folder" in capsys.readouterr().err
        (captured / f"own_{name}").replace(captured / name)
    (captured.parent / "link").symlink_to(folder)
    assert main(f"import --images {captured.parent}/link --out {captured.parent}/out".split()) == 0


def test_one_command_makes_a_surface_in_pixels(result):
    with np.load(result / "height.npz") as arrays:
        assert {"height_px", "ridge_px", "shape_px", "normals_measured"} <= set(arrays.files)
        assert not [name for name in arrays.files if name.endswith("_mm")]
        rows, columns = np.nonzero(arrays["mask"])
        ball = np.sqrt(RADIUS**2 - (columns - 99.5) ** 2 - (rows - 99.5) ** 2)
        error = arrays["height_px"][rows, columns] - ball
        assert np.std(error) < 0.1 * np.ptp(ball)  # pixels of height, not a guessed millimetre
    files = {path.name for path in result.iterdir()}
    assert "print.png" not in files and "normals_measured.png" in files
    facts = json.loads((result / "report.json").read_text())
    assert set(facts["files"]) == {name for name in files if not name.startswith(".")}
    assert facts["result"]["scale_known"] is False and facts["result"]["pitch_mm"] is None
    assert "scale-unknown" in {each["code"] for each in facts["findings"]}
    names = {*facts["facts"], *facts["quality"]["white"]} - {"assumed_px_per_mm"}
    assert not [name for name in names if name.endswith(("_mm", "_mm2", "_um"))]
    page = (result / "report.html").read_text().replace("where it is a finger", "")
    page = re.sub("<script.*?</script>", "", page, flags=re.DOTALL)
    assert (
        "in pixels: its scale is unknown" in page and "finger" not in page.split("<h2>Details")[0]
    )
    assert " mm" not in page.split("<h2>Details")[0].split("</style>")[1].replace("--px-per-mm", "")
    assert b"unit pixel, the scale is unknown" in (result / "surface.ply").read_bytes()[:500]
    assert read_light_tiff(result / "height.tiff")[1]["unit"] == "pixel"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("", "name a capture folder, photographs"),
        ("PHOTOS", "--images PHOTOS --lights FILE --out RESULT"),
        ("PHOTOS --images PHOTOS", "both were given"),
        ("PHOTOS --mask x.png", "--mask goes with --images"),
        ("--images PHOTOS --px-per-mm 0", "--px-per-mm must be"),
        ("--images PHOTOS --px-per-mm 9 --ridge-period 1", "choose one"),
        (
            "--images PHOTOS --ridge-period 7",
            "is 7 mm, where only 0.2 to 1 mm is possible: check --ridge-period",
        ),
        ("--images PHOTOS --lights PHOTOS/none.txt", "does not exist"),
        ("--images PHOTOS/none", "not a folder"),
        ("--images PHOTOS --rig rig.json", "rig.json does not exist"),
        ("--images PHOTOS --rig rig.json --lights x.txt", "choose one"),
        ("--images PHOTOS --rig PHOTOS/lights.txt", "a list of lights with --lights"),
    ],
)
def test_refusals(options, words, photos, tmp_path, capsys):
    command = options.replace("PHOTOS", str(photos)).split()
    assert main(["reconstruct", *command, "--out", str(tmp_path / "out")]) == 2
    assert words.replace("PHOTOS", str(photos)) in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_known_scale_is_not_replaced(photos, tmp_path, capsys):
    capture = tmp_path / "capture"
    assert main(f"import --images {photos} --px-per-mm 20 --out {capture}".split()) == 0
    assert main(f"reconstruct {capture} --px-per-mm 30 --out {tmp_path}/x".split()) == 2
    assert "has a scale already: 20 px/mm" in capsys.readouterr().err


def polarised_photos(photos, root, *, mirrored=3000):
    """The ball's photographs as a crossed series, and with light that its surface reflects as a
    parallel one."""
    parallel, crossed = root / "parallel", root / "crossed"
    for folder in (parallel, crossed):
        folder.mkdir(parents=True)
    shutil.copy(photos / "lights.txt", parallel)
    for k in range(5):
        light = np.asarray(Image.open(photos / f"{k}.png")).astype(np.int64)
        Image.fromarray((light // 2).astype(np.uint16)).save(crossed / f"through_{k}.png")
        Image.fromarray((light // 2 + mirrored * (light > 0)).astype(np.uint16)).save(
            parallel / f"{k}.png"
        )
    return parallel, crossed


def imported(*arguments):
    return main(["import", *map(str, arguments), "--px-per-mm", "10", "--json"])


def test_a_crossed_series_is_imported_beside_the_parallel_one(photos, tmp_path, capsys):
    parallel, crossed = polarised_photos(photos, tmp_path)
    assert imported("--images", parallel, "--crossed", crossed, "--out", tmp_path / "c") == 0
    facts = json.loads(capsys.readouterr().out)
    assert (facts["images"], facts["polarised"]) == (5, True)
    capture = read_capture(tmp_path / "c")
    for name, folder in (("white", parallel), ("white_crossed", crossed)):
        first = np.asarray(Image.open(sorted(folder.glob("*.png"))[0]))
        np.testing.assert_array_equal(capture.bands[name].pixels[0, ..., 0], first)
        assert capture.bands[name].leds == ((0,), (1,), (2,), (3,), (4,))
    assert main(f"reconstruct {tmp_path}/c --preset ea --out {tmp_path}/r".split()) == 0


def test_series_in_the_wrong_folders_are_noted(photos, tmp_path, capsys):
    parallel, crossed = polarised_photos(photos, tmp_path)
    lights = ("--lights", photos / "lights.txt")
    assert (
        imported("--images", crossed, "--crossed", parallel, *lights, "--out", tmp_path / "c") == 0
    )
    assert "were their folders exchanged" in str(json.loads(capsys.readouterr().out)["notes"])


def test_series_that_do_not_fit_are_refused(photos, tmp_path, capsys):
    parallel, crossed = polarised_photos(photos, tmp_path)
    Image.fromarray(np.ones((20, 20), np.uint16)).save(tmp_path / "small.png")
    for change, words in (
        (
            lambda: shutil.copy(tmp_path / "small.png", crossed / "through_2.png"),
            "200 x 200 are expected",
        ),
        (
            lambda: shutil.copy(crossed / "through_4.png", crossed / "through_5.png"),
            "5 photographs, but",
        ),
    ):
        change()
        assert imported("--images", parallel, "--crossed", crossed, "--out", tmp_path / "c") == 2
        assert words in capsys.readouterr().err
        assert not (tmp_path / "c").exists()
    assert imported("--images", parallel, "--crossed", parallel, "--out", tmp_path / "c") == 2
    assert "named twice" in capsys.readouterr().err
    assert main(f"import print.wsq --crossed {parallel} --out {tmp_path}/p".split()) == 2
    assert "--crossed goes with --images" in capsys.readouterr().err
