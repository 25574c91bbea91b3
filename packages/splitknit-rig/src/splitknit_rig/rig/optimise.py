"""Sweep many rigs on the twin, in parallel, take up again what was interrupted, and compare what they measured."""

from __future__ import annotations

import functools
import itertools
import json
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from scipy import stats

from splitknit import (
    Array,
    BadInput,
    BoolArray,
    Camera,
    Checked,
    Led,
    Limits,
    Progress,
    canonical_json,
    compare,
    csv_text,
    differing,
    no_progress,
    plain_json,
    provenance,
    read_json,
    reconstruct,
    require,
    run_jobs,
    settings_hash,
    write_file,
)
from splitknit_rig.rig.candidates import (
    ALBEDO,
    FIELD_MM,
    FULL_PX_PER_MM,
    FULL_WELL_E,
    READ_NOISE_E,
    BuildSettings,
    Finding,
    PhotonSettings,
    PlannedExposure,
    PrintPoints,
    RigCandidate,
    candidate_rig,
    examine,
    led_intensities,
    planned_exposure,
)
from splitknit_simulator import (
    PoseRanges,
    RenderSettings,
    SensorSettings,
    TwinSettings,
    draw_finger,
    finger_surface,
    fresnel_amplitudes,
    irradiance,
    reflected_through,
    side_lights,
    simulate_capture,
    turned_film_rad,
    unit,
)

FIRST_SEED = 400  # seeds of the fingers
MAX_SLANT_DEG = 60.0  # the print is where the shape is flatter than this (``docs/explain/conventions.md``)
DONE, REFUSED, FAILED = "done", "refused", "failed"
OBJECTIVES = {
    "rms": "surface_rms_mm", "ridges": "ridge_rms_um", "normals": "normals_mean_deg", "slopes": "slope_deviation"
}  # fmt: skip
"""Names on the command line, of :func:`splitknit.compare`'s or :func:`slope_deviations`' figures; all are minimised."""
_POSE = PoseRanges(height_mm=(0.0, 0.0), insertion_mm=(25.0, 27.0))
_STUDY_FILE = "sweep.json"
_OWN_FILES = re.compile(r"(sweep|results)\.json|results\.csv|candidates/[\w.+-]+\.json")
_STRAY = re.compile(r"(.*/)?(\.splitknit-[^/]*\.tmp/.*|\.DS_Store|Thumbs\.db|desktop\.ini)")
"""What a killed run or a file manager leaves behind."""


@dataclass(frozen=True, slots=True)
class Study(Checked):
    """Everything that a candidate's figures follow from, besides the candidate."""

    method: Literal["ea", "metric", "information"] = "ea"
    """Preset (``ea``: with ridges apart); ``information``: no finger, see :func:`slope_deviations`."""
    fingers: Annotated[int, Limits(1, 200)] = 3
    """Number of fingers; all candidates photograph the same ones."""
    build: BuildSettings = field(default_factory=BuildSettings)
    photons: PhotonSettings = field(default_factory=PhotonSettings)

    @property
    def seeds(self) -> tuple[int, ...]:
        """Seeds of the fingers."""
        return tuple(range(FIRST_SEED, FIRST_SEED + self.fingers))

    @property
    def bands(self) -> tuple[str, ...]:
        """Bands that the method looks at."""
        return ("white", "nir") if self.method == "metric" else ("white",)

    def findings(self, candidate: RigCandidate) -> tuple[Finding, ...]:
        """What the constraints make of a candidate."""
        return examine(candidate, self.build, self.photons, finger=_typical_print(), bands=self.bands)

    def measure(self, candidate: RigCandidate, seed: int) -> dict[str, float]:
        """Photograph a finger with a candidate, reconstruct it, and compare with its truth. A weak LED is exposed for
        longer, then with a higher gain, which leaves fewer electrons at full scale; the weaker band decides.
        """
        rig = candidate_rig(candidate, self.build, led_intensities(candidate, self.build, self.bands))
        plans = {band: planned_exposure(rig.leds, band, self.photons) for band in self.bands}
        if self.method == "information":
            return slope_deviations(rig.leds, plans["white"])
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


SLANTS_DEG = (0.0, 15.0, 30.0, 45.0, 60.0)  # bounds of the bands of slant
_FACET_MM, _FACET_ROUGHNESS = 1 / 37.85, 0.3
"""Side of the facet, a pixel of half the full resolution, and its GGX alpha."""


