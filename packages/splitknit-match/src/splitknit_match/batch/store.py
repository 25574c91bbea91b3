"""The store of a batch on disk: what it was made with, its tables and its surfaces.

Tables are ``.npz`` files that appear whole or not at all, with their provenance inside. A column of
text is an array of text, a flag is true or false, a payload (``template``) is the bytes of the only
row, and all else are numbers, NaN where there is none.

A surface is exactly what matching needs of a reconstruction, and nothing that follows from it, 8
bytes a pixel of its mask under parallel rays. Nothing is rounded: local binary patterns compare
neighbours, and a step of 0.05 um changed the features of the relief by 7 %.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit import BadInput
from splitknit.errors import refusing, require
from splitknit.files import open_at_once
from splitknit.imaging.geometry import height_gradients, normals_from_gradients
from splitknit.io.atomic import hold, make_folder, private_modes, sweep, write_file
from splitknit.io.fields import parse_json, read_json
from splitknit.io.npz import read_npz, write_npz
from splitknit.io.provenance import canonical_json, json_text, plain_json, provenance, settings_hash
from splitknit.model import BoolArray, FloatArray
from splitknit.reconstruction import Surface
from splitknit.settings import differing
from splitknit_match.matching.template import VERSION as TEMPLATE_VERSION

SUFFIX = ".npz"
ORIGIN = "origin"
Table = dict[str, NDArray[Any]]
"""Columns by their names; payloads are arrays of ``bytes``."""
_TEXTS = (
    "capture",
    "subject",
    "finger",
    "session",
    "failure",
    "input_sha256",
    "a",
    "b",
    "warnings",
)
_FLAGS = ("acquired", "genuine", "compared")
_PAYLOADS = ("template", "print", "minutiae")
_REMEDY = "delete it and run the same again: only what it holds is done anew"
_TYPES: dict[str, type] = dict.fromkeys(_TEXTS, np.str_) | dict.fromkeys(_FLAGS, np.bool_)


def write_table(path: Path, rows: Sequence[Mapping[str, Any]], origin: Mapping[str, Any]) -> None:
    """Write `rows`, of the same columns, and their `origin`; equal ones give equal bytes."""
    arrays = {ORIGIN: np.array(canonical_json(origin))}
    for name in rows[0]:
        values = [row[name] for row in rows]
        if name in _PAYLOADS:
            arrays[name] = np.frombuffer(b"".join(values), np.uint8)
        else:
            arrays[name] = np.array(values, dtype=_TYPES.get(name, np.float64))
    write_npz(path, arrays)


def read_table(path: Path, columns: Sequence[str] | None = None) -> Table:
    """Read `columns` of a table, or else all.

    Raises BadInput if it is damaged or too large, or a column is missing or of another type.
    """
    arrays = _arrays(path, columns)
    names = columns or [name for name in arrays if name != ORIGIN]
    missing = [name for name in names if name not in arrays]
    require(
        not missing, f"'{path}' holds no column {missing}: it is of another version; {_REMEDY}."
    )
    with refusing(_damaged(path)):
        table = {name: _column(name, arrays) for name in names}
        require(len({len(column) for column in table.values()}) == 1, _damaged(path))
    return table


def read_origin(path: Path) -> dict[str, Any]:
    """Provenance of a table. Raises BadInput if the file is damaged."""
    with refusing(_damaged(path)):
        return dict(parse_json(str(_arrays(path, [ORIGIN])[ORIGIN]).encode(), str(path)))


MAX_BYTES = 100_000_000  # longest columns of one file


def _arrays(path: Path, names: Sequence[str] | None) -> Table:
    try:
        return read_npz(path, names, MAX_BYTES)
    except BadInput as error:
        raise BadInput(_damaged(path)) from error


def _column(name: str, arrays: Table) -> NDArray[Any]:
    """One column; ValueError if it is not of the type that its name has."""
    array = arrays[name]
    kind = np.dtype(np.uint8 if name in _PAYLOADS else _TYPES.get(name, np.float64)).kind
    if array.ndim != 1 or array.dtype.kind != kind:
        raise ValueError
    return np.array([array.tobytes()], dtype=object) if name in _PAYLOADS else array


def _damaged(path: Path) -> str:
    return f"'{path}' is damaged; {_REMEDY}."


def write_surface(path: Path, surface: Surface, height_mm: FloatArray) -> None:
    """Write a surface whose knitted height (H, W) is `height_mm`, as ``.npz``."""
    mask = surface.mask
    height, shape, ridge = (
        field[mask] for field in (height_mm, surface.shape_mm, surface.ridge_mm)
    )
    arrays = {
        "mask": mask,
        "pitch_mm": surface.pitch_mm,
        "input_from_upright": surface.input_from_upright,
        "upright_size": surface.upright_size,
        "whole": surface.whole,
        "height_mm": height,
        "shape_mm": shape,
    }
    if not np.array_equal(height - shape, ridge):
        arrays["ridge_mm"] = ridge
    if not np.array_equal(_normals(height_mm, mask, surface.pitch_mm), surface.normals):
        arrays["normals"] = surface.normals[mask]
    write_npz(path, arrays)


def read_surface(path: Path) -> Surface:
    """Read what :func:`write_surface` wrote, to the last bit. Raises BadInput if it is damaged."""
    arrays = read_npz(path)
    with refusing(f"'{path}' is damaged; remove it and the table of its capture, and run again."):
        mask = arrays["mask"]
        height, shape = arrays["height_mm"], arrays["shape_mm"]
        pitch_mm = float(arrays["pitch_mm"])
        if "normals" in arrays:
            normals = np.zeros((*mask.shape, 3), dtype=np.float32)
            normals[mask] = arrays["normals"]
        else:
            normals = _normals(_placed(height, mask), mask, pitch_mm)
        rows, columns = arrays["upright_size"].tolist()
        return Surface(
            ridge_mm=_placed(arrays.get("ridge_mm", height - shape), mask),
            shape_mm=_placed(shape, mask),
            normals=normals,
            mask=mask,
            pitch_mm=pitch_mm,
            input_from_upright=arrays["input_from_upright"],
            upright_size=(rows, columns),
            whole=bool(arrays["whole"]),
        )


def _normals(height_mm: FloatArray, mask: BoolArray, pitch_mm: float) -> FloatArray:
    """Normals (H, W, 3) of a surface under parallel rays, zero outside the mask."""
    seen = np.where(mask, height_mm, np.nan).astype(np.float32)
    normals = normals_from_gradients(*height_gradients(seen, pitch_mm)) * mask[..., None]
    return np.nan_to_num(normals, nan=0.0)


def _placed(values: FloatArray, mask: BoolArray) -> FloatArray:
    whole = np.full(mask.shape, np.nan, dtype=np.float32)
    whole[mask] = values
    return whole


STORE_FILE = "store.json"
FORMAT, VERSION = "splitknit-batch", 4
SCORES = ("a", "b", "genuine", "similarity", "compared")
"""Columns of every table of scores, before the matcher's own."""
_LOCK = ".lock"


