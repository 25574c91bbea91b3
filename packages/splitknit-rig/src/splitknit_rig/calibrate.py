"""``splitknit calibrate``: from photographs to a rig file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from splitknit.arguments import (
    PYTHON_ONLY,
    AnyPath,
    Encoding,
    Positive,
    Progress,
    Report,
    checked,
    refuse_given,
    silent,
)
from splitknit.errors import require
from splitknit.settings import Limits

if TYPE_CHECKING:
    from splitknit_rig.calibration.camera_photos import MeasuredCamera
    from splitknit_rig.calibration.lights_found import CalibratedLights
    from splitknit_rig.calibration.radiometry import RadiometricCalibration
else:
    MeasuredCamera = CalibratedLights = RadiometricCalibration = Any

_TARGET = Parameter(group="The printed target ('splitknit rig target' makes it)")
_SOURCE = Parameter(group="From what (one of them)")
_RIG = Parameter(group="The rig")
_NAIL = Parameter(group="The nail")
_BALLS = Parameter(group="The balls")
_PICTURES = Parameter(group="Photographs")


def _path(path: AnyPath | None) -> Path | None:
    return None if path is None else Path(path)


@checked
def calibrate_camera(
    folder: AnyPath | None = None,
    *,
    out: AnyPath,
    rig: AnyPath | None = None,
    pattern: str | None = None,
    board: Annotated[str, _TARGET] = "9x6",
    square_mm: Annotated[float, _TARGET] = 3.0,
    plane: Annotated[Sequence[AnyPath], _TARGET] = (),
    calibrated_at: Annotated[str | None, PYTHON_ONLY] = None,
    progress: Progress = silent,
) -> MeasuredCamera:
    """Measure the camera from photographs of a checkerboard (Zhang).

    Parameters
    ----------
    folder
        Photographs of one board, tilted differently in each.
    out
        Rig file to write.
    rig
        Rig file whose other parts are kept.
    pattern
        Only files of this name, such as 'left*.jpg', or 'board_*/white_0.tiff' in capture folders
        (default: all).
    board
        Inner corners each way, as 9x6.
    square_mm
        Side of a square, measured on the print.
    plane
        Photograph of the board lying on the finger plane: camera height, scale, tilt; may be
        repeated.
    calibrated_at
        Time of the calibration, ISO 8601; now by default.

    Returns
    -------
    MeasuredCamera
        ``camera`` as it is in the rig file, ``fit`` of the lens, ``pose`` of the finger plane,
        ``findings``.

    Raises
    ------
    BadInput
        Naming the file or argument at fault; nothing is written.

    Examples
    --------
    >>> import splitknit_rig
    >>> splitknit_rig.calibrate_camera(  # doctest: +SKIP
    ...     "boards", out="rig.json", board="9x6", square_mm=3.0
    ... )

    References
    ----------
    Z. Zhang, "A flexible new technique for camera calibration", IEEE Trans. PAMI 22(11), 2000.
    """
    from splitknit_rig.calibration.camera_photos import calibrate_to_rig
    from splitknit_rig.calibration.targets import Board

    return calibrate_to_rig(
        _path(folder),
        Path(out),
        Board.named(board, square_mm),
        plane=tuple(map(Path, plane)),
        rig=_path(rig),
        pattern=pattern,
        calibrated_at=calibrated_at,
        progress=progress,
    )


@checked
def calibrate_lights(
    *,
    out: AnyPath | None = None,
    table: Annotated[AnyPath | None, _SOURCE] = None,
    images: Annotated[AnyPath | None, _SOURCE] = None,
    sphere: Annotated[Literal["chrome", "grey"] | None, _SOURCE] = None,
    rig: Annotated[AnyPath | None, _RIG] = None,
    px_per_cm: Annotated[Positive | None, _RIG] = None,
    image_size: Annotated[str | None, _RIG] = None,
    led_height_cm: Annotated[Positive | None, _RIG] = None,
    led_radius_cm: Annotated[Positive | None, _RIG] = None,
    led_centre_px: Annotated[str | None, _RIG] = None,
    nail_height_mm: Annotated[float | None, Limits(0.5, 500), _NAIL] = None,
    method: Annotated[Literal["circle", "joint"] | None, _NAIL] = None,
    limit_deg: Annotated[float, Limits(0, 90, above=True), _NAIL] = 5.0,
    keep: Annotated[bool, _NAIL] = False,
    ball: Annotated[Sequence[str], _BALLS] = (),
    ground: Annotated[bool, _BALLS] = False,
    encoding: Annotated[Encoding | None, _PICTURES] = None,
    mask: Annotated[AnyPath | None, _PICTURES] = None,
    show: Annotated[AnyPath | None, _PICTURES] = None,
    tips_out: Annotated[AnyPath | None, _PICTURES] = None,
    progress: Progress = silent,
) -> CalibratedLights:
    """Find where the LEDs are: from a nail's shadows or a ball.

    Parameters
    ----------
    out
        Rig file (.json) or list of lights (.txt, .lp of RTI, .dome of Relight) to write; 'splitknit
        reconstruct' takes them as lights of photographs (default: none, only report what was
        found).
    table
        Nail and shadow tips, typed, as CSV.
    images
        Photographs: of the nail, or with `sphere` of a ball.
    sphere
        The photographs show a ball of this kind, or several of chrome.
    rig
        Rig file with the calibrated camera.
    px_per_cm
        Scale on the ground (the finger plane), without `rig`.
    image_size
        Of the photographs, without `rig`: ROWS,COLUMNS; not needed with `sphere`.
    led_height_cm
        Height of the LEDs above the finger plane.
    led_radius_cm
        Radius of the circle on which they sit.
    led_centre_px
        Pixel X,Y of the circle's centre (default: the rig's origin).
    nail_height_mm
        Where it is known (default: it is found).
    method
        circle: the thesis's construction and mean; joint: least squares over all rows (default:
        joint for three nail positions or more, and with `rig`).
    limit_deg
        Directions further apart are refused.
    keep
        Keep LEDs that would be refused.
    ball
        Outline of a ball, X,Y,RADIUS in pixels; may be repeated (default: one is found).
    ground
        The ground beside chrome balls is flat and matt: its light shows how far the lights are.
    encoding
        Of the photographs (default: as for 'splitknit reconstruct').
    mask
        Image that is white where the balls are; with `ball`, where the object is, which is no
        ground.
    show
        Picture of what was found, PNG (default: beside `out`).
    tips_out
        Table of what was found, CSV, to correct and give to `table`.

    Returns
    -------
    CalibratedLights
        ``leds`` with directions, positions, intervals and verdicts; ``rig``; ``findings``; of balls
        ``left_out``, photographs whose light shows no glint.

    Raises
    ------
    BadInput
        Naming the file or argument at fault; nothing is written. ``Refused``, whose facts hold what
        was found, if that is not good enough.

    Examples
    --------
    >>> import splitknit_rig
    >>> splitknit_rig.calibrate_lights(  # doctest: +SKIP
    ...     out="rig_2.json", images="nail", rig="rig_1.json"
    ... )
    """
    from splitknit import read_rig
    from splitknit_rig.calibration import ball_photos as balls
    from splitknit_rig.calibration import light_sources as lights
    from splitknit_rig.calibration.lights_found import Rules
    from splitknit_rig.calibration.nail import Nail

    sources = {
        "table": table is not None,
        "images": images is not None and sphere is None,
        "sphere": sphere is not None,
    }
    chosen = [f"`{name}`" for name, is_given in sources.items() if is_given]
    named = " and ".join(chosen) + " were" if chosen else "none was"
    choices = "`table`, `images`, and `sphere` with `images`"
    require(len(chosen) == 1, f"calibrate lights needs one of {choices}, but {named} given.")
    require(
        sphere is None or images is not None, "`sphere` needs `images`, photographs of the ball."
    )
    if rig is not None:
        refuse_given(
            "and `rig` set the same thing; give one of them.",
            px_per_cm=px_per_cm,
            image_size=image_size,
        )

    refuse_given("goes with `sphere`.", **({} if sphere else {"ball": ball, "ground": ground}))
    target = _path(out)
    lights.check_lights_file(target)
    base = None if rig is None else read_rig(rig)
    if sphere is not None:
        assert images is not None
        shown = balls.BallPhotographs(
            Path(images),
            sphere,
            tuple(map(balls.ball_of_text, ball)),
            _path(mask),
            ground=ground,
            encoding=encoding,
            led_height_cm=led_height_cm,
        )
        base = base or balls.rig_of_balls(shown, px_per_cm, image_size)
        return balls.lights_of_ball(shown, base, target)
    require(
        target is None or target.suffix.lower() != ".lp",
        "an .lp file holds directions, and these lights have places; write a .txt or a rig file.",
    )
    if base is None:
        base = lights.rig_without_leds(px_per_cm, image_size, led_height_cm)
    circle = lights.led_circle(base, led_radius_cm, led_height_cm, led_centre_px)
    rules = Rules(Nail(nail_height_mm), method, 2 if rig is not None else 3, limit_deg, keep)
    if table is not None:
        return lights.lights_of_table(Path(table), base, circle, rules, target)
    assert images is not None
    return lights.lights_of_nail(
        Path(images),
        base,
        circle,
        rules,
        target,
        encoding=encoding,
        show=_path(show),
        tips_out=_path(tips_out),
        progress=progress,
    )


def _pair(kind: Any, tokens: Sequence[Any]) -> tuple[float, float]:
    from splitknit_rig.calibration.light_sources import pair_of

    return pair_of(tokens[0].value, "it must be two numbers with a comma between them")


CardHeight = Annotated[float, Limits(-1000.0, 1000.0)]
CardTilt = Annotated[
    tuple[float, float], Parameter(converter=_pair, n_tokens=1, allow_leading_hyphen=True)
]
PercentLimit = Annotated[Positive | None, Parameter("--limit")]


@checked
def calibrate_radiometry(
    folder: AnyPath,
    *,
    out: AnyPath,
    rig: AnyPath | None = None,
    limit_percent: PercentLimit = None,
    card_height_mm: CardHeight = 0.0,
    card_tilt_deg: CardTilt | None = None,
    progress: Progress = silent,
) -> RadiometricCalibration:
    """Measure lens fall-off, brightness, beam and aim of every LED, from a white card; the camera's
    response.

    Parameters
    ----------
    folder
        Capture folder of a white card under every LED.
    out
        Rig file to write.
    rig
        Rig file with camera and LED places (default: the folder's).
    limit_percent
        Of an LED's residuals (rms, default: 1), in per cent.
    card_height_mm
        Height of the card's surface above the finger plane.
    card_tilt_deg
        Turn of the card about x and y, as X,Y (default: the base's, where 'calibrate camera' found
        it, else 0,0).

    Returns
    -------
    RadiometricCalibration
        ``rig`` with the lens's fall-off, intensities, beams and aims; ``flat_field``, ``findings``,
        and ``facts`` as they are in the rig file's provenance.

    Raises
    ------
    BadInput
        Naming the folder or file at fault; nothing is written.

    Examples
    --------
    >>> import splitknit_rig
    >>> splitknit_rig.calibrate_radiometry("card", out="rig.json")  # doctest: +SKIP
    """
    from splitknit_rig.calibration.radiometry_folder import calibrate_to_file

    return calibrate_to_file(
        Path(folder),
        Path(out),
        rig_file=_path(rig),
        limit_percent=limit_percent,
        card_height_mm=card_height_mm,
        card_tilt_deg=card_tilt_deg,
        progress=progress,
    )


def calibrate_polarisers(
    folder: AnyPath,
    *,
    out: AnyPath,
    rig: AnyPath | None = None,
    progress: Progress = silent,
) -> Report:
    """Measure polarising films: brightness, image shift, and what they let pass, from a printed
    card and a glossy black ball.

    Parameters
    ----------
    folder
        Holds the capture folders card and ball, analyser parallel (white) and crossed
        (white_crossed).
    out
        Rig file to write.
    rig
        Rig file to add the films to (default: the card's).

    Returns
    -------
    Report
        What was measured, with its intervals; ``films`` as they are in the rig file, and ``out``.

    Raises
    ------
    BadInput
        Naming the folder or file at fault; nothing is written.

    Examples
    --------
    >>> calibrate_polarisers("films", out="rig.json").facts["films"]  # doctest: +SKIP
    """
    from splitknit_rig.calibration.polarisers import films_to_file
    from splitknit_rig.calibration.words import film_lines

    facts = films_to_file(Path(folder), Path(out), rig=_path(rig), progress=progress)
    return Report(facts, tuple(film_lines(facts)))
