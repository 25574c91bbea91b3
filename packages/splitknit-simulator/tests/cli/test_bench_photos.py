"""``splitknit simulate --bench`` and ``splitknit reconstruct --rig``."""

import json

import numpy as np
import pytest

from enrolled import refusal_of
from splitknit.cli.main import main
from splitknit.io.capture import read_capture
from splitknit.io.images import read_image
from splitknit.io.rig import read_rig, write_rig
from splitknit.model import Led, Rig
from splitknit_simulator.rigs import built_rig

SCALE = 0.06


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    out = tmp_path_factory.mktemp("bench") / "bench"
    call = f"simulate --bench --seed 3 --scale {SCALE} --out {out}".split()
    assert main([*call, "--set", "boards=3", "--set", "nails=2"]) == 0
    return out


def test_the_bench_holds_its_rigs_and_well_exposed_pictures(bench):
    true, drawn = read_rig(bench / "rig_true.json"), read_rig(bench / "rig_drawn.json")
    assert true.camera.matrix is not None and drawn.camera.matrix is not None
    assert np.abs(true.camera.matrix - built_rig(3, scale=SCALE).camera.matrix).max() < 1e-9
    assert np.abs(true.camera.matrix - drawn.camera.matrix).max() > 0.1
    pictures = [*sorted(bench.glob("board/*.png")), bench / "plane.png"]
    pictures += sorted(bench.glob("nail/nail_*/*.png"))
    assert len(pictures) == 3 + 1 + 2 * 14
    for picture in pictures:
        pixels = read_image(picture)
        assert pixels.shape[:2] == true.camera.image_size
        assert 90 < np.percentile(pixels, 99.5) < 255, picture.name


def test_the_card_is_a_capture_with_an_exposure_series(bench):
    capture = read_capture(bench / "card")
    assert capture.material == "opaque"
    assert [len(band.leds) for band in capture.bands.values()] == [7, 7]
    document = json.loads((bench / "card" / "radiometry.json").read_text())
    series = [read_image(bench / "card" / entry["file"]).mean() for entry in document["exposures"]]
    times = [entry["exposure_s"] for entry in document["exposures"]]
    np.testing.assert_allclose(
        np.array(series) / series[-1], np.array(times) / times[-1], rtol=0.03
    )


@pytest.mark.slow
def test_a_stored_rig_photographs_a_finger_and_another_reconstructs_it(bench, tmp_path):
    true = bench / "rig_true.json"
    assert main(f"simulate --seed 4 --rig {true} --out {tmp_path}/c".split()) == 0
    assert read_capture(tmp_path / "c").rig.camera.height_mm == read_rig(true).camera.height_mm
    call = "reconstruct", tmp_path / "c", "--preset", "ea", "--keep", "--out", tmp_path / "r"
    assert main([*map(str, call), "--rig", str(bench / "rig_drawn.json")]) == 0
    report = json.loads((tmp_path / "r" / "report.json").read_text())
    assert "replaced rig: rig_drawn.json" in json.dumps(report)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (["simulate", "--bench", "--pattern", "loop"], "--pattern does not go with --bench"),
        (["simulate", "--bench", "--set", "nails=9"], "nails must be from 1 to 4"),
        (["simulate", "--rig", "RIG", "--scale", "0.5"], "leave out the scale"),
    ],
)
def test_options_that_exclude_each_other_are_refused(call, words, bench, tmp_path, capsys):
    arguments = [bench / "rig_true.json" if part == "RIG" else part for part in call]
    assert words in refusal_of(capsys, *arguments, "--out", tmp_path / "o")
    assert not (tmp_path / "o").exists()


def test_a_rig_of_another_camera_or_other_leds_is_refused(bench, tmp_path, capsys):
    rig = read_rig(bench / "rig_drawn.json")
    swapped = tuple(
        Led("nir" if led.band == "white" else "white", led.position_mm) for led in rig.leds
    )
    another = built_rig(3, scale=2 * SCALE)
    for name, wrong, words in (
        (
            "few.json",
            Rig(rig.camera, rig.leds[:9]),
            "bands.nir.leds: LED 9 is not in the rig",
        ),
        ("swapped.json", Rig(rig.camera, swapped), "which is a 'nir' LED in the rig, not 'white'"),
        ("other.json", another, "is the rig of another camera"),
    ):
        write_rig(wrong, tmp_path / name)
        options = "--rig", tmp_path / name, "--out", tmp_path / "r"
        assert words in refusal_of(capsys, "reconstruct", bench / "card", *options)
