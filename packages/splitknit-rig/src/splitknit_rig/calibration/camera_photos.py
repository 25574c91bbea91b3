"""From photographs of a checkerboard to the camera of a rig file."""

from __future__ import annotations

import fnmatch
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from splitknit import BadInput, Camera, Rig, read_rig, write_rig
from splitknit.arguments import text_of
from splitknit.errors import naming, require
from splitknit.findings import Finding, Severity, worst_first
from splitknit.io.photograph_files import natural_order
from splitknit.io.provenance import provenance
from splitknit.model import Array, PixelArray, Progress, no_progress
from splitknit.nominal import default_rig
from splitknit.plausible import CAMERA_HEIGHT
from splitknit_rig.calibration.camera import MIN_VIEWS, CameraCalibration, fit_camera
from splitknit_rig.calibration.nail_photos import SUFFIXES, image_of_size
from splitknit_rig.calibration.plane import PlanePose, mean_pose, plane_pose
from splitknit_rig.calibration.targets import Board, find_board
from splitknit_rig.calibration.words import camera_lines
from splitknit_rig.calibration.written import check_rig_file


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredCamera:
    """A camera measured with photographs of targets; None for what they do not determine."""

    out: Path
    """The rig file that was written."""
    board: Board
    """The checkerboard in the photographs."""
    camera: Camera
    """As written to the rig file."""
    fit: CameraCalibration | None
    """The fitted lens and poses of a checkerboard."""
    poses: Mapping[str, PlanePose]
    """Pose of the finger plane, by name of the image that shows it."""
    pose: PlanePose | None
    """Their mean."""
    findings: tuple[Finding, ...]
    calibrated_at: str
    """ISO 8601."""
    leds_nominal: bool = False
    """Whether the rig file's LEDs are those of the drawing, because no rig was given."""
    boardless: tuple[str, ...] = ()
    """Photographs in which no board is in full view."""

    @property
    def facts(self) -> dict[str, Any]:
        """All that was measured, as plain JSON."""
        camera = self.camera
        lens = (
            ["camera.matrix", "camera.distortion", "camera.image_size"]
            if self.fit is not None
            else []
        )
        plane = ["camera.px_per_mm", "camera.height_mm"]
        leds = ["leds"] if self.leds_nominal else []
        return {
            "out": str(self.out),
            "calibrated_at": self.calibrated_at,
            "model": camera.model,
            "image_size": list(camera.image_size),
            "matrix": None if camera.matrix is None else np.asarray(camera.matrix).tolist(),
            "distortion": None if camera.distortion is None else list(camera.distortion),
            "height_mm": camera.height_mm,
            "px_per_mm": camera.px_per_mm,
            "board": {"inner_corners": self.board.name, "square_mm": self.board.square_mm},
            "fit": None if self.fit is None else _fit_facts(self.fit, self.boardless),
            "plane": None if self.pose is None else _plane_facts(self.pose, self.poses, self.fit),
            "measured": lens if self.pose is None else lens + plane,
            "nominal": plane + leds if self.pose is None else leds,
            "findings": [finding.facts for finding in self.findings],
        }

    def __str__(self) -> str:
        return text_of(camera_lines(self.facts))


