"""The ridge matcher on simulated fingers and on pictures whose alignment is known."""

from __future__ import annotations

import itertools
from collections import Counter
from dataclasses import replace
from types import ModuleType

import cv2
import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit_match.matching import coarse, ridge
from splitknit_match.matching.ridge import Prepared, ridge_match
from splitknit_match.matching.ridge_band import RidgeBand
from splitknit_match.matching.template import Template, failed_template, make_template


@pytest.mark.slow
def test_same_fingers_are_more_similar_than_any_others(impressions, templates) -> None:
    ready = [Prepared(template) for template in templates]
    genuine, impostor = [], []
    for i, j in itertools.combinations(range(len(ready)), 2):
        found = ridge_match(ready[i], ready[j])
        same = impressions[i].finger == impressions[j].finger
        (genuine if same else impostor).append(found.similarity)
        if same:
            # the finger of j is turned by the difference of the yaws; upright frames were not given
            turned = np.rad2deg(impressions[j].pose.yaw_rad - impressions[i].pose.yaw_rad)
            assert found.rotation_deg == pytest.approx(turned, abs=2.5)
            assert found.overlap_mm2 > 200
    assert min(genuine) > 0.7
    assert max(impostor) < 0.5


def test_a_picture_is_like_itself(templates) -> None:
    for template in templates[:3]:
        found = ridge_match(template, template)
        assert found.similarity == pytest.approx(1.0, abs=1e-3)
        assert found.rotation_deg == pytest.approx(0.0, abs=0.05)
        assert abs(found.right_mm) < 0.01
        assert abs(found.up_mm) < 0.01


def test_order_does_not_matter(templates) -> None:
    for i, j in ((0, 1), (0, 4), (5, 8)):
        one, other = (
            ridge_match(templates[i], templates[j]),
            ridge_match(templates[j], templates[i]),
        )
        assert one.similarity == other.similarity
        assert one.overlap_mm2 == other.overlap_mm2
        assert one.rotation_deg == pytest.approx(-other.rotation_deg, abs=1e-9)


@pytest.mark.parametrize(
    ("angle", "right", "up"),
    [
        (0.0, 0.0, 0.0),
        (7.3, 1.04, -2.31),
        (-23.9, -0.56, 2.77),
        (91.2, 0.0, 1.3),
        (179.4, 1.1, 0.0),
        (-118.6, 0.0, 0.0),
    ],
)
def test_rotation_and_shift_are_found(templates, angle: float, right: float, up: float) -> None:
    fixed = templates[0]
    a = moved(fixed, -angle, 0.0, 0.0)  # a turned by `angle` lies on the fixed one
    found = ridge_match(a, fixed)
    assert found.similarity > 0.85
    assert found.rotation_deg == pytest.approx(angle, abs=0.5)
    assert ridge_match(fixed, a).rotation_deg == pytest.approx(-angle, abs=0.5)
    b = moved(fixed, 0.0, right, up)
    found = ridge_match(fixed, b)
    # cut to what is valid, a template's middle moves with its content
    assert found.similarity > 0.85
    assert abs(found.right_mm) < 0.15
    assert abs(found.up_mm) < 0.15
    part = window(fixed, rows=slice(20, 200), columns=slice(30, 180))
    found = ridge_match(part, fixed)
    middle = (
        (20 + 199) / 2 - (fixed.valid.shape[0] - 1) / 2,
        (30 + 179) / 2 - (fixed.valid.shape[1] - 1) / 2,
    )
    assert found.up_mm == pytest.approx(-0.1 * middle[0], abs=0.05)
    assert found.right_mm == pytest.approx(0.1 * middle[1], abs=0.05)


def test_other_impressions_are_found_at_any_rotation(impressions, templates) -> None:
    """One impression of each finger, turned, is as similar to another one as before; impostors do
    not gain much."""
    rng = np.random.default_rng(4)
    for k in range(0, 9, 3):
        assert impressions[k].finger == impressions[k + 1].finger != impressions[(k + 4) % 9].finger
        upright = ridge_match(templates[k], templates[k + 1]).similarity
        away = moved(templates[k + 1], float(rng.uniform(40, 320)), 0.0, 0.0)
        assert ridge_match(templates[k], away).similarity > upright - 0.05
        assert ridge_match(templates[(k + 4) % 9], away).similarity < 0.5


