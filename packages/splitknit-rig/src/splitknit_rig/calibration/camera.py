"""Camera calibration from views of one checkerboard: the fit, rejected views, and parameters that
the views do not determine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import cv2
import numpy as np

from splitknit import BadInput
from splitknit.errors import require
from splitknit.findings import Finding, Severity
from splitknit.imaging.robust import deviation
from splitknit.model import Array, FloatArray
from splitknit_rig.calibration.targets import Board

TERMS = ("k1", "k2", "p1", "p2", "k3")  # coefficients of the distortion, in OpenCV's order
_STEPS: tuple[tuple[str, ...], ...] = (("k1",), ("k2",), ("p1", "p2"), ("k3",))
"""Terms are tried in this order, each in addition to those that were kept; k3 only with k2."""
_UNDETERMINED = (
    "the photographs do not determine the camera (no camera fits them, as when all boards lie"
    " parallel to the sensor); tilt the board by 20 to 40 deg to several sides, and let it fill the"
    " picture."
)


@dataclass(frozen=True, slots=True, eq=False)
class _LensFit:
    """A camera matrix with distortion, and the board's pose in each view."""

    matrix: Array  # (3, 3) in pixels
    distortion: tuple[float, ...]  # k1, k2, p1, p2, k3
    # standard deviations: ``fx``, ``fy``, ``cx``, ``cy`` in pixels and the terms that were fitted
    deviations: dict[str, float]
    rms_px: float  # root of the mean squared distance between corners and their prediction
    view_rms_px: Array  # (V,) the same for each view
    # (V, 3) unit normals of the boards in the camera's frame (x right, y down, z away), towards the
    # camera
    normals: Array
    fitted: tuple[str, ...]  # what was fitted beside the focal length
    fixed: Mapping[str, str] = field(default_factory=dict)  # what was held, and why


@dataclass(frozen=True, slots=True, eq=False)
class _Views:
    boards: list[FloatArray]
    corners: list[FloatArray]
    size: tuple[int, int]  # columns, rows of the images


def fit_lens(board_mm: Any, corner_sets: Sequence[Any], image_size: tuple[int, int]) -> _LensFit:
    """Fit matrix and distortion to `corner_sets`, V arrays (N, 2) of columns and rows of the
    corners `board_mm` (N, 2). Square pixels and no distortion come first; k1, k2, (p1, p2), k3 and
    the ratio of the focal lengths are added in turn, each kept only if it differs from zero by more
    than four of its standard deviations. An undetermined principal point is held at the image's
    middle. The focal length's standard deviation is the larger of two: that of the fit, and that of
    fits with the focal length held at other values. Raises BadInput if the views determine no
    camera. Source: Z. Zhang, "A flexible new technique for camera calibration", IEEE TPAMI 22(11),
    2000; terms and deviations as in OpenCV's ``calibrateCameraExtended``.
    """
    board = np.asarray(board_mm, dtype=np.float64)
    flat = np.column_stack([board, np.zeros(len(board))]).astype(np.float32)
    corners = [np.asarray(view, dtype=np.float32).reshape(-1, 1, 2) for view in corner_sets]
    views = _Views([flat] * len(corners), corners, (image_size[1], image_size[0]))
    kept: tuple[str, ...] = ("cx", "cy")
    fixed: dict[str, str] = {}
    best = _fit(views, kept)
    if (off := max(best.deviations["cx"], best.deviations["cy"])) > 0.05 * max(image_size):
        words = (
            f"{off:.0f} px of standard deviation are too much; it was held in the middle of the"
            " image"
        )
        fixed["principal point"], kept = words, ()
        best = _fit(views, kept)
    for step in (("aspect",), *_STEPS, ("aspect",)):
        if step == ("k3",) and "k2" not in kept:
            fixed["k3"] = "0: not tried, as even k2 is undetermined"
            continue
        if step[0] in kept:
            continue
        try:
            trial = _fit(views, kept + step, best)
        except BadInput:
            fixed[_called(step)] = "the photographs do not determine it"
            continue
        values = dict(zip(TERMS, trial.distortion, strict=True))
        values["aspect"] = trial.matrix[0, 0] / trial.matrix[1, 1] - 1
        # a fit with it lowers the sum of squares by variance * (value / deviation)^2
        deviations = {
            **trial.deviations,
            "aspect": abs(values["aspect"]) / _root_rise(best, trial, views),
        }
        ratio = max(abs(values[term]) / max(deviations[term], 1e-300) for term in step)
        # a ratio of focal lengths nearer to one is kept only after k1 was tried
        gross = (
            step != ("aspect",) or abs(values["aspect"]) > 0.015 or "k1" in fixed or "k1" in kept
        )
        if ratio > 4.0 and gross:
            kept, best = kept + step, trial
            fixed.pop(_called(step), None)
        elif step == ("aspect",):
            fixed[_called(step)] = (
                f"1: it differs by {values['aspect']:.1e} +- {deviations['aspect']:.1e} only"
            )
        else:
            estimate = " and ".join(
                f"{values[term]:.2g} +- {deviations[term]:.2g}" for term in step
            )
            fixed[_called(step)] = f"0: the photographs give {estimate}"
    best.deviations.update(_focal_deviations(views, kept, best))
    return replace(
        best,
        fitted=tuple(term for term in (*TERMS, "cx", "cy", "aspect") if term in kept),
        fixed=fixed,
    )