def calibrate_to_rig(
    folder: Path | None,
    out: Path,
    board: Board,
    *,
    plane: Sequence[Path] = (),
    rig: Path | None = None,
    pattern: str | None = None,
    calibrated_at: str | None = None,
    progress: Progress = no_progress,
) -> MeasuredCamera:
    """Calibrate, and write the rig file. BadInput names the file or argument at fault; nothing is
    then written."""
    require(
        folder is not None or len(plane) > 0,
        "give a FOLDER of photographs of a checkerboard, or `plane`: there is nothing to calibrate"
        " from.",
    )
    check_rig_file(out)
    base = read_rig(rig) if rig is not None else None
    photos = _Photos(None if base is None else (base.camera.image_size, str(rig)))
    fit: CameraCalibration | None = None
    boardless: tuple[str, ...] = ()
    if folder is not None:
        files = _image_files(folder, pattern)
        corners, boardless = _board_photos(
            photos, folder, files, board, lambda part: progress("finding corners", 0.85 * part)
        )
        progress("fitting", 0.86)
        fit = naming(
            folder, partial(fit_camera, list(corners.values()), board, photos.size, list(corners))
        )
    marks = {file.name: _plane_marks(photos, file, board) for file in plane}
    progress("measuring the plane", 0.95)
    nominal = Camera(75.7, photos.size) if base is None else base.camera
    require(
        fit is not None or nominal.model == "perspective",
        "`plane` alone measures the height of a camera whose lens is known; give FOLDER too, or a"
        " `rig` with its matrix.",
    )
    lens: dict[str, Any] = {}
    findings: list[Finding] = []
    if fit is not None:
        lens = {"matrix": fit.lens.matrix, "distortion": fit.lens.distortion}
        findings += fit.findings
    camera = replace(nominal, model="perspective", image_size=photos.size, **lens)
    poses = {
        name: plane_pose(board.points_mm, px, camera.matrix, camera.distortion)
        for name, px in marks.items()
    }
    assert camera.matrix is not None
    focal_px = float(np.sqrt(camera.matrix[0, 0] * camera.matrix[1, 1]))
    pose = mean_pose(list(poses.values()), focal_px) if poses else None
    height = nominal.height_mm if pose is None else pose.height_mm
    camera = replace(camera, height_mm=height, px_per_mm=focal_px / height)
    if pose is not None:
        remedy = "check the side of the board's squares (`square_mm`)"
        findings += CAMERA_HEIGHT.notes(height, remedy)
        if base is not None and not 0.6 < height / nominal.height_mm < 1.6:
            words = (
                f"the camera is {height:.0f} mm high, by {rig} {nominal.height_mm:.0f} mm:"
                f" {remedy}."
            )
            findings.append(Finding("other-camera-height", words, Severity.DOUBT))
        findings += _plane_findings(camera, poses, pose)
    elif fit is not None:
        words = (
            f"px_per_mm rests on a height of {height:g} mm that was not measured; photograph the"
            " board flat on the finger plane (`plane`)."
        )
        findings.append(Finding("unmeasured-height", words))
    now = calibrated_at or datetime.now(UTC).isoformat(timespec="seconds").replace("+00:00", "Z")
    measured = MeasuredCamera(
        out, board, camera, fit, poses, pose, worst_first(findings), now, base is None, boardless
    )
    progress("writing", 0.97)
    facts = measured.facts
    stored = {name: facts[name] for name in ("calibrated_at", "measured", "nominal", "findings")}
    residuals = {"fit": facts["fit"], "plane": facts["plane"]}
    origin = {
        **stored,
        "residuals": residuals,
        **provenance({"board": facts["board"]}, photos.hashes),
    }
    start = base or Rig(camera, default_rig().leds, {"source": "nominal: the thesis's drawing"})
    write_rig(replace(start, camera=camera, provenance={**start.provenance, "camera": origin}), out)
    return measured


# Photographs of checkerboards: reading them, and finding what they show.


def _image_files(folder: Path, pattern: str | None = None) -> list[Path]:
    """Images in `folder`, in natural order (2 before 10), or in its capture folders by a glob
    `pattern`."""
    require(
        folder.is_dir(), f"'{folder}' is not a folder; name the folder of checkerboard photographs."
    )
    levels = "/".join("*" * (1 if pattern is None else 1 + pattern.count("/")))
    files = [
        file for file in folder.glob(levels) if file.is_file() and file.suffix.lower() in SUFFIXES
    ]
    files = [file for file in files if not file.name.startswith(".")]
    count = len(files)
    if pattern is not None:
        files = [file for file in files if fnmatch.fnmatchcase(_label(file, folder), pattern)]
        require(
            files,
            f"no image in '{folder}' fits the pattern '{pattern}' ({count} images are there); "
            "quote the pattern and compare it with the files' names.",
        )
    require(
        files,
        f"'{folder}' holds no images (PNG, JPEG or TIFF); put the checkerboard photographs there.",
    )
    return sorted(files, key=lambda file: natural_order(_label(file, folder)))


def _label(file: Path, folder: Path) -> str:
    """Name of a photograph in messages: its path in the folder."""
    return file.relative_to(folder).as_posix()


class _Photos:
    """Reads photographs, all of one size, and keeps their SHA-256 by name."""

    def __init__(self, expected: tuple[tuple[int, int], str] | None) -> None:
        """Expect a size (rows, columns), with the name of what has it; None: that of the first
        photograph."""
        self._expected = expected
        self.hashes: dict[str, str] = {}

    @property
    def size(self) -> tuple[int, int]:
        """Rows, columns."""
        assert self._expected is not None
        return self._expected[0]

    def read(self, file: Path, name: str | None = None) -> PixelArray:
        """Pixels of an image, called `name` in messages."""
        size, reference = self._expected or (None, "")
        rows, columns = size or (0, 0)
        other = (
            f"{reference} has {rows} x {columns}; photograph everything with the camera's one"
            " setting"
        )
        pixels, self.hashes[name or file.name] = image_of_size(file, size, other)
        self._expected = self._expected or (pixels.shape[:2], name or file.name)
        return pixels


def _board_photos(
    photos: _Photos,
    folder: Path,
    files: Sequence[Path],
    board: Board,
    progress: Callable[[float], None],
) -> tuple[dict[str, Array], tuple[str, ...]]:
    """Corners by name, and photographs without the board. If too few show it, BadInput names the
    size of the board that they show."""
    corners: dict[str, Array] = {}
    boardless: list[str] = []
    for k, file in enumerate(files):
        progress(k / len(files))
        label = _label(file, folder)
        grid = naming(file, partial(find_board, photos.read(file, label), board))
        if grid is None:
            boardless.append(label)
        else:
            corners[label] = grid
    if len(corners) < MIN_VIEWS:
        named = ", ".join(boardless[:4]) + (" and more" if len(boardless) > 4 else "")
        missing = f" (not in {named})" if boardless else ""
        raise BadInput(
            f"{folder}: a checkerboard of {board.name} inner corners is in full view in"
            f" {len(corners)} of {len(files)} photographs{missing}, but {MIN_VIEWS} are needed and"
            " 15 are advised; compare `board` with the print (corners where four squares meet), or"
            " take more, each tilted differently."
        )
    return corners, tuple(boardless)


