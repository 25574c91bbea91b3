"""What the tests of the batch share."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from splitknit_match.batch.cases import preset_cases
from splitknit_match.batch.engine import run_batch
from splitknit_match.batch.store import SUFFIX, Store
from splitknit_match.matching.ridge_band import ridge_band
from splitknit_match.matching.template import make_template, pack

CASES = preset_cases(("ea",))


def run(people: Path, out: Path, *names: str, **changes: Any) -> dict[str, Any]:
    """The batch of the case ``ea``, in this process."""
    return run_batch(people, out, **{"cases": CASES, "matchers": names, "jobs": 1} | changes)


def tables(out: Path) -> dict[str, bytes]:
    """Every table of a store by its place."""
    return {
        file.relative_to(out).as_posix(): file.read_bytes()
        for file in sorted(out.rglob(f"*{SUFFIX}"))
    }


def rows_of(table: dict[str, np.ndarray]) -> list[dict[str, object]]:
    """Rows of a table of the store."""
    return [
        dict(zip(table, row, strict=True))
        for row in zip(*(column.tolist() for column in table.values()), strict=True)
    ]


def pairs_of(out: Path, matcher: str) -> list[tuple[str, str]]:
    table = Store(out).scores("ea", matcher)
    return list(zip(table["a"].tolist(), table["b"].tolist(), strict=True))


def waves(finger: str, number: int) -> bytes:
    """Template of a finger: waves of its own, and a little of a session's noise."""
    rng = np.random.default_rng(list(finger.encode()))
    row, column = np.mgrid[:90, :80] * 0.1
    turn = rng.uniform(0, np.pi) + 0.25 * np.hypot(
        row - rng.uniform(2, 7), column - rng.uniform(2, 6)
    )
    relief = np.sin(14.0 * (np.cos(turn) * column + np.sin(turn) * row))
    relief += 0.4 * np.random.default_rng(number).standard_normal(relief.shape)
    return pack(
        make_template(ridge_band(relief.astype(np.float32), np.ones(relief.shape, bool), 0.1))
    )
