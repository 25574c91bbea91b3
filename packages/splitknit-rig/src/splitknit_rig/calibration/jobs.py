"""Photographs in, a rig file out: what the verbs ``calibrate ...`` and their functions do."""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal

from splitknit import BadInput
from splitknit.errors import require
from splitknit.settings import Limits
from splitknit.verbs import AnyPath, Encoding, Help, Job, Positive, Progress, function_of, path

if TYPE_CHECKING:  # a job is read without what does the work
    from splitknit_rig.calibration.camera_photos import MeasuredCamera
    from splitknit_rig.calibration.lights_found import CalibratedLights
    from splitknit_rig.calibration.radiometry import RadiometricCalibration

_TARGET = "the printed target ('splitknit rig target' makes it)"
_SOURCE, _RIG, _NAIL, _PICTURES = "from what (one of them)", "the rig", "the nail", "photographs"
_RESIDUALS = Help("picture to write: residuals under every LED", "PNG")
_RIG_OUT = Help("rig file to write", "RIG2")


@dataclass(frozen=True, slots=True)
class CameraJob(Job):
    """Measure the camera from photographs of a checkerboard (Zhang).

    Returns
    -------
    MeasuredCamera
        ``camera`` as it is in the rig file, ``fit`` of the lens, ``pose`` of the finger plane, ``warnings``.

    Examples
    --------
    >>> import splitknit_rig
    >>> splitknit_rig.calibrate_camera("boards", "rig.json", board="9x6", square_mm=3.0)  # doctest: +SKIP

    References
    ----------
    Z. Zhang, "A flexible new technique for camera calibration", IEEE Trans. PAMI 22(11), 2000.
    """

    # fmt: off
    folder: Annotated[AnyPath | None, Help(
        "photographs of one board, tilted differently in each", "FOLDER", positional=True, nargs="?")]
    out: Annotated[AnyPath, Help("rig file to write", "FILE")]
    _: KW_ONLY
    rig: Annotated[AnyPath | None, Help("rig file whose other parts are kept", "FILE")] = None
    pattern: Annotated[str | None, Help(
        "only files of this name, such as 'left*.jpg', or 'board_*/white_0.png' in capture folders (default: all)",
        "GLOB")] = None
    board: Annotated[str, Help("inner corners each way", "CxR", group=_TARGET)] = "9x6"
    square_mm: Annotated[float, Help("side of a square, measured on the print", "N", group=_TARGET)] = 3.0
    plane: Annotated[tuple[AnyPath, ...], Help(
        "photograph of the board lying on the finger plane: camera height, scale, tilt; may be repeated", "IMAGE",
        group=_TARGET)] = ()
    calibrated_at: Annotated[str | None, Help("time of the calibration, ISO 8601; now by default",
        python_only=True)] = None
    # fmt: on

    def run(self, progress: Progress) -> MeasuredCamera:
        """Calibrate, and write the rig file."""
        from splitknit_rig.calibration.camera_photos import calibrate_to_rig
        from splitknit_rig.calibration.targets import Board

        return calibrate_to_rig(
            path(self.folder),
            path(self.out),
            Board.named(self.board, self.square_mm),
            plane=tuple(map(path, self.plane)),
            rig=path(self.rig),
            pattern=self.pattern,
            calibrated_at=self.calibrated_at,
            progress=progress,
        )


