"""One candidate rig: check it, photograph the fingers with it, reconstruct them, measure how far off they are."""

from __future__ import annotations

import functools
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from splitknit.errors import BadInput, require
from splitknit.evaluation.accuracy import high_passed
from splitknit.model import BoolArray, Camera, FloatArray, Reconstruction, Rig
from splitknit.pipeline import reconstruct
from splitknit.rig.candidates import (
    FIRST_SEED,
    TRUTH_PX_PER_MM,
    BuildSettings,
    Finding,
    PrintPoints,
    RigCandidate,
    Study,
    candidate_rig,
    examine,
)
from splitknit.rig.photography import LAMPS, ExposedCapture, intensity_w_sr, photograph_candidate
from splitknit.simulator.finger.finger import (
    FingerPose,
    PoseRanges,
    SimulatedFinger,
    draw_finger,
    finger_surface,
    placement_of,
)
from splitknit.simulator.finger.master_print import MasterPrint
from splitknit.simulator.finger.shape import FingerBody
from splitknit.simulator.light.skin import SkinOptics, SkinRanges
from splitknit.simulator.surface import SimulatedSurface

# The fingers that all rigs of a sweep photograph: surfaces, and their truth as points.

FIELD_MM = (2200 / 75.7, 3200 / 75.7)
"""Rows and columns of the thesis's field on the finger plane."""
ABOVE_CREASE_MM = 0.5
"""The phalange is what lies further towards the tip than this, seen from its crease."""
MAX_SLANT_DEG = 60.0
"""The print is where the shape is flatter than this (``docs/explain/conventions.md``)."""


@dataclass(frozen=True, slots=True, eq=False)
class _Points:
    """A surface as points."""

    phalange: Array
    """(N, 3) mm, all that the camera sees of the phalange."""
    print: BoolArray
    """(N,) which of them carry the print: slant of the shape up to 60 deg."""


@functools.lru_cache(maxsize=16)
def _person(seed: int) -> tuple[SimulatedFinger, MasterPrint]:
    """A finger and its master print; drawing the print is what takes long."""
    finger = draw_finger(seed)
    return finger, finger.master()


def _pose_of(seed: int, camera: Camera) -> FingerPose:
    """How this finger lies: in the same place under any camera, whose rows are only about `FIELD_MM` long."""
    even = Camera(px_per_mm=100.0, image_size=(round(100 * FIELD_MM[0]), round(100 * FIELD_MM[1])))
    rng = np.random.default_rng(np.random.SeedSequence([seed, 0x0C]))
    pose = PoseRanges(height_mm=(0.0, 0.0), insertion_mm=(25.0, 27.0)).draw(rng, even)
    rows_mm = camera.image_size[0] / camera.px_per_mm
    return replace(pose, insertion_mm=pose.insertion_mm + 0.5 * (rows_mm - even.image_size[0] / even.px_per_mm))


def _view_of(seed: int, camera: Camera) -> SimulatedSurface:
    """The finger on the pixels of `camera`."""
    finger, master = _person(seed)
    return finger_surface(replace(finger, printed=master), _pose_of(seed, camera), camera, workers=1)


def _phalange(seed: int, surface: SimulatedSurface) -> BoolArray:
    """(H, W) pixels of the distal phalange: the finger above its first crease."""
    finger, _ = _person(seed)
    placement = placement_of(FingerBody(finger.shape), _pose_of(seed, surface.camera), surface.camera)
    x, y = _places(surface)
    z = np.where(surface.mask, surface.shape_mm, 0.0).astype(np.float64)
    along = np.asarray(placement.to_finger(x.ravel(), y.ravel(), z.ravel())[1]).reshape(z.shape)
    return np.asarray(surface.mask & (along >= ABOVE_CREASE_MM))


def _printed(surface: SimulatedSurface, where: BoolArray) -> BoolArray:
    """(H, W) pixels of `where` whose shape is flat enough to carry the print."""
    return np.asarray(where & (surface.shape_normals[..., 2] > np.cos(np.deg2rad(MAX_SLANT_DEG))))


def _places(surface: SimulatedSurface) -> tuple[Array, Array]:
    """(H, W) x and y of what each pixel sees, mm; of the pixel on the finger plane beside the finger."""
    x, y = _grid_places(surface.camera)
    if surface.x_mm is not None and surface.y_mm is not None:
        return np.where(surface.mask, surface.x_mm, x), np.where(surface.mask, surface.y_mm, y)
    return x, y


def _grid_places(camera: Camera) -> tuple[Array, Array]:
    """(H, W) x and y of where each pixel looks on the finger plane, mm."""
    rows, columns = camera.image_size
    x = (np.arange(columns) - (columns - 1) / 2) * camera.pitch_mm
    y = ((rows - 1) / 2 - np.arange(rows)) * camera.pitch_mm
    across, up = np.meshgrid(x, y)
    return across, up


