"""Captures behind polarising films: a parallel and a crossed series, image by image."""

import json
from dataclasses import replace

import numpy as np
import pytest

from refusals import bad_input
from small_capture import edit
from splitknit.capture import Ambient
from splitknit.errors import BadInput
from splitknit.io.capture import read_capture, with_rig, write_capture
from splitknit.io.rig import write_rig
from splitknit.model import Led
from splitknit.observation.coloured import LightsSettings, as_lit
from splitknit.observation.observe import observe


@pytest.fixture
def polarised(build_capture):
    """Four lights photographed through an analyser that turns."""
    capture = build_capture()
    white = capture.bands["white"]
    dark = (white.pixels // 2).astype(white.pixels.dtype)
    series = {
        "white": replace(white, polarisation="parallel"),
        "white_crossed": replace(white, name="white_crossed", pixels=dark, polarisation="crossed"),
    }
    return replace(capture, bands={**series, "nir": capture.bands["nir"]})


def neighbours(capture):
    """The same with crossed films before LEDs of their own, beside the others."""
    first = len(capture.rig.leds)
    beside = []
    for led in capture.rig.leds[:4]:
        assert led.position_mm is not None
        x, y, z = led.position_mm
        turn = np.pi / 4  # halfway to the next LED
        beside.append(
            Led(
                "white",
                (x * np.cos(turn) - y * np.sin(turn), x * np.sin(turn) + y * np.cos(turn), z),
            )  # type: ignore[arg-type]
        )
    crossed = replace(capture.bands["white_crossed"], leds=tuple((first + k,) for k in range(4)))
    rig = replace(capture.rig, leds=(*capture.rig.leds, *beside))
    return replace(capture, rig=rig, bands={**capture.bands, "white_crossed": crossed})


@pytest.mark.parametrize("change", [lambda capture: capture, neighbours])
@pytest.mark.parametrize("exposures", [(1.0, 1.0), (1.0, 2.0), (0.5, 1.0)])
def test_both_series_are_written_and_read_back(polarised, tmp_path, change, exposures):
    capture = change(polarised)
    names = ("white", "white_crossed")
    timed = {
        name: replace(capture.bands[name], exposure=np.full(4, s))
        for name, s in zip(names, exposures, strict=True)
    }
    capture = replace(capture, bands={**capture.bands, **timed})
    write_capture(capture, tmp_path / "c")
    again = read_capture(tmp_path / "c")
    assert list(again.bands) == ["white", "white_crossed", "nir"]
    for name, band in capture.bands.items():
        read = again.bands[name]
        np.testing.assert_array_equal(read.pixels, band.pixels)
        np.testing.assert_array_equal(read.exposure, band.exposure)
        assert (read.polarisation, read.leds) == (band.polarisation, band.leds)
    assert "white_crossed_3.png" in again.hashes
    write_capture(again, tmp_path / "d")
    assert (tmp_path / "c" / "capture.json").read_bytes() == (
        tmp_path / "d" / "capture.json"
    ).read_bytes()


def crossed_with(**values):
    return lambda document: document["bands"]["white_crossed"].update(values)


def _exposed(document):
    band = document["bands"]["white_crossed"]
    band["images"] = [{"file": name, "exposure_s": 0.5} for name in band["images"]]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d["bands"]["white"].update(polarisation="vertical"), "white.polarisation: "),
        (
            lambda d: d["bands"]["white"].pop("polarisation"),
            'bands.white must say "polarisation": "parallel"',
        ),
        (crossed_with(polarisation="parallel"), 'bands.white_crossed "crossed"'),
        (
            lambda d: [d["bands"]["white_crossed"][name].pop() for name in ("images", "leds")],
            "bands.white has 4 images but bands.white_crossed 3",
        ),
        (_exposed, "must state exposure_s for every image, both or neither"),
        (crossed_with(leds=[1, 2, 3, 0]), "list both series in the same order"),
        (crossed_with(leds=[4, 5, 6, 7]), "which is a 'nir' LED"),
        (crossed_with(images=[f"white_{k}.png" for k in range(4)]), "twice"),
        (lambda d: d["bands"].pop("white"), "bands: Object missing required field white"),
        (lambda d: d["bands"].update(red={}), "bands: "),
    ],
)
def test_series_that_do_not_match_are_refused(polarised, tmp_path, change, words):
    write_capture(polarised, tmp_path / "c")
    edit(tmp_path / "c" / "capture.json", change)
    with bad_input(r"capture\.json") as refused:
        read_capture(tmp_path / "c")
    assert words in str(refused.value)