def hashed(settings: Any) -> dict[str, Any]:
    """Settings and their hash, as the store keeps them."""
    plain = plain_json(settings)
    return {"settings_sha256": settings_hash(plain), "settings": plain}


TEMPLATES = hashed({"template": TEMPLATE_VERSION})
"""What templates are made with."""


@dataclass(frozen=True, slots=True)
class Place:
    """Where a capture lies in a store."""

    file: Path
    surface_file: Path

    def value(self, column: str) -> Any:
        """Its value of a column."""
        return read_table(self.file, [column])[column][0]

    def surface(self) -> Surface | None:
        """Its surface, to the last bit; None where the capture could not be acquired.

        Raises BadInput if the store was made without surfaces.
        """
        if self.surface_file.is_file():
            return read_surface(self.surface_file)
        require(
            self.value("area_mm2") == 0.0,
            f"'{self.file}' was made without its surface; delete it and run the same again with"
            " surfaces.",
        )
        return None


@dataclass(frozen=True, slots=True)
class Store:
    """A folder of results."""

    folder: Path

    def document(self) -> dict[str, Any]:
        """The store's own record. Raises BadInput if it is missing, damaged or of another
        version."""
        file = self.folder / STORE_FILE
        require(
            file.is_file(),
            f"'{self.folder}' is not a store of 'splitknit batch': it holds no {STORE_FILE}.",
        )
        document, _ = read_json(file, self.damaged)
        require(document.get("format") == FORMAT, self.damaged)
        version = document.get("format_version")
        require(
            version == VERSION,
            f"the store '{self.folder}' is of version {version}, and this is a reader of version"
            f" {VERSION}; run the batch again into another folder.",
        )
        return dict(document)

    @property
    def damaged(self) -> str:
        """What a record that cannot be used is refused with."""
        return f"'{self.folder / STORE_FILE}' is damaged; name another folder for the store."

    def files(self, kind: str, name: str) -> list[Path]:
        """Tables of ``features`` or ``minutiae`` of a case, or of ``scores/CASE`` of a matcher."""
        return sorted((self.folder / kind / name).rglob(f"*{SUFFIX}"))

    def places(self, kind: str, case: str) -> dict[str, Place]:
        """Where each capture lies that is finished: in a file of its name."""
        folder, surfaces = self.folder / kind / case, self.folder / "surfaces" / case
        return {
            name.with_suffix("").as_posix(): Place(folder / name, surfaces / name)
            for name in (file.relative_to(folder) for file in self.files(kind, case))
        }

    def features(self, case: str, columns: Sequence[str] | None = None) -> Table:
        """Columns of all captures of a case, ordered by capture, see ``docs/reference/files.md``.

        Raises BadInput if there are none, or a table is damaged.
        """
        files = self.files("features", case)
        require(files, f"the store '{self.folder}' holds nothing of case '{case}'.")
        table = _joined(files, columns and [*columns, "capture"], "capture")
        return {name: table[name] for name in columns or table}

    def scores(self, case: str, matcher: str) -> Table:
        """Columns of the comparisons of a case by a matcher, ordered by both captures, every pair
        once. Raises BadInput if there are none, or a table is damaged.
        """
        files = self.files(f"scores/{case}", matcher)
        require(
            files,
            f"the store '{self.folder}' holds no comparisons of case '{case}' by matcher"
            f" '{matcher}'.",
        )
        return _joined(files, None, "b", "a")


