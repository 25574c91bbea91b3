"""What the verbs of the command line do, as functions: files or objects in, objects out."""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from splitknit.errors import require
from splitknit.model import Capture, Reconstruction, Rig, no_progress
from splitknit.settings import override

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from splitknit.calibration.camera_photos import MeasuredCamera
    from splitknit.calibration.lights_found import CalibratedLights, LightSettings
    from splitknit.calibration.radiometry import RadiometricCalibration
    from splitknit.evaluation.intervals import BootstrapSettings
    from splitknit.evaluation.study import Evaluation
    from splitknit.gallery.identify import Identification
    from splitknit.gallery.key import Key
    from splitknit.matching.methods import Match
    from splitknit.prints.make import Print

_LOG = logging.getLogger(__name__)
AnyPath = str | os.PathLike[str]
Finger = Reconstruction | Capture | AnyPath
"""A reconstruction, a capture, or the path of a result or capture folder."""


def read_photographs(
    folder: AnyPath,
    lights: AnyPath | NDArray[np.float64] | Rig | None = None,
    px_per_mm: float | None = None,
    *,
    mask: AnyPath | None = None,
    material: Literal["opaque", "skin"] = "opaque",
    encoding: Literal["linear", "srgb"] | None = None,
    background: float | AnyPath | None = None,
    tip_direction_deg: float | None = None,
    max_megapixels: float | None = None,
    crossed: AnyPath | None = None,
    mosaic: Literal["mono", "colour"] | None = None,
    film_deg: float = 90.0,
    nir: AnyPath | None = None,
) -> Capture:
    """Read photographs of one object under one light after the other, taken by any camera, as a capture.

    What was assumed of them (their encoding, lights that were averaged) is logged by the logger ``splitknit.api``.

    Parameters
    ----------
    folder : of JPEG, PNG, TIFF, WEBP, BMP, HEIC or RAW files, in the order of the lights by their names; or a pattern
        of their names, such as ``photos/white_{light}.png``
    lights : list of lights, ``.lp`` file or rig file, directions (L, 3) or rig; by default ``lights.txt`` in the folder
        Directions point towards the lights: x right, y up, z to the camera.
    px_per_mm : pixels a millimetre on the object; without it results are in pixels
    mask : image file, white = object; by default ``mask.png`` in the folder, where there is one
    material : of the object
    encoding : of the stored values; by default as their files state it
    background : stored value of no light that was added to every pixel, or an image with all lights off
    tip_direction_deg : where a finger's tip points (0 = up, counter-clockwise)
    max_megapixels : larger photographs are reduced to so many pixels
    crossed : folder of the same photographs through crossed films; those of `folder` are then the parallel ones
    mosaic : of a camera with films on its pixels, see :func:`splitknit.imaging.polarised.split_mosaic`
    film_deg : direction of the film before the LEDs, for a mosaic
    nir : folder, or pattern, of photographs under near-infrared lights: the rig's NIR LEDs, or a list in that folder

    Returns
    -------
    Capture

    Raises
    ------
    BadInput
        Naming the file or the line at fault.

    Examples
    --------
    >>> import splitknit
    >>> capture = splitknit.read_photographs("photos", "lights.txt", px_per_mm=20.0)  # doctest: +SKIP
    >>> splitknit.reconstruct(capture).height_mm.shape  # doctest: +SKIP
    (1500, 2000)
    """
    from splitknit.io.plain import PhotographOptions, capture_from_photographs

    options = PhotographOptions(
        mask, material, encoding, background, tip_direction_deg, max_megapixels, crossed, mosaic, film_deg, nir=nir
    )
    found = capture_from_photographs(folder, lights, px_per_mm, options, _LOG.warning)
    for note in found.notes:
        _LOG.info("%s", note)
    return found.capture