def test_partial_views_match(impressions, templates) -> None:
    """A third of a finger, of another impression, is still known."""
    part = window(templates[1], rows=slice(60, 170), columns=slice(50, 160))
    assert part.area_mm2 < 125
    genuine = ridge_match(part, templates[0]).similarity
    others = [ridge_match(part, templates[k]).similarity for k in range(3, len(templates), 2)]
    assert genuine > max(others) + 0.15


def test_little_overlap_costs(templates) -> None:
    """Two halves of one picture that share a strip."""
    upper = window(templates[0], rows=slice(0, 140), columns=slice(0, 400))
    lower = window(templates[0], rows=slice(110, 400), columns=slice(0, 400))
    found = ridge_match(upper, lower)
    assert found.overlap_mm2 < 60
    assert found.similarity == pytest.approx(
        found.correlation * np.sqrt(found.overlap_mm2 / 60), abs=1e-6
    )


def test_a_failure_to_acquire_is_compared_with_nothing(templates) -> None:
    found = ridge_match(failed_template(), templates[0])
    assert not found.compared
    assert found.similarity == -1.0


def test_sides_must_have_the_same_pitch(templates) -> None:
    coarse = replace(templates[0], pitch_mm=0.2)
    with pytest.raises(BadInput, match="pitches"):
        ridge_match(coarse, templates[1])


def moved(template: Template, angle_deg: float, right_mm: float, up_mm: float) -> Template:
    """The template turned (counter-clockwise) and shifted on a larger canvas."""
    height, width = template.valid.shape
    side = 2 * max(height, width)
    matrix = cv2.getRotationMatrix2D(((width - 1) / 2, (height - 1) / 2), angle_deg, 1.0)
    matrix[:, 2] += (
        (side - width) / 2 + right_mm / template.pitch_mm,
        (side - height) / 2 - up_mm / template.pitch_mm,
    )
    value = cv2.warpAffine(template.value(), matrix, (side, side), flags=cv2.INTER_CUBIC)
    valid = cv2.warpAffine(template.valid.astype(np.float32), matrix, (side, side)) > 0.99
    return made(np.where(valid, value, 0.0).astype(np.float32), valid, template.pitch_mm)


def window(template: Template, rows: slice, columns: slice) -> Template:
    """A part of a template."""
    return Template(template.level[rows, columns], template.valid[rows, columns], template.pitch_mm)


def made(value: np.ndarray, valid: np.ndarray, pitch_mm: float) -> Template:
    return make_template(RidgeBand(value, valid, pitch_mm))


def test_the_work_of_a_comparison_is_counted(templates, monkeypatch) -> None:
    """Correlations of whole prints, local comparisons, and spectra: none is made twice for a
    prepared side."""
    done: Counter[str] = Counter()

    def counted(module: ModuleType, name: str) -> None:
        work = getattr(module, name)
        monkeypatch.setattr(
            module, name, lambda *given, **how: done.update([name]) or work(*given, **how)
        )

    counted(ridge, "compare_patches")
    counted(coarse, "spectrum_of")
    first, same, other = (Prepared(templates[k]) for k in (0, 1, 3))
    ridge_match(first, same)
    # nine rotations, each there and half a step on; B's ridges; directions of both
    assert done["spectrum_of"] <= 21
    assert done["compare_patches"] <= 4  # two candidates, one refinement, the score
    done.clear()
    ridge_match(first, same)
    assert done["spectrum_of"] == 0
    ridge_match(first, other)
    assert done["compare_patches"] <= 8
    own = Prepared(templates[0])
    done.clear()
    ridge_match(own, own)
    assert done["compare_patches"] == 3  # the second candidate of a clear case is left out
