"""Directions of lights from photographs of a chrome and of a grey ball, against the file that comes
with them."""

import json

import cv2
import numpy as np
import pytest

from enrolled import refusal_of, words_of
from refusals import bad_input
from splitknit_rig.calibration.sphere import (
    balls_of_mask,
    chrome_directions,
    find_ball,
    grey_directions,
)

pytestmark = pytest.mark.external


@pytest.fixture(scope="module")
def folder(data_dir):
    path = data_dir / "psm_spheres"
    if not path.is_dir():
        pytest.skip(f"{path} is absent")
    return path


def stack_and_mask(folder, kind):
    """Of an 8-bit camera of unknown response, taken as linear."""
    *images, mask = (
        cv2.imread(str(folder / kind / f"{kind}.{name}.png"), cv2.IMREAD_GRAYSCALE)
        for name in (*range(12), "mask")
    )
    return np.stack(images).astype(np.float32) / 255, mask > 127


@pytest.fixture(scope="module", params=["chrome", "gray"])
def photographs(request, folder):
    """Kind, stack, mask and directions."""
    directions = np.loadtxt(folder / "lights.txt", skiprows=1)
    return request.param, *stack_and_mask(folder, request.param), directions


def errors_deg(estimated, truth):
    truth = truth / np.linalg.norm(truth, axis=1, keepdims=True)
    return np.degrees(2 * np.arcsin(np.linalg.norm(estimated - truth, axis=1) / 2))


def directions(kind, stack, ball):
    return chrome_directions(stack, ball) if kind == "chrome" else grey_directions(stack, ball)[0]


def test_directions_agree_with_the_lights_of_the_data_set(photographs):
    """The file is itself an estimate: about its first two lights both balls agree with each other
    and not with it."""
    kind, stack, mask, truth = photographs
    errors = errors_deg(directions(kind, stack, balls_of_mask(mask)[0]), truth)
    assert np.median(errors) < (2.2 if kind == "chrome" else 3.0)
    assert errors.mean() < (3.2 if kind == "chrome" else 3.6)
    assert errors.max() < 9.0


def test_directions_of_both_balls_agree(folder):
    estimated = []
    for kind in ("chrome", "gray"):
        stack, mask = stack_and_mask(folder, kind)
        estimated.append(directions(kind, stack, balls_of_mask(mask)[0]))
    errors = errors_deg(*estimated)
    assert np.median(errors) < 2.0 and errors.mean() < 2.1 and errors.max() < 5.6


def test_the_outline_is_found_or_a_mask_requested(photographs):
    """The grey ball stands out, the chrome one is black but for its highlight."""
    kind, stack, mask, _ = photographs
    if kind == "chrome":
        with bad_input("`mask`"):
            find_ball(stack)
        return
    known, estimated = balls_of_mask(mask)[0], find_ball(stack)
    assert estimated.radius_px == pytest.approx(known.radius_px, rel=0.03)
    assert (
        np.hypot(estimated.column - known.column, estimated.row - known.row)
        < 0.03 * known.radius_px
    )


@pytest.mark.parametrize("name", ["lights.txt", "rig.json"])
def test_the_lights_of_a_chrome_ball_reconstruct_a_grey_one(folder, tmp_path, name, capsys):
    """On the command line: from twelve photographs of chrome to the surface of the grey ball."""
    out, result, mask = tmp_path / name, tmp_path / "result", folder / "gray" / "gray.mask.png"
    chrome = "--images", folder / "chrome", "--mask", folder / "chrome" / "chrome.mask.png"
    words_of(capsys, "calibrate lights --sphere chrome", *chrome, "--out", out)
    grey = "--images", folder / "gray", "--mask", mask, "--lights", out
    words_of(capsys, "reconstruct", *grey, "--out", result)
    codes = {
        finding["code"] for finding in json.loads((result / "report.json").read_text())["findings"]
    }
    assert "assumed-encoding" in codes and "light-frame" not in codes
    inside = cv2.imread(str(mask), cv2.IMREAD_GRAYSCALE) > 127
    ball = balls_of_mask(inside)[0].normals(inside.shape)
    with np.load(result / "height.npz") as arrays:
        normals = arrays["normals"].astype(float)
    middle = inside & (np.nan_to_num(ball[..., 2]) > np.cos(np.deg2rad(60)))
    errors = np.degrees(np.arccos(np.clip((normals * ball).sum(axis=-1)[middle], -1, 1)))
    assert errors.mean() < 4.5


@pytest.mark.slow
def test_a_coin_is_not_taken_for_a_chrome_ball(capsys, data_dir, tmp_path):
    """It is the largest round thing in the picture, and balls lie beside it."""
    path = data_dir / "dome" / "birr"
    if not path.is_dir():
        pytest.skip(f"{path} is absent")
    out = tmp_path / "lights.txt"
    words = "lights", "--images", path, "--sphere", "chrome", "--out", out
    assert "seems to be no ball" in refusal_of(capsys, "calibrate", *words)
    assert not out.exists()
