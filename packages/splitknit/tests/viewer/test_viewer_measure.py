"""Distances and sections are those of the finger: a half ellipsoid with a known relief."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from handmade import capture_of, finger
from splitknit.errors import BadInput
from splitknit.report.result import write_results
from splitknit.viewer.surface import ResultSurface, pick, read_surface, section


@pytest.fixture(scope="module")
def surface(shown: Path) -> ResultSurface:
    return read_surface(shown / "metric")


@pytest.fixture(scope="module")
def perspective(tmp_path_factory: pytest.TempPathFactory) -> ResultSurface:
    """The same finger as a camera 140 mm above sees it."""
    result, _ = finger()
    height, width = result.mask.shape
    x = ((np.arange(width) - (width - 1) / 2) * result.pitch_mm)[None, :] * (1 - result.height_mm / 140)
    y = (((height - 1) / 2 - np.arange(height)) * result.pitch_mm)[:, None] * (1 - result.height_mm / 140)
    object.__setattr__(result, "x_mm", x.astype(np.float32))
    object.__setattr__(result, "y_mm", y.astype(np.float32))
    folder = tmp_path_factory.mktemp("perspective") / "result"
    write_results(result, capture_of(result), folder)
    return read_surface(folder)


def height_at(x: float, y: float) -> float:
    along = (y - 1.0) / 8.5 if y > 1.0 else 0.0
    shape = 5.5 * np.sqrt(1.0 - (x / 7.5) ** 2 - along**2)
    radius, turn = np.hypot(x - 0.6, y - 2.0), np.arctan2(y - 2.0, x - 0.6)
    return float(shape + 0.03 * np.cos(2 * np.pi * radius / 0.45 + 2 * turn))


@pytest.mark.parametrize("at", [(0.3, 1.7), (-4.0, -3.0), (3.0, 6.0)])
def test_a_point_from_above(surface: ResultSurface, at: tuple[float, float]) -> None:
    found = pick(surface, np.array([*at, 80.0]), np.array([0.0, 0.0, -2.0]))
    assert found == pytest.approx((*at, height_at(*at)), abs=0.004)


def test_a_point_from_the_side_is_the_first_that_is_met(surface: ResultSurface) -> None:
    origin, way = np.array([-60.0, -2.0, 20.0]), np.array([60.0, 0.0, -16.0])
    found = pick(surface, origin, way)
    assert found is not None
    assert found[0] < 0  # the near flank
    fraction = (found[0] - origin[0]) / way[0]
    np.testing.assert_allclose(found, origin + fraction * way, atol=0.02)
    assert found[2] == pytest.approx(height_at(found[0], found[1]), abs=0.02)


def test_where_a_picture_exaggerates_the_point_is_still_true(surface: ResultSurface) -> None:
    crest = (0.6 + 0.45 * 4, 2.0)  # turn = 0, radius = 4 periods: a crest, where the surface faces the camera
    origin = np.array([*crest, 50.0]) + np.array([0.0, 0.0, 0.0])
    found = pick(surface, origin, np.array([0.0, 0.0, -1.0]), 8.0)
    assert found == pytest.approx((*crest, height_at(*crest)), abs=0.004)
    slanted = np.array([0.6, 0.0, -1.0])
    shown = np.array([crest[0], crest[1], height_at(*crest) + 7 * 0.03])
    seen = pick(surface, shown - 30 * slanted, slanted, 8.0)
    assert seen == pytest.approx((*crest, height_at(*crest)), abs=0.02)
    plain = pick(surface, shown - 30 * slanted, slanted, 1.0)
    assert plain is not None
    assert abs(plain[0] - crest[0]) > 0.08


def test_beside_the_finger_there_is_nothing(surface: ResultSurface) -> None:
    assert pick(surface, np.array([9.0, 0.0, 50.0]), np.array([0.0, 0.0, -1.0])) is None
    assert pick(surface, np.array([0.0, 0.0, 50.0]), np.array([0.0, 0.0, 1.0])) is None
    with pytest.raises(BadInput):
        pick(surface, np.array([0.0, 0.0, np.nan]), np.array([0.0, 0.0, 1.0]))
    with pytest.raises(BadInput):
        pick(surface, np.zeros(3), np.zeros(3))


def test_a_section_across_has_the_ellipse_s_length(surface: ResultSurface) -> None:
    cut = section(surface, (-6.0, -4.0), (6.0, -4.0))
    assert cut.figures["flat_mm"] == pytest.approx(12.0)
    assert cut.figures["height_difference_mm"] == pytest.approx(height_at(6, -4) - height_at(-6, -4), abs=0.01)
    x = np.linspace(-6, 6, 4001)
    z = np.array([height_at(each, -4.0) for each in x])
    length = np.hypot(np.diff(x), np.diff(z)).sum()
    assert cut.figures["along_surface_mm"] == pytest.approx(length, rel=0.01)
    assert cut.figures["missing_share"] == 0.0
    np.testing.assert_allclose(cut.height_mm, np.interp(cut.x_mm, x, z), atol=0.006)


@pytest.mark.parametrize("which", ["surface", "perspective"])
def test_a_section_along_a_ray_of_the_spiral_has_its_relief(which: str, request: pytest.FixtureRequest) -> None:
    shown: ResultSurface = request.getfixturevalue(which)
    cut = section(shown, (0.6, 3.0), (0.6, 8.4))
    assert cut.figures["relief_um"] == pytest.approx(2 * 30 * np.cos(0.05 * np.pi), rel=0.06)
    assert cut.figures["relief_rms_um"] == pytest.approx(30 / np.sqrt(2), rel=0.06)
    low, high = (y * (1 - (height_at(0.6, y) / 140 if which == "perspective" else 0.0)) for y in (3.0, 8.4))
    period = 0.45 * (high - low) / 5.4  # further from the camera looks smaller
    assert cut.figures["ridge_period_mm"] == pytest.approx(period, rel=0.015)
    assert cut.figures["ridges"] in (11, 12, 13)


def test_places_of_a_perspective_camera_are_found(perspective: ResultSurface) -> None:
    inner = ndimage.binary_erosion(perspective.mask, iterations=6)  # at the rim neighbours are missing
    inside = inner[::37, ::41]
    x, y = (field[::37, ::41][inside].astype(float) for field in (perspective.x_mm, perspective.y_mm))
    columns, rows = np.meshgrid(
        np.arange(0, perspective.mask.shape[1], 41), np.arange(0, perspective.mask.shape[0], 37)
    )
    place = perspective.locate(x, y)
    np.testing.assert_allclose(place[0], columns[inside], atol=0.02)
    np.testing.assert_allclose(place[1], rows[inside], atol=0.02)


def test_a_section_over_the_edge_says_so(surface: ResultSurface) -> None:
    cut = section(surface, (0.0, -4.0), (12.0, -4.0))
    assert cut.figures["straight_mm"] is None
    assert cut.figures["along_surface_mm"] is None
    assert cut.figures["missing_share"] == pytest.approx(1 - 7.386 / 12, abs=0.02)


@pytest.mark.parametrize("end", [(0.0, 0.0), (float("nan"), 0.0), (1e6, 0.0)])
def test_ends_that_are_no_ends_are_refused(surface: ResultSurface, end: tuple[float, float]) -> None:
    with pytest.raises(BadInput):
        section(surface, (0.0, 0.0), end)
    with pytest.raises(BadInput, match="no surface"):
        section(surface, (20.0, 0.0), (30.0, 0.0))
