"""Identification: one finger against a gallery, or against what one person claims (verification)."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import count
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit import BadInput, Progress, naming, no_progress, override, path, require
from splitknit_match.gallery.enrol import MINUTIAE_HASH, known_finger, templates_hash
from splitknit_match.gallery.entry import Enrolled, check_person, session_order
from splitknit_match.gallery.gallery import Gallery
from splitknit_match.gallery.identify_job import IdentifyJob
from splitknit_match.gallery.key import key_of
from splitknit_match.gallery.minutia_index import each, unpacked
from splitknit_match.gallery.shards import Shards
from splitknit_match.matching.code import CODE_VERSION, code_of, probe_codes
from splitknit_match.matching.fusion import fused_match, with_fusion
from splitknit_match.matching.inputs import Side, held, read_side
from splitknit_match.matching.methods import (
    ComparedSide,
    FmrBasis,
    MatchDecision,
    Rated,
    as_calibrated,
    doubt_of,
    fmr_basis,
    rate,
    scale_doubt,
    scores_of,
    side_minutiae,
    similarity_at,
)
from splitknit_match.matching.minutiae import minutiae_match
from splitknit_match.matching.minutiae_record import Minutiae, unpack_minutiae
from splitknit_match.matching.ridge import Prepared, RidgeMatchSettings, ridge_match
from splitknit_match.matching.ridge_band import RidgeBandSettings
from splitknit_match.matching.search import EXHAUSTIVE, SearchSettings, glance, nearest_codes
from splitknit_match.matching.surface import MatchingSettings
from splitknit_match.matching.template import Template, TemplateSettings


@dataclass(frozen=True, slots=True)
class IdentifySettings:
    """All that the settings of an identification can change."""

    band: RidgeBandSettings = field(default_factory=RidgeBandSettings)
    template: TemplateSettings = field(default_factory=TemplateSettings)
    ridge: RidgeMatchSettings = field(default_factory=RidgeMatchSettings)
    search: SearchSettings = field(default_factory=SearchSettings)

    @property
    def matching(self) -> MatchingSettings:
        """Settings of templates and comparisons."""
        return MatchingSettings(band=self.band, template=self.template, ridge=self.ridge)


@dataclass(frozen=True, slots=True)
class Searched:
    """What a search went through."""

    method: str
    """``exhaustive``, ``minutiae``, ``codes`` or ``shards``."""
    compared_by: str
    """``ridge``, ``fusion`` or ``minutiae``."""
    without_code: int
    """Captures whose codes had to be made, or that the shards lack."""
    fingers: int | None
    """How many fingers the captures show; None where not all rows were read, and so is `people`."""
    people: int | None
    failures: int
    """Failures to acquire in the gallery, which match nobody."""
    captures: int
    compared: int
    """How many of them were compared, the others were left out by their codes."""
    note: str | None = None
    """Which were compared by less than the others."""


@dataclass(frozen=True, slots=True)
class RankedCandidate:
    """One who may have left the finger."""

    rank: int
    person: str
    finger: str
    session: str
    similarity: float
    code_similarity: float | None
    fmr: float | None
    """False match rate at this similarity, None where it is not known."""
    expected_false_matches: float | None
    """Captures of other fingers, among those searched, that are as similar by chance."""


@dataclass(frozen=True, slots=True)
class SearchDecision(MatchDecision):
    """Whether the best candidate is the finger's owner."""

    expected_false_matches: float = 0.0


@dataclass(frozen=True, slots=True)
class Identification:
    """What a search found; that nobody is found is not an error."""

    gallery: str
    probe: ComparedSide
    mode: str
    """``identification``, or ``verification`` where a person was claimed."""
    person: str | None
    finger: str | None
    by: str
    """``ridges`` or ``minutiae``: what the gallery keeps."""
    searched: Searched
    merge: str
    candidates: tuple[RankedCandidate, ...]
    """Best first."""
    fmr_basis: FmrBasis | None
    decision: SearchDecision | None
    """None where false match rates are not known for the settings, or where the answer is ``undecided``."""
    answer: str
    """``match``, ``no match``, ``undecided``, or ``not acquired``."""
    undecided: str | None
    """Why the answer is neither ``match`` nor ``no match``, and what it takes."""
    timings_s: Mapping[str, float]
    presentation: str | None = None
    """``live`` or ``unknown``, where attacks were to be refused."""


