"""A folder of images of one scene under patterns: what is in it, and how it is to be separated.

Without more, all PNG, TIFF and JPEG images of the folder are the stack, in the order of their names (``a_2`` before
``a_10``), except files named ``black``, ``white`` and ``mask``. Numbers in the names, one or two of them, are taken for
the shifts and must leave no gap. A file ``separation.json`` states it exactly, see ``docs/guide/separation.md``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from splitknit.errors import BadInput, require
from splitknit.io.fields import Fields, as_number, inside, read_json
from splitknit.io.plain import natural_order
from splitknit.separation.stacks import check_shifts

DOCUMENT = "separation.json"
ESTIMATE = "estimate"
_SUFFIXES = {".png", ".tif", ".tiff", ".jpg", ".jpeg"}
_ROLES = ("black", "white", "mask")


@dataclass(frozen=True, slots=True)
class PatternFolder:
    """What is separated, and how."""

    images: tuple[Path, ...]  # in order
    encoding: str = "linear"  # ``linear`` or ``srgb``
    black: Path | None = None  # image without the pattern's light
    white: Path | None = None  # image with the whole source lit
    mask: Path | None = None  # white = to be separated
    alpha: float = 0.5  # lit fraction of the pattern
    dark: float = 0.0  # brightness of the unlit part of the pattern
    patterns: tuple[Path, ...] | str | None = None  # state images, ``estimate``, or None for maximum and minimum
    shifts: tuple[tuple[float, ...], ...] | None = None  # shifts of the pattern in each image
    period: float | None = None  # period of the pattern, in units of the shifts
    check_px: float | None = None  # side of a check on the camera's pixels, for skin, where light spreads

    def __post_init__(self) -> None:
        other = f"encoding must be 'linear' or 'srgb', but it is '{self.encoding}'."
        require(self.encoding in ("linear", "srgb"), other)
        require(len(self.images) > 0, "there are no images.")
        if self.patterns == ESTIMATE:
            few = "states can be found in the images where checks have 5 pixels or more"
            cure = "give the states as patterns, or leave check_px and patterns out."
            wide = self.check_px is None or self.check_px >= 5
            require(wide, f"{few}, but check_px is {self.check_px}; {cure}")

    def settings(self) -> dict[str, Any]:
        """All choices but the files, as JSON can hold them."""
        files = ("images", *_ROLES)
        plain = {item.name: getattr(self, item.name) for item in fields(self) if item.name not in files}
        if isinstance(self.patterns, tuple):
            plain["patterns"] = "given"
        return plain


def read_pattern_folder(folder: Path, changes: Mapping[str, Any] | None = None) -> PatternFolder:
    """Read ``separation.json``, or take the folder as it is; then `changes`, fields of :class:`PatternFolder`.

    ``patterns`` may name a folder of state images in `changes`. Raises BadInput naming the folder, field or file at
    fault.
    """
    require(folder.is_dir(), f"'{folder}' is not a folder; name the folder that holds the images.")
    found = _read_document(folder) if (folder / DOCUMENT).is_file() else _by_names(folder)
    changed = {name: value for name, value in (changes or {}).items() if value is not None}
    if isinstance(changed.get("patterns"), str) and changed["patterns"] != ESTIMATE:
        states = Path(changed["patterns"])
        require(states.is_dir(), f"'{states}' is not a folder of patterns (nor the word '{ESTIMATE}').")
        changed["patterns"] = tuple(_images_in(states))
    try:
        plan = PatternFolder(**{**found, **changed})
        if plan.check_px is not None and plan.patterns is None:
            plan = replace(plan, patterns=ESTIMATE)  # the size of the checks is of use only with states
        if "shifts" not in found:
            _check_names(plan.images)
    except BadInput as error:
        raise BadInput(f"{folder}: {error}") from error
    return plan


def _read_document(folder: Path) -> dict[str, Any]:
    document, _ = read_json(folder / DOCUMENT)
    name = str(folder / DOCUMENT)
    given = Fields(document, name)
    given.format("splitknit-separation", 1)
    method = given.text("method") if given.has("method") else "checkerboard"
    require(method == "checkerboard", f"{name}: method must be 'checkerboard', but it is '{method}'; others left.")
    known = {"format", "version", "method", *(item.name for item in fields(PatternFolder))}
    unknown = sorted(set(given.keys()) - known)
    require(not unknown, f"{name}: the field '{unknown[0] if unknown else ''}' is not known; correct or remove it.")
    found: dict[str, Any] = {}
    if given.has("images"):
        found["images"] = tuple(inside(folder, item, name, "images") for item in given.items("images"))
    else:
        found.update(_by_names(folder))
    for key in _ROLES:
        if given.has(key):
            found[key] = inside(folder, given.get(key), name, key)
    if given.has("encoding"):
        found["encoding"] = given.text("encoding")
    limits = {"alpha": 1.0, "dark": 1.0, "period": 1e6, "check_px": 1e4}
    for key, high in limits.items():
        if given.has(key):
            found[key] = given.number(key, 0.0, high)
    if given.has("patterns"):
        value = given.get("patterns")
        files = () if value == ESTIMATE else given.items("patterns")
        states = tuple(inside(folder, item, name, "patterns") for item in files)
        found["patterns"] = ESTIMATE if value == ESTIMATE else states
    if given.has("shifts"):
        found["shifts"] = _shifts(given)
    return found


def _shifts(given: Fields) -> tuple[tuple[float, ...], ...]:
    rows = [item if isinstance(item, list) else [item] for item in given.items("shifts")]
    table = [tuple(as_number(value) for value in row) for row in rows]
    good = len({len(row) for row in table}) == 1 and len(table[0]) in (1, 2)
    if not good or any(value is None for row in table for value in row):
        given.refuse("shifts", "a list of numbers, or of pairs of numbers, one for each image")
    return tuple(tuple(float(value or 0.0) for value in row) for row in table)


def _by_names(folder: Path) -> dict[str, Any]:
    files = _images_in(folder)
    roles = {file.stem.lower(): file for file in files if file.stem.lower() in _ROLES}
    images = tuple(file for file in files if file.stem.lower() not in _ROLES)
    require(len(images) > 0, f"'{folder}' holds no PNG, TIFF or JPEG images; name the folder that does.")
    return {"images": images, **roles}


def _images_in(folder: Path) -> list[Path]:
    files = [file for file in folder.iterdir() if file.suffix.lower() in _SUFFIXES and file.is_file()]
    return sorted(files, key=lambda file: (natural_order(file.stem), file.name))


def _check_names(images: tuple[Path, ...]) -> None:
    """Refuse images whose names differ in one or two numbers with a gap: a shift is missing."""
    if len(images) < 3 or len({re.sub(r"\d+", "#", image.stem) for image in images}) > 1:
        return
    table = np.array([[int(number[:15]) for number in re.findall(r"\d+", image.stem)] for image in images])
    varying = table[:, np.ptp(table, axis=0) > 0]
    if varying.shape[1] in (1, 2):
        try:
            check_shifts(varying, len(varying))
        except BadInput as error:
            raise BadInput(f"by the numbers in the names of the images: {error}") from error
