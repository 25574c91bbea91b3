"""Sweep many rigs on the twin, in parallel, and take up again what was interrupted."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from splitknit.batch.workers import run_jobs
from splitknit.errors import BadInput, require
from splitknit.io.atomic import write_file
from splitknit.io.fields import read_json
from splitknit.io.provenance import canonical_json, plain_json, provenance, settings_hash
from splitknit.model import Progress, no_progress
from splitknit.rig.candidates import RigCandidate, Study
from splitknit.rig.evaluate_rig import DONE, FAILED, REFUSED, evaluate_candidate, judge
from splitknit.settings import differing

THESIS = {"height_mm": 140.0, "radius_mm": 52.5, "power_w": 1.0}
"""What the thesis's sweep chose (4.1.1)."""
"""Called with what is being done and the fraction of the whole that is done."""


def sweep_rigs(
    out: Path, candidates: Sequence[RigCandidate], study: Study, *, workers: int = 1, progress: Progress = no_progress
) -> list[dict[str, Any]]:
    """Evaluate all candidates and keep each as soon as it is finished.

    Parameters
    ----------
    out : folder; holds nothing, or an earlier sweep of the same study, whose finished candidates are not done again
    candidates : rigs to compare
    study : what they are evaluated with
    workers : processes; the result does not depend on it
    progress : called with the candidate and the fraction done

    Returns
    -------
    Records of :func:`splitknit.rig.evaluate_rig.evaluate_candidate`, in the order of `candidates`. A failed candidate
    is tried again when the sweep is resumed; done and refused ones are not.

    Raises
    ------
    BadInput
        If there are no candidates, or the folder holds something else.
    """
    require(len(candidates) > 0, "there are no candidates to compare.")
    require(1 <= workers <= 256, f"the number of workers must lie between 1 and 256, but it is {workers}.")
    _check_possible(candidates, study)
    folder = _SweepFolder(out, study)
    records: dict[str, dict[str, Any]] = {}
    for candidate in candidates:
        known = folder.read(candidate)
        if known is not None and known["status"] != FAILED:
            records[candidate.name] = known
    waiting = [candidate for candidate in candidates if candidate.name not in records]
    total = len(candidates)
    progress("resuming" if records else "starting", len(records) / total)
    done = run_jobs(partial(evaluate_candidate, study=study), waiting, workers, f"what is finished in '{out}'")
    for candidate, record in done:
        folder.write(candidate, record)
        records[candidate.name] = folder.read(candidate) or record  # as it is read from a file, in any case
        progress(candidate.name, len(records) / total)
    return [records[candidate.name] for candidate in candidates]


def summarise(records: Sequence[dict[str, Any]], study: Study, objective: str = "hausdorff") -> dict[str, Any]:
    """What a sweep found: the best rig, those as good, the Pareto front, and where the thesis's choice stands.

    Parameters
    ----------
    records : of :func:`sweep_rigs`
    study : of the sweep
    objective : ``hausdorff``, ``hausdorff95``, ``rms``, ``whole`` or ``normals``: what is minimised

    Returns
    -------
    dict with ``counts`` (by status), ``objective``, ``best``, ``as_good`` (names), ``pareto`` (names; over the
    objective, the LEDs' power and the size of the box), ``compared`` (by name), ``thesis`` (its row, or None where the
    sweep does not hold it), ``reasons`` (of refused and failed ones, with their number)

    Raises
    ------
    BadInput
        If not one candidate was done; the message gives the reason.
    """
    require(objective in OBJECTIVES, f"the objective must be one of {', '.join(OBJECTIVES)}, not '{objective}'.")
    done = [one for one in records if one["status"] == DONE]
    reasons: dict[str, int] = {}
    for one in records:
        if one["reason"] is not None:
            reasons[one["reason"]] = reasons.get(one["reason"], 0) + 1
    if not done:
        first = max(reasons, key=lambda words: reasons[words])
        require(False, f"not one of the {len(records)} rigs can be built and measured; most often: {first}")
    figure = OBJECTIVES[objective]
    compared = _compare_with_best(done, figure)
    costs = [[one["mean"][figure], one["candidate"]["power_w"], RigCandidate(**_fields(one)).volume_l] for one in done]
    front = _pareto_front(np.array(costs, dtype=np.float64))
    names = [one["candidate"]["name"] for one in done]
    best = next(name for name, row in compared.items() if row["best"])
    return {
        "counts": {status: sum(one["status"] == status for one in records) for status in (DONE, REFUSED, FAILED)},
        "objective": objective,
        "figure": figure,
        "fingers": study.fingers,
        "best": best,
        "as_good": [name for name in names if compared[name]["as_good"]],
        "pareto": [name for name, is_on in zip(names, front, strict=True) if is_on],
        "compared": compared,
        "thesis": _thesis(done, compared),
        "reasons": dict(sorted(reasons.items(), key=lambda item: (-item[1], item[0]))),
    }


