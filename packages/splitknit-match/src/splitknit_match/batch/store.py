"""The store of a batch on disk: what it was made with, and its tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from splitknit import BadInput
from splitknit.errors import read_bytes, refusing, require
from splitknit.io.atomic import atomic_file, make_folder
from splitknit.io.fields import MAX_JSON_BYTES, parse_json
from splitknit.io.provenance import json_text, plain_json, provenance, settings_hash
from splitknit.settings import differing
from splitknit_match.batch.chunks import SUFFIX, Table, read_chunk
from splitknit_match.batch.matchers import matcher
from splitknit_match.batch.population import Population
from splitknit_match.batch.reading import images_of, stored_places
from splitknit_match.batch.scores import COLUMNS
from splitknit_match.batch.settings import BatchSettings
from splitknit_match.matching.thesis import FingerImages

STORE_FILE = "store.json"
FORMAT, VERSION = "splitknit-batch", 3


@dataclass(frozen=True, slots=True)
class Store:
    """A folder of results."""

    folder: Path

    def document(self) -> dict[str, Any]:
        """The store's own record. Raises BadInput if there is no store, it is damaged or of another version."""
        file = self.folder / STORE_FILE
        require(file.is_file(), f"'{self.folder}' is not a store of 'splitknit batch': it holds no {STORE_FILE}.")
        damaged = f"'{file}' is damaged; name another folder for the store."
        document = _json(file, damaged)
        with refusing(damaged):
            known = document["format"] == FORMAT
            version = document["format_version"]
            parts = [document[name] for name in ("population", "cases", "matchers", "matching")]
            entries = [*parts, *parts[1].values(), *parts[2].values()]
            pairs = document.get("pairs", {})
            known = known and all(isinstance(one, dict) for one in [*entries, pairs])
            float(pairs.get("impostors", 0.0))
        require(known, damaged)
        fault = f"the store '{self.folder}' is of version {version}, and this is a reader of version {VERSION}"
        require(version == VERSION, f"{fault}; run the batch again into another folder.")
        return dict(document)

    def files(self, kind: str, name: str) -> list[Path]:
        """Finished chunks of ``features`` or ``minutiae`` of a case, or of ``scores/CASE`` of a matcher."""
        folder = self.folder / kind / name  # what is being written there begins with a dot
        return sorted(file for file in folder.glob(f"*{SUFFIX}") if file.is_file() and not file.name.startswith("."))

    def captures(self, case: str) -> set[str]:
        """Names of the captures that are finished in a case."""
        found: set[str] = set()
        for file in self.files("features", case):
            found.update(read_chunk(file, ["capture"])["capture"].tolist())
        return found

    def features(self, case: str, columns: Sequence[str] | None = None) -> Table:
        """Columns of all captures of a case by their names, ordered by capture, see ``docs/reference/files.md``;
        ``seconds`` only where it is named. Raises BadInput if there is nothing of this case, or a chunk is damaged.
        """
        files = self.files("features", case)
        require(len(files) > 0, f"the store '{self.folder}' holds nothing of case '{case}'.")
        wanted = None
        if columns is not None:
            wanted = list(dict.fromkeys(["capture", *(name for name in columns if name != "seconds")]))
        table = _joined([read_chunk(file, wanted, ["capture"]) for file in files], ["capture"])
        if columns is None:
            return table
        if "seconds" in columns:
            known = self.seconds(case)
            table["seconds"] = np.array([known.get(name, np.nan) for name in table["capture"].tolist()])
        return {name: table[name] for name in columns}

    def scores(self, case: str, matcher: str) -> Table:
        """Columns of the comparisons of a case by a matcher, ordered by both captures, every pair once. Raises BadInput
        if there are none, or a chunk is damaged.
        """
        files = self.files(f"scores/{case}", matcher)
        none = f"the store '{self.folder}' holds no comparisons of case '{case}' by matcher '{matcher}'."
        require(len(files) > 0, none)
        return _joined([read_chunk(file, None, COLUMNS) for file in files], ["b", "a"])

    def images(self, case: str, capture: str) -> FingerImages:
        """Channels of a capture for the thesis's matcher, as reconstruction gives them; BadInput without a surface."""
        place = stored_places(self.files("features", case)).get(capture)
        found = None if place is None else images_of(place)
        if found is None:
            raise BadInput(f"the store '{self.folder}' holds no surface of '{capture}' in case '{case}'.")
        return found

    def seconds(self, case: str) -> dict[str, float]:
        """Seconds that each capture took to reconstruct; the one thing that differs from run to run."""
        found: dict[str, float] = {}
        for file in sorted((self.folder / "timings" / case).glob("*.json")):
            damaged = f"'{file}' is damaged: a number of seconds by the name of a capture is expected; delete it."
            times = _json(file, damaged)
            require(isinstance(times, dict) and all(isinstance(one, (int, float)) for one in times.values()), damaged)
            found |= {name: float(value) for name, value in times.items()}
        return found


