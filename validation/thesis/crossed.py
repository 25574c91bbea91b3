"""The case ``snk-crossed``: Split and Knit on the crossed images of a polarised population.

Crossed films leave the light from within the skin without specular reflection, which the thesis names as a source of
error. The crossed images become a population of their own, which `splitknit batch` reconstructs as any other.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

CASE, OF = "snk-crossed", "snk"


def crossed_population(population: Path, out: Path) -> bool:
    """Make `out` of the polarised captures of `population`, or go on making it; whether there are any.

    Files are hard links, so that hardly any room is taken; each capture's white band is its crossed series.
    """
    found = False
    for file in sorted(population.glob("*/session_*/*/capture.json")):
        document = json.loads(file.read_text(encoding="utf-8"))
        if "white_crossed" not in document["bands"]:
            continue
        found, place = True, out / file.parent.relative_to(population)
        if (place / file.name).exists():
            continue
        document["bands"]["white"] = document["bands"].pop("white_crossed")
        place.mkdir(parents=True, exist_ok=True)
        _linked([one for one in file.parent.iterdir() if one.is_file() and one.name != file.name], place)
        (place / file.name).write_text(json.dumps(document), encoding="utf-8")  # last: the capture is complete
    if found:
        _linked([one for one in population.iterdir() if one.is_file()], out)
    return found


def _linked(files: Sequence[Path], place: Path) -> None:
    for file in files:
        (place / file.name).unlink(missing_ok=True)
        os.link(file, place / file.name)


class WithCrossed:
    """A store whose case ``snk-crossed`` is the case ``snk`` of another store."""

    def __init__(self, store: Any, crossed: Any) -> None:
        self.store, self.crossed = store, crossed

    def _of(self, case: str) -> tuple[Any, str]:
        return (self.crossed, OF) if case == CASE else (self.store, case)

    def features(self, case: str, columns: Sequence[str] | None = None) -> Any:
        store, name = self._of(case)
        return store.features(name, columns)

    def scores(self, case: str, matcher: str) -> Any:
        store, name = self._of(case)
        return store.scores(name, matcher)

    def files(self, kind: str, case: str) -> Any:
        return self.store.files(kind, case)

    def document(self) -> Any:
        return self.store.document()
