"""Settings of the training of `metric`'s own network, which draws relief and glare."""

from __future__ import annotations

from dataclasses import dataclass

from splitknit.errors import require
from splitknit.training.fields_settings import FieldsSettings


@dataclass(frozen=True, slots=True)
class ReliefSettings(FieldsSettings):
    """Network, loss and training.

    The network that ships was trained in three runs, each from the weights of the one before: about 2400 iterations on
    whole fingers alone, then 200 and 4600 on pieces too. The defaults are its numbers, in one run.
    """

    whole_share: float = 0.2
    """Part of the patches that are cut from whole fingers, where there are any; the others are from pieces."""
    slope_share: float = 1.0
    """Weight of the relief's slopes in the loss, beside its heights with weight one."""
    likelihood_share: float = 0.2
    """Weight of how well the network knows its own error."""
    glare_share: float = 0.2
    """Weight of the glare."""

    def __post_init__(self) -> None:
        FieldsSettings.__post_init__(self)
        require(0 <= self.whole_share <= 1, "training: whole_share must lie in [0, 1].")
        self._check_weights("slope_share", "likelihood_share", "glare_share")
