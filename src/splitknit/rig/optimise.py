"""Sweep many rigs on the twin, in parallel, take up again what was interrupted, and compare what they measured."""

from __future__ import annotations

import functools
import json
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from splitknit.batch.workers import run_jobs
from splitknit.errors import BadInput, require
from splitknit.evaluation.accuracy import compare
from splitknit.io.atomic import write_file
from splitknit.io.csv_table import csv_text
from splitknit.io.fields import read_json
from splitknit.io.provenance import canonical_json, plain_json, provenance, settings_hash
from splitknit.model import Camera, Progress, no_progress
from splitknit.pipeline import reconstruct
from splitknit.rig.candidates import (
    FIELD_MM,
    FULL_WELL_E,
    READ_NOISE_E,
    Array,
    BuildSettings,
    Finding,
    PhotonSettings,
    PrintPoints,
    RigCandidate,
    candidate_rig,
    examine,
    led_intensities,
    planned_exposure,
)
from splitknit.settings import Checked, Limits, differing
from splitknit.simulator.camera.sensor import SensorSettings
from splitknit.simulator.finger.finger import PoseRanges, draw_finger, finger_surface
from splitknit.simulator.light.renderer import RenderSettings
from splitknit.simulator.scene import TwinSettings
from splitknit.simulator.twin import simulate_capture

FIRST_SEED = 400
"""Of the fingers."""
MAX_SLANT_DEG = 60.0
"""The print is where the shape is flatter than this (``docs/explain/conventions.md``)."""
DONE, REFUSED, FAILED = "done", "refused", "failed"
OBJECTIVES = {"rms": "surface_rms_mm", "ridges": "ridge_rms_um", "normals": "normals_mean_deg"}
"""Names on the command line, and of the figures of :func:`splitknit.compare`; all are minimised."""
_POSE = PoseRanges(height_mm=(0.0, 0.0), insertion_mm=(25.0, 27.0))
_STUDY_FILE = "sweep.json"
_OWN_FILES = re.compile(r"(sweep|results)\.json|results\.csv|candidates/[\w.+-]+\.json")
_STRAY = re.compile(r"(.*/)?(\.splitknit-[^/]*\.tmp/.*|\.DS_Store|Thumbs\.db|desktop\.ini)")
"""What a killed run or a file manager leaves behind."""


@dataclass(frozen=True, slots=True)
class Study(Checked):
    """Everything that a candidate's figures follow from, besides the candidate."""

    method: Literal["ea", "metric"] = "ea"
    """Preset that reconstructs; of ``ea``, with its ridges apart (``ea-split``)."""
    fingers: Annotated[int, Limits(1, 200)] = 3
    """Number of fingers; all candidates photograph the same ones."""
    build: BuildSettings = field(default_factory=BuildSettings)
    photons: PhotonSettings = field(default_factory=PhotonSettings)

    @property
    def seeds(self) -> tuple[int, ...]:
        """Of the fingers."""
        return tuple(range(FIRST_SEED, FIRST_SEED + self.fingers))

    @property
    def bands(self) -> tuple[str, ...]:
        """Bands that the method looks at."""
        return ("white", "nir") if self.method == "metric" else ("white",)

    def findings(self, candidate: RigCandidate) -> tuple[Finding, ...]:
        """What the constraints make of a candidate."""
        return examine(candidate, self.build, self.photons, finger=_typical_print(), bands=self.bands)

    def measure(self, candidate: RigCandidate, seed: int) -> dict[str, float]:
        """Photograph a finger with a candidate that keeps the constraints, reconstruct it, and compare with its truth.
        A weak LED is exposed for longer, then with a higher gain, which leaves fewer electrons at full scale; of two
        bands the weaker one decides.
        """
        rig = candidate_rig(candidate, self.build, led_intensities(candidate, self.build, self.bands))
        plans = {band: planned_exposure(rig.leds, band, self.photons) for band in self.bands}
        weakest = max((plan for plan in plans.values() if plan), key=lambda plan: (plan.gain, -plan.level))
        sensor = SensorSettings(
            exposure=min(weakest.level, 1.0), full_well_e=FULL_WELL_E / weakest.gain, read_noise_e=READ_NOISE_E, bits=16
        )
        aperture_mm = self.photons.focal_mm(candidate.height_mm) / self.photons.f_number
        render = RenderSettings(aperture_mm=aperture_mm, workers=1)
        settings = TwinSettings(rig=rig, pose=_POSE, sensor=sensor, render=render)
        capture, truth = simulate_capture(seed, settings=settings)
        result = reconstruct(capture, {"ea": "ea-split"}.get(self.method, self.method))
        figures = dict(compare(result, truth).figures)
        for band, plan in plans.items():
            figures |= {f"{what}_{band}": value for what, value in asdict(plan).items()} if plan else {}
        return figures


