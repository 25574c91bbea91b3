"""The flat field as a model: what the twin shows of a card is found again, and nothing else is
called a card."""

from dataclasses import replace

import numpy as np
import pytest

from refusals import bad_input
from splitknit.model import Led
from splitknit.nominal import default_rig, nominal_rig
from splitknit_rig.calibration.card_model import CardPlane, card_light
from splitknit_rig.calibration.flat_field import fit_flat_field
from splitknit_simulator.rigs import built_rig
from white_cards import as_placed, scene_of

STEP = 6
NOISE = 0.003


@pytest.fixture(scope="module")
def rig():
    return built_rig(3, scale=0.08)


def grid(camera, step=STEP):
    rows, columns = np.mgrid[0 : camera.image_size[0] : step, 0 : camera.image_size[1] : step]
    return np.stack([columns.ravel(), rows.ravel()], axis=1).astype(float)


def card_brightness(rig, step=STEP, **card):
    """What the twin sees at the grid's pixels under every LED, no room light."""
    scene = scene_of(rig, 0.0, **card)
    return np.stack(
        [scene.light((k,))[::step, ::step, 0].ravel() for k in range(len(rig.leds))]
    ).astype(float)


def fitted(rig, light, error_mm=0.0):
    """Fit of the grid's light under LEDs whose places are known but for an error."""
    placed = as_placed(rig, error_mm)
    return fit_flat_field(placed.camera, placed.leds, grid(rig.camera), light)


def modelled(rig, *card):
    """Light of a card at the grid's pixels under every LED."""
    pixels = grid(rig.camera)
    return np.stack([card_light(rig.camera, led, pixels, *card) for led in rig.leds])


def relative_error(estimated, truth):
    ratio = estimated / truth
    return np.abs(ratio / np.median(ratio) - 1)


@pytest.mark.parametrize("card", [CardPlane(), CardPlane(8.0), CardPlane(2.0, (1.5, -1.0))])
@pytest.mark.parametrize("model", ["perspective", "orthographic"])
def test_the_model_agrees_with_the_simulated_card(rig, card, model):
    if model == "orthographic":
        rig = replace(rig, camera=replace(rig.camera, model=model))
    truth = card_brightness(rig, reflectance=1.0, height_mm=card.height_mm, tilt_deg=card.tilt_deg)
    assert np.abs(modelled(rig, card) / truth - 1).max() < 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("error_mm", [0.0, 1.0])
def test_light_and_lens_are_measured_although_places_are_off(rig, error_mm):
    """Places exact or a millimetre off: aims and beams make up for it on the plane, and nearly so
    above it."""
    noise = 1 + NOISE * np.random.default_rng(0).standard_normal((14, len(grid(rig.camera))))
    truth = card_brightness(rig)
    flat = fitted(rig, truth * noise, error_mm)
    assert relative_error(modelled(flat), truth).max() < 0.006
    above = modelled(flat, CardPlane(10.0))
    assert relative_error(above, card_brightness(rig, height_mm=10.0)).max() < 0.012
    assert np.abs(flat.rms_percent - 100 * NOISE).max() < 0.03
    assert np.mean([led.intensity for led in flat.leds]) == pytest.approx(1, abs=1e-5)
    assert flat.card_level > 0
    if error_mm == 0:
        beams = np.array([led.lobe_exponent for led in flat.leds]) - [
            led.lobe_exponent for led in rig.leds
        ]
        assert np.abs(beams / flat.exponent_error).max() < 5
        aims = [
            np.rad2deg(np.arccos(np.clip(a.axis @ b.axis, -1, 1)))
            for a, b in zip(flat.leds, rig.leds, strict=True)
        ]
        assert max(aims) < 1.0


