"""What is enrolled, as it comes: a template, the hash of its source, and the pictures where they are to be kept."""

from __future__ import annotations

import hashlib
import io
import zipfile
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from splitknit.apps.matching_inputs import MatchingSettings, Progress, Side, no_progress, read_side
from splitknit.errors import BadInput, read_bytes, require
from splitknit.io import file_hash, read_capture, read_image
from splitknit.io.prints import encode_print_png
from splitknit.matching import pack
from splitknit.prints.ridges import surface_print

KEEP = ("none", "thumbnail", "raw")
_THUMBNAIL_PPI = 250.0
_NOT_INPUTS = ("truth.npz", ".splitknit")
LARGEST_RAW = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Made:
    """What becomes a row of a gallery, but for the names."""

    kind: str
    template: bytes
    area_mm2: float
    source_sha256: str
    failure: str = ""
    images: bytes | None = None


def made_of(
    path: Path, preset: str, settings: MatchingSettings, keep: str = "none", progress: Progress = no_progress
) -> Made:
    """Template and facts of one source.

    Raises
    ------
    BadInput
        If it cannot be read, or (a capture) not be reconstructed.
    """
    side = read_side(path, preset, settings, progress)
    assert side.template is not None
    empty = side.template.empty
    return Made(
        side.kind,
        pack(side.template),
        0.0 if empty else round(side.template.area_mm2, 2),
        source_hash(path),
        "too little skin with ridges" if empty else "",
        None if keep == "none" else _kept(path, side, keep),
    )


def made_or_failed(path: Path, preset: str, settings: MatchingSettings, keep: str = "none") -> Made | str:
    """As :func:`made_of`, for many: a capture that is sound but shows no finger is a failure to acquire.

    Returns a sentence, and no row, where the files themselves are unusable.
    """
    try:
        return made_of(path, preset, settings, keep)
    except BadInput as error:
        if not (path / "capture.json").is_file() or (path / "height.npz").is_file():
            return str(error)
        try:
            read_capture(path)
        except BadInput as unread:
            return str(unread)
        said = str(error).removeprefix(f"{path}: ")
        return Made("capture", b"", 0.0, source_hash(path), failure=said)


def source_hash(path: Path) -> str:
    """SHA-256 of a source: of a file, or of names and hashes of the files of a capture (without its truth)."""
    files = _files(path)
    if files == [path]:
        return file_hash(path)
    lines = [f"{file_hash(file)}  {file.relative_to(path).as_posix()}\n" for file in files]
    return hashlib.sha256("".join(lines).encode("utf-8")).hexdigest()


def _files(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]
    if (path / "height.npz").is_file():
        return [path / "height.npz"]
    return sorted(file for file in path.rglob("*") if file.is_file() and file.name not in _NOT_INPUTS)


def _kept(path: Path, side: Side, keep: str) -> bytes | None:
    """PNG of the relief as a print, or ZIP of the source's files; None where a template is all there is."""
    if side.kind == "template":
        return None
    if keep == "raw":
        return _zipped(path)
    if side.surface is None:
        image = read_image(path)
        rows, columns = image.shape[:2]
        size = (max(1, columns // 2), max(1, rows // 2))
        small = cv2.resize(image.reshape(rows, columns), size, interpolation=cv2.INTER_AREA)
        return encode_print_png(small.astype(np.uint8), _THUMBNAIL_PPI)
    return encode_print_png(surface_print(side.surface, _THUMBNAIL_PPI), _THUMBNAIL_PPI)


def _zipped(path: Path) -> bytes:
    files = _files(path)
    total = sum(file.stat().st_size for file in files)
    require(total <= LARGEST_RAW, f"the files of '{path}' have {total} bytes, too many to keep; keep a thumbnail.")
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_STORED) as archive:
        for file in files:
            name = file.name if file == path else file.relative_to(path).as_posix()
            if path.is_dir() and files == [path / "height.npz"]:
                name = "height.npz"
            archive.writestr(zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0)), read_bytes(file, LARGEST_RAW))
    return stream.getvalue()