@dataclass(frozen=True, slots=True)
class LightsJob(Job):
    """Find where the LEDs are: from a nail's shadows, a ball, or the rig's drawing.

    Returns
    -------
    CalibratedLights
        ``leds`` with directions, positions, intervals and verdicts; ``rig``; ``warnings``.

    Raises
    ------
    BadInput
        Naming the file or argument at fault; nothing is written. ``Refused``, whose facts hold what was found, if that
        is not good enough.

    Examples
    --------
    >>> import splitknit_rig
    >>> drawn = {"px_per_cm": 378.5, "image_size": "1100,1600", "led_height_cm": 14.0, "led_radius_cm": 5.25}
    >>> len(splitknit_rig.calibrate_lights("rig.json", geometry=True, **drawn).leds)
    14
    """

    # fmt: off
    out: Annotated[AnyPath | None, Help(
        "rig file (.json) or list of lights (.txt) to write; 'splitknit reconstruct' takes both as lights of "
        "photographs (default: none, only report what was found)", "FILE")] = None
    _: KW_ONLY
    table: Annotated[AnyPath | None, Help("nail and shadow tips, typed", "CSV", group=_SOURCE)] = None
    images: Annotated[AnyPath | None, Help(
        "photographs: of the nail, or with `sphere` of a ball", "FOLDER", group=_SOURCE)] = None
    sphere: Annotated[Literal["chrome", "grey"] | None, Help(
        "the photographs show a ball of this kind", group=_SOURCE)] = None
    geometry: Annotated[bool, Help("nothing is measured: LEDs where the drawing has them", group=_SOURCE)] = False
    rig: Annotated[AnyPath | None, Help("rig file with the calibrated camera", "FILE", group=_RIG)] = None
    px_per_cm: Annotated[Positive | None, Help("scale on the finger plane, without `rig`", "N", group=_RIG)] = None
    image_size: Annotated[str | None, Help("of the photographs, without `rig`", "ROWS,COLUMNS", group=_RIG)] = None
    led_height_cm: Annotated[Positive | None, Help(
        "height of the LEDs above the finger plane", "N", group=_RIG)] = None
    led_radius_cm: Annotated[Positive | None, Help("radius of the circle on which they sit", "N", group=_RIG)] = None
    led_centre_px: Annotated[str | None, Help(
        "pixel of the circle's centre (default: the rig's origin)", "X,Y", group=_RIG)] = None
    first_azimuth_deg: Annotated[float, Help("of white LED 0, for `geometry` (default: 0)", group=_RIG)] = 0.0
    nail_height_mm: Annotated[float | None, Limits(0.5, 500), Help(
        "where it is known (default: it is found)", "N", group=_NAIL)] = None
    method: Annotated[Literal["circle", "joint"] | None, Help(
        "circle: the thesis's construction and mean; joint: least squares over all rows (default: joint for three nail "
        "positions or more, and with `rig`)", group=_NAIL)] = None
    limit_deg: Annotated[float, Limits(0, 90, above=True), Help(
        "directions further apart are refused", "N", group=_NAIL)] = 5.0
    keep: Annotated[bool, Help("keep LEDs that would be refused", group=_NAIL)] = False
    encoding: Annotated[Encoding | None, Help(
        "of the photographs (default: as for 'splitknit reconstruct')", group=_PICTURES)] = None
    mask: Annotated[AnyPath | None, Help("image that is white where the ball is", "FILE", group=_PICTURES)] = None
    show: Annotated[AnyPath | None, Help(
        "picture of what was found (default: beside `out`)", "PNG", group=_PICTURES)] = None
    tips_out: Annotated[AnyPath | None, Help(
        "table of what was found, to correct and give to `table`", "CSV", group=_PICTURES)] = None
    # fmt: on

    def run(self, progress: Progress) -> CalibratedLights:
        """Find the LEDs, and write the rig file where one is named."""
        from splitknit_rig.calibration import lights_job as lights
        from splitknit_rig.calibration.lights_found import Rules
        from splitknit_rig.calibration.nail import Nail

        source, out = self._source(), path(self.out)
        lights.check_lights_file(out)
        base = None
        if self.rig is not None or self.px_per_cm is not None or source != "sphere":
            base = lights.known_rig(path(self.rig), self.px_per_cm, self.image_size, self.led_height_cm)
        if source == "sphere":
            assert self.images is not None and self.sphere is not None
            ball = lights.BallPhotographs(path(self.images), self.sphere, self.encoding, path(self.mask))
            return lights.lights_of_ball(ball, base, out, led_height_cm=self.led_height_cm)
        assert base is not None
        circle = lights.led_circle(base, self.led_radius_cm, self.led_height_cm, self.led_centre_px)
        if source == "geometry":
            return lights.lights_as_drawn(base, circle, out, first_azimuth_deg=self.first_azimuth_deg)
        joint_from = 2 if self.rig is not None else 3
        rules = Rules(Nail(self.nail_height_mm), self.method, joint_from, self.limit_deg, self.keep)
        if source == "table":
            assert self.table is not None
            return lights.lights_of_table(path(self.table), base, circle, rules, out)
        assert self.images is not None
        pictures: dict[str, Any] = {"encoding": self.encoding, "show": path(self.show), "tips_out": path(self.tips_out)}
        return lights.lights_of_nail(path(self.images), base, circle, rules, out, **pictures, progress=progress)

    def _source(self) -> str:
        asked = {"table": self.table, "images": None if self.sphere else self.images, "sphere": self.sphere}
        sources = [name for name, value in asked.items() if value is not None] + ["geometry"] * bool(self.geometry)
        named = "none was" if not sources else " and ".join(f"`{name}`" for name in sources) + " were"
        require(
            len(sources) == 1,
            f"calibrate lights needs one of `table`, `images`, `sphere` with `images`, and `geometry`, but "
            f"{named} given.",
        )
        require(sources[0] != "sphere" or self.images is not None, "`sphere` needs `images`, photographs of the ball.")
        require(sources[0] != "geometry" or self.out is not None, "`geometry` writes a rig file; name it by `out`.")
        for name in ("px_per_cm", "image_size"):
            alone = self.rig is None or getattr(self, name) is None
            require(alone, f"`{name}` and `rig` set the same thing; give one of them.")
        return sources[0]