@pytest.mark.slow
def test_a_plain_lens_and_beams_without_aims_come_out_as_such():
    rig = default_rig(0.08, seed=4)
    noise = 1 + 0.002 * np.random.default_rng(1).standard_normal((14, len(grid(rig.camera))))
    flat = fit_flat_field(rig.camera, rig.leds, grid(rig.camera), card_brightness(rig) * noise)
    assert np.abs(flat.camera.shading).max() < 0.01
    assert [led.intensity for led in flat.leds] == pytest.approx(
        [led.intensity / np.mean([each.intensity for each in rig.leds]) for led in rig.leds],
        rel=2e-3,
    )
    assert relative_error(modelled(flat), card_brightness(rig)).max() < 0.004
    beams = nominal_rig(0.08)
    flat = fitted(beams, card_brightness(beams) * noise)
    for k in (0, 7):
        assert flat.leds[k].lobe_exponent == pytest.approx(beams.leds[k].lobe_exponent, abs=0.6)
    assert relative_error(modelled(flat), card_brightness(beams)).max() < 0.004


@pytest.mark.slow
def test_dust_is_left_out_of_the_fit(rig):
    pixels = grid(rig.camera)
    truth = card_brightness(rig)
    dusty = truth * (1 + 0.001 * np.random.default_rng(2).standard_normal(truth.shape))
    specks = np.random.default_rng(3).choice(len(pixels), len(pixels) // 50, replace=False)
    dusty[:, specks] *= 0.8
    flat = fitted(rig, dusty)
    assert relative_error(modelled(flat), truth).max() < 0.004
    assert flat.dust[specks].all()
    assert flat.dust.mean() == pytest.approx(len(specks) / len(pixels), abs=0.005)
    assert flat.rms_percent.max() < 0.12


@pytest.mark.slow
def test_a_card_that_ends_in_the_picture_is_refused(rig):
    pixels, light = grid(rig.camera), card_brightness(rig)
    light[:, pixels[:, 0] < 0.2 * rig.camera.image_size[1]] *= 0.02
    with bad_input(r"does not fill the field: 2[01] % of the picture"):
        fitted(rig, light)


def test_a_card_with_a_pattern_is_refused(rig):
    pixels, light = grid(rig.camera), card_brightness(rig)
    light[:, (pixels[:, 0] // 12 + pixels[:, 1] // 12) % 2 == 0] *= 0.75
    with bad_input("not uniform"):
        fitted(rig, light)


def test_an_led_that_did_not_light_is_named(rig):
    light = card_brightness(rig)
    light[9] *= 0.05
    with bad_input(r"LED 9 \(nir\) shows the card at 5 % .* did not light"):
        fitted(rig, light)


@pytest.mark.slow
def test_the_gloss_of_a_card_is_measured(rig):
    light = card_brightness(rig)
    points = CardPlane().points(rig.camera, grid(rig.camera))
    sight = np.array([0.0, 0.0, rig.camera.height_mm]) - points
    sight /= np.linalg.norm(sight, axis=1, keepdims=True)
    towards = [np.asarray(led.position_mm) - points for led in rig.leds]
    half = np.stack([way / np.linalg.norm(way, axis=1, keepdims=True) + sight for way in towards])
    angles = np.rad2deg(np.arccos(half[..., 2] / np.linalg.norm(half, axis=2)))
    shiny = fitted(rig, light * (1 + 0.05 * np.exp(-0.5 * (angles / 5) ** 2)))
    assert abs(fitted(rig, light).gloss_percent) < 0.3
    assert shiny.gloss_percent > 3 and shiny.gloss_percent > 10 * shiny.gloss_error


def test_black_images_distant_leds_and_high_cards_are_refused(rig):
    pixels, light = grid(rig.camera), card_brightness(rig)
    with bad_input("black"):
        fitted(rig, 0 * light)
    distant = [Led(band="white", direction=(0, 0, 1))] * 14
    with bad_input("position_mm"):
        fit_flat_field(rig.camera, distant, pixels, light)
    with bad_input("below the camera"):
        card_light(rig.camera, rig.leds[0], pixels, CardPlane(200.0))
