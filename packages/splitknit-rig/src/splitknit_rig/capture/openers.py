"""Functions that open the devices for photographs: the Raspberry Pi's, or the twin's."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from typing import Any

from splitknit import Rig
from splitknit.devices import Opened
from splitknit.errors import require

Opener = Callable[[int, int], AbstractContextManager[Opened]]
"""Opens the devices, by the twin's seed and impression."""


def opener_of(
    device: str, changes: Mapping[str, Any], rig: Rig | None, scale: float | None, **of: Any
) -> Opener:
    """Function that opens the devices; `changes`: settings by their names; `of`: what the twin
    photographs."""
    return _pi(changes, rig, scale) if device == "pi" else _twin(changes, rig, scale, **of)


def _pi(changes: Mapping[str, Any], rig: Rig | None, scale: float | None) -> Opener:
    """Function that opens the Raspberry Pi's devices."""
    from splitknit.settings import override
    from splitknit_rig.capture.pi import PiCameraSettings, opened_pi

    strays = [name for name in changes if not name.startswith("pi.")]
    require(
        not strays and scale is None,
        f"'{strays[0] if strays else 'scale'}' is a setting of the twin; with `device` pi leave it"
        " out, or use names that begin with capture. or pi.",
    )
    settings = override(
        PiCameraSettings(), {name.removeprefix("pi."): value for name, value in changes.items()}
    )
    return lambda seed, impression: opened_pi(rig, settings)


def _twin(
    changes: Mapping[str, Any],
    rig: Rig | None,
    scale: float | None,
    *,
    pattern: str | None = None,
    target: str | None = None,
) -> Opener:
    """Function that opens the twin's devices, which the simulator's member provides."""
    from functools import partial

    from splitknit.registry import DEVICES, SIMULATOR, extension
    from splitknit_rig.calibration.phantom import PITCH_MM, phantom

    relief = (phantom()[0].height_mm, PITCH_MM) if target == "phantom" else None
    twin = extension(DEVICES, "twin", "the rig's twin", SIMULATOR)(changes, rig, scale)
    return partial(twin.opened, pattern=pattern, target=target, relief=relief)
