"""Direct light of skin from one photograph, by the network of the thesis (section 3.3.1.4)."""

from __future__ import annotations

import os
from typing import Any

import cv2
import numpy as np

from splitknit.errors import require
from splitknit.model import FloatArray
from splitknit.networks.unet import Network, load_network, run_network

DEFAULT_NETWORK = "direct"


def exposure_level(image: FloatArray) -> float:
    """An image's white: the 99.9th percentile of its positive values, all channels together, at
    every second pixel."""
    sample = image[..., ::2, ::2]
    sample = sample[sample > 0]
    return float(np.percentile(sample, 99.9)) if sample.size else 1.0


_LEVEL_SIGMA_PX = 16.0
"""Standard deviation of the neighbourhood whose mean brightness the network takes as one; it was
trained with it. Range: 8 to 32 (validation/parameters)."""


def local_level(image: FloatArray) -> FloatArray:
    """(h, w) mean brightness of the skin about each pixel, one for all channels: what the network
    takes as one. A Gaussian mean over the pixels of `image`, (h, w) or (C, h, w), that are not
    black, by blocks of 8 x 8 pixels.
    """
    grey = np.maximum(image if image.ndim == 2 else image.mean(axis=0, dtype=np.float32), 0.0)
    height, width = grey.shape
    coarse = -(-width // 8), -(-height // 8)

    def spread(values: FloatArray) -> FloatArray:
        small = cv2.resize(values, coarse, interpolation=cv2.INTER_AREA)
        return np.asarray(
            cv2.GaussianBlur(small, (0, 0), _LEVEL_SIGMA_PX / 8, borderType=cv2.BORDER_REFLECT)
        )

    level = spread(grey) / np.maximum(spread((grey > 0).astype(np.float32)), 1e-3)
    # below this fraction of white there is noise alone
    least = max(0.05 * exposure_level(image), 1e-12)
    return np.asarray(
        cv2.resize(np.maximum(level, least), (width, height), interpolation=cv2.INTER_LINEAR)
    )


def direct_light(
    images: Any, network: Network | str | os.PathLike[str] = DEFAULT_NETWORK
) -> FloatArray:
    """Direct light of every image; what is left, image minus direct, is global light.

    Every image is divided by its :func:`local_level` and the result multiplied by it, so that
    neither exposure nor shading matters. What "direct" is depends on the size of the checks that
    the network was trained with; its card shows. The result, of the shape of `images`, lies between
    zero and the image; for enhanced images it is what enhancement makes of the image times the
    direct fraction of its light. Raises BadInput if the images have the wrong shape, hold NaN, or
    are smaller than the network's stride. Source: the thesis, 3.3.1.4; O. Ronneberger, P. Fischer
    and T. Brox, "U-Net", MICCAI 2015.

    images : (N, H, W) grey (given to the network three times, as in the thesis) or (N, 3, H, W)
    red, green, blue;
        linear light, or enhanced by CLAHE; any scale, zero outside the skin
    network : Network, name of a shipped network, or path of an ``.onnx`` file
    """
    ready = network if isinstance(network, Network) else load_network(network)
    stack = np.asarray(images, dtype=np.float32)
    require(
        stack.ndim == 3 or (stack.ndim == 4 and stack.shape[1] == 3),
        f"images must have the shape (N, H, W) or (N, 3, H, W), but they have {stack.shape}.",
    )
    require(stack.size > 0, f"images are empty: shape {stack.shape}.")
    levels = np.stack([local_level(image) for image in stack])
    if stack.ndim == 4:
        levels = levels[:, None]
    direct = run_network(ready, stack / levels)
    if stack.ndim == 3:
        direct = direct.mean(axis=1, dtype=np.float32)
    direct *= levels
    return np.clip(direct, 0.0, np.maximum(stack, 0.0), out=direct)
