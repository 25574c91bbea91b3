"""What the relief's network is punished for."""

from __future__ import annotations

from typing import Any

from splitknit.training.relief_batches import GLARE, RELIEF, WEIGHT
from splitknit.training.relief_settings import ReliefSettings

PARTS = ("relief", "slope", "likelihood", "glare")
VARIANCE_LIMITS = (-6.0, 4.0)
"""Of the logarithm of the relief's variance, in the network's unit."""


def relief_losses(made: Any, batch: Any) -> dict[str, Any]:
    """The parts of the loss, each a mean over the pixels that count.

    Parameters
    ----------
    made : (B, 9, h, w) torch.Tensor
        What the network drew.
    batch : (B, 41, h, w) torch.Tensor
        Samples, see :mod:`splitknit.training.relief_batches`.

    Returns
    -------
    dict of torch scalars by the names of :data:`PARTS`:
    ``relief``, the mean squared error of the heights; ``slope``, that of their differences from pixel to pixel, where
    ridges outweigh what is wide; ``likelihood``, the negative logarithm of the likelihood of the error under the drawn
    variance (the error is taken as given here, so that no height is made worse for it); ``glare``, the mean squared
    error of its waves.
    """
    weight = batch[:, WEIGHT]
    count = weight.sum() + 1.0
    error = made[:, 0] - batch[:, RELIEF]
    along = (error[:, :, 1:] - error[:, :, :-1]) * weight[:, :, 1:]
    down = (error[:, 1:] - error[:, :-1]) * weight[:, 1:]
    logarithm = made[:, 8].clamp(*VARIANCE_LIMITS)
    glare = made[:, 1:8] - batch[:, GLARE]
    return {
        "relief": (error**2 * weight).sum() / count,
        "slope": ((along**2).sum() + (down**2).sum()) / count,
        "likelihood": ((error.detach() ** 2 * (-logarithm).exp() + logarithm) * weight).sum() / count,
        "glare": (glare**2 * weight[:, None]).sum() / count / glare.shape[1],
    }


def total_loss(parts: dict[str, Any], settings: ReliefSettings) -> Any:
    """The weighted sum of the parts."""
    return (
        parts["relief"]
        + settings.slope_share * parts["slope"]
        + settings.likelihood_share * parts["likelihood"]
        + settings.glare_share * parts["glare"]
    )
