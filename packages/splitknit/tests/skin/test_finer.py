"""A grid of half the pitch: it looks at the same places, and a coarse camera's relief is as good as
a fine one's."""

import numpy as np
import pytest

from splitknit.imaging.pixels import bin_mean
from splitknit.imaging.view import view_of
from splitknit.model import Camera
from splitknit.nominal import default_rig
from splitknit.skin.grid import BandImages, Grid
from splitknit.skin.images import finer_grid, finer_images


@pytest.mark.parametrize("model", ["orthographic", "perspective"])
def test_the_finer_grid_equals_that_of_a_camera_with_half_the_pitch(model):
    def grid(px_per_mm, shape):
        matrix = None
        if model == "perspective":
            focal = px_per_mm * 140.0
            matrix = np.array(
                [[focal, 0, (shape[1] - 1) / 2], [0, focal, (shape[0] - 1) / 2], [0, 0, 1]]
            )
        camera = Camera(px_per_mm, shape, 140.0, model, matrix)
        view = view_of(camera, slice(0, shape[0]), slice(0, shape[1]), along_rays=True)
        return Grid(
            np.ones(shape, bool), view.x_mm, view.y_mm, 1 / px_per_mm, (False,) * 4, view.apex_mm
        )

    finer, expected = finer_grid(grid(10.0, (12, 17))), grid(20.0, (24, 34))
    assert finer.pitch_mm == expected.pitch_mm and finer.shape == expected.shape
    np.testing.assert_allclose(finer.x_mm, expected.x_mm, atol=1e-6)
    np.testing.assert_allclose(finer.y_mm, expected.y_mm, atol=1e-6)


def test_finer_images_keep_their_places():
    rows, columns = np.mgrid[:20, :30].astype(np.float32)
    stack = np.stack([3 * rows + columns, 50 - columns])[None].repeat(3, axis=0)
    fine = finer_images(BandImages(("red", "green", "blue"), stack, default_rig()))
    assert fine.stack.shape == (3, 2, 40, 60)
    for c in range(3):
        for k in range(2):
            np.testing.assert_allclose(
                bin_mean(fine.stack[c, k], 2)[2:-2, 2:-2], stack[c, k][2:-2, 2:-2], atol=1e-3
            )