@functools.lru_cache(maxsize=1)
def _typical_print() -> PrintPoints:
    """Print of a finger, as points and normals of its shape half a millimetre apart."""
    camera = Camera(px_per_mm=2.0, image_size=(round(2 * FIELD_MM[0]), round(2 * FIELD_MM[1])))
    pose = _POSE.draw(np.random.default_rng(FIRST_SEED), camera)
    surface = finger_surface(draw_finger(FIRST_SEED), pose, camera, workers=1)
    rows, columns = np.nonzero(surface.mask & (surface.shape_normals[..., 2] > np.cos(np.deg2rad(MAX_SLANT_DEG))))
    (height, width), pitch = camera.image_size, camera.pitch_mm
    x, y = (columns - (width - 1) / 2) * pitch, ((height - 1) / 2 - rows) * pitch
    points = np.stack([x, y, surface.shape_mm[rows, columns]], axis=-1)
    return PrintPoints(points.astype(np.float64), surface.shape_normals[rows, columns].astype(np.float64))


def evaluate_candidate(candidate: RigCandidate, study: Study) -> dict[str, Any]:
    """Judge and measure one candidate; never raises for what it is: a broken one is a result too.

    Returns ``candidate``, ``status`` (``done``; ``refused`` by a constraint; ``failed`` where a finger could not be
    photographed or reconstructed), ``reason`` (one sentence, or None), ``constraints``, ``fingers`` (figures by finger)
    and ``mean`` (of the figures over the fingers, None unless done).
    """
    record: dict[str, Any] = {"candidate": {**asdict(candidate), "name": candidate.name}, "constraints": []}
    nothing: dict[str, Any] = {"fingers": [], "mean": None}
    try:
        findings = study.findings(candidate)
        record["constraints"] = [asdict(finding) for finding in findings]
        if broken := _broken(findings):
            return {**record, "status": REFUSED, "reason": broken[0], **nothing}
        fingers = [{"seed": seed, **study.measure(candidate, seed)} for seed in study.seeds]
    except MemoryError:
        raise  # of the machine, not of the candidate
    except Exception as error:
        words = " ".join(str(error).split()) or "no further words"
        reason = words if isinstance(error, BadInput) else f"{type(error).__name__}: {words}"
        return {**record, "status": FAILED, "reason": reason, **nothing}
    mean = {name: float(np.mean([one[name] for one in fingers])) for name in fingers[0] if name != "seed"}
    return {**record, "status": DONE, "reason": None, "fingers": fingers, "mean": mean}


def _broken(findings: Sequence[Finding]) -> list[str]:
    return [finding.words for finding in findings if finding.hard and not finding.ok]


