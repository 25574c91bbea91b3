"""From images to normals, slopes and heights: in strips, without clipped values, in colour."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from dome_photographs import COLOUR, PX_PER_MM, dome, from_40_mm, stored_as, under
from refusals import bad_input
from splitknit.capture import Ambient
from splitknit.imaging.pixels import GREY_WEIGHTS
from splitknit.imaging.view import view_of
from splitknit.methods import photometry
from splitknit.methods.photometry import MAX_SLOPE
from splitknit.observation.light import FULL_SCALE
from splitknit.photometric.lambertian import lambertian
from splitknit.photometric.robust import robust
from splitknit.presets import PRESETS, HeightSettings, NormalsSettings

SHAPELETS = PRESETS["ea"].shapelets


def white_of(photographs):
    return photographs.white_and_nir(PRESETS["ea"], 0.0)[0]


@pytest.fixture(scope="module")
def white():
    return white_of(dome())


@pytest.fixture(scope="module")
def colours():
    return white_of(dome(colour=COLOUR))


def images_seen(white, **options):
    """What `by_rows` gives the method, put together again."""
    seen = np.full((len(white.light.lights), *white.inside.shape), np.nan, dtype=np.float32)

    def look(images, rows):
        seen[:, rows] = images
        return np.broadcast_to((0.0, 0.6, 0.8), (*images.shape[1:], 3)), images.mean(axis=0)

    return seen, *photometry.by_rows(white, look, **options)


def paraboloid(white, steepness):
    """Slopes and heights in pixels of a paraboloid on the window, x right and y up."""
    rows, columns = np.indices(white.inside.shape, dtype=np.float32)
    x, y = columns - columns.mean(), rows.mean() - rows
    heights = -steepness * (x**2 + y**2) / 2
    slopes = (-steepness * x * white.inside, -steepness * y * white.inside)
    return slopes, heights


def spread(values, inside):
    return float(np.ptp(values[inside]))


class TestByRows:
    def test_all_rows_are_the_linear_images_of_the_window(self, white):
        seen, normals, albedo = images_seen(white)
        images = white.light.grey
        assert_array_equal(seen, images)
        assert_allclose(normals, np.broadcast_to((0.0, 0.6, 0.8), normals.shape))
        assert_array_equal(albedo, images.mean(axis=0))
        assert normals.dtype == albedo.dtype == np.float32

    @pytest.mark.parametrize("rows_each", [1, 7])
    def test_strips_give_the_same_as_all_rows(self, white, rows_each, monkeypatch):
        seen, normals, albedo = images_seen(white)
        width, strips = white.inside.shape[1], []
        monkeypatch.setattr(photometry, "LIGHT_BYTES", 4 * 8 * width * rows_each)

        def look(images, rows):
            strips.append(images.shape[1])
            assert_array_equal(images, seen[:, rows])
            return np.broadcast_to((0.0, 0.6, 0.8), (*images.shape[1:], 3)), images.mean(axis=0)

        again = photometry.by_rows(white, look)
        assert max(strips) == rows_each
        for strip_by_strip, at_once in zip(again, (normals, albedo), strict=True):
            assert_array_equal(strip_by_strip[white.inside], at_once[white.inside])

    def test_strips_without_the_object_are_left_empty(self, white, monkeypatch):
        inside = white.finger.wider.copy()
        top = white.finger.window[0].start
        inside[top : top + 5] = False
        partly = replace(white, finger=replace(white.finger, wider=inside))
        monkeypatch.setattr(photometry, "LIGHT_BYTES", 1)
        seen, normals, albedo = images_seen(partly)
        empty = ~inside[white.finger.window].any(axis=1)
        assert np.isfinite(seen[:, ~empty]).all()
        assert np.isnan(seen[:, empty]).all()
        assert (normals[:5] == 0).all()
        assert np.isnan(albedo[:5]).all()

    @pytest.mark.parametrize(
        ("material", "asked", "dropped"),
        [("opaque", True, True), ("opaque", False, False), ("skin", True, False)],
    )
    def test_clipped_values_of_an_opaque_thing_become_zero(self, white, material, asked, dropped):
        pixels = white.light.stored.pixels.copy()
        rows, columns = white.finger.window
        row, column = rows.start + 20, columns.start + 20
        full = np.iinfo(pixels.dtype).max
        pixels[3, row, column] = full
        pixels[4, row, column] = int(FULL_SCALE * full)
        pixels[5, row, column] = int(FULL_SCALE * full) - 1
        changed = replace(stored_as(white, pixels=pixels), material=material)
        seen, _, _ = images_seen(changed, without_clipped=asked)
        assert [bool(seen[light, 20, 20] == 0) for light in (3, 4, 5)] == [dropped, dropped, False]

    def test_clipped_values_beside_crossed_films_are_kept(self, white):
        pixels = white.light.stored.pixels
        clipped = stored_as(white, pixels=np.full_like(pixels, np.iinfo(pixels.dtype).max))
        behind = replace(clipped, light=replace(clipped.light, crossed=clipped.light))
        seen, _, _ = images_seen(behind, without_clipped=True)
        assert (seen > 0).all()


class TestColourAlbedo:
    def test_grey_photographs_have_none(self, white):
        assert photometry.colour_albedo(white, np.ones(white.inside.shape, np.float32)) is None

    def test_it_has_the_colour_of_the_object_and_the_luma_of_the_grey_albedo(self, colours):
        albedo = np.linspace(0.2, 1.0, colours.inside.size, dtype=np.float32)
        albedo = albedo.reshape(colours.inside.shape)
        colour = photometry.colour_albedo(colours, albedo)
        assert_allclose((colour @ GREY_WEIGHTS)[colours.inside], albedo[colours.inside], rtol=1e-4)
        ratio = colour[colours.inside] / COLOUR
        assert_allclose(ratio / ratio[:, :1], 1.0, atol=0.02)

    def test_strips_give_the_same(self, colours, monkeypatch):
        albedo = np.full(colours.inside.shape, 0.5, dtype=np.float32)
        whole = photometry.colour_albedo(colours, albedo)
        assert (whole[0].sum(axis=-1) > 0).any()
        monkeypatch.setattr(photometry, "LIGHT_BYTES", 1)
        assert_array_equal(photometry.colour_albedo(colours, albedo), whole)

    def test_a_white_highlight_in_one_photograph_leaves_the_colour(self, colours):
        pixels = colours.light.stored.pixels.copy()
        rows, columns = colours.finger.window
        pixels[2, rows.start + 20, columns.start + 20] = 60000
        shiny = stored_as(colours, pixels=pixels)
        colour = photometry.colour_albedo(shiny, np.ones(colours.inside.shape, np.float32))
        ratio = colour[20, 20] / COLOUR
        assert_allclose(ratio / ratio[0], 1.0, atol=0.05)

    def test_an_unknown_grey_albedo_is_black(self, colours):
        albedo = np.full(colours.inside.shape, np.nan, dtype=np.float32)
        assert (photometry.colour_albedo(colours, albedo) == 0).all()

    def test_no_channel_is_negative(self, colours):
        ambient = np.full(colours.light.stored.pixels.shape[1:], 9000, dtype=np.uint16)
        dark = stored_as(colours, ambient=Ambient(ambient))
        colour = photometry.colour_albedo(dark, np.ones(colours.inside.shape, np.float32))
        assert colour.min() >= 0


@pytest.mark.parametrize(("method", "solve"), [("robust", robust), ("lambertian", lambertian)])
def test_the_settings_choose_the_normals_of_distant_lights(white, method, solve):
    images = white.light.grey
    lights, inside = white.rig.light_vectors(), white.inside
    expected = solve(images, lights, inside)
    actual = photometry.distant_normals(images, lights, inside, NormalsSettings(method=method))
    for ours, theirs in zip(actual, expected, strict=True):
        assert_array_equal(ours, theirs)


class TestSlopes:
    def test_they_are_those_of_the_normals_under_a_straight_camera(self, white):
        normals = np.broadcast_to(np.float32((0.36, -0.48, 0.8)), (*white.inside.shape, 3))
        x, y = photometry.slopes_of(normals, white)
        assert_allclose(x[white.inside], -0.45, rtol=1e-5)
        assert_allclose(y[white.inside], 0.6, rtol=1e-5)
        assert (x[~white.inside] == 0).all()

    def test_they_are_cut_at_the_steepest(self, white):
        normals = np.broadcast_to(np.float32((1.0, 0.0, 1e-3)), (*white.inside.shape, 3))
        x, _ = photometry.slopes_of(normals, white)
        assert_allclose(x[white.inside], -MAX_SLOPE, rtol=1e-5)

    def test_a_pixels_own_ray_is_upright(self, white):
        """Under a perspective camera a normal along the ray has no slope."""
        camera = from_40_mm(white.rig.camera)
        view = view_of(camera, *white.finger.window, along_rays=True)
        upright = np.broadcast_to(np.float32((0.0, 0.0, 1.0)), (*white.inside.shape, 3))
        x, y = photometry.slopes_of(view.in_rig(upright), under(white, camera=camera))
        assert np.abs(x).max() < 1e-5
        assert np.abs(y).max() < 1e-5


class TestIntegrated:
    @pytest.mark.parametrize("method", ["poisson", "frankot_chellappa"])
    def test_heights_of_a_paraboloid_are_in_mm(self, white, method):
        slopes, heights_px = paraboloid(white, 0.01)
        height = photometry.integrated(slopes, white, HeightSettings(method=method))
        inside = white.inside
        difference = height * PX_PER_MM - heights_px
        tolerance = 0.02 if method == "poisson" else 0.5
        assert spread(difference, inside) < tolerance * spread(heights_px, inside)

    def test_heights_beyond_what_the_slopes_allow_are_refused(self, white, monkeypatch):
        slopes, _ = paraboloid(white, 0.01)
        deepest = float(np.hypot(*slopes).max()) * sum(
            int(white.inside.any(axis=axis).sum()) for axis in (0, 1)
        )
        span = np.linspace(0.0, 1.0, white.inside.size).reshape(white.inside.shape)
        for factor, refused in ((0.99, False), (1.01, True)):
            monkeypatch.setattr(photometry, "poisson", lambda *_, f=factor: f * deepest * span)
            if refused:
                with bad_input("steep rim"):
                    photometry.integrated(slopes, white, HeightSettings(method="poisson"))
            else:
                photometry.integrated(slopes, white, HeightSettings(method="poisson"))

    def test_a_flat_thing_may_be_a_pixel_deep(self, white, monkeypatch):
        flat = np.zeros(white.inside.shape)
        span = np.linspace(0.0, 1.0, white.inside.size).reshape(white.inside.shape)
        monkeypatch.setattr(photometry, "poisson", lambda *_: 1.01 * span)
        with bad_input("steep rim"):
            photometry.integrated((flat, flat), white, HeightSettings(method="poisson"))
        monkeypatch.setattr(photometry, "poisson", lambda *_: span)
        height = photometry.integrated((flat, flat), white, HeightSettings(method="poisson"))
        assert_allclose(height, span / PX_PER_MM)


class TestRelief:
    def test_shapelets_see_the_same_relief_at_twice_the_scale(self):
        reliefs = []
        for px_per_mm, side in ((20.0, 60), (40.0, 120)):
            white = white_of(dome(side=side, px_per_mm=px_per_mm))
            columns = np.indices(white.inside.shape)[1] / px_per_mm
            waves = 0.2 * np.cos(2 * np.pi * columns / 0.5) * white.inside
            relief = photometry.ridge_relief((waves, 0 * waves), white, SHAPELETS)
            middle = tuple(slice(size // 3, 2 * size // 3) for size in relief.shape)
            reliefs.append(float(relief[middle].std()))
        assert reliefs[0] == pytest.approx(reliefs[1], rel=0.1)
        assert reliefs[0] > 0.002

    def test_the_slow_part_of_a_surface_goes_and_the_fast_part_stays(self, white):
        rows, columns = np.indices(white.inside.shape) / PX_PER_MM
        slow = 0.3 * columns + 0.02 * rows**2
        waves = 0.01 * np.sin(2 * np.pi * columns / 0.5)
        relief = photometry.fast_part(slow + waves, white)
        middle = tuple(slice(size // 3, 2 * size // 3) for size in relief.shape)
        assert np.abs(relief - waves)[middle].max() < 0.003

    def test_a_second_mean_finds_what_the_first_missed_at_the_outline(self, white):
        columns = np.indices(white.inside.shape)[1] / PX_PER_MM
        plane = 0.3 * columns * white.inside
        once = plane - photometry.smoothed(
            plane, white.inside, photometry.SLOW_MM * white.px_per_mm
        )
        twice = photometry.fast_part(plane, white)
        assert np.abs(twice[white.inside]).mean() < 0.7 * np.abs(once[white.inside]).mean()

    def test_the_gain_of_shapelets_stays_beyond_their_finest_scale(self, white):
        gain = photometry.ridge_response(white, SHAPELETS)
        sigma_px = SHAPELETS.sigma_px * PX_PER_MM / photometry.REFERENCE_PX_PER_MM
        finest = np.sqrt(2.0) / sigma_px
        at_finest, beyond = gain(np.array([finest, 2 * finest]))
        assert beyond == at_finest
        assert gain(np.array([0.02 * finest]))[0] < 0.5 * at_finest