def _check_possible(candidates: Sequence[RigCandidate], study: Study) -> None:
    """Refuse, before anything is written, a sweep of which no rig keeps the constraints."""
    reason = ""
    for candidate in candidates:
        try:
            broken = [finding.words for finding in judge(candidate, study) if finding.hard and not finding.ok]
        except BadInput as error:
            broken = [str(error)]
        if not broken:
            return
        reason = reason or broken[0]
    require(False, f"not one of the {len(candidates)} rigs can be built; of the first, {candidates[0].name}: {reason}")


def _thesis(done: Sequence[dict[str, Any]], compared: dict[str, dict[str, Any]]) -> dict[str, Any] | None:
    """The row of the thesis's rig: among several tilts and resolutions, its best."""
    its = [one for one in done if all(one["candidate"][name] == value for name, value in THESIS.items())]
    if not its:
        return None
    name = min((one["candidate"]["name"] for one in its), key=lambda one: compared[one]["value"])
    return {"name": name, **compared[name]}


def _fields(record: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in record["candidate"].items() if name != "name"}


# Which candidates are worth a second look: the best, those as good, and the Pareto front.

Array = NDArray[np.float64]
OBJECTIVES = {
    "hausdorff": "hausdorff_mm",
    "hausdorff95": "hausdorff95_mm",
    "rms": "rms_mm",
    "whole": "whole_mm",
    "normals": "normals_deg",
}
"""Names on the command line, and of the figures; all are minimised."""


def _pareto_front(costs: Array) -> NDArray[np.bool_]:
    """(N,) true where no other row of (N, K) `costs` is at most as large everywhere and smaller somewhere.

    Raises
    ------
    BadInput
        If `costs` is not (N, K) or not finite.
    """
    require(costs.ndim == 2 and costs.shape[1] > 0, f"costs must have the shape (N, K), but it has {costs.shape}.")
    require(bool(np.isfinite(costs).all()), "costs must be finite.")
    front = np.ones(len(costs), dtype=np.bool_)
    for k, row in enumerate(costs):
        front[k] = not bool(((costs <= row).all(axis=1) & (costs < row).any(axis=1)).any())
    return front


def _mean_interval(values: Sequence[float] | Array, fraction: float = 0.95) -> tuple[float, float, float]:
    """Mean of `values` and Student's interval about it; one value alone has no interval: (value, -inf, inf)."""
    numbers = np.asarray(values, dtype=np.float64)
    require(numbers.size > 0, "an interval needs one value at least.")
    mean = float(numbers.mean())
    if numbers.size == 1:
        return mean, -np.inf, np.inf
    half = float(stats.t.ppf(0.5 + 0.5 * fraction, numbers.size - 1) * numbers.std(ddof=1) / np.sqrt(numbers.size))
    return mean, mean - half, mean + half