def test_polarised_series_with_coloured_leds_are_refused(polarised, tmp_path):
    write_capture(polarised, tmp_path / "c")

    def paint(rig):
        for led, colour in zip(rig["leds"][:4], ("red", "green", "blue", "red"), strict=True):
            led["colour"] = colour

    edit(tmp_path / "c" / "rig.json", paint)
    with bad_input("polarised series are lit by white LEDs"):
        read_capture(tmp_path / "c")
    with bad_input("polarised series are lit by white LEDs"):
        with_rig(polarised, tmp_path / "c" / "rig.json")


def test_another_rig_must_hold_the_leds_of_both_series(polarised, tmp_path):
    capture = neighbours(polarised)
    brighter = replace(
        capture.rig, leds=tuple(replace(led, intensity=2.0) for led in capture.rig.leds)
    )
    write_rig(brighter, tmp_path / "new.json")
    assert with_rig(capture, tmp_path / "new.json").rig.leds[8].intensity == 2.0
    write_rig(replace(brighter, leds=brighter.leds[:8]), tmp_path / "short.json")
    with pytest.raises(BadInput, match=r"white_crossed\.leds: LED 8 is not in the rig"):
        with_rig(capture, tmp_path / "short.json")


def test_without_films_the_light_is_the_mean_of_both_series_under_both_leds(polarised):
    capture = neighbours(polarised)
    crossed = replace(
        capture.bands["white_crossed"],
        exposure=np.full(4, 2.0),
        ambient=Ambient(np.full((40, 30, 3), 4, np.uint8)),
    )
    both = observe(replace(capture, bands={**capture.bands, "white_crossed": crossed}))
    white = both.without_films().white
    assert white.lights == ((0, 8), (1, 9), (2, 10), (3, 11))
    assert white.grey.shape == (4, 40, 30)
    parallel, dark = both.white.grey, both.bands["white_crossed"].grey
    np.testing.assert_allclose(white.grey, 0.5 * (parallel + dark), atol=1e-6)


@pytest.mark.parametrize("ambient", [0, 20])
@pytest.mark.parametrize("clips", ["white", "white_crossed"])
def test_a_pixel_that_clips_in_either_series_clips_in_the_mean(polarised, clips, ambient):
    pixels = polarised.bands[clips].pixels.copy()
    pixels[1, 20, 15, :2] = 255
    pixels[2, 20, 15, :1] = 255  # of one channel: the others carry the shading
    room = Ambient(np.full(pixels.shape[1:], ambient, np.uint8)) if ambient else None
    band = replace(polarised.bands[clips], pixels=pixels, ambient=room)
    both = observe(replace(polarised, bands={**polarised.bands, clips: band}))
    white = both.without_films().white
    clipped = white.grey >= white.clips_at[:, None, None] - 1e-6
    assert np.argwhere(clipped).tolist() == [[1, 20, 15]]


def test_polarised_captures_are_not_composed_into_coloured_exposures(polarised):
    with bad_input("this capture is polarised"):
        as_lit(polarised, LightsSettings(compose=1))


def test_the_document_lists_both_series(polarised, tmp_path):
    write_capture(polarised, tmp_path / "c")
    bands = json.loads((tmp_path / "c" / "capture.json").read_text())["bands"]
    assert bands["white"]["polarisation"] == "parallel"
    assert bands["white_crossed"] == {
        "images": [f"white_crossed_{k}.png" for k in range(4)],
        "leds": [0, 1, 2, 3],
        "polarisation": "crossed",
    }
