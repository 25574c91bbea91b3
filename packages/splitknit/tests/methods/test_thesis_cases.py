"""The thesis's cases: what each makes of visible and near-infrared images, and what it states."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from dome_photographs import PX_PER_MM, dome, stored_as, under, with_nir
from splitknit.capture import Ambient
from splitknit.imaging.geometry import smoothed
from splitknit.integration.knit import crossover
from splitknit.methods import thesis
from splitknit.methods.photometry import (
    fast_part,
    integrated,
    ridge_relief,
    ridge_response,
    slopes_of,
)
from splitknit.presets import PRESETS, override

EA = PRESETS["ea"]
PARAMETERS = EA.parameters(False, "opaque")


def both_of(photographs):
    """The white band, and a near-infrared one that is twice as bright and shows another surface."""
    white = photographs.white_and_nir(EA, 0.0)[0]
    pixels = np.roll(white.light.stored.pixels, 2, axis=0) // 2
    return white, stored_as(white, name="nir", pixels=pixels)


@pytest.fixture(scope="module")
def bands():
    return both_of(dome())


@pytest.fixture(scope="module")
def visible(bands):
    """Slopes, height and relief of the white band."""
    white = bands[0]
    slopes = slopes_of(thesis.visible_normals(white, PARAMETERS.photometry)[0], white)
    height = integrated(slopes, white, PARAMETERS.height)
    return height, ridge_relief(slopes, white, PARAMETERS.shapelets)


@pytest.fixture(scope="module")
def shape(bands):
    nir = bands[1]
    return integrated(thesis.shape_slopes(nir, PARAMETERS.photometry), nir, PARAMETERS.height)


def assert_same(actual, expected, bands):
    inside = bands[0].inside
    assert_allclose(actual[inside], expected[inside], atol=1e-6)


class TestCases:
    def test_ea_keeps_the_visible_surface_whole(self, bands, visible):
        surface = thesis.ea(*bands, PARAMETERS)
        assert surface.whole
        assert_same(surface.height_mm, visible[0], bands)
        assert_same(surface.ridge_mm, fast_part(visible[0], bands[0]), bands)
        assert_same(surface.shape_mm, surface.height_mm - surface.ridge_mm, bands)

    def test_ea_split_has_the_relief_of_shapelets(self, bands, visible):
        surface = thesis.ea_split(*bands, PARAMETERS)
        assert not surface.whole
        assert_same(surface.height_mm, visible[0], bands)
        assert_same(surface.ridge_mm, visible[1], bands)
        assert_same(surface.shape_mm, surface.height_mm - surface.ridge_mm, bands)

    def test_split_and_knit_adds_white_relief_and_near_infrared_shape(self, bands, visible, shape):
        surface = thesis.snk(*bands, PARAMETERS)
        assert not surface.whole
        assert_same(surface.ridge_mm, visible[1], bands)
        assert_same(surface.shape_mm, shape, bands)
        assert_same(surface.height_mm, visible[1] + shape, bands)

    def test_the_crossover_takes_high_frequencies_of_white_light(self, bands, visible, shape):
        white = bands[0]
        response = ridge_response(white, PARAMETERS.shapelets)
        surface = thesis.snk_by_crossover(*bands, PARAMETERS)
        expected = crossover(visible[0], shape, response, white.inside)
        assert_same(surface.height_mm, expected, bands)
        assert_same(surface.shape_mm, shape, bands)
        assert_same(surface.ridge_mm, expected - shape, bands)

    @pytest.mark.parametrize("case", thesis.CASES.values())
    def test_normals_and_albedo_are_those_of_white_light(self, case, bands):
        surface = case(*bands, PARAMETERS)
        normals, albedo = thesis.visible_normals(bands[0], PARAMETERS.photometry)
        assert_array_equal(surface.normals, normals)
        assert_array_equal(surface.albedo, albedo)


class TestThesisSurface:
    @pytest.mark.parametrize(
        ("method", "case"), [("whole", "ea"), ("none", "ea_split"), ("addition", "snk")]
    )
    def test_the_settings_name_the_case(self, method, case):
        photographs = dome()
        settings = override(EA, {"knit.method": method})
        surface = thesis.thesis_surface(photographs, settings)
        white, nir = photographs.white_and_nir(settings, 0.0)
        expected = getattr(thesis, case)(white, nir, settings.parameters(False, "opaque"))
        assert_array_equal(surface.height_mm, expected.height_mm)
        assert surface.whole == expected.whole

    def test_its_facts_name_the_band_of_the_shape(self, bands):
        photographs = dome()
        assert thesis.thesis_surface(photographs, EA).facts == {
            "shape_source": "white",
            "separation": "none",
            "heights": "measured",
        }
        assert (
            thesis.thesis_surface(with_nir(photographs), PRESETS["snk"]).facts["shape_source"]
            == "nir"
        )

    def test_its_facts_name_the_separation_of_its_material(self, monkeypatch):
        monkeypatch.setattr(thesis, "_direct_images", lambda images, *_: images)
        settings = override(PRESETS["pr"], {"direct.method": "network"})
        facts = thesis.thesis_surface(dome(), settings).facts
        assert facts["separation"] == "none (opaque material: all light is direct)"
        of_skin = thesis.thesis_surface(dome(material="skin"), settings).facts
        assert of_skin["separation"].startswith("direct light by the network")

    def test_a_finished_surface_is_smoothed_in_mm(self):
        photographs = dome()
        white = photographs.white_and_nir(EA, 0.0)[0]
        plain = thesis.thesis_surface(photographs, EA)
        soft = thesis.thesis_surface(photographs, override(EA, {"smooth.sigma_mm": 0.3}))
        for name in ("height_mm", "ridge_mm"):
            expected = smoothed(getattr(plain, name), white.inside, 0.3 * PX_PER_MM)
            assert_allclose(getattr(soft, name), expected, atol=1e-7)
        assert_allclose(soft.shape_mm, soft.height_mm - soft.ridge_mm, atol=1e-7)

    def test_a_sigma_of_zero_leaves_it(self, bands):
        surface = thesis.ea(*bands, PARAMETERS)
        assert thesis.smoothed_surface(surface, bands[0], 0) is surface


class TestPreparedLight:
    """Contrast enhancement, direct light and equal colours come before the normals, in this
    order."""

    @pytest.fixture
    def steps(self, monkeypatch):
        """Steps stand-in: each adds its digit to the images, so that their order shows."""
        taken = []

        def step(name, factor):
            def taking(images, *arguments):
                taken.append((name, arguments))
                return images * factor

            return taking

        monkeypatch.setattr(thesis, "balanced", step("balanced", 2))
        monkeypatch.setattr(thesis, "_equalised", step("equalised", 3))
        monkeypatch.setattr(thesis, "_direct_images", step("direct", 5))
        return taken

    def photometry(self, *, balance=False, clahe=False, method="none"):
        plain = PARAMETERS.photometry
        return replace(
            plain,
            balance=balance,
            enhance=replace(plain.enhance, clahe=clahe),
            direct=replace(plain.direct, method=method),
        )

    def test_all_three_are_taken_in_order(self, bands, steps):
        thesis.visible_normals(
            bands[0], self.photometry(balance=True, clahe=True, method="network")
        )
        assert [name for name, _ in steps] == ["balanced", "equalised", "direct"]

    def test_colours_are_balanced_on_the_kept_skin(self, bands, steps):
        white = bands[0]
        thesis.visible_normals(white, self.photometry(balance=True))
        rig, mask = steps[0][1]
        assert rig.leds == white.rig.leds
        assert_array_equal(mask, white.finger.mask[white.finger.window])

    def test_direct_light_is_of_the_band_and_its_settings(self, bands, steps):
        settings = self.photometry(method="network")
        thesis.visible_normals(bands[0], settings)
        assert steps[0][1] == (bands[0], settings.direct)

    def test_grey_images_are_not_negative(self, bands):
        white = bands[0]
        ambient = np.full(white.light.stored.pixels.shape[1:], 8000, dtype=np.uint16)
        dark = stored_as(white, ambient=Ambient(ambient))
        images = thesis._grey_images(dark)
        assert images.min() == 0
        assert 0 < images.max() < 1

    def test_lights_beside_equalised_images_have_one_length(self, bands):
        white = bands[0]
        first, *others = white.light.built.leds
        bright = under(white, leds=(replace(first, intensity=2.0), *others))
        enhance = PARAMETERS.photometry.enhance
        plain = thesis._lights(bright, replace(enhance, clahe=False))
        equal = thesis._lights(bright, replace(enhance, clahe=True))
        lengths = np.linalg.norm(plain, axis=1)
        assert lengths[0] == pytest.approx(2 * lengths[1], rel=1e-6)
        assert_allclose(np.linalg.norm(equal, axis=1), 1.0)
        assert_allclose(equal * lengths[:, None], plain)


class TestDirectLight:
    @pytest.fixture
    def asked(self, monkeypatch):
        """What the separation of direct light is asked for."""
        calls = {}
        monkeypatch.setattr(
            thesis, "direct_light", lambda images, network: calls.update(grey=(images, network))
        )
        return calls

    def direct(self, **changes):
        return replace(PARAMETERS.photometry.direct, method="network", **changes)

    def test_it_is_asked_for_on_the_skin_alone(self, bands, asked):
        white = bands[0]
        images = np.ones((8, *white.inside.shape), dtype=np.float32)
        direct = self.direct()
        thesis._direct_images(images, white, direct)
        seen, network = asked["grey"]
        assert_array_equal(seen, images * white.inside)
        assert network == direct.network
