"""Settings of the training of the network that mends the shape."""

from __future__ import annotations

from dataclasses import dataclass

from splitknit.errors import require
from splitknit.training.fields_settings import FieldsSettings


@dataclass(frozen=True, slots=True)
class ShapeSettings(FieldsSettings):
    """Network, loss and training.

    The network that ships was trained in three runs of 957, 2623 and 2354 iterations, each from the weights of the one
    before, while its fingers became ready. The defaults are its numbers, the iterations rounded, in one run.
    """

    widths: tuple[int, ...] = (24, 32, 48, 64)
    """Channels of each level; every level but the first works at half the scale of the one before."""
    iterations: int = 6000
    """Corrections of the weights."""
    batch: int = 8
    """Patches of each."""
    patch_px: int = 160
    """Side of a patch on the coarse grid; a multiple of the network's stride."""
    least_trust: float = 0.15
    """Patches whose mean weight is less are not used: they hold next to no skin."""
    warm_up: int = 100
    """Iterations over which the learning rate rises; then it falls along a cosine."""
    weight_decay: float = 1e-3
    """By which weights shrink, times the learning rate."""
    beyond_px: int = 20
    """So far a patch may reach over a finger's edge: there the shape has most to mend."""
    no_nir_share: float = 0.15
    """Part of the patches that are shown as if there were no near-infrared images."""
    wide_px: int = 8
    """Side of the blocks over which the loss also compares mean slopes: wide errors become the shape's."""
    wide_share: float = 1.0
    """Weight of those means in the loss, beside the slopes with weight one."""

    def __post_init__(self) -> None:
        FieldsSettings.__post_init__(self)
        self._check_shares("no_nir_share")
        self._check_weights("weight_decay", "wide_share")
        require(
            0 <= self.beyond_px < self.patch_px,
            f"training: patch_px must be larger than beyond_px ({self.beyond_px}), but it is {self.patch_px}.",
        )
        require(
            1 <= self.wide_px <= self.patch_px,
            f"training: wide_px must lie between 1 and {self.patch_px}, but it is {self.wide_px}.",
        )
