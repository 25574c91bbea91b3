"""What the core's verbs do: photographs or a capture in, files out."""

from __future__ import annotations

import logging
import time
from dataclasses import KW_ONLY, dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, Literal

from splitknit.errors import BadInput, naming, require
from splitknit.io.photographs import PhotographOptions, PxPerMm, RidgePeriod, check_scale
from splitknit.verbs import AnyPath, Device, Help, Job, Preset, Progress, Settings, function_of, path, refuse_given

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from splitknit.model import Capture, Rig

    GivenLights = AnyPath | NDArray[np.float64] | Rig | None
else:
    GivenLights = AnyPath | None

_LOG = logging.getLogger(__name__)

Folder = Annotated[
    AnyPath,
    Help(
        "folder of photographs, one for each light, in the order of their names (or a pattern of names, such as "
        "'photos/white_{light}.jpg'): JPEG, PNG, TIFF, WEBP, BMP; with the extra 'photos' HEIC and camera RAW",
        "DIR",
        option="--images",
    ),
]


@dataclass(frozen=True, slots=True)
class ReadPhotographsJob(PhotographOptions):
    """Read photographs of one object under one light after the other, taken by any camera, as a capture.

    What was assumed of them (their encoding, lights that were averaged) is logged by the logger
    ``splitknit.jobs``.

    Returns
    -------
    Capture

    Examples
    --------
    >>> import splitknit
    >>> capture = splitknit.read_photographs("photos", "lights.txt", px_per_mm=20.0)  # doctest: +SKIP
    >>> splitknit.reconstruct(capture).height_mm.shape  # doctest: +SKIP
    (1500, 2000)
    """

    # fmt: off
    folder: Folder
    lights: Annotated[GivenLights, Help(
        "directions towards the lights, a line 'x y z' or 'NAME x y z' for each photograph: x right, y up, z to the "
        "camera; a fourth number is its brightness (a fourth to sixth: red, green, blue), else light_intensities.txt "
        "beside the list has it; places in mm where the first line is 'x_mm y_mm z_mm'; also .lp files of RTI and rig "
        "files; unknown: they are estimated (default: lights.txt beside the images)", "FILE",
        takes="path, directions (L, 3) or Rig")] = None
    px_per_mm: PxPerMm = None
    _: KW_ONLY
    light_frame: Annotated[str | None, Help(
        "where x and y of the lights' directions point in the image, where not right-up: right-down (y down), left-up "
        "(mirrored), left-down, up-left, up-right, down-left, down-right", "FRAME")] = None
    ridge_period_mm: RidgePeriod = None
    # fmt: on

    def __post_init__(self) -> None:
        PhotographOptions.__post_init__(self)
        check_scale(self.px_per_mm, self.ridge_period_mm)

    def run(self, progress: Progress) -> Capture:
        """Read them."""
        capture, notes = self.read()
        for note in notes:
            _LOG.info("%s", note)
        return capture

    def read(self) -> tuple[Capture, list[str]]:
        """The capture, and what was assumed of it."""
        from splitknit.io.plain import capture_from_photographs
        from splitknit.model import UNKNOWN_SCALE
        from splitknit.photometric.frames import rig_of_frame
        from splitknit.photometric.uncalibrated import with_estimated_lights
        from splitknit.pipeline import with_scale

        found = capture_from_photographs(self.folder, self.lights, self.px_per_mm, self, _LOG.warning)
        taken = naming(self.folder, lambda: with_estimated_lights(found.capture))
        if self.light_frame is not None:
            taken = replace(taken, rig=rig_of_frame(taken.rig, self.light_frame))
        capture, note = naming(self.folder, lambda: with_scale(taken, None, self.ridge_period_mm))
        kept = [one for one in found.notes if one != UNKNOWN_SCALE or not capture.rig.camera.scale_known]
        return capture, [*kept, *([note] if note else [])]


read_photographs = function_of(ReadPhotographsJob)


@dataclass(frozen=True, slots=True)
class Photographs(ReadPhotographsJob):
    """Photographs in place of a capture folder."""

    folder: Annotated[AnyPath | None, Folder.__metadata__[0]] = None  # type: ignore[assignment]

    def check_alone(self) -> None:
        """Without photographs, refuse what only they have. Raises BadInput."""
        if self.folder is None:
            refuse_given(self, OF_PHOTOGRAPHS, "goes with `folder`.")


