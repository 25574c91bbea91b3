"""Coloured LEDs of a simulated capture: what ``--lights`` stands for."""

from __future__ import annotations

from splitknit.errors import require
from splitknit.model import Rig
from splitknit.simulator.coloured import coloured_rig
from splitknit.simulator.twin import TwinSettings

EXPOSURES = {"coloured": 2, "coloured9": 3}


def coloured_lights(lights: str, settings: TwinSettings) -> Rig:
    """The rig with coloured LEDs in place of its white ones.

    Raises
    ------
    BadInput
        If something else is asked for that has LEDs of its own, or takes them one by one.
    """
    require(settings.rig is None, "a rig file says which LEDs there are; leave out --lights, or --rig.")
    require(not settings.mirrors.names, "mirrors have white LEDs in the twin; leave out --mirrors or --lights.")
    return coloured_rig(settings.scale, settings.rig_seed, settings.intensity_spread, EXPOSURES[lights])
