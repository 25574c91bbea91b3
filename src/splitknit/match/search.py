"""Search of one finger among very many, in two stages: codes of fixed length, then the ridges of the best few."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from splitknit.check import require
from splitknit.match.code import ProbeSettings, code_size, probe_codes
from splitknit.match.ridge import Prepared, RidgeMatchSettings, prepared, ridge_match
from splitknit.match.template import Template
from splitknit.types import FloatArray

EXHAUSTIVE = 2000
"""In a gallery of no more fingers all are compared by their ridges (if it is asked for a sure answer)."""
_BLOCK = 4096

Gallery = Mapping[str, Template | Prepared] | Callable[[str], Template | Prepared]


@dataclass(frozen=True, slots=True)
class SearchSettings:
    """How a gallery is searched."""

    candidates: int = 50
    """Fingers that the codes let through to the comparison of ridges."""
    probe: ProbeSettings = field(default_factory=ProbeSettings)

    def __post_init__(self) -> None:
        require(self.candidates >= 1, "search.candidates must be at least 1.")


@dataclass(frozen=True, slots=True)
class Candidate:
    """A finger that was found."""

    id: str
    similarity: float
    """Of the ridges (:func:`splitknit.match.ridge_match`)."""
    code_similarity: float
    """Of the codes, -1 to 1; NaN where all fingers were compared and none left out by codes."""


class CodeIndex:
    """Codes of a gallery in memory: contiguous, one byte a number, grown as needed.

    It guarantees that `search` looks at every code (no approximation beyond the code itself), that its order of
    results depends on the set of (id, code) alone, not on the order in which they were added and removed, and that it
    holds `nbytes`, at most 2 code_size() bytes a finger just after growing, beside the ids.
    It is not safe to change it in one thread while another searches.
    """

    def __init__(self, ids: Iterable[str] = (), codes: NDArray[np.int8] | None = None) -> None:
        """Make an index of ids (N) and codes (N, code_size()); both may be left out."""
        self._ids: list[str] = []
        self._place: dict[str, int] = {}
        self._codes: NDArray[np.int8] = np.zeros((0, code_size()), dtype=np.int8)
        names = list(ids)
        if names or codes is not None:
            self.add_many(names, np.zeros((0, code_size()), dtype=np.int8) if codes is None else codes)

    def __len__(self) -> int:
        return len(self._ids)

    def __contains__(self, identity: object) -> bool:
        return identity in self._place

    @property
    def ids(self) -> tuple[str, ...]:
        """In the order of `codes`."""
        return tuple(self._ids)

    @property
    def codes(self) -> NDArray[np.int8]:
        """(N, code_size()) view, read-only."""
        view = self._codes[: len(self._ids)]
        view.flags.writeable = False
        return view

    @property
    def nbytes(self) -> int:
        """Memory of the codes, room for growth included."""
        return self._codes.nbytes

    def add(self, identity: str, code: NDArray[np.int8]) -> None:
        """Add a finger.

        Raises
        ------
        BadInput
            If the id is there already, or the code is none of this version.
        """
        self.add_many([identity], np.asarray(code)[None])

    def add_many(self, identities: Sequence[str], codes: NDArray[np.int8]) -> None:
        """Add fingers: ids (N) and codes (N, code_size()); all of them or, if one is refused, none."""
        codes = np.asarray(codes)
        require(
            codes.dtype == np.int8 and codes.shape == (len(identities), code_size()),
            f"codes must be int8 of the shape ({len(identities)}, {code_size()}), but they are {codes.dtype} of the "
            f"shape {codes.shape}; make them with code_of.",
        )
        new = set(identities)
        twice = len(new) < len(identities) or any(identity in self._place for identity in new)
        require(not twice, "an id is in the index already; remove it first, or choose another.")
        start, end = len(self._ids), len(self._ids) + len(identities)
        if end > len(self._codes):
            room = np.zeros((end if start == 0 else max(end, 2 * start, 256), code_size()), dtype=np.int8)
            room[:start] = self._codes[:start]
            self._codes = room
        self._codes[start:end] = codes
        self._ids.extend(identities)
        self._place.update(zip(identities, range(start, end), strict=True))

    def remove(self, identity: str) -> None:
        """Take a finger out; its code is overwritten.

        Raises
        ------
        BadInput
            If there is none of that id.
        """
        require(identity in self._place, f"there is no '{identity}' in the index.")
        place, last = self._place.pop(identity), len(self._ids) - 1
        if place != last:  # the last one moves into the gap
            self._codes[place] = self._codes[last]
            self._ids[place] = self._ids[last]
            self._place[self._ids[place]] = place
        self._codes[last] = 0
        self._ids.pop()

    def search(
        self, probe: Template, k: int = 50, settings: ProbeSettings | None = None
    ) -> tuple[list[str], FloatArray]:
        """The `k` fingers whose codes are most like the probe's.

        Parameters
        ----------
        probe : Template, not empty
        k : at least 1; fewer come back from a smaller index
        settings : of the probe's variants

        Returns
        -------
        ids : list of str, best first; equal scores in the order of their ids
        scores : (k,) float32, -1 to about 1
        """
        require(k >= 1, f"k must be at least 1, but it is {k}.")
        if not self._ids:
            return [], np.zeros(0, dtype=np.float32)
        scores = self.scores(probe_codes(probe, settings))
        k = min(k, len(scores))
        least = np.partition(scores, len(scores) - k)[len(scores) - k]
        ranked = sorted((-float(scores[n]), self._ids[n]) for n in np.flatnonzero(scores >= least).tolist())[:k]
        return [identity for _, identity in ranked], np.array([-score for score, _ in ranked], dtype=np.float32)

    def scores(self, variants: FloatArray) -> FloatArray:
        """(N,) best product of each code with the variants (V, code_size()) of a probe."""
        best = np.empty(len(self._ids), dtype=np.float32)
        right = np.ascontiguousarray(variants.T, dtype=np.float32)
        block = np.empty((_BLOCK, code_size()), dtype=np.float32)
        for start in range(0, len(best), _BLOCK):
            codes = self._codes[start : min(start + _BLOCK, len(best))]
            part = block[: len(codes)]
            part[...] = codes
            best[start : start + len(codes)] = (part @ right).max(axis=1)
        return best


def identify(  # noqa: PLR0917
    probe: Template,
    gallery: Gallery,
    index: CodeIndex,
    k: int | None = None,
    settings: SearchSettings | None = None,
    match: RidgeMatchSettings | None = None,
) -> list[Candidate]:
    """Who is it? Codes choose `k` fingers of the gallery, their ridges are compared.

    Parameters
    ----------
    probe : Template
    gallery : templates (or prepared ones) by id, or a function that fetches one by its id; it is asked for the
        candidates only
    index : codes of the gallery
    k : candidates; `settings.candidates` if None. Where k reaches the size of the index, codes are
        not used at all: the search is exhaustive. For galleries up to `EXHAUSTIVE` fingers that is the recommended way.
    settings : SearchSettings, optional
    match : of the comparison of ridges

    Returns
    -------
    list of Candidate, highest similarity first, at most k; equal ones in the order of their ids. Empty if the probe is
    a failure to acquire. A finger is who it is taken for only where its similarity passes a threshold: `splitknit
    match` prints false match rates of one comparison; a search among N fingers makes N chances of a false match.
    """
    settings = settings or SearchSettings()
    k = settings.candidates if k is None else k
    require(k >= 1, f"k must be at least 1, but it is {k}.")
    if probe.empty or not len(index):
        return []
    if k >= len(index):
        ids = sorted(index.ids)
        scores = np.full(len(ids), np.nan, dtype=np.float32)
    else:
        ids, scores = index.search(probe, k, settings.probe)
    fetch: Callable[[str], Template | Prepared] = gallery.__getitem__ if isinstance(gallery, Mapping) else gallery
    ready = prepared(probe, match)
    found = [
        Candidate(identity, ridge_match(ready, fetch(identity), match).similarity, float(score))
        for identity, score in zip(ids, scores, strict=True)
    ]
    return sorted(found, key=lambda candidate: (-candidate.similarity, candidate.id))
