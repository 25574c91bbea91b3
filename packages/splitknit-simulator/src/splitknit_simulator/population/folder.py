"""What ``splitknit simulate population`` does: a population in a folder, resumable, by several
workers.

The folder is laid out as an enrolment by the devices: ``enrolment.json`` (the plan),
``population.json`` (settings and their hash) and ``S01/session_1/right_index/``, a capture folder
with truth and ``impression.json`` each. Capture folders appear whole or not at all; what is
finished is read off them.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from splitknit import write_capture
from splitknit.errors import naming, refusing, require
from splitknit.io.atomic import atomic_folder, hold, sweep, write_file
from splitknit.io.csv_table import csv_text
from splitknit.io.enrolment import (
    PLAN_FILE,
    Enrolment,
    PlannedCapture,
    open_enrolment,
    plan_enrolment,
)
from splitknit.io.fields import converted, read_json
from splitknit.io.provenance import file_hash, json_text, plain_json, provenance, settings_hash
from splitknit.io.targets import check_file
from splitknit.model import Progress, no_progress
from splitknit.settings import differing
from splitknit.workers import run_jobs
from splitknit_simulator.finger.finger import SimulatedFinger
from splitknit_simulator.finger.master_print import MasterPrint
from splitknit_simulator.population.sessions import (
    DRAWS_VERSION,
    PopulationSettings,
    population_capture,
)
from splitknit_simulator.twin import master_of_print_file

POPULATION_FILE = "population.json"
IMPRESSION_FILE = "impression.json"
TABLE_FILE = "population.csv"
_FORMAT = "splitknit-population"
_VERSION = 1
"""Version of the format of a population's folder. Source: definition."""

_Job = tuple[PlannedCapture, ...]
"""The waiting captures of one finger: its print is drawn once for all of them."""


def simulate_population(
    out: Path,
    settings: PopulationSettings,
    *,
    subjects: int | None = None,
    sessions: int | None = None,
    fingers: Sequence[str] | None = None,
    prints: Path | None = None,
    workers: int = 2,
    progress: Progress = no_progress,
) -> dict[str, Any]:
    """Simulate what is not there yet; return the facts. Raises BadInput if the folder holds
    something else or a population with other settings, another run writes it, the plan would
    shrink, or `prints` holds no usable prints or not those that the population began with.

    subjects, sessions, fingers : how many and which; None as planned earlier, else as in the thesis
    (17, 4, all ten)
    prints : folder of real prints, of whose ridges :func:`choose_prints` gives a third of the
    fingers; fingers that are
        planned later have none
    """
    started = time.perf_counter()
    require(1 <= workers <= 256, f"workers must be 1 to 256, but it is {workers}.")
    check_file(
        out / TABLE_FILE, "the table of a population", lambda data: data.startswith(b"folder,")
    )
    earlier = _earlier(out)
    plan = plan_enrolment(out, subjects=subjects, sessions=sessions, fingers=fingers).plan
    real = RealPrints()
    if prints is not None:
        # prints of the population's fingers, as it was begun
        dealt: dict[str, RealPrint] | None = None
        if earlier is not None:
            file = out / POPULATION_FILE
            dealt = converted(earlier.get("prints", {}), dict[str, RealPrint], f"{file}: prints")
            plain = all(Path(print_.file).name == print_.file for print_ in dealt.values())
            require(plain, _DAMAGED.format(file))
        real = choose_prints(prints, settings.seed, plan.subject_ids(), plan.fingers, dealt)
    document = {
        "format": _FORMAT,
        "format_version": _VERSION,
        "draws": DRAWS_VERSION,
        **provenance(settings),
        **({"prints": plain_json(real.of_finger)} if real.of_finger else {}),
        "settings_sha256": _population_hash(settings, real),
    }
    if earlier is not None:
        _check_settings(out, earlier, document)
    enrolment = open_enrolment(out, subjects=subjects, sessions=sessions, fingers=fingers)
    if not (out / POPULATION_FILE).is_file():
        write_file(out / POPULATION_FILE, json_text(document).encode("ascii"))
    with (out / POPULATION_FILE).open("rb") as stream:
        hold(stream, f"another run is simulating into '{out}'; wait for it, or stop it.")
        sweep(out)
        waiting = enrolment.waiting()
        before = enrolment.plan.total - len(waiting)
        progress("simulating", 0.0)
        work, done = partial(_simulate_job, settings=settings, real=real, folder=out), 0
        for job, captures in run_jobs(
            work, _jobs_of(waiting), workers, f"what is finished in '{out}'"
        ):
            done += captures
            progress(f"{job[0].subject} {job[0].finger}", done / max(len(waiting), 1))
        _write_table(enrolment)
    seconds = time.perf_counter() - started
    return {
        "out": str(out),
        "seed": settings.seed,
        "scale": settings.scale,
        "subjects": enrolment.plan.subjects,
        "sessions": enrolment.plan.sessions,
        "fingers": list(enrolment.plan.fingers),
        "prints": len(real.of_finger),
        "workers": workers,
        "simulated": len(waiting),
        "found": before,
        "total": enrolment.plan.total,
        "settings_sha256": document["settings_sha256"],
        "table": str(out / TABLE_FILE),
        "total_s": seconds,
        "seconds_per_capture": seconds / len(waiting) if waiting else None,
    }


