"""What the preset sees: linear images of a band."""

from __future__ import annotations

from dataclasses import dataclass

from splitknit.model import FloatArray, Rig


@dataclass(frozen=True, slots=True, eq=False)
class BandImages:
    """Linear images of one band on one grid."""

    channels: tuple[str, ...]
    """Names of the channels: red, green, blue, nir."""
    stack: FloatArray
    """(C, L, h, w)."""
    rig: Rig
    """`rig.leds[k]` lights image k."""