def _joined(files: Sequence[Path], columns: Sequence[str] | None, *keys: str) -> Table:
    """Tables as one, ordered by `keys`, the last first; of rows with equal keys the first."""
    tables = [read_table(file, columns) for file in files]
    same = all(table.keys() == tables[0].keys() for table in tables)
    require(
        same and {*keys} <= tables[0].keys(),
        "tables of the store have other columns; delete them and run the same again.",
    )
    whole = {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}
    order = np.lexsort([whole[key] for key in keys])
    same_key = [whole[key][order][1:] == whole[key][order][:-1] for key in keys]
    kept = order[np.concatenate([[True], ~np.all(same_key, axis=0)])]
    return {name: column[kept] for name, column in whole.items()}


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold a store for this run; remove what killed ones left half written, before and after.

    Raises BadInput if the folder holds something else, another run holds it, or it cannot be
    written.
    """
    try:
        make_folder(folder)
        names = {path.name for path in folder.iterdir()}
        require(
            STORE_FILE in names or names <= {_LOCK},
            f"'{folder}' is not empty and holds no {STORE_FILE}: it is not a store; name another"
            " folder.",
        )
        flags = os.O_CREAT | os.O_WRONLY
        stream = os.fdopen(open_at_once(folder / _LOCK, flags, private_modes()[0]), "wb")
    except OSError as error:
        raise BadInput(
            f"cannot write into '{folder}': {error.strerror or error}; choose another folder for"
            " the store."
        ) from error
    with stream:
        hold(stream, f"another run is writing into '{folder}'; wait for it, or stop it.")
        sweep(folder)
        try:
            yield
        finally:
            sweep(folder)


def open_store(
    folder: Path,
    population_sha256: str,
    cases: Mapping[str, Any],
    matchers: Mapping[str, Any],
    pairs: Mapping[str, Any],
) -> Store:
    """Open a store for writing, or start one; the caller holds its lock.

    `cases`, `matchers`: documents of their settings, by name; `pairs`: ``impostors`` and ``seed``
    of a run that compares. Raises BadInput if it is damaged, or
    of another population, version or settings.
    """
    document = {
        "format": FORMAT,
        "format_version": VERSION,
        "software": "splitknit",
        "version": provenance()["version"],
        "population": {"sha256": population_sha256},
        "matching": TEMPLATES,
        "cases": plain_json(cases),
        "matchers": {name: hashed(settings) for name, settings in matchers.items()},
        "pairs": {**pairs} if matchers else {},
    }
    store = Store(folder)
    file = folder / STORE_FILE
    if file.is_file():
        earlier = store.document()
        with refusing(store.damaged):
            document = _merged(folder, earlier, document)
    if not file.is_file() or document != earlier:
        write_file(file, json_text(document).encode("ascii"))
    return store


def _merged(folder: Path, earlier: dict[str, Any], wanted: dict[str, Any]) -> dict[str, Any]:
    """What a store holds after a run that may add cases, matchers and impostors, and no more.

    Raises BadInput naming what differs otherwise: population, version, or settings of one name.
    """
    before, merged = {**earlier}, {**wanted}
    for kind in ("cases", "matchers", "pairs"):
        first, second = earlier.get(kind, {}), wanted.get(kind, {})
        before[kind], merged[kind] = second | first, first | second
    pairs = merged["pairs"]
    if pairs:
        fractions = pairs["impostors"], before["pairs"]["impostors"]
        pairs["impostors"] = before["pairs"]["impostors"] = max(fractions)
    names = differing(before, merged)
    require(
        not names,
        f"the store '{folder}' was made with another {', '.join(names[:4])}; use the same, another"
        " name, or another folder.",
    )
    return merged
