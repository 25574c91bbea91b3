"""The network that draws the relief, in torch: a U-Net of five levels, small enough for a processor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

from splitknit.errors import BadInput
from splitknit.training.network import load_torch
from splitknit.training.relief_batches import FIELDS, OUTPUTS


def relief_network(widths: Sequence[int], fields: int = FIELDS, outputs: int = OUTPUTS) -> Any:
    """Build the network, its weights drawn from torch's current random state.

    Every level is two 3 x 3 convolutions with ReLUs. On the way down, maxima over 2 x 2 pixels go on to the next level;
    on the way up, pixels are doubled and put beside what the level had on the way down. A last 1 x 1 convolution draws
    the outputs.

    Parameters
    ----------
    widths : channels of each level, the finest first
    fields : channels of the input; each is first multiplied by the network's ``scale``
    outputs : channels of the output

    Returns
    -------
    torch.nn.Module from (N, fields, H, W) to (N, outputs, H, W); H and W are multiples of 2^(levels - 1)

    References
    ----------
    Ronneberger et al. 2015, U-Net.
    """
    torch = load_torch()
    nn = torch.nn

    def level(before: int, after: int) -> Any:
        return nn.Sequential(
            nn.Conv2d(before, after, 3, padding=1), nn.ReLU(), nn.Conv2d(after, after, 3, padding=1), nn.ReLU()
        )

    class ReliefNetwork(nn.Module):  # type: ignore[misc, name-defined]
        def __init__(self) -> None:
            super().__init__()
            befores = [fields, *widths[:-1]]
            self.down = nn.ModuleList(level(before, after) for before, after in zip(befores, widths, strict=True))
            rising = reversed(list(pairwise(widths)))
            self.up = nn.ModuleList(level(fine + coarse, fine) for fine, coarse in rising)
            self.out = nn.Conv2d(widths[0], outputs, 1)
            self.register_buffer("scale", torch.ones(fields))

        def forward(self, image: Any) -> Any:
            image = image * self.scale[:, None, None]
            kept = []
            for number, stage in enumerate(self.down):
                image = stage(nn.functional.max_pool2d(image, 2) if number else image)
                kept.append(image)
            kept.pop()
            for stage in self.up:
                image = nn.functional.interpolate(image, scale_factor=2, mode="nearest")
                image = stage(torch.cat([image, kept.pop()], dim=1))
            return self.out(image)

    return ReliefNetwork()


def network_from(state: Mapping[str, Any]) -> Any:
    """The network whose ``state_dict`` this is; widths follow from the weights' shapes.

    Raises
    ------
    BadInput
        If it is not the state of a :func:`relief_network`.
    """
    try:
        levels = sum(name.startswith("down.") and name.endswith(".0.weight") for name in state)
        widths = [int(state[f"down.{number}.0.weight"].shape[0]) for number in range(levels)]
        fields, outputs = int(state["down.0.0.weight"].shape[1]), int(state["out.weight"].shape[0])
        network = relief_network(widths, fields, outputs)
        network.load_state_dict(dict(state))
    except (KeyError, AttributeError, IndexError, RuntimeError, TypeError) as error:
        raise BadInput(f"these are not the weights of a relief network ({str(error).splitlines()[0]}).") from error
    return network.eval()