ALL_PRINTS = 200
"""In a gallery of no more captures all are compared, if a print is looked for."""
LIST, LISTED = 50, 0.005
"""Of more so many, or that fraction, are: those that :class:`splitknit_match.gallery.minutia_index.MinutiaIndex` finds
(what is lost: ``validation/gallery/index.py``)."""
SHORTER = 25
"""Unless `minutiae` are asked for, so many times fewer, laid on the probe by minutiae alone where these propose how."""
_OTHERS = "of {captures} captures {compared} were compared, {why}; about 1 in 100 matches is lost so"
_WHY = "those whose minutiae agree best", "by how well minutiae agree, up to the first that matched"


def identify_finger(
    question: IdentifyJob, progress: Progress = no_progress, warm: Gallery | None = None, side: Side | None = None
) -> Identification:
    """Who is it? That nobody is found is a result, no error. Raises BadInput as :class:`IdentifyJob` states.

    `warm`: a gallery that is open already, and stays so; `side`: the probe, where it was read already.
    """
    gallery, key, shards = path(question.gallery), key_of(question.key), path(question.shards)
    settings = override(IdentifySettings(), question.settings or {})
    probe = held(question.probe, question.resolution_ppi)
    person = None if question.person is None else check_person(question.person)
    finger = None if question.finger is None else known_finger(question.finger)
    mapped = None if shards is None else Shards(shards, key)
    require(
        mapped is None or (person is None and finger is None and question.search != "exhaustive"),
        "`shards` is for a search of the whole gallery by codes; leave out `person`, `finger` and `search`.",
    )
    with Gallery.open(gallery, key) if warm is None else contextlib.nullcontext(warm) as opened:
        of_minutiae = opened.settings_sha256 == MINUTIAE_HASH
        opened.require_comparable(MINUTIAE_HASH if of_minutiae else templates_hash(settings.matching))
        require(
            mapped is None or not of_minutiae, f"'{gallery}' keeps minutiae, which have no codes; leave out `shards`."
        )
        calibrated = of_minutiae or as_calibrated(settings.matching)
        if calibrated:
            # refused here, before anything is made, where no such rate was measured
            similarity_at(question.fmr, "minutiae_of_prints" if of_minutiae else "ridge")
        pool = _pool(opened, person, finger, "exhaustive" if of_minutiae else question.search)
        side = side or read_side(
            probe, question.preset, settings.matching, lambda stage, at: progress(stage, 0.5 * at), question.input_ppi
        )
        made = side_minutiae(side) if of_minutiae else side.template
        if made is None:
            raise BadInput(
                f"{side.path} holds minutiae, but '{gallery}' keeps ridges; name a print, or enrol minutiae."
            )
        acquired = made.acquired if isinstance(made, Minutiae) else not made.empty
        area_mm2 = 0.0 if isinstance(made, Minutiae) else made.area_mm2
        fusion = "fingerphotos" if side.kind == "photo" else "fusion"

        def matches(one: _Found) -> bool:
            return calibrated and _rated(one, fusion, area_mm2, question.fmr).answer == "match"

        started = time.perf_counter()
        found, facts = _search(
            opened, made, pool if mapped is None else mapped, settings=settings, search=question.search,
            matches=matches, progress=progress,
        )  # fmt: skip
        seconds = time.perf_counter() - started
        candidates = _merged(found, question.merge)[: question.top]
        doubt = doubt_of(side)
        whole = calibrated and facts.compared_by == "fusion" and fusion == "fusion" and facts.compared == facts.captures
        if whole and doubt is None and isinstance(made, Template) and candidates and not matches(candidates[0]):
            row = candidates[0][2].row
            for payload in opened.templates([row]).values():
                doubt = scale_doubt(made, unpacked(opened.path, row, payload), question.fmr)
    by = {"minutiae": "minutiae_of_prints", "fusion": fusion}.get(facts.compared_by, facts.compared_by)
    rated = [_rated(one, by, area_mm2, question.fmr) if calibrated else None for one in candidates]
    reported = [_candidate(n, one, facts.captures, it) for n, one, it in zip(count(1), candidates, rated, strict=False)]
    first = rated[0] if rated else None
    decision, undecided = None, None
    if not calibrated:
        undecided = "with other settings than the shipped ones false match rates are not known"
    elif first is not None and first.decision is None:
        undecided = first.undecided
    else:
        at = None if first is None else first.decision
        at = at or MatchDecision(False, question.fmr, similarity_at(question.fmr, by))
        decision = SearchDecision(at.match, at.fmr, at.threshold, at.expected_fmr, facts.captures * at.fmr)
    if doubt is not None and not (decision and decision.match and side.kind != "touches"):  # a match confirms a print's
        decision, undecided = None, doubt
    answer = "undecided" if decision is None else "match" if decision.match else "no match"
    progress("done", 1.0)
    return Identification(
        gallery=str(gallery), mode="identification" if person is None else "verification", person=person, finger=finger,
        probe=ComparedSide(str(side.path), side.kind, area_mm2, acquired, note=side.note, doubt=side.doubt),
        by="minutiae" if of_minutiae else "ridges", searched=facts, merge=question.merge, candidates=tuple(reported),
        fmr_basis=None if not calibrated else fmr_basis(by) if first is None else first.basis, decision=decision,
        answer=answer if acquired or doubt else "not acquired",
        undecided=undecided if acquired or doubt else "failure to acquire", timings_s={"search": seconds},
    )  # fmt: skip