def _population_hash(settings: PopulationSettings, real: RealPrints | None = None) -> str:
    """SHA-256 of everything that the captures follow from; the number of threads is not."""
    render = replace(settings.render, workers=1)
    prints = {"prints": real.of_finger} if real is not None and real.of_finger else {}
    return settings_hash(
        {"draws": DRAWS_VERSION, "settings": replace(settings, render=render)} | prints
    )


def _simulate_job(job: _Job, settings: PopulationSettings, real: RealPrints, folder: Path) -> int:
    """Simulate the captures of one finger into the enrolment `folder`; return how many."""
    place = job[0]
    person = settings.person(int(place.subject.removeprefix("S")))
    finger = person.fingers[place.finger].finger
    master, printed = real.master(f"{place.subject}/{place.finger}", finger)
    for place in job:
        target = folder / place.folder
        simulated = population_capture(settings, person, place.finger, place.session, master=master)
        with atomic_folder(target, overwrite=False) as written:
            write_capture(simulated.capture, written, simulated.truth, overwrite=True)
            text = json_text(simulated.facts | {"print": printed})
            (written / IMPRESSION_FILE).write_text(text, encoding="ascii")
    return len(job)


def _jobs_of(waiting: Sequence[PlannedCapture]) -> list[_Job]:
    """The waiting captures by finger, subject by subject."""
    by_finger: dict[tuple[str, str], list[PlannedCapture]] = {}
    for place in sorted(waiting, key=lambda place: int(place.subject.removeprefix("S"))):
        by_finger.setdefault((place.subject, place.finger), []).append(place)
    return [tuple(places) for places in by_finger.values()]


def _earlier(out: Path) -> dict[str, Any] | None:
    """What the population in `out` was begun with; None if none was. Raises BadInput where it holds
    something else."""
    file = out / POPULATION_FILE
    if not file.is_file():
        taken = out.is_dir() and any(out.glob("S*/session_*/*"))
        require(
            not taken or not (out / PLAN_FILE).is_file(),
            f"'{out}' holds captures of something else than a simulated population; name another"
            " folder.",
        )
        return None
    damaged = _DAMAGED.format(file)
    document, _ = read_json(file, damaged)
    with refusing(damaged):
        known = document["format"] == _FORMAT and document["format_version"] == _VERSION
    require(known, f"'{file}' is of another version.")
    return dict(document)


_DAMAGED = "'{}' cannot be read: it is damaged; name another folder for the population."


def _check_settings(out: Path, earlier: dict[str, Any], document: dict[str, Any]) -> None:
    with refusing(_DAMAGED.format(out / POPULATION_FILE)):
        same = earlier["settings_sha256"] == document["settings_sha256"]
        names = differing(earlier["settings"], document["settings"])
        names += [] if earlier.get("prints") == document.get("prints") else ["prints"]
    where = f" ({', '.join(names[:4])})" if names else ""
    require(
        same,
        f"the population in '{out}' was simulated with other settings{where}; use the same, or name"
        " another folder.",
    )


def _write_table(enrolment: Enrolment) -> None:
    """One line for each finished capture: its folder and the facts of its ``impression.json``."""
    rows: list[dict[str, Any]] = []
    for place in enrolment.places():
        file = enrolment.path(place) / IMPRESSION_FILE
        if file.is_file():
            damaged = f"'{file}' is damaged; remove its folder and run the same again."
            facts, _ = read_json(file, damaged)
            require(isinstance(facts, dict), damaged)
            rows.append({"folder": place.folder} | facts)
    names = list(rows[0]) if rows else []
    text = csv_text(
        [names, *([row.get(name, "") for name in names] for row in rows)] if rows else []
    )
    write_file(enrolment.folder / TABLE_FILE, text.encode("utf-8"))