def slope_deviations(
    leds: Sequence[Led], plan: PlannedExposure | None, analyser_rad: float | None = None
) -> dict[str, float]:
    """How well a facet's slope can be known from its mirror reflection under near white `leds`, behind films.

    The difference of the parallel and the crossed image shows the reflection alone, with the noise of both images: of
    their electrons, at the planned exposure, and of reading them out. The inverse of the Fisher information of both
    slopes (S. Kay, Fundamentals of Statistical Signal Processing, 1993, equation 3.31) is the least covariance that any
    unbiased estimate has; roughness and strength are taken as known. The facet is a GGX one (B. Walter et al., EGSR
    2007, equations 20, 33, 34) in the middle of the finger plane; no finger shadows it. `analyser_rad`: axis of films
    as they are mounted, which weaken the reflection of lights in their plane; None: all reflect as unpolarised light.
    Returns for each band of slant, as ``slope_45_60``, the root mean square over azimuths, and as
    ``slope_median_45_60`` the median; ``slope_deviation`` is the geometric mean of the former over all bands.
    """
    assert plan is not None
    towards = unit(np.array([led.position_mm or led.direction for led in leds]))
    halves = unit(towards + np.array([0.0, 0.0, 1.0]))
    mirror = 0.5 * np.sum(np.square(fresnel_amplitudes(halves[:, 2])), axis=0)
    if analyser_rad is not None:
        aside, to_camera = side_lights(leds), (0.0, 0.0, 1.0)
        for k, way in enumerate(towards):
            film = turned_film_rad(way, analyser_rad) if k in aside else analyser_rad
            mirror[k] = reflected_through(way, to_camera, film, analyser_rad, 0.0)
    light = np.array([float(irradiance(led, (0.0, 0.0, 0.0), way)) for led, way in zip(leds, towards, strict=True)])
    light *= plan.level / (0.5 * ALBEDO / np.pi * light.max())  # half of the diffuse light is in either image
    squared = _FACET_ROUGHNESS**2

    def masking(cosine: Array) -> Array:
        return np.asarray(2 * cosine / (cosine + np.sqrt(squared + (1 - squared) * cosine * cosine)))

    def mirrored(p: Array, q: Array) -> tuple[Array, Array]:
        normal = unit(np.stack([-p, -q, np.ones_like(p)], axis=-1))
        lit, half = np.clip(normal @ towards.T, 1e-4, 1.0), normal @ halves.T
        lobe = squared / (np.pi * (half * half * (squared - 1) + 1) ** 2)
        shine = lobe * masking(lit) * masking(normal[..., 2:]) * mirror / (4 * normal[..., 2:])
        return np.where(lit > 1e-3, light * shine, 0.0), light * lit

    step, pixels, full_e = 1e-4, (_FACET_MM * FULL_PX_PER_MM) ** 2, FULL_WELL_E / plan.gain
    figures: dict[str, float] = {}
    azimuth = np.deg2rad(np.arange(0.0, 360.0, 5.0))
    for low, high in itertools.pairwise(SLANTS_DEG):
        slope = np.tan(np.deg2rad(np.linspace(low, high, 9)))[:, None]
        p, q = slope * np.cos(azimuth), slope * np.sin(azimuth)
        shine, lit = mirrored(p, q)
        by = [(mirrored(p + a, q + b)[0] - mirrored(p - a, q - b)[0]) / (2 * step) for a, b in ((step, 0), (0, step))]
        variance = ((shine + ALBEDO / np.pi * lit) / full_e + 2 * (READ_NOISE_E / full_e) ** 2) / pixels
        pp, pq, qq = (np.sum(by[i] * by[j] / variance, axis=-1) for i, j in ((0, 0), (0, 1), (1, 1)))
        error = (pp + qq) / np.maximum(2 * (pp * qq - pq * pq), 1e-12)
        for name, average in (("slope", np.mean), ("slope_median", np.median)):
            figures[f"{name}_{low:.0f}_{high:.0f}"] = float(np.sqrt(average(error)))
    overall = [value for name, value in figures.items() if "median" not in name]
    return {**figures, "slope_deviation": float(stats.gmean(overall))}


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
    """Evaluate all candidates, keep each when finished, and return their records in order. `out` is new, or an earlier
    sweep of the same study, whose failures are tried again. BadInput if none can be built, or it holds something else.
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


def _pareto_front(costs: Array) -> BoolArray:
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
    """How much worse than the best every candidate is, finger by finger, by name: ``value`` and ``low``, ``high`` (95 %
    interval of the mean over the fingers; None for one finger), ``worse_by`` and ``worse_low``, ``worse_high`` (of the
    paired difference), and ``as_good``: that interval holds zero.
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