def make_print(
    finger: Finger, method: str = "unroll", ppi: float = 500.0, settings: Mapping[str, Any] | None = None
) -> Print:
    """Make the 2D print of a finger.

    Parameters
    ----------
    finger : Reconstruction, Capture or path
        A capture is reconstructed first, by the preset ``metric``.
    method : ``relief``, ``unroll``, ``curvature``, ``photo`` or ``rolled``
        ``photo`` needs a capture; ``rolled`` one with mirrors, as a path.
    ppi : resolution in pixels per inch
    settings : mapping from ``stage.field`` to a value, optional
        Of :class:`splitknit.prints.make.PrintingSettings`.

    Returns
    -------
    Print
        ``image`` (h, w) uint8, ridges dark, mirrored as ink on paper is.

    Raises
    ------
    BadInput
        If the input lacks what the method needs, or shows no ridges.

    Examples
    --------
    >>> import splitknit
    >>> capture, truth = splitknit.simulate_capture(1, settings={"scale": 0.12})
    >>> splitknit.make_print(splitknit.reconstruct(capture, "ea")).image.dtype
    dtype('uint8')
    """
    from splitknit.prints.make import PrintingSettings, make_rolled_print
    from splitknit.prints.make import make_print as printed
    from splitknit.prints.sources import read_source, source_of, source_of_capture

    chosen = override(PrintingSettings(), settings or {})
    if method == "rolled":
        from splitknit.prints.rolled import read_rolled

        require(not isinstance(finger, Capture | Reconstruction), "a rolled print needs the path of a capture folder.")
        source, rolled = read_rolled(Path(finger), "metric", chosen.rolled, no_progress)  # type: ignore[arg-type]
        return make_rolled_print(rolled, source, "free", ppi, chosen)
    if isinstance(finger, Reconstruction):
        source = source_of(finger)
    elif isinstance(finger, Capture):
        source = source_of_capture(finger, photo=method == "photo", surface=method != "photo")
    else:
        source = read_source(Path(finger), photo=method == "photo", surface=method != "photo")
    return printed(source, method, ppi=ppi, settings=chosen)


def match(
    a: Finger,
    b: Finger,
    method: str = "auto",
    preset: str = "metric",
    settings: Mapping[str, Any] | None = None,
    *,
    input_ppi: float | None = None,
    fmr: float | None = None,
) -> Match:
    """Compare two fingers.

    Parameters
    ----------
    a, b : Reconstruction, Capture or path
        Paths may also be templates (``.skt``), prints and records of minutiae.
    method : ``auto``, ``ridge``, ``fusion``, ``thesis``, ``minutiae``, ``voted``, ``minutiae3d``, ``surface-code`` or
        ``tetrahedra``; ``auto`` is ``fusion`` of two prints, ``minutiae`` where one is a record of minutiae, else
        ``ridge``.
    preset : by which captures are reconstructed
    settings : mapping from ``stage.field`` to a value, optional
        Of :class:`splitknit.matching.surface.MatchingSettings`.
    input_ppi : resolution of prints whose files do not state it, optional
    fmr : false match rate at which is decided; by default 1e-4, or the smallest that the method's rates can state

    Returns
    -------
    Match
        ``similarity`` (the method's score; higher is more similar), ``fmr`` (false match rate at this similarity, where
        it was measured) with ``fmr_basis``, ``decision`` (``match``, ``fmr``, ``threshold``), ``alignment`` and the
        rest of what ``splitknit match --json`` prints, as attributes.

    Raises
    ------
    BadInput
        If an input cannot be used by the method.

    Examples
    --------
    >>> import splitknit
    >>> capture, truth = splitknit.simulate_capture(1, settings={"scale": 0.12})
    >>> result = splitknit.reconstruct(capture, "ea")
    >>> round(splitknit.match(result, result).similarity, 2)
    1.0
    """
    from splitknit.matching.methods import match_files

    sides = [side if isinstance(side, Reconstruction | Capture) else Path(side) for side in (a, b)]
    return match_files(
        sides[0], sides[1], method=method, preset=preset, settings=settings, input_ppi=input_ppi, fmr=fmr
    )  # fmt: skip


def identify(
    gallery: AnyPath,
    probe: Finger,
    key: Key | None = None,
    *,
    top: int = 10,
    merge: Literal["person", "finger", "none"] = "person",
    fmr: float = 1e-4,
    search: Literal["auto", "exhaustive", "codes"] = "auto",
    person: str | None = None,
    finger: str | None = None,
    input_ppi: float | None = None,
) -> Identification:
    """Search a gallery for a finger, or check whose it is said to be.

    Parameters
    ----------
    gallery : file, made by ``splitknit enroll``
    probe : Reconstruction, Capture or path
    key : of an encrypted gallery, optional
        See :mod:`splitknit.gallery.key`.
    top : number of candidates that are reported
    merge : one candidate for each person, each finger of a person, or each enrolled capture (``none``)
    fmr : false match rate of one comparison at which is decided
    search : whether all ridges are compared, or only those of similar codes; ``auto``: by the gallery's size
    person : whose finger it is said to be (verification), optional
    finger : which finger it is, where that is known; others are not compared
    input_ppi : resolution of a print whose file does not state it, optional

    Returns
    -------
    Identification
        ``candidates``, best first, and ``decision``; that nobody is found is no error.

    Raises
    ------
    BadInput
        If a file cannot be used, or the claimed person is not in the gallery.

    Examples
    --------
    >>> import splitknit
    >>> splitknit.identify("people.skg", "captures/unknown", top=3).candidates  # doctest: +SKIP
    """
    from splitknit.gallery.identify import IdentifySettings, Question, identify_file

    given = probe if isinstance(probe, Reconstruction | Capture) else Path(probe)
    question = Question(top, merge, fmr, search, person, finger)
    return identify_file(Path(gallery), given, question, IdentifySettings(), key=key, input_ppi=input_ppi)


