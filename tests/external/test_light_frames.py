"""Lights of others' data, given in each of eight frames: the frame is named, and the right one
never doubted."""

import cv2
import numpy as np
import pytest

from splitknit.diagnosis.frames import FRAMES, fit_lights
from splitknit.io.light_list import read_light_list

pytestmark = pytest.mark.external

SETS = ("bear", "ball", "phalange")


def images_of(data_dir, name):
    """Stack, lights and mask."""
    if name == "bear":
        with np.load(data_dir / "diligent" / "bear.npz") as data:
            return (
                data["images"].astype(np.float32) / 65535,
                data["lights"],
                data["mask"].astype(bool),
            )
    if name == "ball":
        folder, lights = data_dir / "psm_spheres" / "gray", data_dir / "psm_spheres" / "lights.txt"
        files, mask, dark = (
            [folder / f"gray.{k}.png" for k in range(12)],
            folder / "gray.mask.png",
            0.0,
        )
        directions = np.loadtxt(lights, skiprows=1)
    else:
        folder = data_dir / "blender_finger" / "phalange"
        files, mask, dark = (
            [folder / f"light_{k:02d}.png" for k in range(12)],
            folder / "mask.png",
            71.0,
        )
        directions = read_light_list(folder / "lights.txt").lights
    read = [cv2.imread(str(file), cv2.IMREAD_ANYDEPTH) for file in (*files, mask)]
    stack = np.stack(read[:-1]).astype(np.float32)
    return np.maximum(stack - dark, 0) / stack.max(), directions, read[-1] > 127


@pytest.mark.slow
@pytest.mark.parametrize("name", SETS)
def test_all_eight_frames(data_dir, name):
    if not all(
        (data_dir / folder).is_dir() for folder in ("diligent", "psm_spheres", "blender_finger")
    ):
        pytest.skip("data sets are absent")
    stack, lights, mask = images_of(data_dir, name)
    for frame, matrix in FRAMES.items():
        turned = np.array(lights, dtype=float)
        turned[:, :2] = turned[:, :2] @ np.array(matrix, dtype=float)
        assert fit_lights(stack, turned, mask).frame == frame


@pytest.mark.slow
@pytest.mark.parametrize("name", SETS)
def test_wrong_orders_are_found_and_the_right_one_never_doubted(data_dir, name):
    if not all(
        (data_dir / folder).is_dir() for folder in ("diligent", "psm_spheres", "blender_finger")
    ):
        pytest.skip("data sets are absent")
    stack, lights, mask = images_of(data_dir, name)
    own = np.arange(len(stack))
    for order in (own, own[::-1], np.roll(own, -3), np.random.default_rng(1).permutation(own)):
        fit = fit_lights(stack[order], lights, mask)
        assert (fit.order, fit.frame) == (tuple(order.tolist()), "right-up")
