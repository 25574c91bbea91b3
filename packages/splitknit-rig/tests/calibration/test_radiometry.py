"""A capture of a white card calibrates a rig; a later one is compared with it; what cannot be used
is named."""

from dataclasses import replace

import numpy as np
import pytest

from refusals import bad_input
from splitknit.io.provenance import canonical_json
from splitknit.io.rig import rig_from_json, rig_to_json
from splitknit.model import Rig
from splitknit_rig.calibration.card_model import CardPlane, card_light
from splitknit_rig.calibration.radiometry import PROVENANCE, fit_radiometry
from splitknit_simulator.rigs import built_rig, with_side_lights
from white_cards import as_placed, photograph, scene_of

EXPOSURES = (6.0, 6.0)


@pytest.fixture(scope="module")
def rig():
    return built_rig(5, scale=0.1)


@pytest.fixture(scope="module")
def capture(rig):
    return photograph(rig, as_placed(rig), exposures=EXPOSURES)


@pytest.fixture(scope="module")
def calibrated(rig, capture):
    return fit_radiometry(capture, as_placed(rig))


def worst(rig, calibrated, height_mm=0.0):
    """Largest error of the flat field on a card, one factor a band free."""
    scene = scene_of(rig, 0.0, height_mm=height_mm)
    rows, columns = np.mgrid[0 : rig.camera.image_size[0] : 9, 0 : rig.camera.image_size[1] : 9]
    pixels = np.stack([columns.ravel(), rows.ravel()], axis=1).astype(float)
    errors = []
    for k, led in enumerate(calibrated.leds):
        truth = scene.light((k,))[::9, ::9, 0].ravel()
        errors.append(card_light(calibrated.camera, led, pixels, CardPlane(height_mm)) / truth)
    ratio = np.stack(errors)
    halves = [ratio[:7] / np.median(ratio[:7]), ratio[7:] / np.median(ratio[7:])]
    return max(float(np.abs(half - 1).max()) for half in halves)


def with_white(capture, **changes):
    white = replace(capture.bands["white"], **changes)
    return replace(capture, bands={**capture.bands, "white": white})


@pytest.mark.slow
def test_a_card_calibrates_side_lights(rig):
    """18 deg above the card: brightness, beam and aim of 21 LEDs."""
    whole = with_side_lights(rig, 7)
    calibrated = fit_radiometry(photograph(whole, as_placed(whole)), as_placed(whole))
    ratio = np.array([led.intensity for led in calibrated.rig.leds]) / [
        led.intensity for led in whole.leds
    ]
    assert np.abs(ratio / np.median(ratio) - 1).max() < 0.02
    pixels = np.array([[60.0, 60.0], [160.0, 110.0], [260.0, 160.0]])
    for k in range(14, 21):
        truth = card_light(whole.camera, whole.leds[k], pixels)
        light = card_light(calibrated.rig.camera, calibrated.rig.leds[k], pixels) / ratio[k]
        assert np.abs(light / truth / np.median(light / truth) - 1).max() < 0.02


def test_the_flat_field_is_right_within_half_a_per_cent(rig, calibrated):
    """Photographs with noise and room light; on the finger plane and at a finger's height."""
    assert worst(rig, calibrated.rig) < 0.003
    assert worst(rig, calibrated.rig, 10.0) < 0.004


@pytest.mark.slow
def test_a_known_tilt_of_the_card_is_corrected(rig):
    """Known, the tilt does no harm; unknown, it goes into the LEDs' brightness."""
    tilt = (0.6, -0.5)
    capture = photograph(
        rig,
        as_placed(rig),
        scene=lambda own: scene_of(own, height_mm=1.5, tilt_deg=tilt),
        exposures=EXPOSURES,
    )
    known = fit_radiometry(capture, as_placed(rig), CardPlane(1.5, tilt))
    assert worst(rig, known.rig) < 0.003
    unknown = fit_radiometry(capture, as_placed(rig), CardPlane(1.5))
    assert 0.004 < worst(rig, unknown.rig) < 0.015


def test_the_provenance_states_the_fit_of_every_led(rig, calibrated):
    facts = calibrated.rig.provenance[PROVENANCE]
    assert facts is calibrated.facts
    assert [led["name"] for led in facts["leds"]] == [
        f"{b} {k}" for b in ("white", "nir") for k in range(7)
    ]
    assert all(led["verdict"] == "good" and led["rms_percent"] < 0.4 for led in facts["leds"])
    assert facts["ambient_percent"]["white"] == pytest.approx(0.2, abs=0.05)
    assert facts["lens"]["corner"] == pytest.approx(1 + sum(rig.camera.shading), abs=0.01)
    again = rig_from_json(rig_to_json(calibrated.rig))
    assert canonical_json(again.provenance) == canonical_json(calibrated.rig.provenance)
    assert again.leds == calibrated.rig.leds
    assert calibrated.findings == ()