def evaluate(
    files: AnyPath | Sequence[AnyPath],
    *,
    dissimilarity: bool = False,
    cluster: Literal["auto", "plain", "finger", "subject"] = "auto",
    average: bool = False,
    fuse: Literal["linear", "minmax", "llr", "trained", "all"] | None = None,
    bootstrap: BootstrapSettings | None = None,
) -> Evaluation:
    """Error rates with their intervals from score files.

    Parameters
    ----------
    files : score files, one a system
        CSV with genuine and impostor comparisons, see ``docs/guide/evaluation.md``.
    dissimilarity : whether a lower score means more similar
    cluster : what intervals are drawn by; ``auto``: fingers, else subjects, else comparisons
    average : whether scores are averaged over sessions as well
    fuse : whether the systems' fusion is one more: of z-scores (``linear``), of min-max scores, of log-likelihood
        ratios (``llr``), by logistic regression (``trained``), or the first three with intervals by subject (``all``)
    bootstrap : of the intervals, :class:`splitknit.evaluation.intervals.BootstrapSettings`, optional

    Returns
    -------
    Evaluation
        ``results``: of every system and variant ``eer``, ``gar_at(far)``, ``auc``, each with its confidence interval;
        ``differences`` between systems; ``notes``.

    Raises
    ------
    BadInput
        If a file cannot be used.

    Examples
    --------
    >>> import splitknit
    >>> splitknit.evaluate("scores.csv").results[0].eer.value  # doctest: +SKIP
    """
    from splitknit.evaluation.intervals import BootstrapSettings
    from splitknit.evaluation.study import EvaluationSettings, evaluate_scores

    listed = [files] if isinstance(files, str | os.PathLike) else list(files)
    settings = EvaluationSettings(dissimilarity, cluster, average, fuse, bootstrap or BootstrapSettings())
    return evaluate_scores([Path(file) for file in listed], settings)


def _path(given: AnyPath | None) -> Path | None:
    return None if given is None else Path(given)


def calibrate_camera(
    folder: AnyPath | None,
    out: AnyPath,
    *,
    board: str = "9x6",
    square_mm: float = 3.0,
    pattern: str | None = None,
    rig: AnyPath | None = None,
    plane: Sequence[AnyPath] = (),
    disc: AnyPath | None = None,
    dot_mm: float = 10.0,
    sensor_pixel_um: float = 1.12,
    binning: float | None = None,
    f_number: float = 2.0,
    finger_depth_mm: float = 8.0,
) -> MeasuredCamera:
    """Calibrate the camera from photographs of a checkerboard, and write a rig file.

    Parameters
    ----------
    folder : photographs of one board, tilted differently in each; None where only `plane` or `disc` is given
    out : rig file to write
    board : inner corners each way
    square_mm : side of a square, measured on the print
    pattern : only files of this name, such as ``left*.jpg``; all by default
    rig : rig file whose other parts are kept, optional
    plane : photographs of the board lying on the finger plane: camera height, scale, tilt
    disc : the same from a photograph of the calibration disc, optional
    dot_mm : spacing of the disc's dots
    sensor_pixel_um : side of a pixel on the sensor
    binning : sensor pixels along a pixel of the image; by default from the image's size
    f_number : of the lens
    finger_depth_mm : depth of the finger that should be sharp

    Returns
    -------
    MeasuredCamera
        ``camera`` as it is in the rig file, ``fit`` of the lens, ``pose`` of the finger plane, ``sharpness``,
        ``warnings``.

    Raises
    ------
    BadInput
        Naming the file or option at fault; nothing is written.

    Examples
    --------
    >>> import splitknit
    >>> splitknit.calibrate_camera("boards", "rig.json", board="9x6", square_mm=3.0)  # doctest: +SKIP

    References
    ----------
    Z. Zhang, "A flexible new technique for camera calibration", IEEE Trans. PAMI 22(11), 2000.
    """
    from splitknit.calibration.camera_photos import CameraJob, calibrate_to_rig

    now = datetime.now(UTC).isoformat(timespec="seconds").replace("+00:00", "Z")
    return calibrate_to_rig(
        CameraJob(
            Path(out), _path(folder), board, square_mm, pattern, _path(rig), tuple(Path(file) for file in plane),
            _path(disc), dot_mm, sensor_pixel_um, binning, f_number, finger_depth_mm, now,
        )
    )  # fmt: skip