def _plane_marks(photos: _Photos, file: Path, board: Board) -> Array:
    """Pixels of the board's corners in the image."""
    corners = naming(file, partial(find_board, photos.read(file), board))
    if corners is None:
        raise BadInput(
            f"{file} shows no checkerboard of {board.name} inner corners in full view; compare"
            " `board` with the print (corners where four squares meet), or lay it flat and evenly"
            " lit, and photograph it again."
        )
    return corners


# What a camera's calibration measured, as facts for programs and as provenance for the rig file;
# its findings.


def _fit_facts(fit: CameraCalibration, boardless: Sequence[str]) -> dict[str, Any]:
    lens = fit.lens
    return {
        "rms_px": lens.rms_px,
        "images": len(fit.used),
        "per_image_px": dict(zip(fit.used, lens.view_rms_px.tolist(), strict=True)),
        "rejected_px": fit.rejected,
        "repeated": fit.repeated,
        "without_board": list(boardless),
        "focal_length_px": [float(lens.matrix[0, 0]), float(lens.matrix[1, 1])],
        "principal_point_px": lens.matrix[:2, 2].tolist(),
        "deviations": dict(lens.deviations),
        "fitted": list(lens.fitted),
        "held": dict(lens.fixed),
        "tilts_deg": [round(float(tilt), 2) for tilt in fit.tilts_deg],
        "variety_deg": fit.variety_deg,
        "coverage": fit.coverage,
    }


def _plane_facts(
    pose: PlanePose, poses: Mapping[str, PlanePose], fit: CameraCalibration | None
) -> dict[str, Any]:
    tilt_deviation = pose.deviations["tilt_deg"]
    if fit is not None:  # an axis that is off by one pixel is off by 1 / f
        axis_px = max(fit.lens.deviations.get("cx", 0.0), fit.lens.deviations.get("cy", 0.0))
        tilt_deviation = float(
            np.hypot(tilt_deviation, np.degrees(axis_px / float(fit.lens.matrix[0, 0])))
        )
    return {
        "height_mm": pose.height_mm,
        "height_mm_deviation": pose.deviations["height_mm"],
        "px_per_mm": pose.px_per_mm,
        "tilt_deg": pose.tilt_deg,
        "tilt_deg_deviation": tilt_deviation,
        "tilt_xy_deg": list(pose.tilt_xy_deg),
        "nearer_at": pose.nearer_side,
        "normal": pose.normal.tolist(),
        "rms_px": pose.rms_px,
        "per_image": {
            name: {
                "height_mm": single.height_mm,
                "tilt_deg": single.tilt_deg,
                "rms_px": single.rms_px,
            }
            for name, single in poses.items()
        },
    }


_FINGER_DEPTH_MM = 8.0
"""Of the finger that the camera sees."""


def _plane_findings(
    camera: Camera, poses: Mapping[str, PlanePose], pose: PlanePose
) -> list[Finding]:
    findings = []
    if pose.tilt_deg > 1.0:
        slope = math.tan(math.radians(pose.tilt_deg))
        reach = math.hypot(*camera.image_size) / 2 / camera.px_per_mm
        words = (
            f"the camera looks on the base obliquely by {pose.tilt_deg:.2f} deg: the picture's"
            f" corners lie up to {reach * slope:.2f} mm nearer or farther than its middle, which"
            f" displaces them by {reach**2 * slope / pose.height_mm:.2f} mm, and what stands"
            f" {_FINGER_DEPTH_MM:g} mm high leans by {_FINGER_DEPTH_MM * slope:.2f} mm; straighten"
            " the camera, or put something thin under the base."
        )
        findings.append(Finding("oblique-camera", words))
    heights = [single.height_mm for single in poses.values()]
    turns = [min(1.0, float(single.normal @ pose.normal)) for single in poses.values()]
    apart = float(np.degrees(np.arccos(turns)).max())
    if max(heights) - min(heights) > 0.003 * pose.height_mm or apart > 0.3:
        each = ", ".join(
            f"{name} {p.height_mm:.2f} mm, {p.tilt_deg:.2f} deg" for name, p in poses.items()
        )
        words = (
            f"the photographs of the finger plane disagree ({each}); the print lay uneven, or its"
            " scale is off."
        )
        findings.append(Finding("planes-disagree", words, Severity.DOUBT))
    if pose.rms_px > max(1.0, 0.01 * camera.px_per_mm):
        words = (
            f"the marks on the finger plane miss their places by {pose.rms_px:.2f} px: the print is"
            " not flat, or its marks are not where they should be."
        )
        findings.append(Finding("uneven-print", words, Severity.DOUBT))
    return findings
