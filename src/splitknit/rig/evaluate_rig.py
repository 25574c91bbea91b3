"""One candidate rig: check it, photograph the fingers with it, reconstruct them, measure how far off they are."""

from __future__ import annotations

import functools
from dataclasses import asdict, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput
from splitknit.model import BoolArray, Camera, FloatArray, Reconstruction, Rig
from splitknit.pipeline import reconstruct
from splitknit.rig.candidates import BuildSettings, Candidate, rig_of
from splitknit.rig.constraints import Finding, Print, examine
from splitknit.rig.hausdorff import both_ways, surface_distances
from splitknit.rig.photo import Shot, photograph
from splitknit.rig.photons import intensity_w_sr
from splitknit.rig.study import Study
from splitknit.rig.subject import grid_places, phalange, places, printed, truth, view_of
from splitknit.simulator.diffusion import WalkTable, load_walks
from splitknit.simulator.skin import SkinRanges, SkinSettings
from splitknit.simulator.surface import Surface

BAND_SIGMA_MM = 0.32
"""Standard deviation of the Gaussian whose complement is the ridge band (``docs/conventions.md``)."""
DONE, REFUSED, FAILED = "done", "refused", "failed"


def evaluate(candidate: Candidate, study: Study) -> dict[str, Any]:
    """Judge and measure one candidate.

    Returns
    -------
    dict with ``candidate``, ``status`` (``done``; ``refused`` by a constraint; ``failed`` where a finger could not be
    photographed or reconstructed), ``reason`` (one sentence, or None), ``constraints``, ``fingers`` (figures by finger)
    and ``mean`` (of the figures over the fingers, None unless done).

    Notes
    -----
    Never raises for what a candidate is: a broken one is a result too. Follows from its arguments alone.
    """
    record: dict[str, Any] = {"candidate": {**asdict(candidate), "name": candidate.name}}
    try:
        findings = judge(candidate, study)
        record["constraints"] = [asdict(finding) for finding in findings]
        broken = [finding.words for finding in findings if finding.hard and not finding.ok]
        if broken:
            return {**record, "status": REFUSED, "reason": broken[0], "fingers": [], "mean": None}
        fingers = [{"seed": seed, **measure(candidate, study, seed)} for seed in study.seeds]
    except MemoryError:
        raise  # of the machine, not of the candidate
    except Exception as error:
        words = " ".join(str(error).split()) or "no further words"
        reason = words if isinstance(error, BadInput) else f"{type(error).__name__}: {words}"
        record.setdefault("constraints", [])
        return {**record, "status": FAILED, "reason": reason, "fingers": [], "mean": None}
    mean = {name: float(np.mean([one[name] for one in fingers])) for name in fingers[0] if name != "seed"}
    return {**record, "status": DONE, "reason": None, "fingers": fingers, "mean": mean}


def judge(candidate: Candidate, study: Study) -> tuple[Finding, ...]:
    """The constraints; under a rendering program's fixed exposure that of the sensor does not count."""
    finger = typical(study.first_seed)
    found = examine(candidate, study.build, study.photons, study.limits, finger=finger, bands=study.bands)
    if study.camera == "renderer":
        return tuple(finding for finding in found if not finding.name.startswith(("exposure", "depth")))
    return found


@functools.lru_cache(maxsize=4)
def typical(seed: int) -> Print:
    """Print of a finger, as points and normals of its shape about half a millimetre apart."""
    surface = view_of(seed, Camera(px_per_mm=4.0, image_size=(116, 169)))
    where = printed(surface, phalange(seed, surface))[::2, ::2]
    x, y = places(surface)
    points = np.stack([x, y, surface.shape_mm.astype(np.float64)], axis=-1)[::2, ::2]
    return Print(points[where], surface.shape_normals[::2, ::2][where].astype(np.float64))


def measure(candidate: Candidate, study: Study, seed: int) -> dict[str, float]:
    """Figures of one finger."""
    rig, known = rigs(candidate, study)
    surface = _seen(seed, candidate.height_mm, candidate.px_per_mm, study.build)
    whole = phalange(seed, surface)
    shot = photograph(
        surface,
        rig,
        known_rig=known,
        mask=whole,
        skin=_skin(seed) if study.material == "skin" else None,
        walks=_walks(),
        photons=study.photons,
        seed=np.random.SeedSequence([seed, 0x0D]),
        rendered=study.camera == "renderer",
    )
    preset = "metric" if study.method == "metric" else "ea"
    changes = {"height.method": "poisson"} if study.method == "ea-poisson" else {}
    result = reconstruct(shot.capture, preset, changes)
    return {**_exposed(shot), **compare_surfaces(result, surface, whole, seed, study.truth_px_per_mm)}