@pytest.mark.slow
def test_ambient_light_gets_a_finding_and_is_subtracted(rig):
    placed = as_placed(rig)
    bright = photograph(rig, placed, scene=lambda own: scene_of(own, 0.08), exposures=EXPOSURES)
    lit = fit_radiometry(bright, placed)
    assert {finding.code for finding in lit.findings} == {"ambient-light"}
    assert str(lit.findings[0]).startswith("light from elsewhere is 8")
    assert worst(rig, lit.rig) < 0.004
    bands = {name: replace(band, ambient=None) for name, band in bright.bands.items()}
    without = fit_radiometry(replace(bright, bands=bands), placed, limit_percent=5)
    absent = [str(each) for each in without.findings if each.code == "no-ambient-image"]
    assert absent[0].startswith("there is no ambient image of the band white")
    assert worst(rig, without.rig) > 0.005


def test_an_image_of_each_led_alone_is_required(rig, capture):
    placed = as_placed(rig)
    white = capture.bands["white"]
    names = "pixels", "leds", "exposure", "black_level"
    short = with_white(capture, **{name: getattr(white, name)[:6] for name in names})
    with bad_input(r"13 images for the rig's 14 LEDs: LED 6 \(white 6\) is missing"):
        fit_radiometry(short, placed)
    with bad_input(r"LED 7 \(nir 0\), 8 \(nir 1\), .* are missing"):
        fit_radiometry(replace(capture, bands={"white": white}), placed)
    for last, words in (
        ((0,), r"LED 0 \(white 0\) lights two images"),
        ((5, 6), "is lit by 2 LEDs"),
    ):
        with bad_input(words):
            fit_radiometry(with_white(capture, leds=(*white.leds[:6], last)), placed)


def test_black_and_clipped_images_are_refused(rig, capture):
    placed = as_placed(rig)

    def with_image(k, change):
        pixels = capture.bands["white"].pixels.copy()
        pixels[k] = change(pixels[k])
        files = tuple(f"white_{j}.png" for j in range(7))
        return with_white(capture, pixels=pixels, files=files)

    with bad_input(r"white_3.png is black \(.*\): LED 3 \(white 3\) did not light"):
        fit_radiometry(with_image(3, lambda image: image // 200), placed)
    with bad_input(r"white_2.png is clipped: .* at full scale .*; take the card with a shorter"):
        fit_radiometry(
            with_image(2, lambda image: np.minimum(image.astype(int) * 2, 65535).astype("u2")),
            placed,
        )


@pytest.mark.slow
def test_a_card_with_a_shadow_is_refused(rig, capture, monkeypatch):
    placed = as_placed(rig)
    shadowed = capture.bands["white"].pixels.copy()
    shadowed[4, :, 100:160] = shadowed[4, :, 100:160] // 10 * 9
    with (
        monkeypatch.context() as patch,
        bad_input(r"LED 4 \(white 4\) lights the card otherwise .*rms is \d"),
    ):
        patch.setattr("splitknit_rig.calibration.flat_field.DUST_PERCENT", 50.0)
        fit_radiometry(with_white(capture, pixels=shadowed), placed)
    with bad_input("lights the card otherwise"):
        fit_radiometry(capture, placed, limit_percent=0.02)


def test_rigs_that_do_not_match_the_capture_are_refused(rig, capture):
    placed = as_placed(rig)
    with bad_input("220 x 320 pixels, but the rig's camera has 110 x 160"):
        fit_radiometry(capture, as_placed(built_rig(5, scale=0.05)))
    with bad_input("a rig of 14 LEDs, but the rig to calibrate has 7"):
        fit_radiometry(capture, Rig(placed.camera, placed.leds[:7]))
    distant = replace(placed.leds[0], position_mm=None, direction=(0.0, 0.0, 1.0))
    with bad_input("LED 0 of the rig has a direction, but no position_mm; calibrate the lights"):
        fit_radiometry(capture, Rig(placed.camera, (distant, *placed.leds[1:])))


@pytest.mark.slow
def test_a_mottled_card_is_refused_as_such(rig, capture):
    rows, columns = rig.camera.image_size
    signs = (np.sign(np.sin(np.arange(n) / period)) for n, period in ((rows, 6), (columns, 7)))
    spots = 1 + 0.017 * np.multiply.outer(*signs)[..., None]
    bands = {
        name: replace(band, pixels=np.round(band.pixels * spots).astype(np.uint16))
        for name, band in capture.bands.items()
    }
    with bad_input(r"the card is not uniform: it differs by 1\.\d % from place to place"):
        fit_radiometry(replace(capture, bands=bands), as_placed(rig))
