"""Lights to the side of the finger: in the twin, and what presets make of them."""

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

import splitknit
import splitknit_simulator
from splitknit.finger import steady
from splitknit.finger.locate import Finger
from splitknit.imaging.light_field import lights_in_front
from splitknit.model import Led, Rig
from splitknit.nominal import default_rig
from splitknit.observation.observe import observe
from splitknit_simulator.light.lighting import arriving, cut_out, dot, towards
from splitknit_simulator.rigs import with_side_lights
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.twin import lay_down

SIDE = 5


@pytest.fixture(scope="module")
def lit():
    settings = {"scale": 0.12, "side_lights": SIDE}
    return splitknit_simulator.simulate_capture(3, settings=settings)[0]


def _chosen(band, count):
    names = "pixels", "leds", "exposure", "black_level", "files"
    return replace(band, **{name: getattr(band, name)[:count] for name in names})


def test_side_lights_are_as_bright_as_the_ring_at_the_finger():
    rig = with_side_lights(default_rig(0.1), SIDE)
    added = rig.leds[14:]
    assert len(added) == SIDE
    for led in added:
        assert led.position_mm is not None
        assert np.hypot(*led.position_mm[:2]) == pytest.approx(90.0)
        assert led.intensity / (90**2 + 30**2) == pytest.approx(1 / 140**2, rel=1e-4)


def test_a_low_light_casts_shadows_of_the_finger_and_a_high_one_none():
    rig = with_side_lights(default_rig(0.12), 3)
    patch = cut_out(lay_down(3, None, TwinSettings(scale=0.12, rig=rig))[0], shadows=True)
    inner = patch.mask & (patch.normal[2] > 0.2)
    for led, least in ((rig.leds[0], 1.0), (rig.leds[14], 0.0)):
        free = (arriving(patch, led)[1] / towards(led, patch.points)[1])[inner]
        assert float(free.min()) == least
        assert float(free.mean()) > 0.3
    # the flank that faces it, as far as the outline
    facing = dot(towards(led, patch.points)[0], patch.normal)[inner]
    assert float(np.mean(free[facing > 0.7])) > 0.99


@pytest.mark.slow
def test_side_lights_lower_the_ridge_error_without_films():
    lit, truth = splitknit_simulator.simulate_capture(3, settings={"scale": 0.25, "side_lights": 7})
    ring = replace(lit, bands={**lit.bands, "white": _chosen(lit.bands["white"], 7)})
    both, before = (splitknit.reconstruct(capture) for capture in (lit, ring))
    assert both.facts["optics"]["relief_by"] == "side"
    assert both.facts["optics"]["specular"]["side_lights"] == 7
    assert both.facts["heights"] == "modelled"
    assert not any(
        "from the side" in warning or "to the side" in warning for warning in both.warnings
    )
    errors = [
        splitknit_simulator.compare(result, truth).figures["ridge_rms_um"]
        for result in (both, before)
    ]
    assert errors[0] < 0.95 * errors[1], errors


@pytest.mark.parametrize(
    ("off_deg", "front"),
    [
        ([20] * 7 + [38], 7),  # one light would lean the shape towards itself
        ([20] * 7 + [29] * 2, 9),
        ([26] * 7 + [38], 8),  # within 1.5 times the sixth
        ([38] * 7, 7),
        ([20] * 5 + [44], 6),  # six are needed
        ([20] * 4 + [44], 5),
        ([38] * 7 + [46], 7),
        ([72] * 7 + [20] * 4, 4),
    ],
)
def test_side_lights_are_distinguished_by_their_angles(off_deg, front):
    across, up = np.sin(np.deg2rad(off_deg)), np.cos(np.deg2rad(off_deg))
    turn = np.arange(len(off_deg))
    towards = np.stack([across * np.cos(turn), across * np.sin(turn), up], axis=1)
    in_front = lights_in_front(
        Rig(
            default_rig(0.1).camera,
            tuple(Led("white", direction=tuple(direction)) for direction in towards),
        )
    )
    assert in_front.sum() == front
    assert max(np.array(off_deg)[in_front]) < min(np.array(off_deg)[~in_front], default=90.0)


@pytest.mark.parametrize(("common_mm", "moved"), [(0.0, False), (0.04, True)])
def test_motion_before_the_side_images_is_the_common_shift(lit, monkeypatch, common_mm, moved):
    """Each light seems to shift the ridges along itself; what could not be registered says
    nothing."""
    parted = observe(lit)
    assert parted.side is not None
    towards = parted.side.rig.light_vectors()[:, :2]
    shifts = -0.05 * towards / np.linalg.norm(towards, axis=1, keepdims=True) + (common_mm, 0.0)
    shifts[[0, 4]] = 0.0  # went astray
    facts = {"motion_white_crossed": {"shift_mm": shifts.tolist()}}
    monkeypatch.setattr(steady, "register", lambda *_, **__: SimpleNamespace(facts=facts))
    kept, findings = steady.without_moved_side(parted, cast("Finger", None))
    assert [finding.code for finding in findings] == ["side-moved"] * moved
    assert (kept is parted) is not moved