def _pair(text: str) -> tuple[float, float]:
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        x, y = math.nan, math.nan
    if not math.isfinite(x + y):
        raise BadInput(f"'{text}' must be two numbers with a comma between them")
    return x, y


@dataclass(frozen=True, slots=True)
class RadiometryJob(Job):
    """Measure lens fall-off, brightness, beam and aim of every LED, from a white card; the camera's response.

    Returns
    -------
    RadiometricCalibration
        ``rig`` with the lens's fall-off, intensities, beams and aims; ``flat_field``, ``warnings``, and ``facts`` as
        they are in the rig file's provenance.

    Examples
    --------
    >>> import splitknit_rig
    >>> splitknit_rig.calibrate_radiometry("card", "rig.json")  # doctest: +SKIP
    """

    # fmt: off
    folder: Annotated[AnyPath, Help("capture folder of a white card under every LED", "FOLDER", positional=True)]
    out: Annotated[AnyPath, _RIG_OUT]
    _: KW_ONLY
    rig: Annotated[AnyPath | None, Help("rig file with camera and LED places (default: FOLDER's)", "RIG")] = None
    limit_percent: Annotated[Positive | None, Help(
        "of an LED's residuals (rms, default: 1)", "PERCENT", "--limit")] = None
    card_height_mm: Annotated[float, Limits(-1000.0, 1000.0), Help(
        "height of the card's surface above the finger plane (default: 0)", "MM")] = 0.0
    card_tilt_deg: Annotated[tuple[float, float] | None, Help(
        "turn of the card about x and y (default: the base's, where 'calibrate camera' found it, else 0,0)", "X,Y",
        read=_pair, takes="pair of float")] = None
    residuals: Annotated[AnyPath | None, _RESIDUALS] = None
    # fmt: on

    def run(self, progress: Progress) -> RadiometricCalibration:
        """Calibrate, and write the rig file."""
        from splitknit_rig.calibration.radiometry_folder import calibrate_to_file

        return calibrate_to_file(
            path(self.folder),
            path(self.out),
            rig_file=path(self.rig),
            limit_percent=self.limit_percent,
            card_height_mm=self.card_height_mm,
            card_tilt_deg=self.card_tilt_deg,
            residuals=path(self.residuals),
            progress=progress,
        )


@dataclass(frozen=True, slots=True)
class PolarisersJob(Job):
    """Measure polarising films: brightness, image shift, and what they let pass, from a printed card and a glossy
    black ball.

    Returns
    -------
    dict
        What was measured, with its intervals; ``films`` as they are in the rig file, ``out`` and ``files``.
    """

    # fmt: off
    folder: Annotated[AnyPath, Help(
        "holds the capture folders card and ball, analyser parallel (white) and crossed (white_crossed)", "FOLDER",
        positional=True)]
    out: Annotated[AnyPath, _RIG_OUT]
    _: KW_ONLY
    rig: Annotated[AnyPath | None, Help("rig file to add the films to (default: the card's)", "RIG")] = None
    residuals: Annotated[AnyPath | None, _RESIDUALS] = None
    # fmt: on

    def run(self, progress: Progress) -> dict[str, Any]:
        """Measure the films, and write them into a rig file."""
        from splitknit_rig.calibration.polarisers import films_to_file

        return films_to_file(
            path(self.folder),
            path(self.out),
            rig=path(self.rig),
            residuals=path(self.residuals),
            progress=progress,
        )


calibrate_camera = function_of(CameraJob, "calibrate_camera")
calibrate_lights = function_of(LightsJob, "calibrate_lights")
calibrate_radiometry = function_of(RadiometryJob, "calibrate_radiometry")
