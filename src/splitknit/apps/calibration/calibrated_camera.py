"""What ``splitknit calibrate camera`` does: photographs of a checkerboard in, the camera of a rig file out."""

from __future__ import annotations

import fnmatch
import hashlib
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.apps.calibration.camera_facts import facts_of, rig_provenance
from splitknit.apps.targets import check_rig_file
from splitknit.calibration import Board, find_board, size_in_view
from splitknit.calibration.camera import CameraCalibration, CameraSettings, calibrate_camera
from splitknit.calibration.depth_of_field import DepthOfField, depth_of_field
from splitknit.calibration.disc import find_disc
from splitknit.calibration.plane import PlanePose, PlaneScale, mean_pose, plane_pose, plane_scale
from splitknit.errors import BadInput, read_bytes, require
from splitknit.io import file_hash, read_rig, write_rig
from splitknit.io.images import DEFAULTS, decode_image
from splitknit.model import Camera, PixelArray, Rig
from splitknit.simulator.rig import default_rig

Progress = Callable[[str, float], None]
_SENSOR_COLUMNS = 3280
_UNBINNED_COLUMNS = 1920


@dataclass(frozen=True, slots=True)
class CameraJob:
    """What is asked for; see ``splitknit calibrate camera --help``."""

    out: Path
    folder: Path | None = None
    board: str = "9x6"
    square_mm: float = 3.0
    pattern: str | None = None
    rig: Path | None = None
    plane: tuple[Path, ...] = ()
    disc: Path | None = None
    dot_mm: float = 10.0
    sensor_pixel_um: float = 1.12
    binning: float | None = None
    f_number: float = 2.0
    finger_depth_mm: float = 8.0
    calibrated_at: str | None = None
    """ISO 8601."""


@dataclass(frozen=True, slots=True, eq=False)
class FoundCamera:
    """All that was found."""

    camera: Camera
    fit: CameraCalibration | None
    boardless: tuple[str, ...]
    poses: dict[str, PlanePose]
    """Pose of the finger plane by the image that shows it."""
    pose: PlanePose | None
    scale: PlaneScale | None
    """Of an orthographic camera."""
    sharpness: DepthOfField | None
    binning: float
    hashes: dict[str, str]
    warnings: tuple[str, ...]


def calibrate_to_rig(job: CameraJob, progress: Progress = lambda stage, share: None) -> dict[str, Any]:
    """Calibrate, write the rig file, return the facts.

    Raises
    ------
    BadInput
        Naming the file or the option at fault; nothing is written.
    """
    require(
        job.folder is not None or len(job.plane) > 0 or job.disc is not None,
        "give a FOLDER of photographs of a checkerboard, --plane or --disc: there is nothing to calibrate from.",
    )
    check_rig_file(job.out)
    base = read_rig(job.rig) if job.rig is not None else None
    found = find_camera(job, base, progress)
    progress("writing", 0.97)
    leds = base.leds if base is not None else default_rig().leds
    before = dict(base.provenance) if base is not None else {"source": "nominal: the thesis's drawing"}
    facts = facts_of(job, found, nominal_leds=base is None)
    mirrors = base.mirrors if base is not None else ()
    provenance = {**before, "camera": rig_provenance(facts, found.hashes)}
    write_rig(Rig(found.camera, leds, provenance, mirrors), job.out)
    return facts


def find_camera(job: CameraJob, base: Rig | None, progress: Progress) -> FoundCamera:
    """Everything but the file."""
    board = Board.named(job.board, job.square_mm)
    fit: CameraCalibration | None = None
    boardless: tuple[str, ...] = ()
    hashes: dict[str, str] = {}
    size: tuple[int, int] | None = base.camera.image_size if base is not None else None
    expected_by = str(job.rig)
    if job.folder is not None:
        files = image_files(job.folder, job.pattern)
        photos = board_photos(
            job.folder, files, board, size, expected_by, lambda share: progress("finding corners", 0.85 * share)
        )
        size, expected_by, hashes = photos.image_size, files[0].name, dict(photos.hashes)
        progress("fitting", 0.86)
        names, corners = list(photos.corners), list(photos.corners.values())
        try:
            fit = calibrate_camera(corners, board, size, names, CameraSettings())
        except BadInput as error:
            raise BadInput(f"{job.folder}: {error}") from error
        boardless = photos.without
    marks = {}
    for file in job.plane:
        marks[file.name], size, expected_by = _same(
            plane_marks(file, board, size, expected_by), size, expected_by, file
        )
    if job.disc is not None:
        found = disc_marks(job.disc, job.dot_mm, size, expected_by)
        marks[job.disc.name], size, expected_by = _same(found, size, expected_by, job.disc)
    for file in (*job.plane, *([job.disc] if job.disc is not None else [])):
        hashes[file.name] = file_hash(file)
    assert size is not None
    progress("measuring the plane", 0.95)
    return _assembled(job, base, size, fit, boardless, marks, hashes)