def _fit(views: _Views, kept: tuple[str, ...], start: _LensFit | None = None) -> _LensFit:
    flags = sum(flag for term, flag in _HOLDING.items() if term not in kept)
    flags |= cv2.CALIB_FIX_FOCAL_LENGTH if "no focal" in kept else 0
    columns, rows = views.size
    matrix = np.eye(3) if start is None else start.matrix.copy()
    if start is None and "cx" not in kept:
        matrix = np.asarray(
            cv2.initCameraMatrix2D(views.boards, views.corners, views.size, 1.0), dtype=np.float64
        )
        if not (np.isfinite(matrix).all() and matrix[0, 0] > 0):
            matrix = np.diag([2.0 * max(views.size)] * 2 + [1.0])
    if start is not None or "cx" not in kept:
        flags |= cv2.CALIB_USE_INTRINSIC_GUESS
    if "cx" not in kept:
        matrix[:2, 2] = (columns - 1) / 2, (rows - 1) / 2
    distortion = np.zeros(5) if start is None else np.array(start.distortion)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 60, 1e-7)
    try:
        rms, fitted, lens, turns, _, deviations, _, view_rms = cv2.calibrateCameraExtended(
            views.boards,
            views.corners,
            views.size,
            matrix,
            distortion,
            flags=flags,
            criteria=criteria,
        )
    except cv2.error as error:
        raise BadInput(_UNDETERMINED) from error
    matrix = np.asarray(fitted, dtype=np.float64)
    focal_px = np.diag(matrix)[:2]
    sound = np.isfinite(matrix).all() and np.isfinite(deviations).all()
    # the fit ran away if the focal length exceeds 40 sides of the image
    require(
        sound and focal_px.min() > 0 and focal_px.max() < 40.0 * max(views.size),
        _UNDETERMINED,
    )
    names = ("fx", "fy", "cx", "cy", *TERMS)
    spread = dict(zip(names, deviations.ravel()[: len(names)].tolist(), strict=True))
    if "aspect" not in kept:
        spread["fx"] = spread["fy"]  # OpenCV counts one of the two
    normals = np.array([-cv2.Rodrigues(np.asarray(turn))[0][:, 2] for turn in turns])
    normals *= np.where(normals[:, 2:] > 0, -1.0, 1.0)
    spread = {name: value for name, value in spread.items() if name in (*kept, "fx", "fy")}
    terms = tuple(lens.ravel()[:5].tolist())
    return _LensFit(
        matrix,
        terms,
        spread,
        float(rms),
        np.asarray(view_rms, dtype=np.float64).ravel(),
        normals,
        kept,
    )


