"""The same finger, turned, mirrored or with its lights in another order, has the same surface."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
import pytest

from splitknit.finger.locate import find_finger
from splitknit.methods.metric import metric_skin
from splitknit.observation.observe import observe
from splitknit.presets import preset_settings
from splitknit.skin.grid import BandImages, Grid
from splitknit.skin.images import working_images
from splitknit.skin.learned import Networks
from splitknit_simulator.twin import simulate_capture

SETTINGS = preset_settings("metric")


@dataclass(frozen=True, eq=False)
class Piece:
    """The middle of a finger: images, grid and networks."""

    bands: tuple[BandImages, ...]
    grid: Grid
    networks: Networks | None

    def surface(self):
        """Shape, less its mean, and relief."""
        surface = metric_skin(
            self.bands, self.grid, SETTINGS.skin, SETTINGS.metric, networks=self.networks
        )
        mean = surface.shape_mm[self.grid.mask].mean()
        return (surface.shape_mm - mean) * self.grid.mask, surface.relief_mm * self.grid.mask

    def moved(self, image, place, mask):
        """The piece whose images and lights are moved; its middle stays where it is."""
        bands = []
        for band in self.bands:
            leds = tuple(
                replace(led, position_mm=(*place(*led.position_mm[:2]), led.position_mm[2]))
                for led in band.rig.leds
            )
            flat = band.stack.reshape(-1, *band.stack.shape[-2:])
            stack = (
                np.stack([image(each) for each in flat]).reshape(*band.stack.shape[:2], *mask.shape)
                * mask
            )
            bands.append(
                BandImages(
                    band.channels,
                    np.ascontiguousarray(stack, np.float32),
                    replace(band.rig, leds=leds),
                )
            )
        return Piece(
            tuple(bands), replace(self.grid, mask=np.ascontiguousarray(mask)), self.networks
        )


@pytest.fixture(scope="module")
def piece():
    capture, _ = simulate_capture(1001, settings={"scale": 0.34})
    light = observe(capture)
    finger = find_finger(light, SETTINGS)
    bands = light.bands["white"], light.bands["nir"]
    images = working_images(bands, None, finger.window, finger.inside, SETTINGS.metric)
    rows, columns = np.nonzero(images.grid.mask)
    row, column, side = int(np.median(rows)), int(np.median(columns)), 192
    cut = np.s_[row - side : row + side, column - side : column + side]
    pitch = images.grid.pitch_mm
    x = (np.arange(2 * side) - side + 0.5) * pitch
    far_x, far_y = (
        float(images.grid.x_mm[column] - 0.5 * pitch),
        float(images.grid.y_mm[row] + 0.5 * pitch),
    )
    disc = np.hypot(x[None, :], x[:, None]) < 0.96 * side * pitch
    shown = []
    for band in images.bands:
        leds = tuple(
            replace(led, position_mm=tuple(np.subtract(led.position_mm, (far_x, far_y, 0.0))))
            for led in band.rig.leds
        )
        stack = np.ascontiguousarray(band.stack[(..., *cut)] * (images.grid.mask[cut] & disc))
        shown.append(BandImages(band.channels, stack, replace(band.rig, leds=leds)))
    grid = Grid(images.grid.mask[cut] & disc, x, -x, pitch, (False,) * 4)
    return Piece(tuple(shown), grid, images.networks)


@pytest.fixture(scope="module")
def straight(piece):
    return piece.surface()


@pytest.mark.slow
def test_the_order_of_the_lights_does_not_matter(piece, straight):
    order = [3, 0, 6, 1, 5, 2, 4]
    bands = tuple(
        BandImages(
            b.channels,
            np.ascontiguousarray(b.stack[:, order]),
            replace(b.rig, leds=tuple(b.rig.leds[k] for k in order)),
        )
        for b in piece.bands
    )
    shape, relief = replace(piece, bands=bands).surface()
    np.testing.assert_allclose(shape, straight[0], atol=2e-4)
    np.testing.assert_allclose(relief, straight[1], atol=2e-4)


@pytest.mark.slow
def test_a_mirrored_finger_has_a_mirrored_surface(piece, straight):
    mask = piece.grid.mask[:, ::-1]
    shape, relief = piece.moved(lambda a: a[:, ::-1], lambda x, y: (-x, y), mask).surface()
    same_surface((shape[:, ::-1], relief[:, ::-1]), straight, piece.grid)


@pytest.mark.slow
@pytest.mark.parametrize("turn_deg", [137.0, 30.0, 90.0, 180.0])
def test_a_turned_finger_has_a_turned_surface(piece, straight, turn_deg):
    side = piece.grid.shape[0]
    matrix = cv2.getRotationMatrix2D(((side - 1) / 2, (side - 1) / 2), turn_deg, 1.0)
    back = cv2.invertAffineTransform(matrix)
    c, s = np.cos(np.deg2rad(turn_deg)), np.sin(np.deg2rad(turn_deg))

    def turned(image, by=matrix):
        return cv2.warpAffine(
            np.ascontiguousarray(image, np.float32), by, (side, side), flags=cv2.INTER_CUBIC
        )

    mask = turned(piece.grid.mask) > 0.999
    surface = piece.moved(turned, lambda x, y: (c * x - s * y, s * x + c * y), mask).surface()
    same_surface(tuple(turned(part, back) for part in surface), straight, piece.grid)


def same_surface(measured, wanted, grid):
    inner = grid.mask & (grid.depth_mm > 1.0)
    shape, relief = (
        (error - error[inner].mean())[inner]
        for error in (measured[0] - wanted[0], measured[1] - wanted[1])
    )
    assert shape.std() < 0.15 * wanted[0][inner].std()
    assert relief.std() < 0.3 * wanted[1][inner].std()
    assert np.corrcoef(measured[1][inner], wanted[1][inner])[0, 1] > 0.96
