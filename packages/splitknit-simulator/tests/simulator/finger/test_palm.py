"""Palm patches."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.fft

from splitknit.errors import BadInput
from splitknit.model import Camera
from splitknit_simulator.finger.palm import PalmSettings, _draw_lines, _groove_map, _PalmLine, draw_palm, palm_surface

SMALL = PalmSettings(size_mm=(20.0, 16.0))
PLAIN = PalmSettings(size_mm=(20.0, 16.0), principal=(0, 0), wrinkles=(0, 0))
CAMERA = Camera(25.0, (360, 460))


@pytest.fixture(scope="module")
def palms():
    return [draw_palm(seed, SMALL) for seed in range(4)]


@pytest.fixture(scope="module")
def surface(palms):
    return palm_surface(palms[0], CAMERA)


def test_a_seed_gives_one_palm_and_another_seed_another(palms, surface):
    again = palm_surface(draw_palm(0, SMALL), CAMERA)
    for name in ("height_mm", "normals", "relief_um", "pigment", "mask"):
        assert getattr(again, name).tobytes() == getattr(surface, name).tobytes()
    reliefs = [palm.relief_mm - palm.relief_mm.mean() for palm in palms]
    for i in range(4):
        for j in range(i):
            a, b = reliefs[i], reliefs[j]
            assert abs(np.sum(a * b)) < 0.3 * np.sqrt(np.sum(a * a) * np.sum(b * b))
    assert len({palm.period_mm for palm in palms}) == 4 and len({palm.shape for palm in palms}) == 4


def test_ridges_have_the_period_and_depth_of_palms():
    """The strongest period in windows without lines, and the spread of the relief there."""
    for seed in range(3):
        palm = draw_palm(seed, PLAIN)
        relief = 1e3 * palm.relief_mm[20:-20, 20:-20]
        power = np.abs(scipy.fft.rfft2(relief - relief.mean())) ** 2
        rows, columns = (scipy.fft.fftfreq(relief.shape[0], 0.05), scipy.fft.rfftfreq(relief.shape[1], 0.05))
        frequency = np.hypot(rows[:, None], columns[None, :])
        band = (frequency > 1.0) & (frequency < 3.0)
        found = float(np.sum(power[band] * frequency[band]) / np.sum(power[band]))
        assert 1.0 / found == pytest.approx(palm.period_mm, rel=0.1)
        assert 0.44 < palm.period_mm < 0.66
        low, high = np.percentile(relief, [2, 99])
        assert 0.7 * palm.ridge_depth_um < high - low < 1.7 * palm.ridge_depth_um
        assert 20 <= palm.ridge_depth_um <= 60
        assert relief.max() < 3.0


def test_ridges_run_along_the_stated_direction():
    palm = draw_palm(2, PLAIN)
    gy, gx = np.gradient(palm.relief_mm.astype(np.float64))
    gy = -gy  # y up
    along, up = np.cos(palm.angle_rad), np.sin(palm.angle_rad)
    assert np.mean((gx * up - gy * along) ** 2) > 20 * np.mean((gx * along + gy * up) ** 2)


def test_lines_are_wide_deep_and_branch(palms):
    for palm in palms:
        assert len(palm.lines) >= SMALL.wrinkles[0]
        for line in palm.lines:
            assert line.depth_mm.max() <= 0.36 and line.depth_mm.min() >= 0
            assert line.width_mm.min() > 0.02
    rng = np.random.default_rng(3)
    counts = {"principal": 3, "wrinkles": 0, "principal_depth_mm": 0.2, "wrinkle_depth_mm": 0.03}
    lines = _draw_lines(rng, (22.0, 17.0), **counts)
    stems = sorted(lines, key=lambda line: -line.depth_mm.max())[:3]
    assert len(lines) > 6
    assert all(0.08 < stem.depth_mm.max() < 0.36 and stem.width_mm.max() > 0.2 for stem in stems)
    # a branch starts on a line
    for line in lines:
        if line.depth_mm[0] > 0.01:
            others = np.concatenate([other.points_mm for other in lines if other is not line])
            assert np.min(np.linalg.norm(others - line.points_mm[0], axis=1)) < 0.3


def test_a_groove_has_its_depth_and_width():
    points = np.stack([np.linspace(-3, 3, 25), np.zeros(25)], 1)
    line = _PalmLine(points, np.full(25, 0.2), np.full(25, 0.3))
    axis = np.arange(-60, 61) * 0.05
    groove = _groove_map((line,), axis, -axis)
    section = groove[:, 60]
    assert section.max() == pytest.approx(0.2, rel=0.02)
    assert np.argmax(section) == 60
    wide = axis[section > 0.2 * np.exp(-0.5)]
    assert np.ptp(wide) == pytest.approx(0.6, abs=0.11)
    aside = _PalmLine(points + np.array([0.0, 1.0]), np.full(25, 0.1), np.full(25, 0.2))
    assert _groove_map((aside,), axis, -axis)[60 - 20, 60] == pytest.approx(0.1, rel=0.03)  # y up, rows down


def test_heights_and_normals_are_of_one_surface(surface):
    """Central differences of the height against the normals, where neither bends sharply."""
    height = surface.height_mm.astype(np.float64)
    gy, gx = np.gradient(height, surface.camera.pitch_mm)
    nz = surface.normals[..., 2]
    for given, found in ((-surface.normals[..., 0] / nz, gx), (-surface.normals[..., 1] / nz, -gy)):
        error = (given - found)[2:-2, 2:-2]
        assert np.sqrt(np.mean(error**2)) < 0.02
        assert np.corrcoef(given[2:-2, 2:-2].ravel(), found[2:-2, 2:-2].ravel())[0, 1] > 0.98
    np.testing.assert_allclose(np.linalg.norm(surface.normals, axis=-1), 1.0, atol=1e-5)
    drop = (surface.height_mm - surface.shape_mm) * surface.shape_normals[..., 2] * 1e3
    np.testing.assert_allclose(drop, surface.relief_um, atol=0.5)


def test_palms_are_gently_curved_and_fill_the_picture(palms):
    for palm in palms:
        surface = palm_surface(palm, CAMERA)
        assert surface.mask.all()
        assert np.degrees(np.arccos(surface.shape_normals[..., 2].min())) < 35
        assert surface.height_mm.min() > -12 and surface.height_mm.max() < 0.1
        assert 0.5 < surface.pigment.min() <= surface.pigment.max() < 1.2


def test_a_palm_does_not_depend_on_the_camera(palms, surface):
    fine = palm_surface(palms[0], Camera(75.0, (1080, 1380)))
    np.testing.assert_allclose(fine.relief_um[1::3, 1::3], surface.relief_um, atol=0.05)
    np.testing.assert_allclose(fine.height_mm[1::3, 1::3], surface.height_mm, atol=1e-4)


def test_beyond_the_patch_there_is_nothing(palms):
    surface = palm_surface(palms[1], Camera(10.0, (200, 240)))
    assert 0.6 < surface.mask.mean() < 0.9
    assert np.isnan(surface.height_mm[~surface.mask]).all() and not surface.normals[~surface.mask].any()
    assert surface.mask[100, 120] and not surface.mask[0, 0]


@pytest.mark.slow
def test_a_triradius_turns_the_direction_by_half_a_turn():
    palm = draw_palm(0, PalmSettings(size_mm=(20.0, 16.0), delta_share=1.0))
    turn = np.linspace(0, 2 * np.pi, 200)
    x, y = palm.triradius_mm[0] + 1.0 * np.cos(turn), palm.triradius_mm[1] + 1.0 * np.sin(turn)
    column = np.rint((x - palm.x_mm[0]) / 0.05).astype(int)
    row = np.rint((palm.y_mm[0] - y) / 0.05).astype(int)
    angle = np.unwrap(2 * palm.angle_rad[row, column].astype(np.float64)) / 2
    assert angle[-1] - angle[0] == pytest.approx(-np.pi, abs=0.2)
    assert draw_palm(0, PalmSettings(size_mm=(20.0, 16.0), delta_share=0.0)).triradius_mm is None


@pytest.mark.parametrize(
    ("wrong", "word"),
    [
        ({"size_mm": (1.0, 30.0)}, "size_mm"),
        ({"period_mm": (0.6, 0.5)}, "period_mm"),
        ({"pitch_mm": 0.1}, "pitch_mm"),
        ({"ridge_depth_um": (20.0, 900.0)}, "ridge_depth_um"),
        ({"radius_mm": (2.0, 30.0)}, "radius_mm"),
        ({"delta_share": 2.0}, "delta_share"),
    ],
)
def test_impossible_palms_are_refused(wrong, word):
    with pytest.raises(BadInput, match=word):
        PalmSettings(**wrong)


def test_bad_seeds_and_cameras_are_refused(palms):
    with pytest.raises(BadInput, match="seed"):
        draw_palm(-1)
    with pytest.raises(BadInput, match="orthographic"):
        palm_surface(palms[0], Camera(10.0, (8, 8), model="perspective", matrix=np.eye(3)))