_Found = tuple[float, float | None, Enrolled, float | None, float | None]
"""Similarity of ridges (or of ridges and minutiae), of codes, what was compared, similarity of minutiae alone, and the
area that overlaps, mm2."""


def _pool(gallery: Gallery, person: str | None, finger: str | None, search: str) -> list[Enrolled] | None:
    """Rows to search; None for all of a gallery so large that not all may have to be read."""
    if (
        person is None
        and finger is None
        and (search in ("codes", "minutiae") or (search == "auto" and len(gallery) > ALL_PRINTS))
    ):
        return None
    rows = gallery.entries(person, finger)
    who = " and ".join(word for word in (person and f"person '{person}'", finger and f"finger '{finger}'") if word)
    require(
        len(rows) > 0 or not who,
        f"'{gallery.path}' holds nothing of {who}; 'splitknit gallery list' shows who is in it.",
    )
    return rows


def _search(
    gallery: Gallery,
    probe: Template | Minutiae,
    pool: list[Enrolled] | Shards | None,
    *,
    settings: IdentifySettings,
    search: str,
    matches: Callable[[_Found], bool],
    progress: Progress,
) -> tuple[list[_Found], Searched]:
    """Compare these, or those that minutiae or codes (of shards, or of the gallery) choose.

    By ridges and minutiae where the probe and one of them at least have both, on the same scale where one has not.
    """
    if isinstance(probe, Minutiae):
        assert isinstance(pool, list)
        facts = _searched(pool)
        found = _by_minutiae(gallery, probe, {one.row: one for one in pool})
        return found, replace(facts, compared_by="minutiae", compared=len(found))
    ready = Prepared(probe, settings.ridge)
    if pool is None and search != "codes" and not probe.empty and ready.cylinders is not None:
        index = gallery.minutia_index()
        captures = len(index.rows) + len(index.others)
        chosen = index.nearest(
            ready.cylinders, max(LIST, round(LISTED * captures)) // (SHORTER if search == "auto" else 1)
        )
        waves = [chosen[:1], chosen[1:], index.others] if search == "auto" else [[*chosen, *index.others]]
        facts = Searched("minutiae", "fusion", 0, None, None, len(gallery) - captures, captures, 0)
        found = []
        ended = False
        for wave in waves:
            progress("comparing", 0.5 + 0.5 * len(found) / captures)
            part, note = _compared(
                gallery, ready, gallery.entries_at(wave), {}, no_progress, sure=0.0 if search == "auto" else None
            )
            found += part
            ended = search == "auto" and any(map(matches, part))
            if ended:
                break
        if len(found) < captures:
            note = "; ".join(
                filter(None, (_OTHERS.format(captures=captures, compared=len(found), why=_WHY[ended]), note))
            )
        by = "fusion" if any(one[3] is not None or one[4] is not None for one in found) else "ridge"
        return sorted(found, key=_order), replace(facts, compared_by=by, compared=len(found), note=note)
    score: dict[int, float] = {}
    rows: dict[int, Enrolled] = {}
    if pool is None and search != "codes" and len(gallery) <= EXHAUSTIVE:
        pool = gallery.entries()
    if isinstance(pool, Shards):
        rest = gallery.entries_at(gallery.without_code(CODE_VERSION))
        failures = sum(one.template_bytes == 0 for one in rest.values())
        without_code = max(0, len(gallery) - failures - len(pool))
        acquired, score = _by_shards(gallery, probe, pool, settings)
        facts = Searched("shards", "ridge", without_code, None, None, failures, len(pool), 0)
    elif pool is None:
        codes, without_code, failures = _codes(gallery, progress)
        acquired = list(codes)
        facts = Searched("exhaustive", "ridge", without_code, None, None, failures, len(codes), 0)
        if len(acquired) > settings.search.candidates and not probe.empty:
            variants = probe_codes(probe, settings.search.variants_of(probe))
            places, scores = nearest_codes(np.stack(list(codes.values())), variants, settings.search.candidates)
            score = {acquired[place]: value for place, value in zip(places, scores.tolist(), strict=True)}
            acquired, facts = list(score), replace(facts, method="codes")
    else:
        facts = _searched(pool)
        rows = {one.row: one for one in pool if one.template_bytes > 0}
        acquired = list(rows)
    if probe.empty or not acquired:
        return [], facts
    found, note = _compared(gallery, ready, rows or gallery.entries_at(acquired), score, progress)
    by = "fusion" if any(one[4] is not None for one in found) else "ridge"
    return sorted(found, key=_order), replace(facts, compared_by=by, compared=len(found), note=note)


