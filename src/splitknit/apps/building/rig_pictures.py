"""Pictures of a rig's parts: each one from above and from below, the exploded rig, and a cut through it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from splitknit.apps.building.part_pictures import Body, View, draw
from splitknit.apps.pictures import ColourArray
from splitknit.io import write_image
from splitknit.rig.assembly import STACK, STACK_BELOW, RigPart
from splitknit.rig.part_files import half_of
from splitknit.rig.stl import Triangles

_DARK = (0.55, 0.61, 0.69)
_PALE = (0.93, 0.92, 0.88)
_COLOURS = {
    "base": (0.85, 0.56, 0.33),
    "window_base": (0.85, 0.56, 0.33),
    "cylinder": (0.55, 0.61, 0.69),
    "frame": (0.42, 0.66, 0.58),
    "box": (0.62, 0.62, 0.72),
    "lid": (0.78, 0.72, 0.52),
}
_TITLES = {
    "base": "base",
    "window_base": "window base",
    "cylinder": "cylinder",
    "frame": "LED and camera frame",
    "box": "circuit box",
    "lid": "lid",
}
_GAP_MM = 32.0
_EXPLODED = View(-58.0, 24.0)
_EXPLODED_BELOW = View(58.0, 24.0)
"""Turned over, the hand's side is +y."""
_SECTION = View(-28.0, 12.0)
_SECTION_BELOW = View(28.0, 12.0)


def write_pictures(
    folder: Path,
    parts: Mapping[str, RigPart],
    placed: Mapping[str, Triangles],
    *,
    below: bool,
    progress: Callable[[str, float], None],
) -> list[str]:
    """Draw everything into a folder; return the names of the files.

    Parameters
    ----------
    folder : an existing folder
    parts : all parts by name
    placed : their triangles in the rig's frame
    below : the camera is below the finger
    progress : called with what is drawn and the share done
    """
    names = []
    for done, (name, triangles) in enumerate(placed.items()):
        progress(f"picture of {name}", 0.82 + 0.12 * done / len(placed))
        write_image(folder / f"{name}.png", part_picture(triangles, parts[name].kind.colour))
        names.append(f"{name}.png")
    stack = STACK_BELOW if below else STACK
    progress("exploded view", 0.94)
    write_image(folder / "exploded.png", exploded_picture(placed, stack, below=below))
    progress("section", 0.97)
    cut = {name: half_of(parts[name]) for name in stack}
    write_image(folder / "section.png", section_picture(cut, below=below))
    return [*names, "exploded.png", "section.png"]


def part_picture(triangles: Triangles, colour: str) -> ColourArray:
    """Return a part seen from above, and from below beside it."""
    body = Body(triangles, _PALE if colour == "white" else _DARK)
    return np.hstack([draw([body], View(-60.0, 42.0), (480, 600)), draw([body], View(-60.0, -35.0), (480, 600))])


def exploded_picture(placed: Mapping[str, Triangles], stack: Sequence[str], *, below: bool) -> ColourArray:
    """Return the stack with gaps between its parts, and their names."""
    view = _EXPLODED_BELOW if below else _EXPLODED
    azimuth = np.deg2rad(view.azimuth_deg + 40.0)
    bodies = []
    for place, name in enumerate(stack):
        triangles = _turned(placed[name] + np.array([0.0, 0.0, _GAP_MM * place], dtype=np.float32), below)
        low, high = triangles.reshape(-1, 3).min(axis=0), triangles.reshape(-1, 3).max(axis=0)
        radius = 0.88 * float(high[0])
        middle = (radius * np.cos(azimuth), radius * np.sin(azimuth), float(low[2] + high[2]) / 2)
        bodies.append(Body(triangles, _COLOURS[name], _TITLES[name], middle))
    return draw(bodies, view, (1000, 860), labels=0.26)


def section_picture(cut: Mapping[str, Triangles], *, below: bool) -> ColourArray:
    """Return the assembled rig cut open along the finger."""
    bodies = [Body(_turned(triangles, below), _COLOURS[name]) for name, triangles in cut.items()]
    return draw(bodies, _SECTION_BELOW if below else _SECTION, (900, 640))


def _turned(triangles: Triangles, below: bool) -> NDArray[np.float32]:
    """Turn the rig over where the camera is below."""
    if not below:
        return triangles
    return np.asarray(triangles * np.array([1.0, -1.0, -1.0], dtype=np.float32))