def _same(found: Any, size: Any, expected_by: str, file: Path) -> tuple[Any, tuple[int, int], str]:
    places_mm, places_px, image_size = found
    return (places_mm, places_px), image_size, expected_by if size is not None else file.name


def _assembled(  # noqa: PLR0917 - what was read, in order
    job: CameraJob,
    base: Rig | None,
    size: tuple[int, int],
    fit: CameraCalibration | None,
    boardless: tuple[str, ...],
    marks: dict[str, Any],
    hashes: dict[str, str],
) -> FoundCamera:
    """Camera, plane, depth of field."""
    old = base.camera if base is not None else Camera(75.7, size)
    warnings = list(fit.warnings) if fit is not None else []
    poses: dict[str, PlanePose] = {}
    pose, scale, sharpness = None, None, None
    if fit is None and old.model == "orthographic":
        scale = _mean_scale([plane_scale(*one) for one in marks.values()])
        camera = replace(old, px_per_mm=scale.px_per_mm, image_size=size)
    else:
        camera = replace(
            old,
            model="perspective",
            image_size=size,
            matrix=fit.lens.matrix if fit is not None else old.matrix,
            distortion=fit.lens.distortion if fit is not None else old.distortion,
        )
        assert camera.matrix is not None
        focal = float(np.sqrt(camera.matrix[0, 0] * camera.matrix[1, 1]))
        for name, (places_mm, places_px) in marks.items():
            poses[name] = plane_pose(places_mm, places_px, camera.matrix, camera.distortion)
        pose = mean_pose(list(poses.values()), focal) if poses else None
        height = pose.height_mm if pose is not None else old.height_mm
        camera = replace(camera, height_mm=height, px_per_mm=focal / height)
        pixel_um = job.sensor_pixel_um * _binning(job, size[1])
        require(0.1 <= job.sensor_pixel_um <= 100, "--sensor-pixel-um must be from 0.1 to 100 micrometres.")
        require(0.3 <= job.f_number <= 128, "--aperture must be an f-number from 0.3 to 128.")
        require(0 < job.finger_depth_mm < height, "--finger-depth-mm must be positive and below the camera's height.")
        sharpness = depth_of_field(focal, pixel_um, job.f_number, height, finger_depth_mm=job.finger_depth_mm)
    return FoundCamera(
        camera, fit, boardless, poses, pose, scale, sharpness, _binning(job, size[1]), hashes, tuple(warnings)
    )


def _mean_scale(scales: list[PlaneScale]) -> PlaneScale:
    weight = np.array([1 / max(one.deviation, 1e-12) ** 2 for one in scales])
    mean = float(np.sum(weight * [one.px_per_mm for one in scales]) / weight.sum())
    return PlaneScale(
        mean,
        float(np.sqrt(np.mean([one.rms_px**2 for one in scales]))),
        float(1 / np.sqrt(weight.sum())),
        max(one.anisotropy for one in scales),
    )


def _binning(job: CameraJob, columns: int) -> float:
    """Sensor pixels along a pixel of the image: the IMX219 bins below 1920 columns, and crops above."""
    if job.binning is not None:
        require(1 <= job.binning <= 64, "--binning must be from 1 to 64.")
        return job.binning
    return 1.0 if columns >= _UNBINNED_COLUMNS else max(1.0, float(round(_SENSOR_COLUMNS / columns)))


# Photographs of checkerboard and disc: reading them, and finding what they show.

Points = NDArray[np.float64]
SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff")
LEAST = 5
_LOOKED_AT = 6
"""Photographs in which a board of another size is sought."""


@dataclass(frozen=True, slots=True, eq=False)
class BoardPhotos:
    """Corners in photographs of one size."""

    image_size: tuple[int, int]
    corners: Mapping[str, Points]
    """By the file's name."""
    without: tuple[str, ...]
    """Files in which no board of the size is in full view."""
    hashes: Mapping[str, str]


def image_files(folder: Path, pattern: str | None = None) -> list[Path]:
    """Images in `folder`, in the order that people count, only those whose name fits the glob `pattern` if given.

    A pattern such as ``board_*/white_0.png`` takes images of capture folders inside `folder`.
    """
    require(folder.is_dir(), f"'{folder}' is not a folder; name the folder of checkerboard photographs.")
    levels = "/".join("*" * (1 if pattern is None else 1 + pattern.count("/")))
    files = [file for file in folder.glob(levels) if file.is_file() and file.suffix.lower() in SUFFIXES]
    files = [file for file in files if not file.name.startswith(".")]
    count = len(files)
    if pattern is not None:
        files = [file for file in files if fnmatch.fnmatchcase(_label(file, folder), pattern)]
        require(
            bool(files),
            f"no image in '{folder}' fits the pattern '{pattern}' ({count} images are there); "
            "quote the pattern and compare it with the files' names.",
        )
    require(bool(files), f"'{folder}' holds no images (PNG, JPEG or TIFF); put the checkerboard photographs there.")
    return sorted(files, key=lambda file: [(len(p), p) for p in re.findall(r"\d+|\D+", _label(file, folder))])


