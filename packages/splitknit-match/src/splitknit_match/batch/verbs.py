"""Verbs on many fingers: ``splitknit batch``, and ``enroll``, of one finger or a whole
population."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from splitknit.arguments import (
    AnyPath,
    Fraction,
    Natural,
    Preset,
    Progress,
    Report,
    ResolutionPpi,
    Ridges,
    checked,
    count,
    refuse_given,
    silent,
)
from splitknit.errors import BadInput, require
from splitknit.findings import Finding, worst_first
from splitknit_match.gallery.verbs import KeyFile

if TYPE_CHECKING:
    from splitknit_match.batch.cases import Case
    from splitknit_match.gallery.gallery import EnrolledCapture


@checked
def batch(
    population: AnyPath,
    *,
    out: AnyPath,
    cases: str | None = None,
    case: Sequence[str] = (),
    matchers: str = "ridge",
    impostors: Fraction = 1.0,
    seed: Natural = 0,
    surfaces: Annotated[bool, Parameter(negative="--no-surfaces")] = True,
    jobs: Natural = 2,
    scheduler: str | None = None,
    progress: Progress = silent,
) -> Report:
    """Reconstruct and compare a population.

    What is there already is skipped.

    Parameters
    ----------
    population
        Folder of 'splitknit simulate population' or an enrolment.
    out
        Folder of the results; may be there.
    cases
        Presets with commas (default: metric,snk,pr,ea).
    case
        A case of your own, NAME=PRESET:STAGE.FIELD=VALUE,...: a preset with settings changed; may
        be repeated.
    matchers
        ridge, thesis, thesis-code, minutiae, with commas; or none.
    impostors
        Fraction of the comparisons of two fingers.
    seed
        Which of them.
    surfaces
        --no-surfaces: keep no surfaces, which only the matcher thesis needs: a tenth of the disk.
    jobs
        Processes at most, if memory allows.
    scheduler
        Dask scheduler tls://HOST:PORT whose workers do it instead.

    Returns
    -------
    Report

    Raises
    ------
    BadInput
        As :func:`splitknit_match.batch.engine.run_batch`.

    Examples
    --------
    >>> batch("population", out="store", cases="metric").facts["captures"]  # doctest: +SKIP
    """
    from splitknit_match.batch.cases import preset_cases
    from splitknit_match.batch.engine import run_batch

    own = tuple(_case(text) for text in case)
    if cases is not None:
        presets = _names(cases, "`cases`", "such as metric,ea")
        own = (*preset_cases(tuple(presets)), *own)
    names = _names(matchers, "`matchers`", "such as ridge, or none")
    facts = run_batch(
        Path(population),
        Path(out),
        cases=own or preset_cases(),
        matchers=[] if names == ["none"] else names,
        impostors=impostors,
        seed=seed,
        surfaces=surfaces,
        jobs=jobs,
        scheduler=scheduler,
        progress=progress,
    )
    return Report(facts, tuple(_batch_lines(facts)))


def _names(text: str, option: str, such: str) -> list[str]:
    names = [name.strip() for name in text.split(",") if name.strip()]
    require(names, f"{option} needs a name at least, {such}, but it is '{text}'.")
    return names


def _case(text: str) -> Case:
    """Read ``NAME=PRESET:STAGE.FIELD=VALUE,...``; commas inside brackets belong to a value."""
    from splitknit.cli.options import parse_assignment
    from splitknit_match.batch.cases import Case

    name, _, rest = text.partition("=")
    preset, _, changes = rest.partition(":")
    require(preset.strip(), f"`case` '{text}' is not of the form NAME=PRESET:STAGE.FIELD=VALUE,...")
    assignments = re.findall(r"(?:\[[^\]]*\]|[^,\[])+", changes)
    parts = [parse_assignment(part) for part in assignments if part.strip()]
    return Case(name.strip(), preset.strip(), dict(parts))


def _batch_lines(facts: Mapping[str, Any]) -> list[str]:
    work = f"{facts['reconstructed']} reconstructions made now, {facts['found']} were there"
    cases = f"{len(facts['cases'])} cases ({', '.join(facts['cases'])})"
    lines = [f"{work}: {facts['captures']} captures in {cases} in {facts['out']}."]
    lines += [f"Please note: {finding['message']}" for finding in facts["findings"]]
    for scores in facts["scores"]:
        each = scores["ms_per_comparison"]
        speed = "" if each is None else f" ({each:.1f} ms each on one core)"
        compared = f"{scores['compared']} comparisons made now"
        lines.append(f"{scores['case']}, {scores['matcher']}: {compared}{speed}.")
    if facts["csv"]:
        lines.append(f"Score files for 'splitknit evaluate --scores': {', '.join(facts['csv'])}.")
    return lines


@checked
def enroll(
    gallery: AnyPath,
    sources: Sequence[AnyPath] = (),
    *,
    key_file: KeyFile = None,
    person: str | None = None,
    finger: str | None = None,
    session: str | None = None,
    population: AnyPath | None = None,
    workers: Natural | None = None,
    replace: bool = False,
    with_time: bool = False,
    duplicates: Literal["refuse", "warn", "allow"] | None = None,
    resolution_ppi: ResolutionPpi = None,
    ridges: Ridges = None,
    mask: AnyPath | None = None,
    box: str | None = None,
    preset: Preset = "metric",
    progress: Progress = silent,
) -> Report:
    """Put fingers into a gallery, which is made where there is none.

    Parameters
    ----------
    gallery
        File of the gallery.
    sources
        Capture folder, result folder, template (.skt), print (PNG, TIFF, JPEG, BMP, WSQ, ISO
        19794-4, ANSI/NIST-ITL) or record of minutiae (ISO 19794-2, ANSI 378), or photograph of a
        finger in colour; several are sessions of one finger.
    person
        Whose finger it is.
    finger
        Which, such as right_index.
    session
        Which session (default: the next number).
    population
        Instead of sources: a whole enrolment, FOLDER/S01/session_1/right_index (or right_index.png)
        and so on; resumable.
    workers
        Processes for a population (default: 1).
    replace
        Let a capture take the place of one of the same names.
    with_time
        Keep the time of enrolment as well.
    duplicates
        What to do about a finger that matches another person's: refuse it, report it (warn, the
        default), or not look (allow).
    mask
        The finger of a photograph: an image of its size, white on the finger.
    box
        The part X,Y,W,H of a photograph in which the finger lies, pixels from its upper left.
    preset
        How captures are reconstructed.

    Returns
    -------
    Report

    Raises
    ------
    BadInput
        Naming what is at fault; the gallery is then as before, but for captures of a population
        that are done.

    Examples
    --------
    >>> added = enroll(  # doctest: +SKIP
    ...     "people.skg", ["print.png"], person="Ann", finger="right_index"
    ... )
    >>> added.facts["people"]  # doctest: +SKIP
    1
    """
    from splitknit.io.provenance import known_json
    from splitknit_match.batch.enrol import enroll_population
    from splitknit_match.gallery.file import key_of, readable_gallery
    from splitknit_match.gallery.gallery import Enrolling
    from splitknit_match.gallery.gallery import enroll as enroll_finger
    from splitknit_match.prints.photo_finger import PhotoFinger

    how = Enrolling(preset, replace, with_time, resolution_ppi, ridges, PhotoFinger(mask, box))
    key = key_of(key_file)
    if population is None:
        require(workers is None, "`workers` is for `population`.")
        require(
            len(sources) == 1 or not how.where.chosen,
            "`mask` and `box` are for one photograph; name one source.",
        )
        if person is None or finger is None:
            raise BadInput(
                "name whose finger it is: `person` NAME `finger` right_index (or `population`"
                " FOLDER)."
            )
        enrolment = enroll_finger(
            gallery,
            list(sources),
            person,
            finger,
            session=session,
            key=key,
            how=how,
            duplicates=duplicates or "warn",
            progress=progress,
        )
        facts = dict(known_json(enrolment.content))
        facts |= {"enrolled": known_json(enrolment.enrolled), "alike": known_json(enrolment.alike)}
        lines = [
            _enrolled_line(capture)
            for capture in enrolment.enrolled
            if capture.acquired or not capture.new  # else a finding states it
        ]
        findings: Sequence[Finding] = enrolment.findings
    else:
        why = "does not go with `population`, whose folders have names."
        refuse_given(why, person=person, finger=finger, session=session, mask=mask, box=box)
        refuse_given(
            "goes with sources; people of a `population` are not compared.", duplicates=duplicates
        )
        require(not sources, "name sources or a `population`, not both.")
        facts = enroll_population(
            Path(gallery),
            Path(population),
            how,
            key=key,
            workers=1 if workers is None else workers,
            progress=progress,
        )
        new = count(facts["new"], "capture")
        lines = [f"{new} enrolled, {facts['known']} of {facts['found']} were there already."]
        findings = []
        if failed := facts["failures_to_acquire"]:
            first = f"first: {failed[0]['path']}: {failed[0]['reason'].rstrip('.')}"
            words = f"{count(len(failed), 'failure')} to acquire, kept as such ({first})."
            files = tuple(failure["path"] for failure in failed)
            findings = [Finding("failure-to-acquire", words, files=files)]
    locked = ", encrypted" if facts["encrypted"] else ""
    people = count(facts["people"], "person", "people")
    holds = (
        f"{count(facts['captures'], 'capture')} of {count(facts['fingers'], 'finger')} of {people}"
    )
    findings = worst_first([*findings, *readable_gallery(gallery, key_file)])
    lines += [f"Please note: {finding}" for finding in findings]
    lines.append(f"{facts['gallery']} holds {holds}{locked}.")
    facts["findings"] = [finding.facts for finding in findings]
    return Report(facts, tuple(lines))


def _enrolled_line(capture: EnrolledCapture) -> str:
    from splitknit_match.gallery.file import in_words

    who = in_words(capture.person, capture.finger, capture.session)
    if not capture.new:
        return f"{who} was enrolled from the same source already."
    holds = f"{capture.area_mm2:.0f} mm² of skin" if capture.area_mm2 else "minutiae"
    return f"Enrolled {who}: {holds}, {capture.template_bytes / 1000:.1f} kB."
