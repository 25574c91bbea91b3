"""Directions of lights from photographs of a chrome and of a grey ball, against the file that comes
with them."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest

from splitknit.cli.main import main
from splitknit.errors import BadInput
from splitknit_rig.calibration.sphere import (
    Ball,
    ball_of_mask,
    chrome_directions,
    find_ball,
    grey_directions,
    rim_of,
)

pytestmark = pytest.mark.external


@pytest.fixture(scope="module", params=["chrome", "gray"])
def photographs(request, data_dir):
    """Kind, stack, mask and directions; an 8-bit camera of unknown response, taken as linear."""
    folder = data_dir / "psm_spheres"
    if not folder.is_dir():
        pytest.skip(f"{folder} is absent")
    kind = request.param
    images = [
        cv2.imread(str(folder / kind / f"{kind}.{k}.png"), cv2.IMREAD_GRAYSCALE) for k in range(12)
    ]
    mask = cv2.imread(str(folder / kind / f"{kind}.mask.png"), cv2.IMREAD_GRAYSCALE) > 127
    return (
        kind,
        np.stack(images).astype(np.float32) / 255,
        mask,
        np.loadtxt(folder / "lights.txt", skiprows=1),
    )


def errors_deg(found, truth):
    truth = truth / np.linalg.norm(truth, axis=1, keepdims=True)
    return np.degrees(2 * np.arcsin(np.linalg.norm(found - truth, axis=1) / 2))


def directions(kind, stack, ball):
    return chrome_directions(stack, ball) if kind == "chrome" else grey_directions(stack, ball)[0]


def test_directions(photographs):
    """The file is itself an estimate: about its first two lights both balls agree with each other
    and not with it."""
    kind, stack, mask, truth = photographs
    errors = errors_deg(directions(kind, stack, ball_of_mask(mask)), truth)
    assert np.median(errors) < (2.2 if kind == "chrome" else 3.0)
    assert errors.mean() < (3.2 if kind == "chrome" else 3.6)
    assert errors.max() < 9.0


@pytest.mark.parametrize("aside", [(0, 0, 0.96), (0, 0, 1.04), (5, 0, 1.0), (-4, 3, 0.98)])
def test_a_mask_beside_the_ball_gives_way_to_the_rim(photographs, aside):
    """Errors of 3 to 8 deg by the mask itself, which is a per cent off before it is moved."""
    kind, stack, mask, truth = photographs
    ball = ball_of_mask(mask)
    off = Ball(ball.column + aside[0], ball.row + aside[1], aside[2] * ball.radius_px)
    rim, agreed = rim_of(stack, off)
    assert agreed > 0.5
    assert errors_deg(directions(kind, stack, rim), truth).mean() < 3.1


def test_both_balls_agree(data_dir):
    found = []
    for kind in ("chrome", "gray"):
        folder = data_dir / "psm_spheres" / kind
        if not folder.is_dir():
            pytest.skip(f"{folder} is absent")
        images = [
            cv2.imread(str(folder / f"{kind}.{k}.png"), cv2.IMREAD_GRAYSCALE) for k in range(12)
        ]
        mask = cv2.imread(str(folder / f"{kind}.mask.png"), cv2.IMREAD_GRAYSCALE) > 127
        found.append(
            directions(kind, np.stack(images).astype(np.float32) / 255, ball_of_mask(mask))
        )
    errors = errors_deg(*found)
    assert np.median(errors) < 2.0 and errors.mean() < 2.1 and errors.max() < 5.6


def test_the_outline_is_found_or_asked_for(photographs):
    """The grey ball stands out, the chrome one is black but for its highlight."""
    kind, stack, mask, _ = photographs
    if kind == "chrome":
        with pytest.raises(BadInput, match="`mask`"):
            find_ball(stack)
        return
    given, found = ball_of_mask(mask), find_ball(stack)
    assert found.radius_px == pytest.approx(given.radius_px, rel=0.03)
    assert np.hypot(found.column - given.column, found.row - given.row) < 0.03 * given.radius_px


@pytest.mark.parametrize("name", ["lights.txt", "rig.json"])
def test_a_chrome_ball_gives_the_lights_of_a_grey_one(data_dir, tmp_path, name):
    """On the command line: from twelve photographs of chrome to the surface of the grey ball."""
    folder = data_dir / "psm_spheres"
    if not folder.is_dir():
        pytest.skip(f"{folder} is absent")
    out, result, mask = tmp_path / name, tmp_path / "result", folder / "gray" / "gray.mask.png"
    found = [
        "--images",
        str(folder / "chrome"),
        "--mask",
        str(folder / "chrome" / "chrome.mask.png"),
    ]
    assert main(["calibrate", "lights", "--sphere", "chrome", *found, "--out", str(out)]) == 0
    given = ["--images", str(folder / "gray"), "--mask", str(mask), "--lights", str(out)]
    assert main(["reconstruct", *given, "--out", str(result)]) == 0
    codes = {
        finding["code"] for finding in json.loads((result / "report.json").read_text())["findings"]
    }
    assert "assumed-encoding" in codes and "light-frame" not in codes
    inside = cv2.imread(str(mask), cv2.IMREAD_GRAYSCALE) > 127
    ball = ball_of_mask(inside).normals(inside.shape)
    with np.load(result / "height.npz") as arrays:
        normals = arrays["normals"].astype(float)
    middle = inside & (np.nan_to_num(ball[..., 2]) > np.cos(np.deg2rad(60)))
    errors = np.degrees(np.arccos(np.clip((normals * ball).sum(axis=-1)[middle], -1, 1)))
    assert errors.mean() < 4.5