def _compare_with_best(records: Sequence[dict[str, Any]], objective: str) -> dict[str, dict[str, Any]]:
    """How much worse than the best every candidate is, finger by finger.

    `records`: of :func:`splitknit.rig.evaluate_rig.evaluate_candidate`, all done, of the same fingers; `objective`:
    name of the figure, as ``hausdorff_mm``. Returns by name of the candidate: ``value`` and ``low``, ``high`` (95 %
    interval of the mean over the fingers; None for one finger), ``worse_by`` and ``worse_low``, ``worse_high`` (the
    same of the paired difference from the best), and ``as_good``: the interval of the difference holds zero.
    """
    values = {one["candidate"]["name"]: np.array([f[objective] for f in one["fingers"]]) for one in records}
    best = min(values, key=lambda name: (float(values[name].mean()), name))
    compared = {}
    for name, own in values.items():
        mean, low, high = _mean_interval(own)
        worse, worse_low, worse_high = _mean_interval(own - values[best])
        compared[name] = {
            "value": mean,
            "low": _finite(low),
            "high": _finite(high),
            "worse_by": worse,
            "worse_low": _finite(worse_low),
            "worse_high": _finite(worse_high),
            "as_good": bool(worse_low <= 0.0),
            "best": name == best,
        }
    return compared


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None


# The folder that a sweep grows in: one file a candidate, whole or not there; taken up again where it was left.

FORMAT = "splitknit-rig-sweep"
STUDY_FILE = "sweep.json"
CANDIDATES = "candidates"
OWN_FILES = re.compile(r"(sweep|results)\.json|results\.csv|index\.html|[a-z_]+\.svg|candidates/[\w.+-]+\.json")
_STRAY = re.compile(r"(.*/)?(\.splitknit-[^/]*\.tmp/.*|\.DS_Store|Thumbs\.db|desktop\.ini)")
"""What a killed run or a file manager leaves behind."""


class _SweepFolder:
    """A folder of finished candidates of one study."""

    def __init__(self, out: Path, study: Study) -> None:
        """Make the folder, or see that it holds a sweep of this very study. Raises BadInput if `out` is a file, holds
        other files, or a sweep with other settings.
        """
        self.out = out
        self.document = json.loads(
            canonical_json({"format": FORMAT, "version": 1, "software": provenance()["version"], "study": study})
        )
        self.hash = settings_hash(self.document)
        require(not out.exists() or out.is_dir(), f"'{out}' is a file; name a folder to write into.")
        if out.is_dir() and self._files():
            self._check()
        else:
            self._write(out / STUDY_FILE, self.document)

    def read(self, candidate: RigCandidate) -> dict[str, Any] | None:
        """The candidate's record, or None where it is not finished (or its file is damaged)."""
        try:
            stored, _ = read_json(self._file(candidate))
            if stored["study_sha256"] != self.hash or stored["record"]["candidate"]["name"] != candidate.name:
                return None
            record: dict[str, Any] = stored["record"]
            return record
        except (ValueError, KeyError, TypeError):
            return None

    def write(self, candidate: RigCandidate, record: Mapping[str, Any]) -> None:
        """Keep a finished candidate."""
        self._write(self._file(candidate), {"study_sha256": self.hash, "record": plain_json(record)})

    def _file(self, candidate: RigCandidate) -> Path:
        return self.out / CANDIDATES / f"{candidate.name}.json"

    def _files(self) -> list[str]:
        found = (path for path in self.out.rglob("*") if path.is_symlink() or not path.is_dir())
        names = (path.relative_to(self.out).as_posix() for path in found)
        return sorted(name for name in names if not _STRAY.fullmatch(name))

    def _check(self) -> None:
        names = self._files()
        foreign = [name for name in names if not OWN_FILES.fullmatch(name)]
        require(
            not foreign and STUDY_FILE in names,
            f"'{self.out}' holds '{(foreign or names)[0]}' and no sweep to go on with; name another folder.",
        )
        before, _ = read_json(self.out / STUDY_FILE, f"'{self.out / STUDY_FILE}' is damaged; name another folder.")
        changed = [name.removeprefix("study.") or "format" for name in differing(before, self.document)]
        require(
            not changed,
            f"the sweep in '{self.out}' was made with other settings ({', '.join(changed)}); give the same ones, or "
            "name another folder.",
        )

    def _write(self, path: Path, document: Any) -> None:
        write_file(path, (json.dumps(document, indent=1, sort_keys=True, allow_nan=False) + "\n").encode())
