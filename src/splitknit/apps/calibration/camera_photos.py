"""Photographs of checkerboard and disc: reading them, and finding what they show."""

from __future__ import annotations

import fnmatch
import hashlib
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.calibration import Board, find_board, size_in_view
from splitknit.calibration.disc import find_disc
from splitknit.errors import BadInput, read_bytes, require
from splitknit.io.images import DEFAULTS, decode_image
from splitknit.model import PixelArray

Points = NDArray[np.float64]
SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff")
LEAST = 5
_LOOKED_AT = 6
"""Photographs in which a board of another size is sought."""


@dataclass(frozen=True, slots=True, eq=False)
class BoardPhotos:
    """Corners in photographs of one size."""

    image_size: tuple[int, int]
    corners: Mapping[str, Points]
    """By the file's name."""
    without: tuple[str, ...]
    """Files in which no board of the size is in full view."""
    hashes: Mapping[str, str]


def image_files(folder: Path, pattern: str | None = None) -> list[Path]:
    """Images in `folder`, in the order that people count, only those whose name fits the glob `pattern` if given.

    A pattern such as ``board_*/white_0.png`` takes images of capture folders inside `folder`.
    """
    require(folder.is_dir(), f"'{folder}' is not a folder; name the folder of checkerboard photographs.")
    levels = "/".join("*" * (1 if pattern is None else 1 + pattern.count("/")))
    files = [file for file in folder.glob(levels) if file.is_file() and file.suffix.lower() in SUFFIXES]
    files = [file for file in files if not file.name.startswith(".")]
    count = len(files)
    if pattern is not None:
        files = [file for file in files if fnmatch.fnmatchcase(_label(file, folder), pattern)]
        require(
            bool(files),
            f"no image in '{folder}' fits the pattern '{pattern}' ({count} images are there); "
            "quote the pattern and compare it with the files' names.",
        )
    require(bool(files), f"'{folder}' holds no images (PNG, JPEG or TIFF); put the checkerboard photographs there.")
    return sorted(files, key=lambda file: [(len(p), p) for p in re.findall(r"\d+|\D+", _label(file, folder))])


def _label(file: Path, folder: Path) -> str:
    """How a photograph is called: its path in the folder."""
    return file.relative_to(folder).as_posix()


def read_photo(path: Path, size: tuple[int, int] | None, expected_by: str) -> tuple[PixelArray, str]:
    """Pixels and SHA-256 of an image that must have `size` (rows, columns), if one is expected."""
    data = read_bytes(path, DEFAULTS.max_bytes)
    pixels = decode_image(data, str(path))
    if size is not None:
        require(
            pixels.shape[:2] == size,
            f"{path} has {pixels.shape[0]} x {pixels.shape[1]} pixels (rows x columns), but {expected_by} has "
            f"{size[0]} x {size[1]}; photograph everything with the camera's one setting.",
        )
    return pixels, hashlib.sha256(data).hexdigest()


def board_photos(  # noqa: PLR0917
    folder: Path,
    files: Sequence[Path],
    board: Board,
    size: tuple[int, int] | None,
    expected_by: str,
    progress: Callable[[float], None],
) -> BoardPhotos:
    """Find the board in every photograph.

    Raises
    ------
    BadInput
        If a file is no image, sizes differ, or too few photographs show the board: then with the size of the board that
        they do show, where one is found.
    """
    corners: dict[str, Points] = {}
    hashes: dict[str, str] = {}
    without: list[Path] = []
    for k, file in enumerate(files):
        progress(k / len(files))
        pixels, hashes[_label(file, folder)] = read_photo(file, size, expected_by)
        if size is None:
            size, expected_by = (pixels.shape[0], pixels.shape[1]), _label(file, folder)
        found = _found(file, find_board, pixels, board)
        if found is None:
            without.append(file)
        else:
            corners[_label(file, folder)] = found
        if not corners and len(without) == _LOOKED_AT:
            _refuse_other_size(without, board)
    assert size is not None
    if len(corners) < LEAST:
        _refuse_other_size(without, board)
        named = ", ".join(_label(file, folder) for file in without[:4]) + (" and more" if len(without) > 4 else "")
        missing = f" (not in {named})" if without else ""
        raise BadInput(
            f"{folder}: a checkerboard of {board.columns} x {board.rows} inner corners is in full view in "
            f"{len(corners)} of {len(files)} photographs{missing}, but {LEAST} are needed and 15 are advised; "
            "take more, the board tilted differently in each."
        )
    return BoardPhotos(size, corners, tuple(_label(file, folder) for file in without), hashes)


def plane_marks(
    file: Path, board: Board, size: tuple[int, int] | None, expected_by: str
) -> tuple[Points, Points, tuple[int, int]]:
    """Places of the board's corners in mm and in the image, and the image's size."""
    pixels, _ = read_photo(file, size, expected_by)
    corners = _found(file, find_board, pixels, board)
    if corners is None:
        _refuse_other_size([file], board)
        raise BadInput(
            f"{file} shows no checkerboard of {board.columns} x {board.rows} inner corners in full view; "
            "lay the board flat on the finger plane, evenly lit, and photograph it again."
        )
    return board.points_mm, corners, (pixels.shape[0], pixels.shape[1])


def disc_marks(
    file: Path, spacing_mm: float, size: tuple[int, int] | None, expected_by: str
) -> tuple[Points, Points, tuple[int, int]]:
    """Places of the disc's dots in mm and in the image, and the image's size."""
    pixels, _ = read_photo(file, size, expected_by)
    places_mm, places_px = _found(file, find_disc, pixels, spacing_mm)
    return places_mm, places_px, (pixels.shape[0], pixels.shape[1])


def _found(file: Path, search: Callable[..., Any], *arguments: Any) -> Any:
    """Run a search that knows arrays only; let what it refuses name the file."""
    try:
        return search(*arguments)
    except BadInput as error:
        raise BadInput(f"{file}: {error}") from error


def _refuse_other_size(files: Sequence[Path], board: Board) -> None:
    """Refuse the board's size if photographs show a board of another."""
    sizes: Counter[tuple[int, int]] = Counter()
    for file in files[:_LOOKED_AT]:
        try:
            seen = size_in_view(read_photo(file, None, "")[0])
        except BadInput:
            continue
        if seen is not None:
            sizes[seen] += 1
    if not sizes:
        return
    (size, count), *_ = sizes.most_common(1)
    asked = max(board.size), min(board.size)
    if size != asked and (count > 1 or len(files) == 1):
        raise BadInput(
            f"{files[0]} shows a checkerboard of {size[0]} x {size[1]} inner corners, not of {board.columns} x "
            f"{board.rows}; say --board {size[0]}x{size[1]}, or photograph the whole board."
        )
