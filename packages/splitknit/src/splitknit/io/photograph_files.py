"""Which files of a folder are photographs, and in which order: that of their lights."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from splitknit.errors import BadInput, require
from splitknit.io.photos import SUFFIXES

LIGHT_LISTS = ("lights.txt", "light_directions.txt")
INTENSITIES = "light_intensities.txt"
"""Names of lists beside photographs, DiLiGenT's among them."""


class FolderContent(NamedTuple):
    """Files of a folder of photographs, by use."""

    photographs: list[Path]
    """In the order of the lights."""
    masks: list[Path]
    skipped: list[str]
    """Names of what else is there, each with the reason."""


def home_of(folder: Path) -> Path:
    """The folder of photographs that are named by their folder, by a pattern, or by one file."""
    return folder.parent if "{light}" in folder.name or folder.is_file() else folder


def photographs_in(
    folder: Path,
    table: Path,
    names: Sequence[str] = (),
    used: Sequence[Path] = (),
    *,
    find_mask: bool = True,
) -> FolderContent:
    """Photographs of a folder, of a pattern of names, or of one file.

    `table`: file of the lights, for messages; `names`: of photographs, from that file; empty: all,
    photo_2 before photo_10; `used`: files with another use; `find_mask`: whether a ``mask.png`` (or
    another format) is looked for. Raises BadInput if the folder cannot be read, holds more than
    1000 photographs, or lacks one that is named.
    """
    skipped: list[str] = []
    if folder.is_file():
        files = [folder]
    elif "{light}" in folder.name:
        files = _of_pattern(folder)
    else:
        files, skipped = _listed(folder, used)
    require(
        len(files) <= 1000,
        f"{folder} holds {len(files)} photographs; at most 1000 are read.",
    )
    masks = [file for file in files if find_mask and file.stem.lower() == "mask"]
    doubtful = [file for file in files if "mask" in file.stem.lower() and file not in masks]
    skipped += [f"{file.name} (a mask? name it with `mask`)" for file in doubtful]
    photographs = [file for file in files if file not in (*masks, *doubtful)]
    if names:
        named = [_named(photographs, name, table) for name in names]
        skipped += [
            f"{file.name} (not in {table.name})" for file in photographs if file not in named
        ]
        photographs = named
    return FolderContent(photographs, masks, skipped)


def _listed(folder: Path, used: Sequence[Path]) -> tuple[list[Path], list[str]]:
    """Photographs of a folder, and what else is there."""
    photographs = []
    skipped = []
    try:
        files = sorted(folder.iterdir(), key=lambda file: natural_order(file.name))
    except OSError as error:
        raise BadInput(f"{folder} cannot be read ({error.strerror}).") from error
    for file in files:
        if file.name.startswith(".") or Path(os.path.realpath(file)) in used:
            continue
        if file.is_file() and file.suffix.lower() in SUFFIXES:
            photographs.append(file)
        elif file.name not in (*LIGHT_LISTS, INTENSITIES):
            skipped.append(f"{file.name} ({'a folder' if file.is_dir() else 'not a photograph'})")
    return photographs, skipped


def _of_pattern(pattern: Path) -> list[Path]:
    """Files whose names have a number in the place of ``{light}``, by that number."""
    before, _, after = pattern.name.partition("{light}")
    form = re.compile(rf"{re.escape(before)}(\d{{1,6}}){re.escape(after)}", flags=re.IGNORECASE)
    files: dict[int, Path] = {}
    for file in sorted(pattern.parent.iterdir()):
        match = form.fullmatch(file.name)
        if match and file.is_file():
            number = int(match[1])
            first = files.setdefault(number, file)
            require(
                first == file,
                f"{first} and {file.name} are both of light {number}; keep one of them.",
            )
    return [files[number] for number in sorted(files)]


def natural_order(name: str) -> list[tuple[int, str]]:
    """Key by which photo_2 comes before photo_10."""
    return [
        (int(part), "") if part.isdecimal() else (-1, part)
        for part in re.split(r"(\d+)", name[:300])
    ]


def _named(files: Sequence[Path], name: str, table: Path) -> Path:
    """The photograph that the lights' file names; suffixes and capitals need not agree."""
    fits: list[Path] = []
    for form in (str, str.lower, lambda word: Path(word.lower()).stem):
        fits = fits or [
            file for file in files if name == file.stem or form(name) == form(file.name)
        ]
    require(len(fits) > 0, f"{table} names {name!a}, but there is no such photograph.")
    require(
        len(fits) == 1,
        f"{table} names {name!a}, which fits {some_of([file.name for file in fits])}.",
    )
    return fits[0]


def some_of(names: Sequence[str]) -> str:
    """The first of many names, and how many more there are."""
    return ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")
