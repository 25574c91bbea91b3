"""Real photographs with laser-scanned normals: DiLiGenT's bear under 24 of its lights."""

import numpy as np
import pytest

from splitknit.photometric.lambertian import lambertian
from splitknit.photometric.robust import robust

pytestmark = pytest.mark.external


@pytest.fixture(scope="module")
def bear(data_dir):
    path = data_dir / "diligent" / "bear.npz"
    if not path.is_file():
        pytest.skip(f"{path} is absent")
    with np.load(path) as data:
        return {name: data[name] for name in ("images", "lights", "mask", "normals")}


def mean_error_deg(normals, bear, mask):
    return float(
        np.degrees(np.arccos(np.clip((normals * bear["normals"]).sum(axis=-1), -1, 1)))[mask].mean()
    )


def test_normals_of_the_bear_are_as_accurate_as_stored(bear):
    mask = bear["mask"].astype(bool)
    stack = bear["images"].astype(np.float32) / 65535
    plain, _ = lambertian(stack, bear["lights"], mask)
    kept, albedo = robust(stack, bear["lights"], mask)
    assert mean_error_deg(plain, bear, mask) < 8.95
    assert mean_error_deg(kept, bear, mask) < 5.5
    assert (albedo[mask] > 0).all()


@pytest.mark.parametrize("seed", range(3))
def test_robust_is_better_with_seven_of_the_lights_too(bear, seed):
    mask = bear["mask"].astype(bool)
    chosen = np.sort(np.random.default_rng(seed).choice(24, 7, replace=False))
    stack, lights = bear["images"][chosen].astype(np.float32) / 65535, bear["lights"][chosen]
    plain, _ = lambertian(stack, lights, mask)
    kept, _ = robust(stack, lights, mask)
    assert mean_error_deg(kept, bear, mask) < mean_error_deg(plain, bear, mask)