# Ridges of real prints for a third of a population's fingers.


_SUFFIXES = (".png", ".tif", ".tiff", ".jpg", ".jpeg")


@dataclass(frozen=True, slots=True)
class RealPrint:
    """The print whose ridges a finger has."""

    file: str  # its name in the folder of prints
    sha256: str  # hash of the file
    mirrored: bool = False  # whether the finger is the one that would leave the mirror image


@dataclass(frozen=True, slots=True)
class RealPrints:
    """A folder of prints, and which finger has which."""

    folder: Path = Path()
    of_finger: Mapping[str, RealPrint] = field(default_factory=dict)
    """By the finger's name in the world, such as ``S01/right_index``."""

    def master(self, name: str, finger: SimulatedFinger) -> tuple[MasterPrint, str]:
        """A finger's master print, and the real print that it is from, '' where it is drawn;
        BadInput if it changed."""
        if name not in self.of_finger:
            return finger.master(), ""
        real_print = self.of_finger[name]
        self.check(real_print)
        path = self.folder / real_print.file
        laid = partial(
            master_of_print_file,
            path,
            finger.seed,
            finger.print_settings,
            mirrored=real_print.mirrored,
        )
        return naming(path, laid), f"{real_print.file}{', mirrored' * real_print.mirrored}"

    def check(self, real_print: RealPrint) -> None:
        """Refuse a file that is not what it was when the population was begun."""
        path = self.folder / real_print.file
        require(
            path.is_file() and file_hash(path) == real_print.sha256,
            f"'{path}' is not the print that the population was begun with; name the folder that"
            " holds it.",
        )


def choose_prints(
    folder: Path,
    seed: int,
    subjects: Sequence[str],
    fingers: Sequence[str],
    dealt: Mapping[str, RealPrint] | None = None,
) -> RealPrints:
    """Deal real prints out to a third of a population's fingers, as evenly over people as their
    number allows.

    Files of `folder` (PNG, TIFF or JPEG of 500 pixels an inch, tip up, ridges dark) are named
    ``FINGER_IMPRESSION.png``: what stands before the last underscore is one real finger, and it
    becomes one finger of the population, in all sessions, by the first of its impressions in the
    order of names. Where there are fewer real fingers than a third, their mirror images are others
    (no matcher mirrors); where these are too few as well, fewer fingers than a third have a real
    print's ridges.

    `dealt`: what was dealt out when the population was begun; then that is kept, and the files are
    compared. Raises BadInput if the folder holds no prints, one of those chosen shows no ridges, or
    one is not what it was.
    """
    if dealt is not None:
        require(
            len(dealt) > 0,
            "the population was begun without real prints; leave them out, or name another folder.",
        )
        kept = RealPrints(folder, dealt)
        for real_print in dealt.values():
            kept.check(real_print)
        return kept
    firsts = _first_impressions(folder)
    # a third of the fingers have the ridges of a real print, where there are enough
    wanted = max(1, round((1 / 3) * len(subjects) * len(fingers)))
    rng = np.random.default_rng([seed, 0xB0D4])
    identities = [
        (firsts[k], mirrored) for mirrored in (False, True) for k in rng.permutation(len(firsts))
    ][:wanted]
    for path, mirrored in identities:
        naming(path, partial(master_of_print_file, path, mirrored=mirrored))
    own = {subject: rng.permutation(len(fingers)) for subject in subjects}
    places = [
        f"{subjects[k]}/{fingers[own[subjects[k]][turn]]}"
        for turn in range(len(fingers))
        for k in rng.permutation(len(subjects))
    ]
    chosen = (RealPrint(path.name, file_hash(path), mirrored) for path, mirrored in identities)
    return RealPrints(folder, dict(zip(places, chosen, strict=False)))


def _first_impressions(folder: Path) -> list[Path]:
    """One file of each real finger, by name."""
    require(folder.is_dir(), f"'{folder}' is not a folder of prints.")
    files = sorted(
        path for path in folder.iterdir() if path.suffix.lower() in _SUFFIXES and path.is_file()
    )
    require(len(files) > 0, f"'{folder}' holds no prints (PNG, TIFF or JPEG).")
    firsts: dict[str, Path] = {}
    for path in files:
        firsts.setdefault(path.stem.rpartition("_")[0] or path.stem, path)
    return list(firsts.values())
