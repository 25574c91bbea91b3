"""Steps of the `metric` method one by one: walls, films, lights to the side, notes, pixels."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from dome_photographs import dome, stored_as, with_nir
from refusals import bad_input
from skin_scene import ring
from splitknit import steps
from splitknit.methods import metric
from splitknit.methods.metric import (
    COLOUR_MM,
    DOUBTFUL,
    FAINT,
    JPEG_COARSE,
    JPEG_LOSS,
    JPEG_LOSS_COARSE,
    LITTLE_GLOSS,
    RED_PART,
    SHAPE_MM,
    WALL_OF_STEEP,
    WALL_PART,
    WHITE_ROUGHNESS,
    WHITE_SCATTERED,
)
from splitknit.methods.photometry import MAX_SLOPE
from splitknit.presets import PRESETS
from splitknit.skin.grid import BandImages, Grid
from splitknit.skin.images import SkinImages
from splitknit.skin.learned import GAIN_UNCERTAINTY, Networks
from splitknit.skin.relief import KNIT_MM

METRIC = PRESETS["metric"]
SIDE = 60
PITCH_MM = 0.1


def codes(findings):
    return [finding.code for finding in findings]


def square_grid():
    axis = (np.arange(SIDE) - (SIDE - 1) / 2) * PITCH_MM
    return Grid(np.ones((SIDE, SIDE), bool), axis, -axis, PITCH_MM, (False,) * 4)


def field(seed):
    return np.random.default_rng(seed).uniform(0.1, 1.0, (SIDE, SIDE)).astype(np.float32)


def white_band(seed=0):
    stack = np.random.default_rng(seed).uniform(0.1, 1.0, (3, 7, SIDE, SIDE)).astype(np.float32)
    return BandImages(("red", "green", "blue"), stack, ring("white"))


def skin_images(*, crossed=None, side=None, findings=(), networks=None):
    return SkinImages(
        grid=square_grid(),
        bands=(white_band(), white_band(1)),
        crossed=crossed,
        parallel=ring("white"),
        side=side,
        networks=networks,
        binning=1,
        finer=False,
        place=(slice(0, SIDE), slice(0, SIDE)),
        size=(SIDE, SIDE),
        findings=findings,
    )


def skin_surface(**facts):
    return metric.SkinSurface(field(1), field(2) / 50, field(3) / 500, field(4), facts)


class TestWalls:
    def walls(self, cut, steep, size=1000):
        """Findings of slopes of which `cut` are cut and `steep` more are steep."""
        slopes = np.zeros((1, size))
        slopes[0, :cut] = MAX_SLOPE
        slopes[0, cut : cut + steep] = 0.3 * MAX_SLOPE
        return metric.doubt_of_walls(slopes, 0 * slopes, np.ones((1, size), bool))

    def test_a_surface_without_steep_slopes_has_none(self):
        assert self.walls(0, 0) == ()

    def test_they_are_said_with_their_part_and_slant(self):
        (finding,) = self.walls(20, 10)
        assert finding.code == "steep-walls"
        assert "2.0 % of the surface" in str(finding)
        assert "steeper than 81 deg" in str(finding)
        assert "give a `mask` that ends inside a rim" in str(finding)

    def test_a_few_cut_slopes_are_none(self):
        few = round(WALL_PART * 1000)
        assert codes(self.walls(few, 0)) == ["steep-walls"]
        assert self.walls(few - 1, 0) == ()

    def test_a_ball_has_more_steep_slopes_than_cut_ones(self):
        cut = 20
        most = round(cut / WALL_OF_STEEP) - cut
        assert codes(self.walls(cut, most)) == ["steep-walls"]
        assert self.walls(cut, most + 1) == ()

    def test_both_slopes_count_inside_alone(self):
        slopes = np.full((1, 1000), MAX_SLOPE / np.sqrt(2))
        inside = np.zeros((1, 1000), bool)
        inside[0, :500] = True
        (finding,) = metric.doubt_of_walls(slopes, -slopes, inside)
        assert "100.0 %" in str(finding)
        assert metric.doubt_of_walls(np.where(inside, 0, slopes), 0 * slopes, inside) == ()


class TestOpaque:
    def bands(self):
        white, _ = dome("metric").white_and_nir(METRIC, 0.0)
        pixels = np.roll(white.light.stored.pixels, 2, axis=0)
        return white, stored_as(white, name="nir", pixels=pixels)

    def test_its_facts_name_the_band_of_the_shape_and_the_material(self):
        surface = metric.opaque_surface(dome("metric"), METRIC)
        factor = surface.facts["height_factor_sd"]
        assert surface.facts == {
            "shape_source": "white",
            "separation": metric.OPAQUE,
            "heights": "measured",
            "height_factor_sd": factor,
        }
        assert np.isfinite(surface.uncertainty_um[surface.height_mm > 0]).all()
        assert factor > 0

    def test_a_near_infrared_band_is_named_for_its_shape(self):
        both = with_nir(dome("metric"), 2)
        assert metric.opaque_surface(both, METRIC).facts["shape_source"] == "nir"


class TestFilms:
    @pytest.fixture
    def measured(self, monkeypatch):
        """What the specular image gives, and how it was asked for."""
        asked = SimpleNamespace(skins=[], start=None, films=None, matt=None)
        asked.fit = {
            "specular_over_noise": 2 * FAINT,
            "roughness": WHITE_ROUGHNESS,
            "scattered_over_specular": WHITE_SCATTERED,
            "side_lights": 3,
        }
        asked.height, asked.error = field(7), field(8) / 100

        def metric_skin(bands, grid, skin, p, networks=None):
            asked.skins.append((bands, grid, skin, p, networks))
            return replace(skin_surface(relief_by="network"), albedo=field(len(asked.skins)))

        def heights(images, matt, start, films):
            asked.matt, asked.start, asked.films = matt, start, films
            return asked.height, asked.error, asked.fit

        monkeypatch.setattr(metric, "metric_skin", metric_skin)
        monkeypatch.setattr(metric, "_specular_heights", heights)
        return asked

    def polarised(self, networks="networks", side=None, p=METRIC.metric):
        images = skin_images(crossed=white_band(5), side=side)
        return images, metric.metric_polarised(images, "skin", p, networks)

    def test_heights_are_split_into_a_slow_shape_and_a_relief(self, measured):
        images, surface = self.polarised()
        first = skin_surface()
        rest = measured.height - first.shape_mm
        slow = images.grid.smooth(rest, images.grid.mask, KNIT_MM)
        assert_allclose(surface.shape_mm, first.shape_mm + slow, atol=1e-6)
        assert_allclose(surface.relief_mm, rest - slow, atol=1e-6)
        assert surface.deviation_mm is measured.error
        assert surface.facts == {"relief_by": "polarised", "specular": measured.fit}

    def test_hardly_any_specular_reflection_leaves_the_modelled_surface(self, measured):
        measured.fit["specular_over_noise"] = np.nextafter(FAINT, 0)
        images, surface = self.polarised()
        assert measured.skins[1][0] is images.bands
        assert measured.skins[1][1:] == (images.grid, "skin", METRIC.metric, "networks")
        assert surface.facts == {"relief_by": "network", "specular": measured.fit}
        assert_array_equal(surface.albedo, field(2))
        measured.fit["specular_over_noise"] = FAINT
        assert self.polarised()[1].facts["relief_by"] == "polarised"

    def from_the_side(self):
        images = skin_images(side=(white_band(4), None, ring("white")))
        return images, metric.metric_side(images, "skin", "p", "networks")

    def test_side_lights_give_what_is_finer_than_the_shape(self, measured):
        images, surface = self.from_the_side()
        first, grid = skin_surface(), images.grid
        rest = measured.height - first.shape_mm
        rest = rest - grid.smooth(rest, grid.mask, SHAPE_MM)
        slow = grid.smooth(rest, grid.mask, KNIT_MM)
        assert_allclose(surface.relief_mm, rest - slow, atol=1e-5)
        assert_allclose(surface.shape_mm, first.shape_mm + slow, atol=1e-5)
        assert surface.facts == {"relief_by": "side", "specular": measured.fit}
        assert measured.films is False
        assert measured.skins[0][0] is images.bands

    def test_what_is_white_is_taken_from_both_series(self, measured):
        images, _ = self.from_the_side()
        grid, white = images.grid, images.bands[0]
        red, blue = (grid.smooth(white.stack[c].mean(axis=0), grid.mask, COLOUR_MM) for c in (0, 2))
        part = RED_PART * blue / red
        for band, matt in zip((white, images.side[0]), measured.matt, strict=True):
            expected = band.stack - (band.stack[2] - part * band.stack[0]) / 2
            assert_allclose(matt.stack, expected, atol=1e-5)

    @pytest.mark.parametrize(
        ("name", "value"),
        [
            ("specular_over_noise", np.nextafter(FAINT, 0)),
            ("roughness", np.nextafter(WHITE_ROUGHNESS, 1)),
            ("scattered_over_specular", np.nextafter(WHITE_SCATTERED, 99)),
            ("side_lights", 0),
        ],
    )
    def test_unfit_white_light_is_not_used(self, measured, name, value):
        measured.fit[name] = value
        _, surface = self.from_the_side()
        assert surface.facts == {"relief_by": "network", "specular": measured.fit}
        assert_array_equal(surface.relief_mm, skin_surface().relief_mm)

    def test_white_light_at_its_limits_is_used(self, measured):
        measured.fit["specular_over_noise"] = FAINT
        assert self.from_the_side()[1].facts["relief_by"] == "side"


class TestNotes:
    def notes(self, images=None, **facts):
        facts = {"relief_by": "shading", **facts}
        surface = replace(skin_surface(), facts=facts, relief_mm=0.1 * field(2))
        return metric._findings_on(images or skin_images(), surface)

    def network(self, **facts):
        known = {"relief_rms_um": 20.0, "relief_error_um": 2.0, "gloss": 1.0}
        return self.notes(relief_by="network", **{**known, "gain_uncertainty": 0.2, **facts})

    def test_a_usual_relief_has_none(self):
        assert self.notes() == ()
        assert self.network() == ()

    def test_notes_of_the_images_are_kept(self):
        noted = metric.side_unused(1)
        assert self.notes(skin_images(findings=(noted,))) == (noted,)

    def test_ridges_that_are_hardly_measured_are_noted_with_their_lengths(self):
        assert self.network(relief_error_um=20.0 * DOUBTFUL) == ()
        (note,) = self.network(relief_error_um=15.0)
        assert note.code == "hardly-measured"
        assert note.lengths_mm == (0.02, 0.015)
        assert "20 um rms with an expected error of 15 um" in str(note)

    def test_a_common_factor_is_noted_where_there_is_little_gloss(self):
        assert self.network(gloss=LITTLE_GLOSS) == ()
        (note,) = self.network(gloss=np.nextafter(LITTLE_GLOSS, 0), gain_uncertainty=0.7)
        assert note.code == "little-gloss"
        assert "standard deviation 70 %" in str(note)

    @pytest.mark.parametrize(("crossed", "words"), [(None, "by colour"), ("films", "crossed")])
    def test_unused_specular_light_stands_first(self, crossed, words):
        images = skin_images(crossed=crossed, findings=(metric.side_unused(1),))
        notes = self.notes(images, specular={"side_lights": 0})
        assert codes(notes) == ["specular-unused", "side-unused"]
        assert words in str(notes[0])
        used = self.notes(images, relief_by="polarised", specular={"side_lights": 0})
        assert codes(used) == ["side-unused"]

    @pytest.mark.parametrize(
        ("relief_by", "fitting", "noted"),
        [("side", 7, []), ("side", 5, ["side-misfit"]), ("polarised", 0, ["side-misfit"])],
    )
    def test_side_lights_that_do_not_fit_are_counted(self, relief_by, fitting, noted):
        images = skin_images(side=(None, None, ring("white")))
        notes = self.notes(images, relief_by=relief_by, specular={"side_lights": fitting})
        assert codes(notes) == noted
        for note in notes:
            assert str(note).startswith(f"{7 - fitting} of the white images")

    def test_side_lights_of_a_modelled_surface_are_noted_once(self):
        images = skin_images(side=(None, None, ring("white")))
        assert codes(self.notes(images, specular={"side_lights": 5})) == ["specular-unused"]

    def test_an_odd_relief_is_noted(self):
        surface = replace(skin_surface(relief_by="shading"), relief_mm=3.0 * field(2))
        (note,) = metric._findings_on(skin_images(), surface)
        assert note.code == "odd-relief"
        heights = np.subtract(*np.percentile(3000.0 * field(2), (95, 5)))
        assert f"{heights:.0f}" in str(note) or f"{heights:.3g}" in str(note)

    def test_an_empty_mask_has_no_relief(self):
        grid = replace(square_grid(), mask=np.zeros((SIDE, SIDE), bool))
        images = replace(skin_images(), grid=grid)
        metric._findings_on(images, skin_surface(relief_by="shading"))


class TestOnPixels:
    @pytest.fixture
    def chosen(self, monkeypatch):
        names = []

        def method(name):
            def run(*arguments):
                names.append((name, arguments))
                return skin_surface(
                    relief_by={"metric_polarised": "polarised"}.get(name, "shading")
                )

            return run

        for name in ("metric_polarised", "metric_side", "metric_skin"):
            monkeypatch.setattr(metric, name, method(name))
        return names

    def test_the_gain_is_part_of_the_uncertainty_of_modelled_ridges(self, monkeypatch):
        known = {"relief_rms_um": 20.0, "relief_error_um": 2.0, "gloss": 1.0}
        first = replace(skin_surface(), facts={"relief_by": "network", **known})
        monkeypatch.setattr(metric, "metric_skin", lambda *_: first)
        images = skin_images()
        still = metric._on_pixels(images, METRIC, 0.3, wet_sd=0.0)
        assert still.facts["optics"]["gain_uncertainty"] == GAIN_UNCERTAINTY
        monkeypatch.setattr(metric, "GAIN_UNCERTAINTY", 0.5)
        surface = metric._on_pixels(images, METRIC, 0.3, wet_sd=1.2)
        fields = first.relief_mm, first.deviation_mm
        stated = metric.stated_deviation(*fields, images.grid, 1.3)
        assert surface.facts["optics"]["gain_uncertainty"] == pytest.approx(1.3)
        expected = 1000 * np.hypot(stated, 0.3 * first.relief_mm)
        assert_allclose(surface.uncertainty_um, expected, rtol=1e-6)

    def test_what_jpeg_took_is_part_of_the_uncertainty(self, chosen):
        first = skin_surface()
        surface = metric._on_pixels(skin_images(), METRIC, 0.3, 0.0)
        expected = 1000 * np.hypot(first.deviation_mm, 0.3 * first.relief_mm)
        assert_allclose(surface.uncertainty_um, expected, rtol=1e-6)

    def test_each_run_of_the_relief_network_is_reported(self, monkeypatch):
        reported = []
        monkeypatch.setattr(steps, "report", lambda name, part: reported.append((name, part)))
        networks = metric._reporting(Networks(lambda fields: fields + 1))
        for _ in range(5):
            assert networks.relief(np.zeros(1)) == 1
        assert reported == [("surface", part) for part in (0.25, 0.5, 0.75, 1.0, 1.0)]
        assert metric._reporting(None) is None


class TestSkin:
    @pytest.fixture
    def steps_taken(self, monkeypatch):
        losses = []

        def on_pixels(images, settings, jpeg_loss, wet_sd):
            losses.append((jpeg_loss, wet_sd))
            optics = {"relief_by": "network", "gain_uncertainty": wet_sd}
            return metric.FingerSurface(
                *(field(1),) * 4, facts={"optics": optics}, findings=(metric.side_unused(9),)
            )

        monkeypatch.setattr(metric, "working_images", lambda *_: skin_images())
        monkeypatch.setattr(metric, "_on_pixels", on_pixels)
        return losses

    def photographs(self, px_per_mm=20.0, **facts):
        photographs = dome("metric", px_per_mm=px_per_mm)
        finger = replace(photographs.finger, facts={**photographs.finger.facts, **facts})
        return replace(photographs, finger=finger)

    def test_coloured_leds_are_refused(self):
        photographs = self.photographs()
        rig = photographs.observation.rig
        red = replace(rig, leds=tuple(replace(led, colour="red") for led in rig.leds))
        white = replace(photographs.observation.white, built=red)
        lit = photographs.observation.with_light(white)
        with bad_input("each coloured LED differently"):
            metric.skin_surface(replace(photographs, observation=lit), METRIC)

    @pytest.mark.parametrize(
        ("px_per_mm", "facts", "loss"),
        [
            (20.0, {}, 0.0),
            (20.0, {"jpeg": 90}, JPEG_LOSS),
            (JPEG_COARSE, {"jpeg": 90}, JPEG_LOSS),
            (JPEG_COARSE - 0.1, {"jpeg": 90}, JPEG_LOSS_COARSE),
        ],
    )
    def test_jpeg_takes_part_of_the_relief(self, steps_taken, px_per_mm, facts, loss):
        metric.skin_surface(self.photographs(px_per_mm, **facts), METRIC)
        assert steps_taken == [(loss, 0.0)]

    @pytest.mark.parametrize(
        ("unexplained", "wet_sd"),
        [(0.05, 0.0), (0.0675, 0.15), (0.085, 0.3), (0.12, 0.6), (0.3, 0.6)],
    )
    def test_light_that_no_matt_surface_explains_is_said(self, steps_taken, unexplained, wet_sd):
        surface = metric.skin_surface(self.photographs(light_residual=unexplained), METRIC)
        assert steps_taken == [(0.0, pytest.approx(wet_sd))]
        assert codes(surface.findings) == ["wet-finger"] * (wet_sd > 0.25) + ["side-unused"]

    def test_unused_side_lights_stand_first(self, steps_taken):
        photographs = self.photographs()
        observation = photographs.observation
        lit = replace(observation, side=observation.white.of_images([0, 1, 2]))
        surface = metric.skin_surface(replace(photographs, observation=lit), METRIC)
        assert [str(finding)[:20] for finding in surface.findings] == [
            "the 3 white images l",
            "the 9 white images l",
        ]
        plain = metric.skin_surface(self.photographs(), METRIC)
        assert len(plain.findings) == 1

    @pytest.mark.parametrize(
        ("material", "stated", "undone"),
        [
            ("skin", None, True),
            ("opaque", None, False),
            ("skin", False, False),
            ("opaque", True, True),
        ],
    )
    def test_blur_is_undone_of_skin_or_as_stated(self, material, stated, undone):
        assert metric.undoes_blur(material, replace(METRIC.skin, invert_blur=stated)) == undone
