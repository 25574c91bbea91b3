"""Search of one finger among very many, in stages: codes of fixed length, a glance at the ridges of the best, then
the comparison of the ridges of a few.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.matching.code import ProbeSettings, code_size, laid_on, probe_codes
from splitknit.matching.elastic import compare_patches
from splitknit.matching.ridge import Prepared, RidgeMatchSettings, prepared, ridge_match
from splitknit.matching.template import Template
from splitknit.model import FloatArray
from splitknit.settings import Checked, Limits

EXHAUSTIVE = 2000
"""In a gallery of no more fingers all are compared by their ridges (if it is asked for a sure answer)."""
PRESSED_MM = 2.0
"""Prints are searched with shifts up to this: about the standard deviation of where a finger is put on a sensor."""
_BLOCK = 1024
"""Codes that are widened to float32 at a time: what a core's cache holds."""

Gallery = Mapping[str, Template | Prepared] | Callable[[str], Template | Prepared]


@dataclass(frozen=True, slots=True)
class SearchSettings(Checked):
    """How a gallery is searched."""

    candidates: Annotated[int, Limits(1)] = 50
    """Fingers that the codes let through to a glance at their ridges, which are laid as the codes fit best."""
    finalists: Annotated[int, Limits(1)] = 3
    """Of those the fingers whose ridges are compared in full."""
    shortlist: Annotated[int, Limits(1, 10_000)] = 500
    """Fingers that shards let through to a glance, where a gallery has shards."""
    probe: ProbeSettings = field(default_factory=ProbeSettings)
    """Of fingers; of prints at least `PRESSED_MM` of shift."""

    def variants_of(self, probe: Template) -> ProbeSettings:
        """How a probe is laid: a print, which has minutiae, lies further off than a finger before a camera."""
        one = self.probe
        if probe.minutiae is None:
            return one
        return replace(one, right_mm=max(one.right_mm, PRESSED_MM), down_mm=max(one.down_mm, PRESSED_MM))


@dataclass(frozen=True, slots=True)
class Candidate:
    """A finger that was found."""

    id: str
    similarity: float
    """Of the ridges (:func:`splitknit.matching.ridge.ridge_match`)."""
    code_similarity: float
    """Of the codes, -1 to 1; NaN where all fingers were compared and none left out by codes."""


class CodeIndex:
    """Codes of a gallery in memory, one byte a number.

    `search` looks at every code (no approximation beyond the code itself), and the order of its results depends on the
    set of (id, code) alone. Threads may share it.
    """

    def __init__(self, ids: Iterable[str], codes: NDArray[np.int8]) -> None:
        """Take ids (N), each once, and codes (N, code_size()) of :func:`splitknit.matching.code.code_of`."""
        self.ids, self.codes = tuple(ids), np.ascontiguousarray(codes)
        wanted = (len(self.ids), code_size())
        require(
            self.codes.dtype == np.int8 and self.codes.shape == wanted,
            f"codes must be int8 of the shape {wanted}, but they are {self.codes.dtype} of the shape "
            f"{self.codes.shape}; make them with code_of.",
        )
        require(len(set(self.ids)) == len(self.ids), "an id is in the index twice; each finger needs its own.")

    def __len__(self) -> int:
        return len(self.ids)

    def search(
        self, probe: Template, k: int = 50, settings: ProbeSettings | None = None
    ) -> tuple[list[str], FloatArray]:
        """Ids and scores (k,) of the fingers whose codes are most like those of a probe that is not empty.

        Best first, equal ones in the order of their ids; scores from -1 to about 1; fewer than `k` from a smaller
        index. `settings`: of the probe's variants.
        """
        require(k >= 1, f"k must be at least 1, but it is {k}.")
        if not self.ids:
            return [], np.zeros(0, dtype=np.float32)
        places, scores = self.nearest(probe_codes(probe, settings), k)
        return [self.ids[place] for place in places], scores

    def nearest(self, variants: FloatArray, k: int) -> tuple[list[int], FloatArray]:
        """Places and scores of the `k` best, as :meth:`search`, for the variants (V, code_size()) of a probe."""
        scores = self.scores(variants)
        k = min(k, len(scores))
        least = np.partition(scores, len(scores) - k)[len(scores) - k]
        ranked = sorted((-float(scores[n]), self.ids[n], n) for n in np.flatnonzero(scores >= least).tolist())[:k]
        return [n for _, _, n in ranked], np.array([-score for score, _, _ in ranked], dtype=np.float32)

    def scores(self, variants: FloatArray) -> FloatArray:
        """(N,) best product of each code with the variants (V, code_size()) of a probe."""
        best = np.empty(len(self), dtype=np.float32)
        left = np.ascontiguousarray(variants, dtype=np.float32)
        block = np.empty((_BLOCK, code_size()), dtype=np.float32)
        for start in range(0, len(best), _BLOCK):
            codes = self.codes[start : start + _BLOCK]
            part = block[: len(codes)]
            part[...] = codes
            best[start : start + len(codes)] = (left @ part.T).max(axis=0)
        return best


