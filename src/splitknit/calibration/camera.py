"""Camera calibration from views of one checkerboard: what is fitted, what is rejected, what the views cannot tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.calibration.board import Board
from splitknit.calibration.lens_model import LensFit, LensSettings, fit_lens
from splitknit.errors import BadInput, require

Points = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class CameraSettings:
    """What views must be like."""

    least_views: int = 5
    """Views that must remain."""
    outlier_spread: float = 5.0
    """A view is rejected if its error exceeds the median by this many times the robust spread of all errors ..."""
    outlier_ratio: float = 1.6
    """... and by this factor."""
    same_px: float = 0.3
    """Views whose corners differ by less than this (rms) are one view, photographed twice."""
    focal_refused: float = 0.01
    """Relative standard deviation of the focal length from which views are refused."""
    focal_warned: float = 0.003
    """The same, from which there is a warning."""
    aspect_refused: float = 0.02
    """Difference of fx / fy from one that is refused: sensors have square pixels."""
    tilt_deg: float = 10.0
    """Views should hold boards whose normals differ by more than this."""
    coverage: float = 0.5
    """Part of the picture that the corners of all views together should span."""
    lens: LensSettings = field(default_factory=LensSettings)

    def __post_init__(self) -> None:
        require(self.least_views >= 3, "CameraSettings: least_views must be at least 3.")
        require(self.outlier_spread > 0 and self.outlier_ratio >= 1, "CameraSettings: the outlier rule is too narrow.")
        require(
            0 < self.focal_warned <= self.focal_refused, "CameraSettings: focal_warned must not exceed the refusal."
        )


@dataclass(frozen=True, slots=True, eq=False)
class CameraCalibration:
    """A calibrated camera, with what it rests on."""

    lens: LensFit
    image_size: tuple[int, int]
    """Rows, columns."""
    used: tuple[str, ...]
    """Names of the views that were fitted; `lens.view_rms_px` is in their order."""
    rejected: dict[str, float]
    """Views with too large an error: that error in pixels, when it was rejected."""
    repeated: dict[str, str]
    """Views that show the same as another, and that other."""
    tilts_deg: NDArray[np.float64]
    """(V,) angle between each board and the sensor."""
    variety_deg: float
    """Largest angle between two boards."""
    coverage: float
    """Part of the picture that the corners span."""
    warnings: tuple[str, ...]


DEFAULTS = CameraSettings()


def calibrate_camera(
    corner_sets: Sequence[Any],
    board: Board,
    image_size: tuple[int, int],
    names: Sequence[str] | None = None,
    settings: CameraSettings = DEFAULTS,
) -> CameraCalibration:
    """Calibrate a camera by Zhang's method, with rejection of bad views.

    Views with an error far above the others' are taken out, the worst first, and the rest is fitted again: far is more
    than `outlier_spread` robust standard deviations (1.4826 times the median absolute deviation) above the median, and
    `outlier_ratio` times the median.

    Parameters
    ----------
    corner_sets : V arrays (N, 2), column and row of the board's corners, in the order of `board.points_mm`
    board : Board
    image_size : rows, columns
    names : V names for messages
    settings : CameraSettings

    Returns
    -------
    CameraCalibration

    Raises
    ------
    BadInput
        If too few views remain, or the views do not determine the focal length: boards that all lie parallel to the
        sensor look the same to a long lens far away as to a short one near by.

    References
    ----------
    Z. Zhang, "A flexible new technique for camera calibration", IEEE TPAMI 22(11), 2000; section 4 names the degenerate
    configurations.
    """
    views = [_checked(one, board) for one in corner_sets]
    names = list(names) if names is not None else [f"view {k}" for k in range(len(views))]
    require(len(names) == len(views), f"{len(names)} names for {len(views)} views.")
    kept, repeated = _without_repeats(views, names, settings.same_px)
    _require_enough(len(kept), len(views), settings, f" ({len(repeated)} of them twice)" if repeated else "")
    rejected: dict[str, float] = {}
    while True:
        lens = fit_lens(board.points_mm, [views[k] for k in kept], image_size, settings.lens)
        worst = _outlier(lens.view_rms_px, settings)
        if worst is None:
            break
        rejected[names[kept[worst]]] = float(lens.view_rms_px[worst])
        del kept[worst]
        shown = ", ".join(f"{name} ({error:.2f} px)" for name, error in rejected.items())
        _require_enough(len(kept), len(views), settings, f" (the error of {shown} is far above the others')")
    tilts = np.degrees(np.arccos(np.clip(-lens.normals[:, 2], -1, 1)))
    variety = float(np.degrees(np.arccos(np.clip(lens.normals @ lens.normals.T, -1, 1)).max()))
    coverage = _coverage(np.concatenate([views[k] for k in kept]), image_size)
    warnings = _judged(lens, tilts, variety, coverage, settings)
    used = tuple(names[k] for k in kept)
    return CameraCalibration(lens, image_size, used, rejected, repeated, tilts, variety, coverage, warnings)


def _checked(corners: Any, board: Board) -> Points:
    array = np.asarray(corners, dtype=np.float64)
    count = board.columns * board.rows
    require(
        array.shape == (count, 2) and bool(np.isfinite(array).all()),
        f"the corners of a view must be finite and of the shape ({count}, 2), but the shape is {array.shape}.",
    )
    return array


def _without_repeats(views: list[Points], names: list[str], same_px: float) -> tuple[list[int], dict[str, str]]:
    kept: list[int] = []
    repeated: dict[str, str] = {}
    for k, view in enumerate(views):
        for other in kept:
            # a board that is named from its other end is the same one
            apart = min(float(np.sqrt(((view - there) ** 2).sum(axis=1).mean())) for there in _orders(views[other]))
            if apart < same_px:
                repeated[names[k]] = names[other]
                break
        else:
            kept.append(k)
    return kept, repeated


def _orders(view: Points) -> tuple[Points, Points]:
    return view, view[::-1]


def _require_enough(count: int, given: int, settings: CameraSettings, why: str) -> None:
    require(
        count >= settings.least_views,
        f"only {count} of {given} photographs of the board can be used{why}, but {settings.least_views} are needed "
        "and 15 are advised; take more, the board tilted differently in each.",
    )


def _outlier(errors: NDArray[np.float64], settings: CameraSettings) -> int | None:
    """Index of the worst view if it lies outside what the others do."""
    worst = int(np.argmax(errors))
    middle = float(np.median(errors))
    spread = 1.4826 * float(np.median(np.abs(errors - middle)))
    limit = max(middle + settings.outlier_spread * spread, settings.outlier_ratio * middle)
    return worst if errors[worst] > limit else None


def _coverage(corners: Points, image_size: tuple[int, int]) -> float:
    """Part of the picture, in an 8 x 8 grid, that holds a corner or lies between ones that do."""
    rows, columns = image_size
    i = np.clip(corners[:, 1] * 8 / rows, 0, 7).astype(int)
    j = np.clip(corners[:, 0] * 8 / columns, 0, 7).astype(int)
    cells = np.zeros((8, 8), dtype=bool)
    cells[i, j] = True
    across = np.maximum.accumulate(cells, axis=1) & np.maximum.accumulate(cells[:, ::-1], axis=1)[:, ::-1]
    return float(across.mean())


def _judged(
    lens: LensFit, tilts: NDArray[np.float64], variety: float, coverage: float, settings: CameraSettings
) -> tuple[str, ...]:
    """Warnings, or the refusal of views that tell too little."""
    ratio = float(lens.matrix[0, 0] / lens.matrix[1, 1])
    require(
        abs(ratio - 1) < settings.aspect_refused,
        f"the pixels come out as no squares (fx / fy = {ratio:.3f}): the photographs were stretched, or the printed "
        "squares are none; measure the print along both sides, and use the camera's own images.",
    )
    relative = lens.deviations["fx"] / lens.matrix[0, 0]
    tilted = f"the boards' tilts are {tilts.min():.0f} to {tilts.max():.0f} deg, {variety:.0f} deg apart at most"
    remedy = "tilt the board by 20 to 40 deg to several sides"
    if relative > settings.focal_refused:
        if variety < settings.tilt_deg:
            raise BadInput(
                f"the boards all lie nearly parallel ({tilted}), and then focal length and distance cannot be told "
                f"apart (the focal length is uncertain by {100 * relative:.1f} %); {remedy}."
            )
        raise BadInput(
            f"the photographs leave the focal length uncertain by {100 * relative:.1f} % ({tilted}; the corners miss "
            f"their places by {lens.rms_px:.2f} px); {remedy}, let it fill the picture, and hold it still."
        )
    warnings = []
    if relative > settings.focal_warned:
        warnings.append(f"the focal length is uncertain by {100 * relative:.2f} % ({tilted}); {remedy}.")
    elif variety < settings.tilt_deg:
        warnings.append(f"the boards lie nearly parallel ({tilted}); {remedy}.")
    if "principal point" in lens.fixed:
        warnings.append(f"the principal point is not determined ({lens.fixed['principal point']}).")
    if coverage < settings.coverage:
        warnings.append(
            f"the boards cover {100 * coverage:.0f} % of the picture; outside them the distortion is a guess: "
            "let the board reach into every corner."
        )
    return tuple(warnings)