def _root_rise(held: _LensFit, free: _LensFit, views: _Views) -> float:
    """Square root of the increase of the sum of squares when a value is held, in units of a
    coordinate's variance."""
    coordinates = 2 * len(views.corners) * len(views.boards[0])
    return float(
        np.sqrt(coordinates * max(held.rms_px**2 / max(free.rms_px, 1e-12) ** 2 - 1, 1e-12))
    )


def _focal_deviations(views: _Views, kept: tuple[str, ...], best: _LensFit) -> dict[str, float]:
    """Standard deviations of fx and fy, at least those that fits with other focal lengths give."""
    estimates = []
    for factor in (0.97, 1.03):
        matrix = best.matrix.copy()
        matrix[[0, 1], [0, 1]] *= factor
        try:
            held = _fit(views, (*kept, "no focal"), replace(best, matrix=matrix))
        except BadInput:
            continue
        estimates.append(abs(factor - 1) * best.matrix[0, 0] / _root_rise(held, best, views))
    largest = max(estimates, default=float("inf"))
    doubtful = largest > 2 * best.deviations["fx"]
    return {name: largest if doubtful else best.deviations[name] for name in ("fx", "fy")}


def _called(step: tuple[str, ...]) -> str:
    return "fx / fy" if step == ("aspect",) else " and ".join(step)


_HOLDING = {
    "k1": cv2.CALIB_FIX_K1,
    "k2": cv2.CALIB_FIX_K2,
    "k3": cv2.CALIB_FIX_K3,
    "p1": cv2.CALIB_ZERO_TANGENT_DIST,
    "cx": cv2.CALIB_FIX_PRINCIPAL_POINT,
    "aspect": cv2.CALIB_FIX_ASPECT_RATIO,
}


@dataclass(frozen=True, slots=True, eq=False)
class CameraCalibration:
    """A calibrated camera, with the views that it was fitted to."""

    lens: _LensFit
    # names of the views that were fitted; `lens.view_rms_px` is in their order
    used: tuple[str, ...]
    # views with too large an error: that error in pixels, when it was rejected
    rejected: dict[str, float]
    repeated: dict[str, str]  # views that show the same as another, and that other
    tilts_deg: Array  # (V,) angle between each board and the sensor
    variety_deg: float  # largest angle between two boards
    coverage: float  # part of the picture that the corners span
    findings: tuple[Finding, ...]


def fit_camera(
    corner_sets: Sequence[Any],
    board: Board,
    image_size: tuple[int, int],
    names: Sequence[str] | None = None,
) -> CameraCalibration:
    """Calibrate a camera by Zhang's method from `corner_sets`: V arrays (N, 2), column and row of
    the board's corners in the order of `board.points_mm`; `names` are for messages. Views whose
    error is 5 robust standard deviations (1.4826 times the median absolute deviation) above the
    median, and 1.6 times it, are removed, the worst first. Raises BadInput if too few views remain,
    or they do not determine the focal length, as boards parallel to the sensor do not (section 4).
    """
    views = [np.asarray(corners, dtype=np.float64) for corners in corner_sets]
    names = list(names) if names is not None else [f"view {k}" for k in range(len(views))]
    kept, repeated = _without_repeats(views, names)
    _require_enough(len(kept), len(views), f" ({len(repeated)} of them twice)" if repeated else "")
    rejected: dict[str, float] = {}
    while True:
        lens = fit_lens(board.points_mm, [views[k] for k in kept], image_size)
        worst, middle = int(np.argmax(lens.view_rms_px)), float(np.median(lens.view_rms_px))
        spread = deviation(lens.view_rms_px - middle)
        if not lens.view_rms_px[worst] > max(middle + 5.0 * spread, 1.6 * middle):
            break
        rejected[names[kept[worst]]] = float(lens.view_rms_px[worst])
        del kept[worst]
        removed = ", ".join(f"{name} ({error:.2f} px)" for name, error in rejected.items())
        _require_enough(
            len(kept), len(views), f" (the error of {removed} is far above the others')"
        )
    tilts = np.degrees(np.arccos(np.clip(-lens.normals[:, 2], -1, 1)))
    variety = float(np.degrees(np.arccos(np.clip(lens.normals @ lens.normals.T, -1, 1)).max()))
    # Part of the picture, in an 8 x 8 grid, that holds a corner or lies between ones that do
    places = np.clip(
        np.concatenate([views[k] for k in kept])[:, ::-1] * 8 / image_size, 0, 7
    ).astype(int)
    cells = np.zeros((8, 8), dtype=bool)
    cells[tuple(places.T)] = True
    across = (
        np.maximum.accumulate(cells, axis=1)
        & np.maximum.accumulate(cells[:, ::-1], axis=1)[:, ::-1]
    )
    coverage = float(across.mean())
    findings = _judged(lens, tilts, variety, coverage)
    used = tuple(names[k] for k in kept)
    return CameraCalibration(lens, used, rejected, repeated, tilts, variety, coverage, findings)


