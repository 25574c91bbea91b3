"""Photographs of a grey ball under twelve lights: normals against the sphere that its outline
gives."""

import cv2
import numpy as np
import pytest

import splitknit
from splitknit.photometric.lambertian import lambertian
from splitknit.photometric.robust import robust

pytestmark = pytest.mark.external


@pytest.fixture(scope="module")
def ball(data_dir):
    """Stack, lights, mask and the sphere's normals; an 8-bit camera of unknown response, taken as
    linear."""
    folder = data_dir / "psm_spheres"
    if not folder.is_dir():
        pytest.skip(f"{folder} is absent")
    images = [
        cv2.imread(str(folder / "gray" / f"gray.{k}.png"), cv2.IMREAD_GRAYSCALE) for k in range(12)
    ]
    lights = np.loadtxt(folder / "lights.txt", skiprows=1)
    mask = cv2.imread(str(folder / "gray" / "gray.mask.png"), cv2.IMREAD_GRAYSCALE) > 127
    rows, columns = np.nonzero(mask)
    centre_x, centre_y = (columns.min() + columns.max()) / 2, (rows.min() + rows.max()) / 2
    radius = (np.ptp(columns) + np.ptp(rows) + 2) / 4
    i, j = np.mgrid[0 : mask.shape[0], 0 : mask.shape[1]]
    x, y = (j - centre_x) / radius, (centre_y - i) / radius
    sphere = np.dstack([x, y, np.sqrt(np.clip(1 - x**2 - y**2, 0, None))])
    return np.stack(images).astype(np.float32) / 255, lights, mask, sphere


def test_normals_follow_the_sphere(ball):
    stack, lights, mask, sphere = ball
    inner = mask & (sphere[..., 2] > np.cos(np.deg2rad(75)))
    errors = {}
    for method in (lambertian, robust):
        normals, _ = method(stack, lights, mask)
        errors[method.__name__] = np.degrees(
            np.arccos(np.clip((normals * sphere).sum(axis=-1), -1, 1))
        )[inner].mean()
    assert errors["lambertian"] < 5.5
    assert errors["robust"] < 4.6


@pytest.mark.parametrize("masked", [False, True])
def test_the_wall_behind_is_left_out_with_a_finding(ball, masked):
    stack, lights, mask, _ = ball
    result = splitknit.reconstruct_images(stack, lights, mask if masked else None)
    noted = "background-left-out" in [finding.code for finding in result.findings]
    assert noted == (not masked)
    assert (result.mask & mask).sum() / (result.mask | mask).sum() > 0.95
