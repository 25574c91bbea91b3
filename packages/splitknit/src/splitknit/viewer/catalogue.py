"""What there is to show: results below what was named, and the captures they were made from where at hand."""

from __future__ import annotations

import hashlib
import json
import os
import stat
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from splitknit.errors import BadInput, require

if TYPE_CHECKING:
    from splitknit.io.prints import PrintFile

_PIECE = 1 << 20


def open_below(root: Path, name: str) -> BinaryIO:
    """Open the plain file `name` (relative, parts apart by ``/``) below `root` for reading. Each part is opened from
    the one before it, so that what is checked is what is opened. Raises BadInput if the name leaves the folder, a part
    of it is a link, or it is not a plain file that can be read.
    """
    parts = name.split("/")
    plain = all(part not in ("", ".", "..") and not set(part) & set("\\\0:") for part in parts)
    require(plain, "the name leads out of the folder.")
    flags = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_NONBLOCK", 0)
    held: list[int] = []
    try:
        if os.open not in os.supports_dir_fd:  # Windows: what is checked may be replaced before it is opened
            path = root.joinpath(*parts)
            require(path.resolve(strict=True) == root.resolve().joinpath(*parts), f"'{parts[-1]}' is a link.")
            require(path.is_file(), f"'{parts[-1]}' is not a plain file.")
            return path.open("rb")
        held.append(os.open(root, os.O_RDONLY | getattr(os, "O_DIRECTORY", 0)))
        for part in parts:
            held.append(os.open(part, flags, dir_fd=held[-1]))
        require(stat.S_ISREG(os.fstat(held[-1]).st_mode), f"'{parts[-1]}' is not a plain file.")
        return os.fdopen(held.pop(), "rb")
    except OSError as error:
        raise BadInput(f"'{parts[-1]}' is not there, or it cannot be read.") from error
    finally:
        for handle in held:
            os.close(handle)


@dataclass(frozen=True, slots=True, eq=False)
class Reply:
    """What is sent back."""

    kind: str
    size: int
    chunks: bytes | Iterable[bytes]
    headers: Mapping[str, str] = field(default_factory=dict)
    stream: BinaryIO | None = None
    """The open file that the chunks come from."""

    @classmethod
    def of_file(cls, stream: BinaryIO, kind: str, headers: Mapping[str, str] | None = None) -> Reply:
        """The content of an open file, a piece at a time."""
        chunks = iter(partial(stream.read, _PIECE), b"")
        return cls(kind, os.fstat(stream.fileno()).st_size, chunks, headers or {}, stream)

    def close(self) -> None:
        """Close the file; call it for every reply, sent or not."""
        if self.stream is not None:
            self.stream.close()


def read_below(root: Path, name: str, max_bytes: int = 1 << 30) -> bytes:
    """Return the content of a file that :func:`open_below` opens."""
    with open_below(root, name) as stream:
        require(os.fstat(stream.fileno()).st_size <= max_bytes, f"'{name}' is too large.")
        return stream.read()


_DEEPEST = 6
_MAX = 5000
_REPORT_BYTES = 20_000_000


@dataclass(frozen=True, slots=True)
class CatalogueEntry:
    """One result, or one folder of photographs."""

    key: str
    """By which the page requests it: its number."""
    name: str
    """As people know it: where it lies below what was named."""
    folder: Path
    capture: Path | None = None
    """Folder of the photographs it was made from."""
    report: dict[str, Any] = field(default_factory=dict, compare=False)
    result: bool = True
    """If not, there are only photographs."""


@dataclass(frozen=True, slots=True)
class Catalogue:
    """All results that can be chosen, and those that were."""

    title: str
    entries: tuple[CatalogueEntry, ...]
    chosen: tuple[str, ...]  # keys of the results that were named: none where a folder of many was

    def entry(self, key: str) -> CatalogueEntry:
        """Return one entry. Raises BadInput if there is none of that key."""
        known = key.isascii() and key.isdigit() and len(key) < 7 and int(key) < len(self.entries)
        require(known, f"there is no result number {key[:20]!a}.")
        return self.entries[int(key)]


