"""Sections, and the surface in a page, are those of the finger: a half ellipsoid with a known
relief."""

import base64
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from handmade import finger
from refusals import bad_input
from splitknit.report import surface as surface_module
from splitknit.report.surface import scene_of, section, surface_in


def perspective(result):
    """The same finger as a camera 140 mm above sees it."""
    height, width = result.mask.shape
    x = ((np.arange(width) - (width - 1) / 2) * result.pitch_mm)[None, :] * (
        1 - result.height_mm / 140
    )
    y = (((height - 1) / 2 - np.arange(height)) * result.pitch_mm)[:, None] * (
        1 - result.height_mm / 140
    )
    return replace(result, x_mm=x.astype(np.float32), y_mm=y.astype(np.float32))


@pytest.fixture(scope="module")
def surfaces():
    result, _ = finger()
    return {"parallel": surface_in(result), "perspective": surface_in(perspective(result))}


def height_at(x, y):
    along = (y - 1.0) / 8.5 if y > 1.0 else 0.0
    shape = 5.5 * np.sqrt(1.0 - (x / 7.5) ** 2 - along**2)
    radius, turn = np.hypot(x - 0.6, y - 2.0), np.arctan2(y - 2.0, x - 0.6)
    return float(shape + 0.03 * np.cos(2 * np.pi * radius / 0.45 + 2 * turn))


def test_a_section_across_has_the_ellipse_s_length(surfaces):
    cut = section(surfaces["parallel"], (-6.0, -4.0), (6.0, -4.0))
    assert cut.figures["flat_mm"] == pytest.approx(12.0)
    assert cut.figures["height_difference_mm"] == pytest.approx(
        height_at(6, -4) - height_at(-6, -4), abs=0.01
    )
    z = np.array([height_at(each, -4.0) for each in cut.x_mm])
    np.testing.assert_allclose(cut.height_mm, z, atol=0.006)


@pytest.mark.parametrize("which", ["parallel", "perspective"])
def test_a_section_along_a_ray_of_the_spiral_has_its_heights(which, surfaces):
    cut = section(surfaces[which], (0.6, 3.0), (0.6, 8.0))
    nearer = 1.0 - (cut.height_mm / 140 if which == "perspective" else 0.0 * cut.height_mm)
    places = zip(cut.x_mm / nearer, cut.y_mm / nearer, strict=True)
    z = np.array([height_at(x, y) for x, y in places])
    np.testing.assert_allclose(cut.height_mm, z, atol=0.006)


def test_the_pixels_of_places_under_a_perspective_camera_are_found(surfaces):
    surface = surfaces["perspective"]
    rows, columns = np.nonzero(np.isfinite(surface.x_mm[::37, ::41]))
    rows, columns = 37 * rows, 41 * columns
    x, y = (field[rows, columns].astype(float) for field in (surface.x_mm, surface.y_mm))
    apart = np.abs(surface.locate(x, y) - np.stack([columns, rows])).max(axis=0)
    assert np.median(apart) < 0.02  # at the rim neighbours are missing


def test_a_section_over_the_edge_has_no_height_difference(surfaces):
    cut = section(surfaces["parallel"], (0.0, -4.0), (12.0, -4.0))
    assert cut.figures["height_difference_mm"] is None
    assert np.isnan(cut.height_mm).mean() == pytest.approx(1 - 7.386 / 12, abs=0.02)


@pytest.mark.parametrize("end", [(0.0, 0.0), (float("nan"), 0.0), (1e6, 0.0)])
def test_a_section_without_two_ends_on_the_surface_is_refused(surfaces, end):
    with bad_input():
        section(surfaces["parallel"], (0.0, 0.0), end)
    with bad_input("no surface"):
        section(surfaces["parallel"], (20.0, 0.0), (30.0, 0.0))


def test_an_empty_result_is_refused():
    result, _ = finger()
    with bad_input("no heights"):
        surface_in(replace(result, mask=np.zeros_like(result.mask)))


def decoded(field):
    """Values of a field of a page, as its script computes them."""
    data = np.frombuffer(base64.b64decode(field["png"]), np.uint8)
    blue, green, red = np.moveaxis(cv2.imdecode(data, cv2.IMREAD_COLOR).astype(float), -1, 0)
    assert not blue.any()
    level = 256 * red + green
    return np.where(level > 0, field["low"] + field["step"] * (level - 1), np.nan)


@pytest.mark.parametrize("which", ["parallel", "perspective"])
def test_a_page_holds_the_heights_of_the_surface(which):
    result, _ = finger()
    result = perspective(result) if which == "perspective" else result
    (facts,) = json.loads(scene_of(result, "metric").data)
    height = decoded(facts["shape"]) + decoded(facts["ridge"])
    rows, columns = np.nonzero(np.isfinite(height))
    x, y = facts["left"] + facts["pitch"] * columns, facts["top"] - facts["pitch"] * rows
    if which == "perspective":  # where the camera's rays meet the surface
        nearer = 1 - height[rows, columns] / 140
        x, y = x / nearer, y / nearer
    inner = (x / 7.5) ** 2 + np.where(y > 1, (y - 1) / 8.5, 0.0) ** 2 < 0.9
    true = [height_at(*place) for place in zip(x[inner][::97], y[inner][::97], strict=True)]
    np.testing.assert_allclose(height[rows, columns][inner][::97], true, atol=0.01)
    assert len(rows) == pytest.approx(result.mask.sum(), rel=0.1)


def test_a_large_surface_is_thinned(monkeypatch):
    monkeypatch.setattr(surface_module, "_MOST_POINTS", 10_000)
    result, _ = finger()
    (facts,) = json.loads(scene_of(result, "metric").data)
    assert 8000 < np.isfinite(decoded(facts["shape"])).sum() <= 10_500


def test_a_title_cannot_end_the_data():
    result, _ = finger()
    drawn = scene_of(result, "</script><script>alert(1)</script>")
    assert "<" not in drawn.data
    assert json.loads(drawn.data)[0]["title"].startswith("</script>")


def test_the_bundled_script_is_the_one_that_was_made():
    root = Path(__file__).resolve().parents[4]
    subprocess.run([sys.executable, str(root / "tools" / "vendor_three.py"), "--check"], check=True)