def _searched(pool: list[Enrolled]) -> Searched:
    names = [one.entry for one in pool if one.template_bytes > 0]
    fingers, people = len({(one.person, one.finger) for one in names}), len({one.person for one in names})
    return Searched("exhaustive", "ridge", 0, fingers, people, len(pool) - len(names), len(names), 0)


def _compared(
    gallery: Gallery,
    probe: Prepared,
    rows: Mapping[int, Enrolled],
    score: Mapping[int, float],
    progress: Progress,
    *,
    sure: float | None = None,
) -> tuple[list[_Found], str | None]:
    """Compare the probe with each of some rows by ridges, and minutiae where both hold some; and a note."""
    payloads = gallery.templates(list(rows))  # of those that were not removed just now
    templates = {row: unpacked(gallery.path, row, payload) for row, payload in payloads.items()}
    fused, note = with_fusion(templates.values(), probe.template)

    def scores_of(row: int) -> tuple[float, float | None, float | None]:
        other = Prepared(templates[row], probe.settings)
        if not fused:
            return ridge_match(probe, other).similarity, None, None
        both = fused_match(probe, other, sure)
        return both.similarity, both.minutiae, both.ridge.overlap_mm2

    found: list[_Found] = []
    for row, (similarity, minutiae, overlap_mm2) in zip(templates, each(scores_of, list(templates)), strict=True):
        progress("comparing", 0.5 + 0.5 * len(found) / len(templates))
        found.append((similarity, score.get(row), rows[row], minutiae, overlap_mm2))
    return found, note