OF_PHOTOGRAPHS = (
    "lights", "mask", "material", "encoding", "brightness", "background", "max_megapixels", "crossed", "mosaic", "flat"
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class ReconstructJob(Job):
    """Turn a capture folder, or photographs, into a 3D fingerprint.

    Returns
    -------
    dict
        The facts of ``report.json``, and ``out``, ``area_mm2``, ``total_s``.
    """

    # fmt: off
    capture: Annotated[AnyPath | None, Help(
        "capture folder (with capture.json), or see `folder`", "CAPTURE", positional=True)] = None
    _: KW_ONLY
    out: Annotated[AnyPath, Help("folder to write the results into", "DIR")]
    preset: Annotated[Preset, Help(
        "metric (the default), or the thesis's snk (all of it), pr (direct light, no split), ea (plain), these two "
        "split by shapelets (pr-split, ea-split), or another published case: kumar, zheng, lin")] = "metric"
    rig: Annotated[AnyPath | None, Help(
        "rig file instead of the capture's, such as a calibration; with `folder` its white LEDs and camera",
        "RIG")] = None
    shape: Annotated[Literal["nir", "white", "mirror"] | None, Help(
        "where the finger's shape comes from: near-infrared (nir, the default), white light, or its outlines in "
        "mirrors beside it (mirror)")] = None
    device: Device = "cpu"
    keep: Annotated[bool, Help("go on where photographs that contradict each other spoil the surface of skin")] = False
    strict: Annotated[bool, Help("write nothing where a note says that something spoils the surface")] = False
    settings: Settings = None
    photographs: Annotated[Photographs, Help("photographs")] = field(default_factory=Photographs)
    # fmt: on

    def run(self, progress: Progress) -> dict[str, Any]:
        """Read a capture or photographs, reconstruct, write all results."""
        from splitknit.accuracy import read_truth
        from splitknit.io.atomic import atomic_folder
        from splitknit.io.targets import check_target
        from splitknit.networks.unet import use_device
        from splitknit.pipeline import reconstruct
        from splitknit.presets import preset_settings
        from splitknit.report.result import write_files
        from splitknit.settings import override
        from splitknit.steps import one_heap

        changes = dict(self.settings or {}) | ({"keep": True} if self.keep else {})
        if self.shape is not None:
            changes["shape.source"] = self.shape
        both = "; both were given." if self.capture is not None else "."
        one = (self.capture is None) != (self.photographs.folder is None)
        require(one, f"name a capture folder, or photographs with `folder` DIR `lights` FILE{both}")
        self.photographs.check_alone()
        started = time.perf_counter()
        one_heap()
        source, out = path(self.capture or self.photographs.folder), path(self.out)
        override(preset_settings(self.preset), changes)  # a wrong setting is refused before the images are read
        check_target(out, "height.npz", "an earlier result", keep=source)
        device = use_device(self.device)
        with atomic_folder(out) as target:
            progress("reading", 0.0)
            capture, notes = self._read()
            read_s = time.perf_counter() - started
            shown, held = _shown_of(capture), [capture]
            del capture  # so that its images go once they are read: 0.3 GB less at a full frame's peak
            try:
                result = reconstruct(
                    held.pop(), self.preset, changes, lambda stage, fraction: progress(stage, 0.15 + 0.65 * fraction)
                )
                if device != "cpu":  # its last digits are others'
                    result = replace(result, facts={**result.facts, "device": device})
                said = [note for note in notes if not any(note in warning for warning in result.warnings)]
                timings, spoilt = {"reading": read_s, **result.timings_s}, result.facts.get("spoilt", 0)
                require(not (self.strict and spoilt), f"{result.warnings[0].rstrip('.') if spoilt else ''} (`strict`).")
                warnings = (*result.warnings[:spoilt], *said, *result.warnings[spoilt:])
                result = replace(result, timings_s=timings, warnings=warnings)
                progress("writing", 0.8)
                truth = read_truth(shown) if shown.truth is not None and shown.rig.camera.scale_known else None
                facts = write_files(result, shown, target, truth)
            except BadInput as error:  # stages know arrays only
                raise BadInput(f"{source}: {error}") from error
        progress("done", 1.0)
        total_s = time.perf_counter() - started
        return {**facts, "out": str(out), "area_mm2": facts["result"]["area_mm2"], "total_s": total_s}

    def _read(self) -> tuple[Capture, list[str]]:
        """The capture, with what was given in place of its own, and notes on it."""
        from splitknit.io.capture import read_capture, with_rig
        from splitknit.photometric.frames import rig_of_frame
        from splitknit.pipeline import with_scale

        given, rig = self.photographs, path(self.rig)
        if self.capture is None:
            require(rig is None or given.lights is None, "`rig` and `lights` both give the lights; choose one.")
            named = rig is None or rig.suffix.lower() == ".json"
            require(named, f"`rig` must name a rig file (.json), not '{rig}'; name a list of lights with `lights`.")
            return replace(given, lights=given.lights or rig).read()
        capture = read_capture(self.capture)
        if rig is not None:
            capture = with_rig(capture, rig)
        if given.tip_direction_deg is not None:
            capture = replace(capture, tip_direction_deg=given.tip_direction_deg)
        if given.light_frame is not None:
            capture = replace(capture, rig=rig_of_frame(capture.rig, given.light_frame))
        scaled = partial(with_scale, capture, given.px_per_mm, given.ridge_period_mm)
        capture, note = naming(self.capture, scaled)
        return capture, [note] if note else []


def _shown_of(capture: Capture) -> Capture:
    """The capture with small images for a report, so that the large ones can be let go, for the sake of memory."""
    from splitknit.report.photos import small_images

    bands = {name: replace(band, pixels=small_images(band), ambient=None) for name, band in capture.bands.items()}
    return replace(capture, bands=bands)
