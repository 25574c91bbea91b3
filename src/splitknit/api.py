"""What the verbs of the command line do, as functions: files or objects in, objects and plain facts out."""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from splitknit.errors import require
from splitknit.model import Capture, Reconstruction, Rig, no_progress
from splitknit.settings import override

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from splitknit.evaluation.study import Evaluation
    from splitknit.gallery.key import Key
    from splitknit.prints.make import Print

_LOG = logging.getLogger(__name__)
AnyPath = str | os.PathLike[str]
Finger = Reconstruction | Capture | AnyPath
"""A reconstruction, a capture, or the path of a result or capture folder."""


def read_photographs(
    folder: AnyPath,
    lights: AnyPath | NDArray[np.float64] | Rig | None = None,
    px_per_mm: float | None = None,
    **options: Any,
) -> Capture:
    """Read photographs of one object under one light after the other, taken by any camera, as a capture.

    What was assumed of them (their encoding, lights that were averaged) is logged by the logger ``splitknit.api``.

    Parameters
    ----------
    folder : of JPEG, PNG, TIFF, WEBP, BMP, HEIC or RAW files, in the order of the lights by their names
    lights : list of lights, ``.lp`` file or rig file, directions (L, 3) or rig; by default ``lights.txt`` in the folder
        Directions point towards the lights: x right, y up, z to the camera.
    px_per_mm : pixels a millimetre on the object; without it results are in pixels
    **options
        Fields of :class:`splitknit.io.plain.PhotographOptions`: ``mask``, ``material`` (``opaque`` or ``skin``),
        ``encoding``, ``background``, ``tip_direction_deg``, ``max_megapixels``, ``crossed``, ``mosaic``, ``film_deg``.

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

    found = capture_from_photographs(folder, lights, px_per_mm, PhotographOptions(**options), _LOG.warning)
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
) -> dict[str, Any]:
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

    Returns
    -------
    dict
        ``similarity`` (the method's score; higher is more similar), ``fmr`` (false match rate at this similarity, where
        it was measured) with ``fmr_basis``, ``decision`` (``match``, ``fmr``, ``threshold``), ``alignment`` and the
        rest of what ``splitknit match --json`` prints.

    Raises
    ------
    BadInput
        If an input cannot be used by the method.

    Examples
    --------
    >>> import splitknit
    >>> capture, truth = splitknit.simulate_capture(1, settings={"scale": 0.12})
    >>> result = splitknit.reconstruct(capture, "ea")
    >>> round(splitknit.match(result, result)["similarity"], 2)
    1.0
    """
    from splitknit.matching.methods import match_files

    sides = [side if isinstance(side, Reconstruction | Capture) else Path(side) for side in (a, b)]
    return match_files(
        sides[0], sides[1], method=method, preset=preset, settings=dict(settings or {}),
        input_ppi=input_ppi,
    )  # fmt: skip


def identify(
    gallery: AnyPath, finger: Finger, key: Key | None = None, *, input_ppi: float | None = None, **question: Any
) -> dict[str, Any]:
    """Search a gallery for a finger.

    Parameters
    ----------
    gallery : file, made by ``splitknit enroll``
    finger : Reconstruction, Capture or path
    key : of an encrypted gallery, optional
        See :mod:`splitknit.gallery.key`.
    input_ppi : resolution of a print whose file does not state it, optional
    **question
        Fields of :class:`splitknit.gallery.identify.Question`: ``top``, ``merge``, ``fmr``, ``search``, ``person``,
        ``finger``.

    Returns
    -------
    dict
        ``candidates``, best first, and ``decision``; that nobody is found is no error.

    Raises
    ------
    BadInput
        If a file cannot be used, or the claimed person is not in the gallery.

    Examples
    --------
    >>> import splitknit
    >>> splitknit.identify("people.skg", "captures/unknown", top=3)["candidates"]  # doctest: +SKIP
    """
    from splitknit.gallery.identify import IdentifySettings, Question, identify_file

    probe = finger if isinstance(finger, Reconstruction | Capture) else Path(finger)
    return identify_file(Path(gallery), probe, Question(**question), IdentifySettings(), key=key, input_ppi=input_ppi)


def evaluate(files: AnyPath | Sequence[AnyPath], **settings: Any) -> Evaluation:
    """Error rates with their intervals from score files.

    Parameters
    ----------
    files : score files, one a system
        CSV with genuine and impostor comparisons, see ``docs/guide/evaluation.md``.
    **settings
        Fields of :class:`splitknit.evaluation.study.EvaluationSettings`.

    Returns
    -------
    Evaluation
        ``facts`` is what ``report.json`` holds: EER, GAR at FAR, AUC, each with its confidence interval.

    Raises
    ------
    BadInput
        If a file cannot be used.

    Examples
    --------
    >>> import splitknit
    >>> splitknit.evaluate("scores.csv").facts["systems"]  # doctest: +SKIP
    """
    from splitknit.evaluation.study import EvaluationSettings, evaluate_scores

    listed = [files] if isinstance(files, str | os.PathLike) else list(files)
    return evaluate_scores([Path(file) for file in listed], EvaluationSettings(**settings))


def calibrate_camera(folder: AnyPath, out: AnyPath, **options: Any) -> dict[str, Any]:
    """Calibrate the camera from photographs of a checkerboard, and write a rig file.

    Parameters
    ----------
    folder : photographs of one board, tilted differently in each
    out : rig file to write
    **options
        Fields of :class:`splitknit.calibration.camera_photos.CameraJob`: ``board``, ``square_mm``, ``plane``, ``disc``,
        ``rig`` and others; paths as :class:`pathlib.Path`.

    Returns
    -------
    dict
        What was found, as ``splitknit calibrate camera --json`` prints it.

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
    return calibrate_to_rig(CameraJob(out=Path(out), folder=Path(folder), calibrated_at=now, **options))


def calibrate_lights(out: AnyPath | None = None, **options: Any) -> dict[str, Any]:
    """Find the LEDs, and write a rig file where one is named.

    Parameters
    ----------
    out : rig file to write, optional
    **options
        Fields of :class:`splitknit.calibration.lights_job.LightsJob`: ``table`` (tips of the nail's shadow), ``images``
        with ``sphere``, or ``geometry``; paths as :class:`pathlib.Path`.

    Returns
    -------
    dict
        What was found, as ``splitknit calibrate lights --json`` prints it.

    Raises
    ------
    BadInput
        Naming the file or option at fault; nothing is written.

    Examples
    --------
    >>> import splitknit
    >>> drawn = {"px_per_cm": 378.5, "image_size": "1100,1600", "led_height_cm": 14.0, "led_radius_cm": 5.25}
    >>> facts = splitknit.calibrate_lights(geometry=True, **drawn)
    >>> len(facts["leds"])
    14
    """
    from splitknit.calibration.lights_job import LightsJob, lights_to_rig

    return lights_to_rig(LightsJob(out=None if out is None else Path(out), **options))


def calibrate_radiometry(folder: AnyPath, out: AnyPath, **options: Any) -> dict[str, Any]:
    """Calibrate brightness (response, noise, LEDs, fall-off) from a capture of a white card, and write a rig file.

    Parameters
    ----------
    folder : capture folder of the card
    out : rig file to write
    **options
        Of :func:`splitknit.calibration.radiometry_folder.calibrate_to_file`.

    Returns
    -------
    dict
        What was found, as ``splitknit calibrate radiometry --json`` prints it.

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

    return calibrate_to_file(Path(folder), Path(out), **options)
