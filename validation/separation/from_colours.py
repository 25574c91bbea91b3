"""Direct light of enhanced grey images by the fraction that the network sees in their colours."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from splitknit.errors import require
from splitknit.imaging.pixels import GREY_WEIGHTS
from splitknit.model import FloatArray
from splitknit.networks.unet import Network
from splitknit.separation.direct import DEFAULT_NETWORK, direct_light


def direct_of_enhanced(
    enhanced: Any, images: Any, network: Network | str | os.PathLike[str] = DEFAULT_NETWORK
) -> FloatArray:
    """Direct part (N, H, W) of enhanced grey images, by the direct fraction of their colour images
    (N, 3, H, W).

    Grey images have lost the colours that show how much of skin's light is direct: here the network
    sees the colours, and its fraction multiplies the enhanced image. The thesis gives it the
    enhanced image itself (:func:`splitknit.separation.direct.direct_light`).
    """
    grey, colours = np.asarray(enhanced, dtype=np.float32), np.asarray(images, dtype=np.float32)
    good = grey.ndim == 3 and colours.shape == (grey.shape[0], 3, *grey.shape[1:])
    require(
        good,
        f"enhanced images (N, H, W) and colours (N, 3, H, W) do not match: {grey.shape} and"
        f" {colours.shape}.",
    )
    direct = direct_light(colours, network)
    weights = GREY_WEIGHTS[:, None, None]
    of_all = np.maximum((np.maximum(colours, 0.0) * weights).sum(axis=1), 1e-12)
    fraction = np.clip((direct * weights).sum(axis=1) / of_all, 0.0, 1.0)
    return np.asarray(np.maximum(grey, 0.0) * fraction)
