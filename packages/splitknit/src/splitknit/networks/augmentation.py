"""Test-time augmentation: the mean of a network's outputs on several orientations of its input."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from splitknit.model import FloatArray

_Pairs = tuple[tuple[int, int], ...]


@dataclass(frozen=True, slots=True)
class Symmetry:
    """How fields (n, h, w) change when the image is turned or mirrored; those that are not named
    are scalars."""

    vectors: _Pairs
    """Pairs of fields that are a vector's x and y (up), or cos a and sin a of its azimuth."""
    second_harmonics: _Pairs = ()
    """Pairs of fields that are parts of cos 2a and sin 2a."""
    third_harmonics: _Pairs = ()
    """Pairs of fields that are parts of cos 3a and sin 3a."""

    def turned(self, fields: FloatArray, quarters: int) -> FloatArray:
        """A view of fields turned counter-clockwise by so many quarters of a turn. Vectors and
        harmonics turn in the memory of `fields`, which the opposite turn restores."""
        harmonics = self.vectors, self.second_harmonics, self.third_harmonics
        for order, pairs in enumerate(harmonics, 1):
            for cosine, sine in pairs:
                for _ in range(order * quarters % 4):
                    fields[[cosine, sine]] = fields[[sine, cosine]]
                    fields[cosine] *= -1
        return np.rot90(fields, quarters, (1, 2))


def mean_over_turns(
    network: Callable[[FloatArray], FloatArray],
    fields: FloatArray,
    symmetries: tuple[Symmetry, Symmetry],
    turns: Sequence[int],
    earlier: FloatArray | None = None,
) -> FloatArray:
    """Mean of a network's output (m, h, w) over `turns`, in quarters, of its input `fields` (n, h,
    w).

    `fields` are turned in place and back: beside the network, which needs most memory, there is no
    copy. `symmetries`: of the network's input and of its output; `earlier`: output in one more
    orientation.
    """
    of_fields, of_output = symmetries
    outputs = [] if earlier is None else [earlier]
    for quarters in turns:
        output = np.array(network(of_fields.turned(fields, quarters)))
        outputs.append(of_output.turned(output, -quarters))
        of_fields.turned(fields, -quarters)
    return np.asarray(sum(outputs) / len(outputs))


_MAX_RESTORED = 0.25  # largest power that is restored, over the estimate's own


def shrinkage_gain(rms: float, error: float) -> float:
    """Factor sqrt(1 + error^2 / rms^2), at most sqrt(1 + `_MAX_RESTORED`), that restores the
    variance lost by a minimum-mean-square-error estimate (a posterior mean). `rms`: of the
    estimate; `error`: expected.
    """
    return float(np.sqrt(1 + min((error / max(rms, 1e-6)) ** 2, _MAX_RESTORED)))