def calibrate_lights(
    out: AnyPath | None = None,
    *,
    table: AnyPath | None = None,
    images: AnyPath | None = None,
    sphere: Literal["chrome", "grey"] | None = None,
    geometry: bool = False,
    rig: AnyPath | None = None,
    px_per_cm: float | None = None,
    image_size: str | None = None,
    led_height_cm: float | None = None,
    led_radius_cm: float | None = None,
    led_centre_px: str | None = None,
    first_azimuth_deg: float = 0.0,
    method: Literal["circle", "joint"] | None = None,
    keep: bool = False,
    encoding: Literal["linear", "srgb"] | None = None,
    mask: AnyPath | None = None,
    show: AnyPath | None = None,
    tips_out: AnyPath | None = None,
    settings: LightSettings | None = None,
) -> CalibratedLights:
    """Find the LEDs, and write a rig file where one is named.

    Parameters
    ----------
    out : rig file, or list of lights (``.txt``), to write; optional
    table, images, sphere, geometry
        From what, one of them: a CSV table of nail and shadow tips, photographs of the nail, photographs (`images`) of
        a ball of the kind `sphere`, or the drawing (`geometry`).
    rig : rig file with the calibrated camera, optional
    px_per_cm, image_size : scale on the finger plane and ``rows,columns`` of the photographs, without `rig`
    led_height_cm, led_radius_cm, led_centre_px, first_azimuth_deg
        The circle on which the LEDs sit: height above the finger plane, radius, centre as ``x,y`` in pixels, azimuth of
        white LED 0 (of `geometry`); by default the rig's.
    method : the thesis's construction (``circle``) or least squares over all rows; by default by the nail's positions
    keep : whether LEDs are kept that would be refused
    encoding : of the photographs; by default as their files state it
    mask : image that is white where the ball is, optional
    show, tips_out : picture and table of what was found in photographs, to write; by default beside `out`
    settings : :class:`splitknit.calibration.lights_found.LightSettings`, optional

    Returns
    -------
    CalibratedLights
        ``leds`` with directions, positions, intervals and verdicts; ``rig``; ``warnings``.

    Raises
    ------
    BadInput
        Naming the file or option at fault; nothing is written.

    Examples
    --------
    >>> import splitknit
    >>> drawn = {"px_per_cm": 378.5, "image_size": "1100,1600", "led_height_cm": 14.0, "led_radius_cm": 5.25}
    >>> len(splitknit.calibrate_lights("rig.json", geometry=True, **drawn).leds)
    14
    """
    from splitknit.calibration.lights_found import LightSettings, LightsJob
    from splitknit.calibration.lights_job import lights_to_rig

    return lights_to_rig(
        LightsJob(
            _path(table), _path(images), sphere, geometry, _path(rig), px_per_cm, image_size, led_height_cm,
            led_radius_cm, led_centre_px, first_azimuth_deg, method, keep, encoding, _path(mask), _path(show),
            _path(tips_out), _path(out), settings or LightSettings(),
        )
    )  # fmt: skip


def calibrate_radiometry(
    folder: AnyPath,
    out: AnyPath,
    *,
    rig_file: AnyPath | None = None,
    card: tuple[float, tuple[float, float] | None] = (0.0, None),
    limit_percent: float | None = None,
    residuals: AnyPath | None = None,
) -> RadiometricCalibration:
    """Calibrate brightness (response, noise, LEDs, fall-off) from a capture of a white card, and write a rig file.

    Parameters
    ----------
    folder : capture folder of the card
    out : rig file to write
    rig_file : rig to calibrate; the folder's own by default
    card : height in mm above the finger plane and turn about x and y in deg of the card; None: as the base lies
    limit_percent : largest rms of an LED's residuals; 1 by default
    residuals : picture of the residuals to write, optional

    Returns
    -------
    RadiometricCalibration
        ``rig`` with the lens's fall-off, intensities, beams and aims; ``flat_field``, ``warnings``, and ``facts`` as
        they are in the rig file's provenance.

    Raises
    ------
    BadInput
        Naming the folder or file at fault; nothing is written.

    Examples
    --------
    >>> import splitknit
    >>> splitknit.calibrate_radiometry("card", "rig.json")  # doctest: +SKIP
    """
    from splitknit.calibration.radiometry_folder import calibrate_to_file

    return calibrate_to_file(
        Path(folder), Path(out),
        rig_file=_path(rig_file), card=card, limit_percent=limit_percent, residuals=_path(residuals),
    )  # fmt: skip