def sweep_rigs(
    out: Path, candidates: Sequence[RigCandidate], study: Study, *, workers: int = 1, progress: Progress = no_progress
) -> list[dict[str, Any]]:
    """Evaluate all candidates, keep each as soon as it is finished, and return their records in order. `out` holds
    nothing, or an earlier sweep of the same study, whose failed candidates are tried again. Raises BadInput if there
    are no candidates, none can be built, or the folder holds something else.
    """
    require(len(candidates) > 0, "there are no candidates to compare.")
    require(1 <= workers <= 256, f"the number of workers must lie between 1 and 256, but it is {workers}.")
    if all(_broken(study.findings(candidate)) for candidate in candidates):
        reason = _broken(study.findings(candidates[0]))[0]
        number, name = len(candidates), candidates[0].name
        raise BadInput(f"not one of the {number} rigs can be built; of the first, {name}: {reason}")
    folder = _SweepFolder(out, study)
    records: dict[str, dict[str, Any]] = {}
    for candidate in candidates:
        known = folder.read(candidate)
        if known is not None and known["status"] != FAILED:
            records[candidate.name] = known
    waiting = [candidate for candidate in candidates if candidate.name not in records]
    total = len(candidates)
    progress("resuming" if records else "starting", len(records) / total)
    work = functools.partial(evaluate_candidate, study=study)
    for candidate, record in run_jobs(work, waiting, workers, f"what is finished in '{out}'"):
        folder.write(candidate, record)
        records[candidate.name] = folder.read(candidate) or record  # as it is read from a file, in any case
        progress(candidate.name, len(records) / total)
    return [records[candidate.name] for candidate in candidates]


class _SweepFolder:
    """A folder of finished candidates of one study, one file each, whole or not there."""

    def __init__(self, out: Path, study: Study) -> None:
        """Make the folder, or see that it holds a sweep of this very study."""
        self.out = out
        facts = {"format": "splitknit-rig-sweep", "version": 1, "software": provenance()["version"], "study": study}
        document = json.loads(canonical_json(facts))
        self.hash = settings_hash(document)
        require(not out.exists() or out.is_dir(), f"'{out}' is a file; name a folder to write into.")
        found = (path for path in out.rglob("*") if path.is_symlink() or not path.is_dir())
        names = sorted(path.relative_to(out).as_posix() for path in found)
        names = [name for name in names if not _STRAY.fullmatch(name)]
        if not names:
            self._write(out / _STUDY_FILE, document)
            return
        foreign = [name for name in names if not _OWN_FILES.fullmatch(name)]
        require(
            not foreign and _STUDY_FILE in names,
            f"'{out}' holds '{(foreign or names)[0]}' and no sweep to go on with; name another folder.",
        )
        before, _ = read_json(out / _STUDY_FILE, f"'{out / _STUDY_FILE}' is damaged; name another folder.")
        changed = [name.removeprefix("study.") or "format" for name in differing(before, document)]
        require(
            not changed,
            f"the sweep in '{out}' was made with other settings ({', '.join(changed)}); give the same ones, or name "
            "another folder.",
        )

    def read(self, candidate: RigCandidate) -> dict[str, Any] | None:
        """The candidate's record, or None where it is not finished (or its file is damaged)."""
        try:
            stored, _ = read_json(self._file(candidate))
            record: dict[str, Any] = stored["record"]
            its_own = stored["study_sha256"] == self.hash and record["candidate"]["name"] == candidate.name
            return record if its_own else None
        except (ValueError, KeyError, TypeError):
            return None

    def write(self, candidate: RigCandidate, record: Mapping[str, Any]) -> None:
        """Keep a finished candidate."""
        self._write(self._file(candidate), {"study_sha256": self.hash, "record": plain_json(record)})

    def _file(self, candidate: RigCandidate) -> Path:
        return self.out / "candidates" / f"{candidate.name}.json"

    def _write(self, path: Path, document: Any) -> None:
        write_file(path, (json.dumps(document, indent=1, sort_keys=True, allow_nan=False) + "\n").encode())


# What a sweep found: the best rig, those as good, and the Pareto front.