def _json(file: Path, damaged: str) -> Any:
    data = read_bytes(file, MAX_JSON_BYTES)
    try:
        return parse_json(data, str(file))
    except BadInput as error:
        raise BadInput(damaged) from error


def _joined(tables: Sequence[Table], keys: list[str]) -> Table:
    """The tables as one, ordered by `keys`, the last first; of rows with equal keys the first."""
    other = "chunks of the store have different columns; delete the older ones and run the same again."
    require(all(table.keys() == tables[0].keys() for table in tables), other)
    whole = {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}
    order = np.lexsort([whole[key] for key in keys])
    again = np.zeros(len(order), dtype=np.bool_)
    again[1:] = np.all([whole[key][order][1:] == whole[key][order][:-1] for key in keys], axis=0)
    return {name: column[order[~again]] for name, column in whole.items()}


def open_store(folder: Path, population: Population, settings: BatchSettings) -> Store:
    """Open a store for writing, or start one; the caller holds its lock. Raises BadInput if the folder holds something
    else, or a store of another population or with other settings.
    """
    document: dict[str, Any] = {
        "format": FORMAT,
        "format_version": VERSION,
        "software": "splitknit",
        "version": provenance()["version"],
        "population": {"sha256": population.sha256},
        "matching": _hashed({"band": settings.matching.band, "template": settings.matching.template}),
        "cases": {case.name: plain_json(case.document()) for case in settings.cases},
        "matchers": {name: _hashed(matcher(name, settings.matching).document) for name in settings.matchers},
    }
    if settings.matchers:
        document["pairs"] = {"seed": settings.seed, "impostors": settings.impostors}
    store = Store(folder)
    file = folder / STORE_FILE
    if file.is_file():
        earlier = store.document()
        _check_same(folder, earlier, document)
        document["cases"] = earlier["cases"] | document["cases"]
        document["matchers"] = earlier["matchers"] | document["matchers"]
        pairs = _pairs(folder, earlier.get("pairs"), document.get("pairs"))
        document |= {"pairs": pairs} if pairs else {}
        if document == earlier:
            return store
    with atomic_file(file) as stream:
        stream.write(json_text(document).encode("ascii"))
    return store


def check_store_target(folder: Path) -> None:
    """Refuse a folder that holds something else than a store. Raises BadInput."""
    try:
        require(not folder.exists() or folder.is_dir(), f"'{folder}' is a file; name a folder for the store.")
        names = {path.name for path in folder.iterdir()} if folder.is_dir() else set()
    except (OSError, ValueError) as error:
        raise BadInput(f"'{folder}' cannot be used as a store: {error}.") from error
    fault = f"'{folder}' is not empty and holds no {STORE_FILE}: it is not a store"
    require(not names or STORE_FILE in names or names <= {".lock"}, f"{fault}; name another folder.")
    try:
        make_folder(folder)
    except OSError as error:
        raise BadInput(f"cannot write '{folder}': {error.strerror or error}; choose another place.") from error


def _hashed(settings: Mapping[str, Any]) -> dict[str, Any]:
    plain = plain_json(settings)
    return {"settings_sha256": settings_hash(plain), "settings": plain}


def _check_same(folder: Path, earlier: Mapping[str, Any], wanted: Mapping[str, Any]) -> None:
    fault = f"the store '{folder}' is of another population"
    cure = "name another folder, or the population that it is of."
    require(earlier["population"].get("sha256") == wanted["population"]["sha256"], f"{fault}; {cure}")
    fault = f"the store '{folder}' was made by splitknit {earlier.get('version')}, and this is {wanted['version']}"
    require(earlier.get("version") == wanted["version"], f"{fault}; use that version, or name another folder.")
    for kind, words in (("cases", "case"), ("matchers", "matcher")):
        for name in earlier[kind].keys() & wanted[kind].keys():
            _check_settings(folder, f"{words} '{name}'", earlier[kind][name], wanted[kind][name])
    _check_settings(folder, "templates", earlier["matching"], wanted["matching"])


def _pairs(folder: Path, earlier: Any, wanted: Any) -> Any:
    """Which comparisons: a later run may request more of them, drawn the same way."""
    if not earlier or not wanted:
        return wanted or earlier
    fault = f"the impostors in the store '{folder}' were drawn with the seed {earlier.get('seed')},"
    require(earlier.get("seed") == wanted["seed"], f"{fault} not {wanted['seed']}; use the same, or another folder.")
    return wanted | {"impostors": max(wanted["impostors"], float(earlier.get("impostors", 0.0)))}


def _check_settings(folder: Path, what: str, earlier: Mapping[str, Any], wanted: Mapping[str, Any]) -> None:
    names = differing(earlier.get("settings", {}), wanted["settings"])
    where = f" ({', '.join(names[:4])})" if names else ""
    fault = f"the store '{folder}' was made with other settings of {what}{where}; use the same, another name,"
    require(earlier.get("settings_sha256") == wanted["settings_sha256"], f"{fault} or another folder.")
