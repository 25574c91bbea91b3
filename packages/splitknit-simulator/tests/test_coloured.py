"""Coloured LEDs in a capture: separated, written and read, and refused where they cannot be
separated."""

import json

import numpy as np
import pytest

from enrolled import refusal_of
from refusals import bad_input
from small_capture import edit
from splitknit.cli.main import main
from splitknit.io.capture import read_capture, write_capture
from splitknit.io.rig import read_rig, write_rig
from splitknit.model import Camera, Led, Rig
from splitknit.nominal import CROSSTALK
from splitknit.observation.coloured import COMPOSED, balanced, composed
from splitknit.observation.observe import observe
from splitknit.pipeline import reconstruct
from splitknit_simulator.rigs import coloured_rig
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.twin import simulate_capture

MIXING = np.array(CROSSTALK)
MOVED = {"moved-photograph", "double-photograph", "moved-finger", "undone-motion"}


@pytest.fixture(scope="module")
def twin():
    return simulate_capture(4, "left_loop", TwinSettings(rig=coloured_rig(0.12, 0)))[0]


@pytest.fixture(scope="module")
def white():
    return simulate_capture(4, "left_loop", TwinSettings(scale=0.12))[0]


def test_a_coloured_capture_is_written_and_read(twin, tmp_path):
    write_capture(twin, tmp_path / "c")
    read = read_capture(tmp_path / "c")
    light = observe(read).white
    assert light.photographs == 2
    assert light.colours == observe(twin).white.colours
    np.testing.assert_array_equal(light.grey, observe(twin).white.grey)
    assert [led.colour for led in read.rig.leds] == [led.colour for led in twin.rig.leds]
    result = reconstruct(read, "lin")
    assert result.mask.mean() > 0.1
    assert not any(COMPOSED in words for words in result.warnings)
    assert not any("bright as the rig file promises" in words for words in result.warnings)
    assert not MOVED & {finding.code for finding in result.findings}, "the finger lies still"


def test_a_rig_file_names_colours_and_crosstalk_only_where_stated(tmp_path):
    leds = tuple(Led("white", (40 * np.cos(a), 40 * np.sin(a), 100.0)) for a in range(4))
    write_rig(Rig(Camera(10.0, (20, 30)), leds), tmp_path / "rig.json")
    text = (tmp_path / "rig.json").read_text()
    assert "colour" not in text
    assert "crosstalk" not in text
    edit(tmp_path / "rig.json", lambda d: d["leds"][0].update(colour="green"))
    edit(tmp_path / "rig.json", lambda d: d["camera"].update(crosstalk=MIXING.tolist()))
    rig = read_rig(tmp_path / "rig.json")
    assert rig.leds[0].colour == "green"
    np.testing.assert_array_equal(rig.camera.crosstalk, MIXING)


@pytest.mark.parametrize(
    ("file", "change", "words"),
    [
        ("rig.json", lambda d: d["leds"][0].update(colour="purple"), "red, green or blue"),
        ("rig.json", lambda d: d["leds"][-1].update(colour="red"), "only LEDs of the band 'white'"),
        ("rig.json", lambda d: d["camera"].update(crosstalk=[[1, 0], [0, 1]]), "camera.crosstalk"),
        (
            "rig.json",
            lambda d: d["camera"].update(crosstalk=[[1, 1, 1]] * 3),
            "that separate the three colours",
        ),
        (
            "rig.json",
            lambda d: d["leds"][0].pop("colour"),
            "coloured and white LEDs for one exposure",
        ),
        (
            "capture.json",
            lambda d: d["bands"]["white"].update(leds=[[0], [3]]),
            "at least 3 lights",
        ),
    ],
)
def test_colours_that_cannot_be_separated_are_refused(  # noqa: PLR0917
    twin, tmp_path, capsys, file, change, words
):
    write_capture(twin, tmp_path / "c")
    edit(tmp_path / "c" / file, change)
    options = "--out", tmp_path / "r", "--preset", "lin"
    assert words in refusal_of(capsys, "reconstruct", tmp_path / "c", *options)
    assert not (tmp_path / "r").exists()


def test_metric_refuses_coloured_leds(twin):
    with bad_input("blurs the light of each coloured LED differently"):
        reconstruct(twin)


@pytest.mark.slow
def test_white_images_become_coloured_exposures(white):
    coloured = composed(white, 2)
    band = coloured.bands["white"]
    assert band.pixels.shape == (2, *white.shape, 3)
    assert band.pixels.dtype == np.uint16
    colours = observe(white).white.stack
    light = observe(coloured).white
    stack = light.grey
    clipped = 0
    for image, group in zip(stack, light.lights, strict=True):
        led = coloured.rig.leds[group[0]]
        places = [white_led.position_mm for white_led in white.rig.leds]
        source = colours[("red", "green", "blue").index(led.colour), places.index(led.position_mm)]
        fine = (image < 0.9) & (source < 0.9)
        clipped += int((~fine).sum())
        assert np.quantile(np.abs(image - source)[fine], 0.999) < 2e-3
    assert clipped < 0.01 * stack.size
    assert coloured.bands["nir"] is white.bands["nir"]
    result = reconstruct(white, "lin")
    assert f"2 coloured exposures were {COMPOSED}" in result.warnings
    assert not MOVED & {finding.code for finding in result.findings}, "the finger lies still"
    plain = reconstruct(coloured, "lin")
    np.testing.assert_array_equal(result.height_mm, plain.height_mm)


def test_balanced_images_fit_a_matt_surface_better(twin):
    light = observe(twin).white
    lights = light.rig.light_vectors()
    stack = light.grey
    mask = stack.min(axis=0) > 0.05
    even = balanced(stack, light.rig, mask)
    left = []
    for images in (stack[:, mask], even[:, mask]):
        rest = images - lights @ (np.linalg.pinv(lights) @ images)
        left.append(float((rest**2).mean() / (images**2).mean()))
    assert left[1] < 0.5 * left[0]


@pytest.mark.slow
def test_simulate_photographs_coloured_lights_still_or_moving(tmp_path, capsys):
    command = ["simulate", "--scale", "0.06", "--lights", "coloured9"]
    assert main([*command, "--out", str(tmp_path / "c")]) == 0
    assert "--preset lin" in capsys.readouterr().out
    # one pose an exposure
    assert main([*command, "--out", str(tmp_path / "m"), "--motion", "0.2"]) == 0
    for name in "cm":
        document = json.loads((tmp_path / name / "capture.json").read_text())
        assert [len(group) for group in document["bands"]["white"]["leds"]] == [3, 3, 3]
    still, moved = ((tmp_path / name / "white_2.png").read_bytes() for name in "cm")
    assert still != moved
