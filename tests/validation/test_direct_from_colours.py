"""Direct light of enhanced images by the fraction of their colours."""

from __future__ import annotations

import numpy as np
import pytest

from script_folder import VALIDATION, Script
from splitknit.errors import BadInput
from splitknit.networks.unet import load_network
from splitknit.separation.direct import direct_light

FOLDER = VALIDATION / "separation"
TINY = VALIDATION.parent / "packages/splitknit/tests/networks/tiny.onnx"


def test_enhanced_images_get_the_direct_fraction_of_the_colour_images(script: Script) -> None:
    direct_of_enhanced = script("from_colours").direct_of_enhanced
    network = load_network(TINY)
    images = np.random.default_rng(5).random((2, 3, 203, 150), dtype=np.float32)
    enhanced = np.sqrt(images.mean(axis=1))
    weights = np.array([0.299, 0.587, 0.114])[:, None, None]
    fraction = (direct_light(images, network) * weights).sum(axis=1) / (images * weights).sum(
        axis=1
    )
    assert np.ptp(fraction) > 0.05
    np.testing.assert_allclose(
        direct_of_enhanced(enhanced, images, network), enhanced * fraction, rtol=1e-4, atol=1e-6
    )
    with pytest.raises(BadInput, match="do not match"):
        direct_of_enhanced(enhanced[:1], images, network)