def _without_repeats(views: list[Array], names: list[str]) -> tuple[list[int], dict[str, str]]:
    kept: list[int] = []
    repeated: dict[str, str] = {}
    for k, view in enumerate(views):
        for earlier in kept:
            # a board that is named from its other end is the same one
            both = (views[earlier], views[earlier][::-1])
            apart = min(float(np.sqrt(((view - there) ** 2).sum(axis=1).mean())) for there in both)
            if apart < 0.3:  # px rms: one view, photographed twice
                repeated[names[k]] = names[earlier]
                break
        else:
            kept.append(k)
    return kept, repeated


MIN_VIEWS = 5


def _require_enough(count: int, total: int, why: str) -> None:
    require(
        count >= MIN_VIEWS,
        f"only {count} of {total} photographs of the board can be used{why}, but {MIN_VIEWS} are"
        " needed and 15 are advised; take more, the board tilted differently in each.",
    )


_MIN_VARIETY_DEG = 10.0  # between two of the boards' normals


def _judged(lens: _LensFit, tilts: Array, variety: float, coverage: float) -> tuple[Finding, ...]:
    """Findings; raises BadInput if the views determine too little."""
    ratio = float(lens.matrix[0, 0] / lens.matrix[1, 1])
    require(
        abs(ratio - 1) < 0.02,
        f"the pixels come out as no squares (fx / fy = {ratio:.3f}): the photographs were"
        " stretched, or the printed squares are none; measure the print along both sides, and use"
        " the camera's own images.",
    )
    relative = lens.deviations["fx"] / lens.matrix[0, 0]
    tilted = (
        f"the boards' tilts are {tilts.min():.0f} to {tilts.max():.0f} deg, {variety:.0f} deg apart"
        " at most"
    )
    remedy = "tilt the board by 20 to 40 deg to several sides"
    if relative > 0.01:
        if variety < _MIN_VARIETY_DEG:
            raise BadInput(
                f"the boards all lie nearly parallel ({tilted}); then focal length and distance"
                f" cannot be separated (the focal length is uncertain by {100 * relative:.1f} %);"
                f" {remedy}."
            )
        raise BadInput(
            f"the photographs leave the focal length uncertain by {100 * relative:.1f} % ({tilted};"
            f" the corners miss their places by {lens.rms_px:.2f} px); {remedy}, let it fill the"
            " picture, and hold it still."
        )
    findings = []
    if relative > 0.003:  # the goal of the camera's calibration
        words = f"the focal length is uncertain by {100 * relative:.2f} % ({tilted}); {remedy}."
        findings.append(Finding("uncertain-focal-length", words, Severity.DOUBT))
    elif variety < _MIN_VARIETY_DEG:
        words = f"the boards lie nearly parallel ({tilted}); {remedy}."
        findings.append(Finding("parallel-boards", words))
    if "principal point" in lens.fixed:
        words = f"the principal point is not determined ({lens.fixed['principal point']})."
        findings.append(Finding("held-principal-point", words))
    if coverage < 0.5:
        words = (
            f"the boards cover {100 * coverage:.0f} % of the picture; outside them the distortion"
            " is a guess: let the board reach into every corner."
        )
        findings.append(Finding("uncovered-picture", words, Severity.DOUBT))
    return tuple(findings)
