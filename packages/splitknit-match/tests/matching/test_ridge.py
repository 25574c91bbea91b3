"""The ridge matcher on simulated fingers and on templates whose alignment is known."""

import itertools
from dataclasses import replace
from unittest.mock import Mock

import cv2
import numpy as np
import pytest

from refusals import bad_input
from splitknit_match.matching import coarse, ridge
from splitknit_match.matching.ridge import Prepared, ridge_match
from splitknit_match.matching.ridge_band import RidgeBand
from splitknit_match.matching.template import Template, failed_template, make_template


@pytest.mark.slow
def test_same_fingers_are_more_similar_than_any_others(impressions, templates):
    ready = [Prepared(template) for template in templates]
    genuine, impostor = [], []
    for i, j in itertools.combinations(range(len(ready)), 2):
        match = ridge_match(ready[i], ready[j])
        a, b = impressions[i], impressions[j]
        if a.finger != b.finger:
            impostor.append(match.similarity)
            continue
        genuine.append(match.similarity)
        # no upright frames: b is turned by the difference of the yaws
        turned = np.rad2deg(b.pose.yaw_rad - a.pose.yaw_rad)
        assert match.rotation_deg == pytest.approx(turned, abs=2.5)
        assert match.overlap_mm2 > 200
    assert min(genuine) > 0.7
    assert max(impostor) < 0.5


@pytest.mark.parametrize(("i", "j"), [(0, 1), (0, 4), (5, 8)])
def test_exchanged_sides_score_the_same(templates, i, j):
    match = ridge_match(templates[i], templates[j])
    exchanged = ridge_match(templates[j], templates[i])
    assert match.similarity == exchanged.similarity
    assert match.overlap_mm2 == exchanged.overlap_mm2
    assert match.rotation_deg == pytest.approx(-exchanged.rotation_deg, abs=1e-9)


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
def test_rotation_and_shift_are_recovered(templates, angle, right, up):
    fixed = templates[0]
    turned = moved(fixed, -angle, 0.0, 0.0)  # turned by `angle`, it lies on the fixed one
    match = ridge_match(turned, fixed)
    assert match.similarity > 0.85
    assert match.rotation_deg == pytest.approx(angle, abs=0.5)
    assert ridge_match(fixed, turned).rotation_deg == pytest.approx(-angle, abs=0.5)
    match = ridge_match(fixed, moved(fixed, 0.0, right, up))
    # cut to what is valid, a template's middle moves with its content
    assert match.similarity > 0.85
    assert abs(match.right_mm) < 0.15
    assert abs(match.up_mm) < 0.15


def test_the_shift_of_a_part_is_that_of_its_middle(templates):
    whole = templates[0]
    rows, columns = whole.valid.shape
    match = ridge_match(window(whole, rows=slice(20, 200), columns=slice(30, 180)), whole)
    assert match.up_mm == pytest.approx(0.1 * ((rows - 1) / 2 - (20 + 199) / 2), abs=0.05)
    assert match.right_mm == pytest.approx(0.1 * ((30 + 179) / 2 - (columns - 1) / 2), abs=0.05)


def test_second_impressions_match_at_any_rotation(impressions, templates):
    """Turned, a second impression is as similar as before; impostors do not gain much."""
    rng = np.random.default_rng(4)
    for k in range(0, 9, 3):
        assert impressions[k].finger == impressions[k + 1].finger != impressions[(k + 4) % 9].finger
        upright = ridge_match(templates[k], templates[k + 1]).similarity
        away = moved(templates[k + 1], float(rng.uniform(40, 320)), 0.0, 0.0)
        assert ridge_match(templates[k], away).similarity > upright - 0.05
        assert ridge_match(templates[(k + 4) % 9], away).similarity < 0.5


def test_a_third_of_a_second_impression_matches(templates):
    part = window(templates[1], rows=slice(60, 170), columns=slice(50, 160))
    assert part.area_mm2 < 125
    genuine = ridge_match(part, templates[0]).similarity
    impostors = [ridge_match(part, templates[k]).similarity for k in range(3, len(templates), 2)]
    assert genuine > max(impostors) + 0.15


def test_a_failure_to_acquire_is_not_compared(templates):
    match = ridge_match(failed_template(), templates[0])
    assert not match.compared
    assert match.similarity == -1.0


def test_sides_must_have_the_same_pitch(templates):
    with bad_input("pitches"):
        ridge_match(replace(templates[0], pitch_mm=0.2), templates[1])


def moved(template, angle_deg, right_mm, up_mm):
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
    value = np.where(valid, value, 0.0).astype(np.float32)
    return make_template(RidgeBand(value, valid, template.pitch_mm))


def window(template, rows, columns):
    """A part of a template."""
    return Template(template.level[rows, columns], template.valid[rows, columns], template.pitch_mm)


def test_no_work_is_done_twice_for_a_prepared_side(templates, monkeypatch):
    """Spectra of whole prints, and local comparisons."""
    patches, spectra = Mock(wraps=ridge.compare_patches), Mock(wraps=coarse.spectrum_of)
    monkeypatch.setattr(ridge, "compare_patches", patches)
    monkeypatch.setattr(coarse, "spectrum_of", spectra)
    first, same, impostor = (Prepared(templates[k]) for k in (0, 1, 3))
    ridge_match(first, same)
    # nine rotations, each there and half a step on; B's ridges; directions of both
    assert spectra.call_count <= 21
    assert patches.call_count <= 4  # two candidates, one refinement, the score
    patches.reset_mock()
    spectra.reset_mock()
    ridge_match(first, same)
    assert spectra.call_count == 0
    ridge_match(first, impostor)
    assert patches.call_count <= 8
    own = Prepared(templates[0])
    patches.reset_mock()
    ridge_match(own, own)
    assert patches.call_count == 3  # the second candidate of a clear case is left out