@functools.lru_cache(maxsize=8)
def _truth(seed: int, px_per_mm: float) -> _Points:
    """The true surface, seen straight from above, whatever the rig: what every reconstruction is measured against."""
    size = (round(FIELD_MM[0] * px_per_mm), round(FIELD_MM[1] * px_per_mm))
    surface = _view_of(seed, Camera(px_per_mm=px_per_mm, image_size=size))
    whole = _phalange(seed, surface)
    x, y = _places(surface)
    points = np.stack([x, y, surface.height_mm.astype(np.float64)], axis=-1)
    return _Points(points[whole], _printed(surface, whole)[whole])


BAND_SIGMA_MM = 0.32
"""Standard deviation of the Gaussian whose complement is the ridge band (``docs/explain/conventions.md``)."""
DONE, REFUSED, FAILED = "done", "refused", "failed"


def evaluate_candidate(candidate: RigCandidate, study: Study) -> dict[str, Any]:
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
        fingers = [{"seed": seed, **_measure(candidate, study, seed)} for seed in study.seeds]
    except MemoryError:
        raise  # of the machine, not of the candidate
    except Exception as error:
        words = " ".join(str(error).split()) or "no further words"
        reason = words if isinstance(error, BadInput) else f"{type(error).__name__}: {words}"
        record.setdefault("constraints", [])
        return {**record, "status": FAILED, "reason": reason, "fingers": [], "mean": None}
    mean = {name: float(np.mean([one[name] for one in fingers])) for name in fingers[0] if name != "seed"}
    return {**record, "status": DONE, "reason": None, "fingers": fingers, "mean": mean}


def judge(candidate: RigCandidate, study: Study) -> tuple[Finding, ...]:
    """The constraints; under a rendering program's fixed exposure that of the sensor does not count."""
    finger = _typical(FIRST_SEED)
    found = examine(candidate, study.build, study.photons, finger=finger, bands=study.bands)
    if study.camera == "renderer":
        return tuple(finding for finding in found if not finding.name.startswith(("exposure", "depth")))
    return found


@functools.lru_cache(maxsize=4)
def _typical(seed: int) -> PrintPoints:
    """Print of a finger, as points and normals of its shape about half a millimetre apart."""
    surface = _view_of(seed, Camera(px_per_mm=4.0, image_size=(116, 169)))
    where = _printed(surface, _phalange(seed, surface))[::2, ::2]
    x, y = _places(surface)
    points = np.stack([x, y, surface.shape_mm.astype(np.float64)], axis=-1)[::2, ::2]
    return PrintPoints(points[where], surface.shape_normals[::2, ::2][where].astype(np.float64))


def _measure(candidate: RigCandidate, study: Study, seed: int) -> dict[str, float]:
    """Figures of one finger."""
    rig, known = _rigs(candidate, study)
    surface = _seen(seed, candidate.height_mm, candidate.px_per_mm, study.build)
    whole = _phalange(seed, surface)
    shot = photograph_candidate(
        surface,
        rig,
        known_rig=known,
        mask=whole,
        skin=_skin(seed) if study.material == "skin" else None,
        photons=study.photons,
        seed=np.random.SeedSequence([seed, 0x0D]),
        rendered=study.camera == "renderer",
    )
    preset = "metric" if study.method == "metric" else "ea-split"  # the surface of ea, ridges by shapelets
    changes = {"height.method": "poisson"} if study.method == "ea-poisson" else {}
    result = reconstruct(shot.capture, preset, changes)
    return {**_exposed(shot), **_compare_surfaces(result, surface, whole, seed, TRUTH_PX_PER_MM)}


def _rigs(candidate: RigCandidate, study: Study) -> tuple[Rig, Rig]:
    """The rig that photographs, and the one that the reconstruction assumes: the thesis's methods see parallel rays."""
    build = study.build
    if study.camera == "renderer":
        build = replace(build, half_angle_deg=90.0)
        intensities = dict.fromkeys(study.bands, candidate.power_w / (4.0 * np.pi))
    else:
        intensities = {
            band: intensity_w_sr(candidate.power_w, LAMPS[band], build.lobe_exponent) for band in study.bands
        }
    rig = candidate_rig(candidate, build, intensities)
    return rig, rig if study.method == "metric" else candidate_rig(candidate, build, intensities, "orthographic")