def _label(file: Path, folder: Path) -> str:
    """How a photograph is called: its path in the folder."""
    return file.relative_to(folder).as_posix()


def read_photo(path: Path, size: tuple[int, int] | None, expected_by: str) -> tuple[PixelArray, str]:
    """Pixels and SHA-256 of an image that must have `size` (rows, columns), if one is expected."""
    data = read_bytes(path, DEFAULTS.max_bytes)
    pixels = decode_image(data, str(path))
    if size is not None:
        require(
            pixels.shape[:2] == size,
            f"{path} has {pixels.shape[0]} x {pixels.shape[1]} pixels (rows x columns), but {expected_by} has "
            f"{size[0]} x {size[1]}; photograph everything with the camera's one setting.",
        )
    return pixels, hashlib.sha256(data).hexdigest()


def board_photos(  # noqa: PLR0917
    folder: Path,
    files: Sequence[Path],
    board: Board,
    size: tuple[int, int] | None,
    expected_by: str,
    progress: Callable[[float], None],
) -> BoardPhotos:
    """Find the board in every photograph.

    Raises
    ------
    BadInput
        If a file is no image, sizes differ, or too few photographs show the board: then with the size of the board that
        they do show, where one is found.
    """
    corners: dict[str, Points] = {}
    hashes: dict[str, str] = {}
    without: list[Path] = []
    for k, file in enumerate(files):
        progress(k / len(files))
        pixels, hashes[_label(file, folder)] = read_photo(file, size, expected_by)
        if size is None:
            size, expected_by = (pixels.shape[0], pixels.shape[1]), _label(file, folder)
        found = _found(file, find_board, pixels, board)
        if found is None:
            without.append(file)
        else:
            corners[_label(file, folder)] = found
        if not corners and len(without) == _LOOKED_AT:
            _refuse_other_size(without, board)
    assert size is not None
    if len(corners) < LEAST:
        _refuse_other_size(without, board)
        named = ", ".join(_label(file, folder) for file in without[:4]) + (" and more" if len(without) > 4 else "")
        missing = f" (not in {named})" if without else ""
        raise BadInput(
            f"{folder}: a checkerboard of {board.columns} x {board.rows} inner corners is in full view in "
            f"{len(corners)} of {len(files)} photographs{missing}, but {LEAST} are needed and 15 are advised; "
            "take more, the board tilted differently in each."
        )
    return BoardPhotos(size, corners, tuple(_label(file, folder) for file in without), hashes)


def plane_marks(
    file: Path, board: Board, size: tuple[int, int] | None, expected_by: str
) -> tuple[Points, Points, tuple[int, int]]:
    """Places of the board's corners in mm and in the image, and the image's size."""
    pixels, _ = read_photo(file, size, expected_by)
    corners = _found(file, find_board, pixels, board)
    if corners is None:
        _refuse_other_size([file], board)
        raise BadInput(
            f"{file} shows no checkerboard of {board.columns} x {board.rows} inner corners in full view; "
            "lay the board flat on the finger plane, evenly lit, and photograph it again."
        )
    return board.points_mm, corners, (pixels.shape[0], pixels.shape[1])


def disc_marks(
    file: Path, spacing_mm: float, size: tuple[int, int] | None, expected_by: str
) -> tuple[Points, Points, tuple[int, int]]:
    """Places of the disc's dots in mm and in the image, and the image's size."""
    pixels, _ = read_photo(file, size, expected_by)
    places_mm, places_px = _found(file, find_disc, pixels, spacing_mm)
    return places_mm, places_px, (pixels.shape[0], pixels.shape[1])


def _found(file: Path, search: Callable[..., Any], *arguments: Any) -> Any:
    """Run a search that knows arrays only; let what it refuses name the file."""
    try:
        return search(*arguments)
    except BadInput as error:
        raise BadInput(f"{file}: {error}") from error


def _refuse_other_size(files: Sequence[Path], board: Board) -> None:
    """Refuse the board's size if photographs show a board of another."""
    sizes: Counter[tuple[int, int]] = Counter()
    for file in files[:_LOOKED_AT]:
        try:
            seen = size_in_view(read_photo(file, None, "")[0])
        except BadInput:
            continue
        if seen is not None:
            sizes[seen] += 1
    if not sizes:
        return
    (size, count), *_ = sizes.most_common(1)
    asked = max(board.size), min(board.size)
    if size != asked and (count > 1 or len(files) == 1):
        raise BadInput(
            f"{files[0]} shows a checkerboard of {size[0]} x {size[1]} inner corners, not of {board.columns} x "
            f"{board.rows}; say --board {size[0]}x{size[1]}, or photograph the whole board."
        )