def summarise(records: Sequence[dict[str, Any]], figure: str) -> dict[str, Any]:
    """Compare the rigs of a sweep by one of the records' figures, which is minimised, as ``surface_rms_mm``.

    Returns ``counts`` (by status), ``figure``, ``best``, ``as_good`` (names), ``pareto`` (names; over the figure, the
    LEDs' power and the size of the box), ``compared`` (by name), ``reasons`` (of refused and failed ones, with their
    number). Raises BadInput, with the reason, if not one candidate was done.
    """
    done = [one for one in records if one["status"] == DONE]
    reasons = Counter(one["reason"] for one in records if one["reason"] is not None)
    if not done:
        often = reasons.most_common(1)[0][0]
        raise BadInput(f"not one of the {len(records)} rigs can be built and measured; most often: {often}")
    compared = _compare_with_best(done, figure)
    names = [one["candidate"]["name"] for one in done]
    rigs = [RigCandidate(**{k: v for k, v in one["candidate"].items() if k != "name"}) for one in done]
    costs = [[one["mean"][figure], rig.power_w, rig.volume_l] for one, rig in zip(done, rigs, strict=True)]
    front = _pareto_front(np.array(costs, dtype=np.float64))
    return {
        "counts": {status: sum(one["status"] == status for one in records) for status in (DONE, REFUSED, FAILED)},
        "figure": figure,
        "best": next(name for name, row in compared.items() if row["best"]),
        "as_good": [name for name in names if compared[name]["as_good"]],
        "pareto": [name for name, is_on in zip(names, front, strict=True) if is_on],
        "compared": compared,
        "reasons": dict(sorted(reasons.items(), key=lambda item: (-item[1], item[0]))),
    }


def results_csv(
    records: Sequence[dict[str, Any]], compared: Mapping[str, Mapping[str, Any]], pareto: Sequence[str]
) -> bytes:
    """All candidates as CSV, one line each; `compared` and `pareto` are of :func:`summarise`."""
    rows: list[dict[str, Any]] = []
    for one in records:
        name, tilt = one["candidate"]["name"], one["candidate"]["tilt_deg"]
        row = {**one["candidate"], "tilt_deg": "centre" if tilt is None else tilt, "status": one["status"]}
        row |= {"reason": one["reason"], **(one["mean"] or {}), **compared.get(name, {}), "pareto": name in pareto}
        rows.append({key: float(f"{cell:.6g}") if isinstance(cell, float) else cell for key, cell in row.items()})
    names = list(dict.fromkeys(name for row in rows for name in row))
    return csv_text([names, *([row.get(name, "") for name in names] for row in rows)]).encode()


def _pareto_front(costs: Array) -> NDArray[np.bool_]:
    """(N,) true where no other row of (N, K) `costs` is at most as large everywhere and smaller somewhere."""
    require(bool(np.isfinite(costs).all()), "costs must be finite.")
    return np.array([not ((costs <= row).all(axis=1) & (costs < row).any(axis=1)).any() for row in costs])


def _mean_interval(values: Sequence[float] | Array, fraction: float = 0.95) -> tuple[float, float, float]:
    """Mean of `values` and Student's interval about it; one value alone has no interval: (value, -inf, inf)."""
    numbers = np.asarray(values, dtype=np.float64)
    mean = float(numbers.mean())
    if numbers.size == 1:
        return mean, -np.inf, np.inf
    half = float(stats.t.ppf(0.5 + 0.5 * fraction, numbers.size - 1) * numbers.std(ddof=1) / np.sqrt(numbers.size))
    return mean, mean - half, mean + half


def _compare_with_best(records: Sequence[dict[str, Any]], figure: str) -> dict[str, dict[str, Any]]:
    """How much worse than the best every candidate is, finger by finger.

    Returns by name of the candidate: ``value`` and ``low``, ``high`` (95 % interval of the mean over the fingers; None
    for one finger), ``worse_by`` and ``worse_low``, ``worse_high`` (the same of the paired difference from the best),
    and ``as_good``: the interval of the difference holds zero.
    """
    values = {one["candidate"]["name"]: np.array([f[figure] for f in one["fingers"]]) for one in records}
    best = min(values, key=lambda name: (float(values[name].mean()), name))
    compared: dict[str, dict[str, Any]] = {}
    for name, own in values.items():
        ends = zip(
            ("value", "low", "high", "worse_by", "worse_low", "worse_high"),
            (*_mean_interval(own), *_mean_interval(own - values[best])),
            strict=True,
        )
        row: dict[str, Any] = {end: value if np.isfinite(value) else None for end, value in ends}
        compared[name] = {**row, "as_good": row["worse_low"] is None or row["worse_low"] <= 0.0, "best": name == best}
    return compared