def _compare_surfaces(
    result: Reconstruction, surface: SimulatedSurface, whole: BoolArray, seed: int, truth_px_per_mm: float
) -> dict[str, float]:
    """Distances between the true and the reconstructed surface.

    The mean height over the print is removed. ``hausdorff_mm``, ``hausdorff95_mm`` and ``rms_mm`` are those of the
    print (slant up to 60 deg), whose nearest points are looked for on the whole phalange; ``whole_mm`` is the Hausdorff
    distance of the whole phalange, whose steep sides and cut edge decide it. ``normals_deg`` is the mean angle between
    true and reconstructed normals on the print, ``ridge_correlation`` that of the ridge bands there.
    """
    true = _truth(seed, truth_px_per_mm)
    flat = _printed(surface, whole) & np.isfinite(result.height_mm)
    kept = whole & np.isfinite(result.height_mm)
    x, y = _grid_places(surface.camera)
    if result.x_mm is not None and result.y_mm is not None:
        x, y = result.x_mm.astype(np.float64), result.y_mm.astype(np.float64)
    lift = float(np.mean(result.height_mm[flat], dtype=np.float64) - np.mean(surface.height_mm[flat], dtype=np.float64))
    points = np.stack([x, y, result.height_mm - lift], axis=-1).astype(np.float64)
    there, back = _both_ways(true.phalange, points[kept])
    cosine = np.sum(result.normals[flat].astype(np.float64) * surface.normals[flat], axis=1)
    return {
        **_surface_distances(there[true.print], back[flat[kept]]),
        "whole_mm": _surface_distances(there, back)["hausdorff_mm"],
        "normals_deg": float(np.mean(np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0))))),
        "ridge_correlation": _ridge_correlation(
            result.ridge_mm, surface.height_mm - surface.shape_mm, kept, flat, BAND_SIGMA_MM / result.pitch_mm
        ),
    }


def _exposed(shot: ExposedCapture) -> dict[str, float]:
    return {
        f"{what}_{band}": float(value)
        for band, one in shot.exposures.items()
        for what, value in (("exposure_s", one.time_s), ("gain", one.gain), ("level", one.level))
    }


def _ridge_correlation(
    relief: FloatArray, true: FloatArray, mask: BoolArray, where: BoolArray, sigma_px: float
) -> float:
    """Correlation of two reliefs, each minus its Gaussian mean over the mask."""
    first, second = (high_passed(field, mask, sigma_px)[where].astype(np.float64) for field in (relief, true))
    first, second = first - first.mean(), second - second.mean()
    return float(np.sum(first * second) / max(float(np.sqrt(np.sum(first**2) * np.sum(second**2))), 1e-30))


@functools.lru_cache(maxsize=32)
def _seen(seed: int, height_mm: float, px_per_mm: float, build: BuildSettings) -> SimulatedSurface:
    """The finger under this height's camera: the LEDs do not change it."""
    standing = RigCandidate(height_mm, 50.0, 1.0, None, px_per_mm)
    return _view_of(seed, candidate_rig(standing, build, {"white": 1.0}).camera)


@functools.lru_cache(maxsize=64)
def _skin(seed: int) -> SkinOptics:
    return SkinRanges().draw(np.random.default_rng(np.random.SeedSequence([seed, 0x51])))


# How far two surfaces lie apart, as sets of points.

Array = NDArray[np.float64]


def _both_ways(first: Array, second: Array) -> tuple[Array, Array]:
    """Nearest distances from (N, 3) `first` to (M, 3) `second`, (N,), and back, (M,). Raises BadInput if a set is
    empty, not (N, 3) or not finite.
    """
    for name, points in (("first", first), ("second", second)):
        require(
            points.ndim == 2 and points.shape[1] == 3 and points.shape[0] > 0,
            f"{name} must hold points (N, 3), but it has the shape {points.shape}.",
        )
        require(bool(np.isfinite(points).all()), f"{name} holds points that are not finite.")
    return np.asarray(cKDTree(second).query(first)[0]), np.asarray(cKDTree(first).query(second)[0])


def _surface_distances(there: Array, back: Array) -> dict[str, float]:
    """Hausdorff distance, its 95 % variant and root mean square (mm) of nearest distances, (N,) and (M,), in both
    directions: those of :func:`_both_ways`, or a part of them.

    Where only the middle of two surfaces is measured, a point at its border may have its neighbour just beyond; so
    distances are found on the whole surfaces and those of the middle are kept. Source: F. Hausdorff, Grundzuege der
    Mengenlehre, 1914, chapter 8; D. P. Huttenlocher, G. A. Klanderman, W. J. Rucklidge, Comparing images using the
    Hausdorff distance, IEEE PAMI 15 (1993), equations (1) and (2); the percentile is their partial distance, equation
    (8).
    """
    require(there.size > 0 and back.size > 0, "no distances to summarise; the surfaces share no points.")
    return {
        "hausdorff_mm": float(max(there.max(), back.max())),
        "hausdorff95_mm": float(max(np.percentile(there, 95), np.percentile(back, 95))),
        "rms_mm": float(np.sqrt(0.5 * (np.mean(there**2) + np.mean(back**2)))),
    }