def _by_shards(
    gallery: Gallery, probe: Template, shards: Shards, settings: IdentifySettings
) -> tuple[list[int], dict[int, float]]:
    """Rows that codes, and of their best a glance at the ridges, let through; and the similarities of codes."""
    if probe.empty:
        return [], {}
    hits = shards.search(probe, settings.search.shortlist, settings.search.variants_of(probe))
    score = dict(zip(hits.rows.tolist(), hits.similarity.tolist(), strict=True))
    ready, ranks = Prepared(probe, settings.ridge), {}
    for row, variant in zip(hits.rows.tolist(), hits.variant.tolist(), strict=True):
        for payload in gallery.templates([row]).values():  # none if it was removed since the shards were made
            other = Prepared(unpacked(gallery.path, row, payload), settings.ridge)
            ranks[row] = glance(ready, other, settings.search.variants_of(probe), variant)
    return sorted(ranks, key=lambda row: (-ranks[row], row))[: settings.search.candidates], score


def _by_minutiae(gallery: Gallery, probe: Minutiae, rows: dict[int, Enrolled]) -> list[_Found]:
    """Compare with every row of a gallery of minutiae."""
    found: list[_Found] = []
    if probe.acquired:
        for row, payload in gallery.templates([row for row, one in rows.items() if one.template_bytes > 0]).items():
            other = naming(f"row {row} of '{gallery.path}'", partial(unpack_minutiae, payload))
            found.append((minutiae_match(probe, other), None, rows[row], None, None))
    return sorted(found, key=_order)


def _codes(gallery: Gallery, progress: Progress) -> tuple[dict[int, NDArray[np.int8]], int, int]:
    """Codes of all rows, how many of them had to be made just now, and the number of failures to acquire."""
    codes = {row: np.frombuffer(code, dtype=np.int8) for row, code in gallery.codes(CODE_VERSION).items()}
    rest = gallery.entries_at(gallery.without_code(CODE_VERSION))
    missing = [row for row, one in rest.items() if one.template_bytes > 0]
    for k, (row, payload) in enumerate(gallery.templates(missing).items()):
        progress("coding", 0.5 * k / len(missing))
        codes[row] = code_of(unpacked(gallery.path, row, payload))
    return codes, len(missing), len(rest) - len(missing)


def _order(one: _Found) -> tuple[Any, ...]:
    entry = one[2].entry
    return -one[0], entry.person, entry.finger, session_order(entry.session)


def _merged(found: Sequence[_Found], merge: str) -> list[_Found]:
    """The best of each person or finger, best first."""
    seen, kept = set(), []
    for one in found:
        entry = one[2].entry
        name = {"person": (entry.person,), "finger": (entry.person, entry.finger), "none": (one[2].row,)}[merge]
        if name not in seen:
            seen.add(name)
            kept.append(one)
    return kept


def _rated(one: _Found, by: str, area_mm2: float, fmr: float) -> Rated:
    """By the impostors of what was compared: area and minutiae."""
    similarity, _, row, minutiae, overlap_mm2 = one
    scores = by if by == "minutiae_of_prints" else scores_of(by, (area_mm2, row.entry.area_mm2), minutiae)
    return rate(similarity, scores, overlap_mm2, fmr)


def _candidate(rank: int, one: _Found, searched: int, rated: Rated | None) -> RankedCandidate:
    who, fmr = one[2].entry, None if rated is None else rated.fmr
    expected = None if fmr is None else searched * fmr
    return RankedCandidate(rank, who.person, who.finger, who.session, *one[:2], fmr, expected)
