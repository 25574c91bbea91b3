"""False match rates that were measured on simulated impostors and come with the package."""

from __future__ import annotations

import json
from functools import cache
from importlib import resources

import numpy as np

from splitknit.matching import FmrTable


@cache
def fmr_table(name: str) -> FmrTable | None:
    """Table in the package's file `name`; None where it was not measured."""
    file = resources.files("splitknit.apps") / name
    if not file.is_file():
        return None
    document = json.loads(file.read_text(encoding="utf-8"))
    return FmrTable(np.array(document["similarity"]), np.array(document["fmr"]), int(document["impostors"]))
