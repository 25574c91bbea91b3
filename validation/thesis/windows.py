"""A small window of one capture against the whole of the other, by ridges: rates that are not at a ceiling.

The window is a disc on the template of a capture, at a place that is drawn from the capture's name.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import numpy as np
from compared import each
from trials import Pairs, Trial, Values

from splitknit.imaging.geometry import bounding_box
from splitknit_match.batch.reading import Place, small_column
from splitknit_match.matching.ridge import Prepared, ridge_match
from splitknit_match.matching.template import Template, unpack

DIAMETERS_MM = (8.0, 6.0, 4.0)
SKIN = 0.95
"""Of a window's area, at least."""


def window_trials(pairs: Pairs, places: Mapping[str, Place], case: str, jobs: int) -> list[Trial]:
    """One trial for each diameter on all `pairs`; NaN where a capture has no ridges or no such window."""
    names = pairs.captures.names
    order = np.argsort(pairs.a, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(pairs.a[order])) + 1)
    tasks = [(str(names[pairs.a[group[0]]]), [str(names[b]) for b in pairs.b[group]]) for group in groups]
    found = np.empty((len(order), len(DIAMETERS_MM)))
    found[order] = np.concatenate(each(partial(_compare, dict(places)), tasks, jobs))
    return [
        Trial(f"{case}, {diameter:g} mm", "ridge", "", found[:, k], None) for k, diameter in enumerate(DIAMETERS_MM)
    ]


def _compare(places: Mapping[str, Place], task: tuple[str, list[str]]) -> Values:
    """(N, diameters) similarities of one capture's windows and N whole captures."""
    first, others = task
    rng = np.random.default_rng(int.from_bytes(hashlib.sha256(first.encode()).digest()[:8], "big"))
    shown = unpack(small_column(places[first], "template"))
    windows = [None if shown.empty else disc(shown, diameter, rng) for diameter in DIAMETERS_MM]
    sides = [None if window is None else Prepared(window) for window in windows]
    result = np.full((len(others), len(sides)), np.nan)
    for row, other in zip(result, others, strict=True):
        whole = unpack(small_column(places[other], "template"))
        if whole.empty:
            continue
        right = Prepared(whole)
        row[:] = [np.nan if left is None else ridge_match(left, right).similarity for left in sides]
    return result


def disc(template: Template, diameter_mm: float, rng: np.random.Generator) -> Template | None:
    """A round window of a template; None where the finger has no place for it."""
    rows, columns = np.indices(template.valid.shape)
    radius = diameter_mm / 2 / template.pitch_mm
    if min(template.valid.shape) <= 2 * radius:
        return None
    for _ in range(1000):
        row, column = (rng.uniform(radius, side - radius) for side in template.valid.shape)
        inside = np.hypot(rows - row, columns - column) < radius
        if template.valid[inside].mean() > SKIN:
            box, inside = bounding_box(inside), inside & template.valid
            level = np.where(inside, template.level, 0)[box].astype(np.uint8)
            return replace(template, valid=inside[box].copy(), level=level)
    return None
