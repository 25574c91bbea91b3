"""Functions that open the devices for photographs: the Raspberry Pi's, or the twin's."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from typing import Any

from splitknit import read_rig
from splitknit.arguments import AnyPath
from splitknit.devices import Opened
from splitknit.errors import require

Opener = Callable[[int, int], AbstractContextManager[Opened]]
"""Opens the devices, by the twin's seed and impression."""


def opener_of(
    device: str,
    changes: Mapping[str, Any],
    rig_file: AnyPath | None,
    scale: float | None,
    *,
    pattern: str | None = None,
    target: str | None = None,
) -> Opener:
    """Function that opens the devices of a rig file: the Raspberry Pi's, or the twin's, which the
    simulator's member provides; `changes`: settings by their names; the twin photographs a finger
    with a `pattern`, or a `target`."""
    rig = None if rig_file is None else read_rig(rig_file)
    if device == "pi":
        from splitknit.settings import override
        from splitknit_rig.capture.pi import PiCameraSettings, opened_pi

        strays = [name for name in changes if not name.startswith("pi.")]
        require(
            not strays and scale is None,
            f"'{strays[0] if strays else 'scale'}' is a setting of the twin; with `device` pi leave"
            " it out, or use names that begin with capture. or pi.",
        )
        settings = override(
            PiCameraSettings(), {name.removeprefix("pi."): value for name, value in changes.items()}
        )
        return lambda seed, impression: opened_pi(rig, settings)
    from functools import partial

    from splitknit.registry import DEVICES, SIMULATOR, extension
    from splitknit_rig.calibration.phantom import PITCH_MM, phantom

    relief = (phantom()[0].height_mm, PITCH_MM) if target == "phantom" else None
    twin = extension(DEVICES, "twin", "the rig's twin", SIMULATOR)(changes, rig, scale)
    return partial(twin.opened, pattern=pattern, target=target, relief=relief)
