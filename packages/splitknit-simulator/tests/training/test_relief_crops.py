from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit.imaging.view import _pixel_axes_mm
from splitknit_simulator.light.renderer import BandLight
from splitknit_simulator.training import relief
from splitknit_simulator.training.fields import FIELDS
from splitknit_simulator.training.relief import (
    CHANNELS,
    GLARE,
    RELIEF,
    TRIM_PX,
    WEIGHT,
    ReliefData,
    training_crops,
)

SMALL = ReliefData(scale=0.15, crop_usual_share=1.0, crop_px=180, crops=3)
SIDE = 180 - 2 * TRIM_PX


@pytest.fixture(scope="module")
def taken():
    """Pieces of a finger, and what each was assembled from."""
    seen = []
    plain, surface, surfaces = relief._assembled, relief.finger_surface, []

    def assembled(white, grid, surface_mm, light, truth):
        seen.append((white, grid, surface_mm, truth))
        return plain(white, grid, surface_mm, light, truth)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(relief, "_assembled", assembled)
        patch.setattr(relief, "finger_surface", lambda *a, **k: surfaces.append(surface(*a, **k)) or surfaces[-1])
        return training_crops(7000, SMALL), seen, surfaces[0]


@pytest.mark.slow
def test_pieces_hold_skin_relief_and_glare(taken) -> None:
    pieces = taken[0]
    assert pieces.shape[1:] == (CHANNELS, SIDE, SIDE) and 1 <= len(pieces) <= 3 and pieces.dtype == np.float16
    values = pieces.astype(np.float32)
    assert np.isfinite(values).all()
    for piece in values:
        assert piece[WEIGHT].mean() >= 0.2
        skin = piece[WEIGHT] > 0.9
        assert 0.2 < piece[RELIEF][skin].std() < 5 and piece[GLARE][0][skin].mean() >= 0
        assert abs(np.corrcoef(piece[RELIEF][skin], piece[2][skin])[0, 1]) > 0.03  # pigment varies beside it
    if len(values) > 1:  # another skin under other lights
        assert not np.array_equal(values[0][FIELDS - 3 : FIELDS, 30, 30], values[1][FIELDS - 3 : FIELDS, 30, 30])


def test_a_piece_lies_where_it_was_cut_and_its_shape_is_a_little_wrong(taken) -> None:
    _, seen, surface = taken
    for white, grid, smooth_mm, truth in seen:
        window = []
        for axis, own in zip(_pixel_axes_mm(white.rig.camera), (grid.x_mm, grid.y_mm), strict=True):
            first = int(np.argmin(np.abs(axis - own[0])))
            np.testing.assert_allclose(own, axis[first : first + 180], atol=1e-6)
            window.append(slice(first, first + 180))
        np.testing.assert_array_equal(grid.mask, surface.mask[window[1], window[0]])
        there = (surface.height_mm - surface.shape_mm)[window[1], window[0]][grid.mask]
        np.testing.assert_allclose(truth.relief_mm()[grid.mask], there, atol=1e-5)
        assert white.stack.shape == (3, 7, 180, 180) and len(white.rig.leds) == 7
        assert 0.3 < white.stack.max() <= 1.0
        error = (smooth_mm - truth.shape_mm())[grid.mask]
        assert 1e-3 < error.std() < 1.5  # mm, a tilted and bent plane over 16 mm


def test_pieces_follow_from_the_finger_s_number(taken) -> None:
    pieces = taken[0]
    one = training_crops(7000, replace(SMALL, crops=1))
    np.testing.assert_array_equal(one[0], pieces[0])


def test_rendered_light_is_put_where_its_window_says() -> None:
    light = np.arange(2 * 4 * 5, dtype=np.float32).reshape(2, 4, 5)
    # rows 9 to 12 and columns 18 to 22 of the picture; the piece begins at row 10 and column 20
    band = BandLight((slice(9, 13), slice(18, 23)), light, light)
    piece = relief._placed(light, band, (slice(10, 16), slice(20, 26)))
    assert piece.shape == (2, 6, 6)
    np.testing.assert_array_equal(piece[:, :3, :3], light[:, 1:, 2:])
    assert piece[:, 3:].sum() == 0 and piece[:, :, 3:].sum() == 0


def test_pieces_larger_than_the_picture_are_refused() -> None:
    with pytest.raises(BadInput, match="do not fit into images"):
        training_crops(7000, replace(SMALL, crop_px=420))
    with pytest.raises(BadInput, match="rim"):
        training_crops(7000, replace(SMALL, crop_px=120))
