"""Photographs of a finger and its surface in the full picture."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from dome_photographs import COLOUR, PX_PER_MM, dome, with_nir
from refusals import bad_input
from splitknit.findings import Finding, Severity
from splitknit.methods import photographs as module
from splitknit.methods.photographs import (
    FingerSurface,
    findings_for,
    photographs_of,
    placed,
    side_unused,
)
from splitknit.methods.thesis import thesis_surface
from splitknit.presets import PRESETS, override

EA, SNK, METRIC = PRESETS["ea"], PRESETS["snk"], PRESETS["metric"]


@pytest.fixture(scope="module")
def photographs():
    return dome()


class TestBands:
    @pytest.mark.parametrize(
        ("settings", "names"),
        [
            (METRIC, ["white", "nir"]),
            (override(METRIC, {"shape.source": "white"}), ["white"]),
            (EA, ["white"]),
        ],
    )
    def test_the_near_infrared_band_is_taken_for_a_shape_of_its_own(
        self, photographs, settings, names
    ):
        bands = with_nir(photographs).bands(settings)
        assert [light.name for light in bands] == names

    def test_white_serves_for_both_where_there_is_no_other(self, photographs):
        white, nir = photographs.white_and_nir(METRIC, 3.0)
        assert white == nir
        assert (white.plane_mm, white.light.name) == (3.0, "white")
        both = with_nir(photographs).white_and_nir(METRIC, 0.0)
        assert [part.light.name for part in both] == ["white", "nir"]

    def test_a_band_has_its_own_lights_and_the_cameras_scale(self, photographs):
        taken = with_nir(photographs)
        _, nir = taken.white_and_nir(METRIC, 0.0)
        assert {led.band for led in nir.rig.leds} == {"nir"}
        assert len(nir.rig.leds) == 8
        assert (nir.px_per_mm, nir.pitch_mm) == (PX_PER_MM, 1 / PX_PER_MM)
        assert_array_equal(nir.inside, taken.finger.wider[taken.finger.window])

    def test_findings_of_the_search_and_the_diagnosis_are_kept(self, photographs, monkeypatch):
        noted, doubted = Finding("hollow", "a note."), Finding("spoilt", "a doubt.", Severity.DOUBT)
        finger = replace(photographs.finger, findings=(noted,))
        observation = photographs.observation
        monkeypatch.setattr(module, "locate_finger", lambda *_: (observation, finger))
        monkeypatch.setattr(module, "diagnose", lambda *_, **__: (observation, finger, (doubted,)))
        assert photographs_of(None, EA.finding()).findings == (doubted, noted)


class TestFindings:
    def codes(self, photographs, settings, *findings):
        found = replace(photographs, findings=findings)
        return [finding.code for finding in findings_for(found, settings)]

    def test_the_worst_stands_first(self, photographs):
        findings = (
            Finding("hollow", "a note."),
            Finding("spoilt", "a doubt.", Severity.DOUBT, band="white"),
        )
        assert self.codes(photographs, EA, *findings) == ["spoilt", "hollow"]

    def test_what_is_wrong_with_an_unused_band_is_left_out(self, photographs):
        findings = (
            Finding("spoilt", "a doubt.", Severity.DOUBT, band="nir"),
            Finding("noted", "a note.", band="nir"),
            Finding("whitened", "a doubt.", Severity.DOUBT, band="white"),
        )
        assert self.codes(photographs, EA, *findings) == ["whitened", "noted"]
        both = with_nir(photographs)
        assert self.codes(both, METRIC, *findings) == ["spoilt", "whitened", "noted"]

    @pytest.mark.parametrize(
        ("settings", "material", "noted"),
        [
            (SNK, "skin", True),
            (SNK, "opaque", False),
            (EA, "skin", False),
            (override(SNK, {"shape.source": "white"}), "skin", False),
        ],
    )
    def test_skin_without_near_infrared_light_is_noted(
        self, photographs, settings, material, noted
    ):
        observation = replace(photographs.observation, material=material)
        alone = replace(photographs, observation=observation)
        assert ("no-nir" in self.codes(alone, settings)) == noted

    def test_unused_side_lights_are_noted_by_the_thesis_cases_alone(self, photographs):
        observation = photographs.observation
        lit = replace(observation, side=observation.white.of_images([0, 1, 2]))
        from_side = replace(photographs, observation=lit)
        assert "side-unused" in self.codes(from_side, EA)
        assert "side-unused" not in self.codes(from_side, METRIC)

    def test_the_count_of_unused_lights_is_said(self):
        finding = side_unused(3)
        assert finding.code == "side-unused"
        assert str(finding).startswith("the 3 white images")


@pytest.fixture(scope="module")
def surface(photographs):
    return thesis_surface(photographs, EA)


@pytest.fixture(scope="module")
def result(photographs, surface):
    return placed(photographs, surface, 0.0)


class TestPlaced:
    def test_fields_lie_in_the_window_of_the_full_picture(self, photographs, surface, result):
        mask, window = photographs.finger.mask, photographs.finger.window
        inside = mask[window]
        for name in ("ridge_mm", "albedo"):
            whole = getattr(result, name)
            assert whole.dtype == np.float32
            assert np.isnan(whole[~mask]).all()
            assert_array_equal(whole[window][inside], getattr(surface, name)[inside])
        # a height above the plane is not known, so that only differences count
        difference = (result.height_mm[window] - surface.height_mm)[inside]
        assert np.ptp(difference) < 1e-5

    def test_parts_sum_to_the_height(self, result):
        mask = result.mask
        assert_allclose(
            (result.shape_mm + result.ridge_mm)[mask], result.height_mm[mask], atol=1e-5
        )

    def test_vectors_are_zero_outside_without_negative_zeros(self, result):
        for vectors in (result.normals, result.normals_measured):
            assert vectors.dtype == np.float32
            outside = vectors[~result.mask]
            assert (outside == 0).all()
            assert not np.signbit(outside).any()
            assert_allclose(np.linalg.norm(vectors[result.mask], axis=-1), 1.0, atol=1e-5)

    def test_what_is_not_measured_is_none(self, photographs, surface):
        bare = replace(surface, normals=None, colour=None, uncertainty_um=None)
        result = placed(photographs, bare, 0.0)
        assert result.normals_measured is None
        assert result.colour is None
        assert result.uncertainty_um is None

    def test_colour_and_uncertainty_are_placed(self, photographs, surface):
        shape = photographs.finger.inside.shape
        known = replace(
            surface,
            colour=np.broadcast_to(np.float32(COLOUR), (*shape, 3)),
            uncertainty_um=np.full(shape, 2.5, dtype=np.float32),
        )
        result = placed(photographs, known, 0.0)
        assert_allclose(
            result.colour[result.mask], np.tile(COLOUR, (result.mask.sum(), 1)), rtol=1e-6
        )
        assert (result.uncertainty_um[result.mask] == 2.5).all()
        assert np.isnan(result.uncertainty_um[~result.mask]).all()

    def test_the_result_states_where_it_comes_from(self, photographs, surface):
        picture = np.ones(photographs.finger.mask.shape, dtype=np.float32)
        lit = replace(photographs.observation, hashes={"a.png": "0" * 64})
        result = placed(replace(photographs, specular=picture, observation=lit), surface, 0.0)
        assert result.specular is picture
        assert result.whole == surface.whole
        assert (result.pitch_mm, result.scale_known) == (1 / PX_PER_MM, True)
        assert result.facts.items() >= {"material": "opaque", **surface.facts}.items()
        assert result.upright_size == photographs.finger.upright.size
        assert result.hashes == {"a.png": "0" * 64}
        assert (result.x_mm, result.y_mm) == (None, None)

    def test_a_relief_along_rays_is_what_the_heights_differ_by(
        self, photographs, surface, monkeypatch
    ):
        shape = photographs.finger.inside.shape
        height, slow = np.full(shape, 3.0), np.full(shape, 2.0)
        normals = np.broadcast_to((0.0, 0.0, 1.0), (*shape, 3))
        monkeypatch.setattr(
            module, "place", lambda *_: (height, slow, normals, np.full(shape, 5.0), 6 * height)
        )
        result = placed(photographs, surface, 0.0)
        assert (result.ridge_mm[result.mask] == 1.0).all()
        assert (result.x_mm[result.mask] == 5.0).all()
        assert (result.y_mm[result.mask] == 18.0).all()


class TestMirrorShape:
    def test_a_surface_kept_whole_has_no_place_for_it(self):
        with bad_input("keeps the visible surface whole"):
            override(EA, {"shape.source": "mirror"})

    @pytest.mark.parametrize(("settings", "detailed"), [(METRIC, True), (SNK, False)])
    def test_the_relief_is_put_on_the_mirrors_shape(self, monkeypatch, settings, detailed):
        photographs = dome()
        shape = photographs.finger.inside.shape
        surface = FingerSurface(
            height_mm=np.full(shape, 3.0),
            ridge_mm=np.full(shape, 0.5),
            shape_mm=np.full(shape, 2.5),
            albedo=np.ones(shape),
            facts={"shape_source": "white", "heights": "measured"},
            findings=(Finding("hollow", "a note."),),
        )
        smaller = photographs.finger.mask.copy()
        smaller[:10] = False
        details = []

        def shape_of(finger, seen, detail_mm):
            details.append(detail_mm)
            return np.full(shape, 7.0), smaller, {"shape_source": "mirror"}

        monkeypatch.setattr("splitknit.mirrors.captured.mirror_shape_of", shape_of)
        seen = type("Seen", (), {"shape": type("Shape", (), {"findings": (Finding("a", "b."),)})})
        monkeypatch.setattr("splitknit.mirrors.captured.seen_in_mirrors", lambda *_: seen)
        cut, mirrored = module.on_mirror_shape(photographs, surface, settings)
        assert (mirrored.height_mm == 7.5).all()
        assert (mirrored.shape_mm == 7.0).all()
        assert mirrored.facts == {"shape_source": "mirror", "heights": "measured"}
        assert [finding.code for finding in mirrored.findings] == ["hollow", "a"]
        assert cut.finger.mask is smaller
        assert photographs.finger.mask is not smaller
        assert (details[0] is not None) == detailed
