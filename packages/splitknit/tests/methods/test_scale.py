"""A scale that nobody measured is stated later, or taken from the ridges; odd ones are doubted."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from dome_photographs import dome
from refusals import bad_input
from splitknit.methods import scale
from splitknit.methods.scale import with_scale, with_working_scale
from splitknit.observation.plain import capture_of_arrays
from splitknit.plausible import USUAL_RIDGE_PERIOD_MM

PERIOD_PX = 9.0
SIDE = 300


@cache
def ridged():
    """A flat thing with waves 9 px apart, and no scale."""
    rows, columns = np.indices((SIDE, SIDE))
    slope = 0.25 * np.cos(2 * np.pi * columns / PERIOD_PX)
    normals = np.stack([-slope, 0 * slope, np.ones_like(slope)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    azimuth = np.radians(np.arange(0, 360, 60))
    lights = np.stack([0.5 * np.cos(azimuth), 0.5 * np.sin(azimuth), 0 * azimuth + 0.85], axis=1)
    images = 0.6 * np.einsum("lk,hwk->lhw", lights, normals)
    images = np.clip(images + np.random.default_rng(0).normal(0, 0.002, images.shape), 0, 1)
    mask = np.hypot(rows - SIDE / 2, columns - SIDE / 2) < 0.48 * SIDE
    capture, _ = capture_of_arrays(
        np.rint(65535 * images).astype(np.uint16), lights, mask, None, np.ones(6)
    )
    return capture


def camera_of(capture):
    return capture.rig.camera


def with_camera(capture, **changes):
    return replace(capture, rig=replace(capture.rig, camera=replace(camera_of(capture), **changes)))


def codes(notes):
    return [note.code for note in notes]


class TestStated:
    def test_nothing_stated_leaves_the_capture(self):
        capture = ridged()
        assert with_scale(capture) == (capture, "")

    def test_pixels_a_millimetre_are_taken(self):
        capture, note = with_scale(ridged(), 20.0)
        assert (camera_of(capture).px_per_mm, camera_of(capture).scale_known) == (20.0, True)
        assert note == ""
        assert "scale" not in capture.rig.provenance

    def test_the_period_of_the_ridges_gives_it(self):
        capture, note = with_scale(ridged(), ridge_period_mm=0.5)
        assert camera_of(capture).px_per_mm == pytest.approx(PERIOD_PX / 0.5, rel=0.03)
        assert camera_of(capture).scale_known
        assert capture.rig.provenance["scale"] == note
        assert note.startswith("scale from the ridges")

    def test_other_provenance_is_kept(self):
        origin = {"calibrated": "yesterday"}
        capture = replace(ridged(), rig=replace(ridged().rig, provenance=origin))
        assert with_scale(capture, ridge_period_mm=0.5)[0].rig.provenance.keys() == {
            "calibrated",
            "scale",
        }

    def test_a_second_scale_is_refused(self):
        with bad_input(r"scale already: 10 px/mm"):
            with_scale(with_camera(ridged(), px_per_mm=10.0, scale_known=True), 20.0)
        with bad_input("both give the scale"):
            with_scale(ridged(), 20.0, 0.5)


class TestWorking:
    def test_skin_of_unknown_scale_has_its_ridges_at_the_usual_distance(self):
        skin = replace(ridged(), material="skin")
        capture, notes = with_working_scale(skin)
        assert camera_of(capture).px_per_mm == pytest.approx(
            PERIOD_PX / USUAL_RIDGE_PERIOD_MM, rel=0.03
        )
        assert not camera_of(capture).scale_known
        assert notes == ()

    def test_objects_keep_an_unknown_scale(self):
        assert with_working_scale(ridged()) == (ridged(), ())
        odd = with_camera(ridged(), px_per_mm=0.05)
        assert with_working_scale(odd) == (odd, ())

    @pytest.mark.parametrize(
        ("px_per_mm", "codes_expected"), [(10.0, []), (0.05, ["odd-view"]), (400.0, [])]
    )
    def test_an_odd_view_of_an_object_is_noted(self, px_per_mm, codes_expected):
        capture = with_camera(ridged(), px_per_mm=px_per_mm, scale_known=True)
        same, notes = with_working_scale(capture)
        assert same is capture
        assert codes(notes) == codes_expected
        if notes:
            assert "0.05 px/mm (`px_per_mm`), as all lengths follow it" in str(notes[0])
            assert "6000 mm" in str(notes[0])

    def test_an_odd_view_of_skin_is_noted(self):
        skin = replace(with_camera(ridged(), px_per_mm=40.0, scale_known=True), material="skin")
        same, notes = with_working_scale(skin)
        assert same is skin
        assert codes(notes) == ["odd-view"]
        assert "40 px/mm" in str(notes[0])

    @pytest.mark.parametrize(("factor", "noted"), [(1.0, 0), (0.1, 1), (8.0, 1)])
    def test_leds_nearer_or_farther_than_usual_are_noted(self, factor, noted):
        capture = replace(with_camera(ridged(), px_per_mm=10.0, scale_known=True), material="skin")
        places = [(60.0 * factor, 0.0, 80.0 * factor), (0.0, 60.0 * factor, 80.0 * factor)]
        leds = tuple(
            replace(led, direction=None, position_mm=place)
            for led, place in zip(capture.rig.leds[:2], places, strict=True)
        )
        near = replace(capture, rig=replace(capture.rig, leds=(*leds, *capture.rig.leds[2:])))
        _, notes = with_working_scale(near)
        assert codes(notes) == ["odd-led-distance"] * noted * 2
        for note in notes:
            assert "position_mm, millimetres" in str(note)
            assert f"{100 * factor:g} mm" in str(note)


def test_plain_normals_look_for_no_finger(monkeypatch):
    asked = []
    monkeypatch.setattr(
        scale, "photographs_of", lambda capture, settings: asked.append(capture.material) or dome()
    )
    normals, mask = scale._plain_normals(replace(ridged(), material="skin"))
    assert asked == ["opaque"]
    assert normals.shape == (*mask.shape, 3)
    np.testing.assert_allclose(np.linalg.norm(normals[mask], axis=-1), 1.0, atol=1e-5)