def rigs(candidate: Candidate, study: Study) -> tuple[Rig, Rig]:
    """The rig that photographs, and what the reconstruction is told: the thesis's methods see in parallel rays."""
    build, lamps = study.build, study.photons.lamps
    if study.camera == "renderer":
        build = replace(build, half_angle_deg=90.0)
        intensities = dict.fromkeys(study.bands, candidate.power_w / (4.0 * np.pi))
    else:
        intensities = {
            band: intensity_w_sr(candidate.power_w, lamps[band], build.lobe_exponent) for band in study.bands
        }
    rig = rig_of(candidate, build, intensities)
    return rig, rig if study.method == "metric" else rig_of(candidate, build, intensities, "orthographic")


def compare_surfaces(
    result: Reconstruction, surface: Surface, whole: BoolArray, seed: int, truth_px_per_mm: float
) -> dict[str, float]:
    """Distances between the true and the reconstructed surface.

    The mean height over the print is removed. ``hausdorff_mm``, ``hausdorff95_mm`` and ``rms_mm`` are those of the
    print (slant up to 60 deg), whose nearest points are looked for on the whole phalange; ``whole_mm`` is the Hausdorff
    distance of the whole phalange, whose steep sides and cut edge decide it. ``normals_deg`` is the mean angle between
    true and reconstructed normals on the print, ``ridge_correlation`` that of the ridge bands there.
    """
    true = truth(seed, truth_px_per_mm)
    flat = printed(surface, whole) & np.isfinite(result.height_mm)
    kept = whole & np.isfinite(result.height_mm)
    x, y = grid_places(surface.camera)
    if result.x_mm is not None and result.y_mm is not None:
        x, y = result.x_mm.astype(np.float64), result.y_mm.astype(np.float64)
    lift = float(np.mean(result.height_mm[flat], dtype=np.float64) - np.mean(surface.height_mm[flat], dtype=np.float64))
    points = np.stack([x, y, result.height_mm - lift], axis=-1).astype(np.float64)
    there, back = both_ways(true.phalange, points[kept])
    near = surface_distances(there[true.print], back[flat[kept]])
    cosine = np.sum(result.normals[flat].astype(np.float64) * surface.normals[flat], axis=1)
    return {
        "hausdorff_mm": near.hausdorff_mm,
        "hausdorff95_mm": near.hausdorff95_mm,
        "rms_mm": near.rms_mm,
        "whole_mm": surface_distances(there, back).hausdorff_mm,
        "normals_deg": float(np.mean(np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0))))),
        "ridge_correlation": _ridge_correlation(
            result.ridge_mm, surface.height_mm - surface.shape_mm, kept, flat, BAND_SIGMA_MM / result.pitch_mm
        ),
    }


def _exposed(shot: Shot) -> dict[str, float]:
    return {
        f"{what}_{band}": float(value)
        for band, one in shot.exposures.items()
        for what, value in (("exposure_s", one.time_s), ("gain", one.gain), ("level", one.level))
    }


def _ridge_correlation(
    relief: FloatArray, true: FloatArray, mask: BoolArray, where: BoolArray, sigma_px: float
) -> float:
    """Correlation of two reliefs, each minus its Gaussian mean over the mask."""
    weight = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), sigma_px, borderType=cv2.BORDER_CONSTANT)

    def band(field: FloatArray) -> NDArray[np.float64]:
        inside = np.where(mask, field, np.float32(0.0)).astype(np.float32)
        mean = cv2.GaussianBlur(inside, (0, 0), sigma_px, borderType=cv2.BORDER_CONSTANT) / np.maximum(weight, 1e-3)
        return np.asarray((inside - mean)[where], dtype=np.float64)

    first, second = band(relief), band(true)
    first, second = first - first.mean(), second - second.mean()
    return float(np.sum(first * second) / max(float(np.sqrt(np.sum(first**2) * np.sum(second**2))), 1e-30))


@functools.lru_cache(maxsize=32)
def _seen(seed: int, height_mm: float, px_per_mm: float, build: BuildSettings) -> Surface:
    """The finger under this height's camera: the LEDs do not change it."""
    standing = Candidate(height_mm, 50.0, 1.0, None, px_per_mm)
    return view_of(seed, rig_of(standing, build, {"white": 1.0}).camera)


@functools.lru_cache(maxsize=64)
def _skin(seed: int) -> SkinSettings:
    return SkinRanges().draw(np.random.default_rng(np.random.SeedSequence([seed, 0x51])))


@functools.lru_cache(maxsize=1)
def _walks() -> WalkTable:
    return load_walks()
