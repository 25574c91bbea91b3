"""Places of lights: glints by Fermat's principle and a ground of its own shading are the truth."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from splitknit.errors import BadInput
from splitknit.photometric.places import (
    BallGlints,
    MattGround,
    fit_places,
    glints_on,
    places_by_ground,
)

EYE = np.array([2.0, -3.0, 95.0])
PX_PER_MM = 18.0


def dome(count: int = 24) -> np.ndarray:
    """Lights on three rings of a dome of 62 mm."""
    ring = np.repeat([20.0, 45.0, 70.0], count // 3)
    azimuth = np.deg2rad(np.arange(count) * 360.0 * 3 / count + 7.0 * ring)
    elevation = np.deg2rad(ring)
    return 62.0 * np.column_stack(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ]
    )


def shortest_path(light: np.ndarray, middle: np.ndarray, radius: float) -> np.ndarray:
    """Where the way from light over ball to camera is shortest (Fermat), seen on the ground."""

    def point(angles: np.ndarray) -> np.ndarray:
        normal = np.array([*np.tan(angles), 1.0])
        return middle + radius * normal / np.linalg.norm(normal)

    def way(angles: np.ndarray) -> float:
        return float(np.linalg.norm(light - point(angles)) + np.linalg.norm(EYE - point(angles)))

    found = minimize(way, [0.0, 0.0], method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-13})
    place = point(found.x)
    return EYE[:2] + (place[:2] - EYE[:2]) * EYE[2] / (EYE[2] - place[2])


def photographed(
    lights: np.ndarray, middle: tuple[float, float, float], radius: float, noise_px: float = 0.0
) -> BallGlints:
    """A ball whose outline is 8 % too large, as a soft rim's is."""
    generator = np.random.default_rng(3)
    glints = np.array([shortest_path(light, np.array(middle), radius) for light in lights])
    glints += generator.normal(0, noise_px / PX_PER_MM, glints.shape)
    nearer = EYE[2] / (EYE[2] - middle[2])
    x, y = EYE[:2] + (np.array(middle[:2]) - EYE[:2]) * nearer
    return BallGlints((x, y, 1.08 * radius * nearer), glints)


def felt(lights: np.ndarray, exponent: float = 0.0) -> MattGround:
    """Flat ground of uneven albedo under lamps that differ by 5 %, with noise of 2 %."""
    generator = np.random.default_rng(5)
    points = generator.uniform(-40, 40, (400, 2))
    away = lights[:, None] - np.column_stack([points, np.zeros(400)])
    irradiance = lights[:, None, 2] / np.linalg.norm(away, axis=2) ** 3
    axes = lights / np.linalg.norm(lights, axis=1, keepdims=True)
    off_axis = np.einsum("kpi,ki->kp", away, axes) / np.linalg.norm(away, axis=2)
    irradiance *= off_axis**exponent
    lamps = np.exp(generator.normal(0, 0.05, (len(lights), 1)))
    values = lamps * irradiance * generator.uniform(0.2, 0.6, 400) * 62.0**2
    values *= 1 + generator.normal(0, 0.02, values.shape)
    return MattGround(points, values, np.ones(values.shape, dtype=np.bool_))


def test_a_glint_is_where_the_way_of_the_light_is_shortest() -> None:
    middle, lights = np.array([30.0, -5.0, 2.0]), dome(6)
    expected = [shortest_path(light, middle, 2.5) for light in lights]
    np.testing.assert_allclose(glints_on(lights, middle, 2.5, EYE), expected, atol=1e-5)


@pytest.mark.parametrize("balls", [1, 2])
def test_places_come_within_two_millimetres_and_their_interval(balls: int) -> None:
    lights = dome()
    seen = [photographed(lights, (x, 3.0, 2.5), 2.5, noise_px=0.1) for x in (-30.0, 34.0)[:balls]]
    found = fit_places(
        seen, PX_PER_MM, ground=felt(lights), eye_mm=(0, 0, 90), eye_sd_mm=(10, 10, 30)
    )
    error = np.linalg.norm(found.places_mm - lights, axis=1)
    assert np.median(error) < 2.0
    assert (error < 2 * found.interval_mm).mean() > 0.9


@pytest.mark.parametrize("balls", [1, 2])
@pytest.mark.parametrize("exponent", [1.0, 5.0])
def test_a_lens_on_the_lamps_is_not_taken_for_their_places(balls: int, exponent: float) -> None:
    """As lamps that shine evenly, those with a lens came out 5 to 15 mm off."""
    lights = dome()
    seen = [photographed(lights, (x, 3.0, 2.5), 2.5, noise_px=0.1) for x in (-30.0, 34.0)[:balls]]
    ground = felt(lights, exponent)
    found = fit_places(seen, PX_PER_MM, ground=ground, eye_mm=(0, 0, 90), eye_sd_mm=(10, 10, 30))
    error = np.linalg.norm(found.places_mm - lights, axis=1)
    assert np.median(error) < 2.0
    assert (error < found.interval_mm).mean() > 0.9
    assert found.lobe_exponent == pytest.approx(exponent, rel=0.2)


def test_a_light_that_glints_on_one_ball_only_has_a_place() -> None:
    lights = dome()
    first, second = (photographed(lights, (x, 3.0, 2.5), 2.5) for x in (-30.0, 34.0))
    hidden = second.glints_mm.copy()
    hidden[4] = np.nan
    found = fit_places(
        [first, BallGlints(second.outline_mm, hidden)],
        PX_PER_MM,
        ground=felt(lights),
        eye_mm=(0, 0, 90),
        eye_sd_mm=(10, 10, 30),
    )
    assert np.linalg.norm(found.places_mm[4] - lights[4]) < 6.0
    assert found.interval_mm[4] > 1.0


def test_a_light_without_glint_is_named() -> None:
    ball = BallGlints((0.0, 0.0, 2.0), np.full((3, 2), np.nan))
    with pytest.raises(BadInput, match="light 0 has no glint"):
        fit_places([ball], PX_PER_MM, eye_mm=(0, 0, 90), eye_sd_mm=(10, 10, 30))


def test_directions_read_from_a_ball_and_the_ground_show_that_lights_are_near() -> None:
    """The ball lies 30 mm beside the middle, where the program that read them did not look."""
    lights = dome()
    ball = photographed(lights, (-30.0, 3.0, 2.5), 2.5)
    normal = (ball.glints_mm - ball.outline_mm[:2]) / ball.outline_mm[2]
    normal = np.column_stack([normal, np.sqrt(1 - (normal**2).sum(axis=1))])
    directions = 2 * normal[:, 2:] * normal - (0.0, 0.0, 1.0)
    fit, explained = places_by_ground(directions, felt(lights), 120.0)
    assert explained > 1.0
    assert np.linalg.norm(fit.places_mm - lights, axis=1).mean() < 6.0
    assert fit.dome_mm[3] == pytest.approx(62.0, rel=0.1)


def test_an_evenly_lit_ground_shows_distant_lights() -> None:
    lights = dome()
    ground = felt(lights)
    values = ground.values.mean(axis=0) * lights[:, 2:] / 62.0
    values = values * (1 + np.random.default_rng(1).normal(0, 0.05, values.shape))
    _, explained = places_by_ground(lights, MattGround(ground.points_mm, values, values > 0), 120.0)
    assert abs(explained) < 0.05