def make_catalogue(paths: Sequence[Path], capture: Path | None = None) -> Catalogue:
    """Find the results that `paths` name (a result, a folder of results, two results), or the photographs (a capture, a
    folder of photographs). `capture`: folder of the photographs of the results, or a folder of such folders laid out as
    the results are. Raises BadInput if a path is neither, or the capture is none of theirs.
    """
    require(len(paths) <= 2, "name one result, a folder of results, two results, or photographs.")
    if not paths:
        return Catalogue("", (), ())
    roots = [_named_folder(path) for path in paths]
    if len(roots) == 1 and not _is_result(roots[0]):
        taken = (roots[0] / "capture.json").is_file()
        folders = [] if taken else _find_results(roots[0])
        if taken or (not folders and _holds_photographs(roots[0])):
            require(capture is None, f"'{paths[0]}' holds photographs itself; leave `capture` out.")
            only = CatalogueEntry("0", roots[0].name, roots[0], roots[0], result=False)
            return Catalogue(only.name, (only,), (only.key,))
        results = "folders with a height.npz, as `splitknit reconstruct` writes them"
        fault = f"there is no result in '{paths[0]}' ({results}), and no photograph"
        require(len(folders) > 0, f"{fault}; name a result, a folder of results, or a folder of photographs.")
        names = [folder.relative_to(roots[0]).as_posix() for folder in folders]
        chosen: tuple[str, ...] = ()
    else:
        for path, root in zip(paths, roots, strict=True):
            require(_is_result(root), f"'{path}' is not a result (it holds no height.npz); name two results.")
        folders, names = roots, _distinct_names(roots)
        chosen = tuple(str(k) for k in range(len(roots)))
    named = enumerate(zip(names, folders, strict=True))
    entries = tuple(_entry(str(k), name, folder, capture) for k, (name, folder) in named)
    if capture is not None:
        fault = f"'{capture}' is not the capture that this was made from"
        lacking = "no capture.json in it has the hash that the result's report.json states."
        require(any(entry.capture is not None for entry in entries), f"{fault}: {lacking}")
    return Catalogue(names[0] if len(names) == 1 else roots[0].name, entries, chosen)


def _is_result(folder: Path) -> bool:
    """Whether `splitknit reconstruct` wrote here."""
    file = folder / "height.npz"
    return file.is_file() and not file.is_symlink()


def _holds_photographs(folder: Path) -> bool:
    """Whether an image lies in the folder itself."""
    from splitknit.io.photos import SUFFIXES  # the first view of a result waits for no image library

    return any(file.suffix.lower() in SUFFIXES and not file.name.startswith(".") for file in folder.iterdir())


def _find_results(root: Path) -> list[Path]:
    """The results below `root`, links not followed, by name; BadInput if there are more than can be listed."""
    found = []
    for folder, below, _ in os.walk(root, followlinks=False):
        here = Path(folder)
        if _is_result(here):
            found.append(here)
            below.clear()
            require(len(found) <= _MAX, f"'{root}' holds more than {_MAX} results; name a folder below it.")
        deep = len(here.relative_to(root).parts) >= _DEEPEST
        below[:] = [] if deep else sorted(name for name in below if not name.startswith("."))
    return sorted(found)


def _read_report(folder: Path) -> dict[str, Any]:
    """Return a result's ``report.json``, or nothing where it is missing or damaged."""
    try:
        document = json.loads(read_below(folder, "report.json", _REPORT_BYTES))
    except (BadInput, ValueError, RecursionError):
        return {}
    return document if isinstance(document, dict) else {}


def _entry(key: str, name: str, folder: Path, capture: Path | None) -> CatalogueEntry:
    report = _read_report(folder)
    places = [folder.parent / "capture", folder.parent.parent / "capture"]
    if capture is not None:
        places = [_resolved(capture), _resolved(capture) / name]
    hashes = report.get("inputs_sha256")
    wanted = hashes.get("capture.json") if isinstance(hashes, dict) else None
    found = next((place for place in places if _has_hash(place, wanted)), None)
    return CatalogueEntry(key, name, folder, found, report)


def _has_hash(place: Path, sha256: object) -> bool:
    try:
        return hashlib.sha256(read_below(place, "capture.json", _REPORT_BYTES)).hexdigest() == sha256
    except BadInput:
        return False


def _resolved(path: Path) -> Path:
    try:
        return path.expanduser().resolve()
    except (OSError, ValueError, RuntimeError) as error:
        raise BadInput(f"{os.fspath(path)!r} is not a usable path: {error}.") from error


def _named_folder(path: Path) -> Path:
    root = _resolved(path)
    try:
        folder, there = root.is_dir(), root.exists()
    except (OSError, ValueError):
        folder = there = False
    require(there, f"there is no '{path}'; name a result folder, a folder of results, or photographs.")
    require(folder, f"'{path}' is a file; name a result folder (with height.npz), or a folder of results.")
    return root


def _distinct_names(folders: Sequence[Path]) -> list[str]:
    """Return the names of folders, with as many parents as it takes to distinguish them."""
    for depth in range(1, 1 + max(len(folder.parts) for folder in folders)):
        names = ["/".join(folder.parts[-depth:]) for folder in folders]
        if len(set(names)) == len(names):
            return names
    return [f"{folder.name} ({k + 1})" for k, folder in enumerate(folders)]


@lru_cache(maxsize=8)
def print_of(folder: Path) -> PrintFile:
    """Read a result's ``print.png``. Raises BadInput if there is none, it is a link, or it cannot be read."""
    from splitknit.io.prints import read_print_png  # a catalogue needs none of it

    open_below(folder, "print.png").close()
    return read_print_png(folder / "print.png")