def identify(
    probe: Template,
    gallery: Gallery,
    index: CodeIndex,
    k: int | None = None,
    *,
    settings: SearchSettings | None = None,
    match: RidgeMatchSettings | None = None,
) -> list[Candidate]:
    """Who is it? Codes choose `k` fingers of the gallery, a glance at their ridges a few, and those are compared.

    `gallery`: templates (or prepared ones) by id, or a function that fetches one by its id, which is asked for the
    candidates only; `index`: codes of the gallery; `k`: candidates of the codes, by default `settings.candidates`.
    Where k reaches the size of the index, all are compared and codes not used: the safe choice for galleries up to
    `EXHAUSTIVE` fingers. Returns at most `settings.finalists` (all of a gallery that is compared as a whole), highest
    similarity first, equal ones in the order of their ids; none if the probe is a failure to acquire. A search among N
    fingers makes N chances of a false match. Raises BadInput if k is less than 1, or a template has another pitch than
    the probe.
    """
    settings = settings or SearchSettings()
    k = settings.candidates if k is None else k
    require(k >= 1, f"k must be at least 1, but it is {k}.")
    if probe.empty or not len(index):
        return []
    fetch: Callable[[str], Template | Prepared] = gallery.__getitem__ if isinstance(gallery, Mapping) else gallery
    ready = prepared(probe, match)
    if k >= len(index):
        chosen = [(identity, float("nan"), prepared(fetch(identity), match)) for identity in sorted(index.ids)]
    else:
        laid = settings.variants_of(probe)
        variants = probe_codes(probe, laid)
        chosen, worths = [], []
        for place, score in zip(*index.nearest(variants, k), strict=True):
            code = index.codes[place].astype(np.float32)
            other = prepared(fetch(index.ids[place]), match)
            worths.append(glance(ready, other, laid, int(np.argmax(variants @ code))))
            chosen.append((index.ids[place], float(score), other))
        best = sorted(range(len(chosen)), key=lambda n: (-worths[n], chosen[n][0]))[: settings.finalists]
        chosen = [chosen[n] for n in best]
    found = [
        Candidate(identity, ridge_match(ready, other, match).similarity, score) for identity, score, other in chosen
    ]
    return sorted(found, key=lambda candidate: (-candidate.similarity, candidate.id))


def glance(probe: Prepared, other: Prepared, settings: ProbeSettings, variant: int) -> float:
    """How well patches of the probe's ridges are found in the other finger, laid as its code fits best.

    Returns agreement times the root of the number of patches; -1 for a failure to acquire. `variant`: number of the
    probe's variant that fits best. Raises BadInput if the templates have different pitches.
    """
    if other.template.empty:
        return -1.0
    require(
        probe.template.pitch_mm == other.template.pitch_mm,
        f"templates have pitches of {probe.template.pitch_mm:g} and {other.template.pitch_mm:g} mm; make both new.",
    )
    turn, right, down = (float(values[variant]) for values in settings.variants())
    start = laid_on(probe.template, other.template, turn, right, down)
    seen = compare_patches(probe.first, other.value, other.template.valid, start)
    return float(seen.mean * np.sqrt(len(seen.used)))
