"""Photographs or a capture folder in, a capture or a folder of results out."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, Literal

from splitknit.arguments import (
    AnyPath,
    Encoding,
    Preset,
    Progress,
    Report,
    Settings,
    checked,
    refuse_given,
    silent,
)
from splitknit.errors import BadInput, naming, require
from splitknit.findings import SEVERITY_WORDS, Finding, Severity, worst_first
from splitknit.io.photographs import (
    NO_PHOTOGRAPHS,
    OF_CAPTURES,
    AllPhotographs,
    GivenPhotographs,
    Lights,
)
from splitknit.registry import IMPORTS, registered

if TYPE_CHECKING:
    from splitknit.capture import Capture
    from splitknit.model import FloatArray
    from splitknit.reconstruction import Reconstruction

_LOG = logging.getLogger(__name__)


def read_photographs(
    images: AnyPath,
    lights: Lights | None = None,
    px_per_mm: float | None = None,
    *,
    light_frame: str | None = None,
    ridge_period_mm: float | None = None,
    mask: AnyPath | None = None,
    material: Literal["skin", "opaque"] | None = None,
    tip_direction_deg: float | None = None,
    encoding: Encoding | None = None,
    brightness: Literal["estimate", "equal"] | None = None,
    background: float | AnyPath | None = None,
    crossed: AnyPath | None = None,
    flat: AnyPath | None = None,
    nir: AnyPath | None = None,
) -> Capture:
    """Read photographs of one object under one light after the other, taken by any camera, as a
    capture.

    What was assumed of them (such as their encoding) is logged by the logger ``splitknit.folders``.

    Parameters
    ----------
    images : path
        Folder of photographs, or a pattern of their names.
    lights : path, directions (L, 3) or Rig, optional
        By default ``lights.txt`` beside the images.
    px_per_mm : float, optional
        Scale on the object; without it heights are in pixels.
    light_frame, ridge_period_mm, mask, material, tip_direction_deg, encoding : optional
        See :class:`splitknit.io.photographs.GivenPhotographs`, whose fields they are.
    brightness, background, crossed, flat, nir : optional
        Likewise.

    Returns
    -------
    Capture

    Raises
    ------
    BadInput
        If photographs are missing, damaged, black or overexposed, or do not fit their lights.

    Examples
    --------
    >>> import splitknit
    >>> capture = splitknit.read_photographs(  # doctest: +SKIP
    ...     "photos", "lights.txt", px_per_mm=20.0
    ... )
    >>> splitknit.reconstruct(capture).height_mm.shape  # doctest: +SKIP
    (1500, 2000)
    """
    capture, notes = capture_of(GivenPhotographs(**locals()))
    for note in notes:
        _LOG.info("%s", note)
    return capture


def capture_of(photographs: GivenPhotographs) -> tuple[Capture, list[Finding]]:
    """Photographs as a capture, and what was assumed of them. Raises BadInput as
    :func:`read_photographs`."""
    from splitknit.observation.plain import capture_from_photographs
    from splitknit.reconstruction import UNKNOWN_SCALE

    images = photographs.images
    assert images is not None
    read, assumed = capture_from_photographs(photographs)
    capture, notes = _with_frame_and_scale(read, images, photographs, None)
    if not capture.rig.camera.scale_known:
        notes.append(Finding("scale-unknown", UNKNOWN_SCALE))
    return capture, [*assumed, *notes]


def _with_frame_and_scale(
    capture: Capture, source: AnyPath, photographs: GivenPhotographs, px_per_mm: float | None
) -> tuple[Capture, list[Finding]]:
    """The capture with lights in the stated frame and the stated scale, and notes on it."""
    from splitknit.diagnosis.frames import rig_of_frame
    from splitknit.pipeline import with_scale

    if photographs.light_frame is not None:
        capture = replace(capture, rig=rig_of_frame(capture.rig, photographs.light_frame))
    capture, note = naming(
        source, partial(with_scale, capture, px_per_mm, photographs.ridge_period_mm)
    )
    return capture, [Finding("scale-of-ridges", note)] if note else []


@checked
def reconstruct_to_folder(
    capture: AnyPath | None = None,
    *,
    out: AnyPath,
    normals: AnyPath | None = None,
    normals_y: Literal["up", "down"] | None = None,
    preset: Preset = "metric",
    rig: AnyPath | None = None,
    shape: Literal["nir", "white", "mirror"] | None = None,
    keep: bool = False,
    strict: bool = False,
    keep_steps: bool = False,
    settings: Settings = None,
    photographs: AllPhotographs = NO_PHOTOGRAPHS,
    progress: Progress = silent,
) -> Report:
    """Turn a capture folder, photographs or a normal map into a surface.

    Parameters
    ----------
    capture
        Capture folder (with capture.json), or see `images`.
    out
        Folder to write the results into.
    normals
        Normal map of another program, which is integrated: PNG or TIFF of 8 or 16 bits, .npy, .npz,
        or EXR (extra 'photos'); x right, y up, z to the camera. With photographs, the part of their
        light that it leaves unexplained is written, and the regions that contradict it are named.
    normals_y
        Where its y points in the image (default: up, or down where only that makes a surface of
        it).
    preset
        metric (the default), or the thesis's snk (all of it), pr (direct light, no split), ea
        (plain), these two split by shapelets (pr-split, ea-split), or another published case:
        kumar, zheng, lin.
    rig
        Rig file instead of the capture's, such as a calibration; with `images` its white LEDs and
        camera.
    shape
        Where the finger's shape comes from: near-infrared (nir, the default), white light, or its
        outlines in mirrors beside it (mirror).
    keep
        Go on where photographs that contradict each other spoil the surface of skin.
    strict
        Write nothing where a note says that something spoils the surface.
    keep_steps
        Write what the steps made of the photographs into steps/: their chromaticity and its raw
        mask where the finger is looked for by it, and, of the thesis's presets, each white
        photograph enhanced, its direct and its global light.
    photographs
        What is known of photographs in place of a capture folder.

    Returns
    -------
    Report
        Facts of ``report.json``, and ``out``, ``area_mm2``, ``total_s``.

    Raises
    ------
    BadInput
        Naming the argument or the file at fault; nothing is written.

    Examples
    --------
    >>> reconstruct_to_folder("capture", out="result").facts["area_mm2"]  # doctest: +SKIP
    423.7
    """
    from splitknit.io.atomic import atomic_folder
    from splitknit.io.normal_maps import read_normal_map
    from splitknit.io.paging import one_heap
    from splitknit.io.targets import check_target
    from splitknit.presets import preset_settings
    from splitknit.settings import override

    alone = capture is None and photographs.images is None
    _check_sources(capture, normals, photographs)
    if alone:
        refuse_given(
            "goes with photographs.",
            preset=preset != "metric",
            shape=shape,
            keep=keep,
            keep_steps=keep_steps,
            settings=settings,
        )
    if normals is None:
        refuse_given("goes with `normals`.", normals_y=normals_y)
    changes = dict(settings or {}) | ({"keep": True} if keep else {})
    if shape is not None:
        changes["shape.source"] = shape
    started = time.perf_counter()
    one_heap()
    source = Path(capture or photographs.images or normals or "")
    # a wrong setting is refused before the images are read
    override(preset_settings(preset), changes)
    check_target(Path(out), "height.npz", "an earlier result", keep=source)
    with atomic_folder(Path(out)) as target:
        progress("reading", 0.0)
        given = None if normals is None else read_normal_map(normals)
        photographed, notes = (None, []) if alone else _read(capture, rig, photographs)
        read_s = time.perf_counter() - started
        small = None if photographed is None else _small(photographed)  # for the report
        kept: dict[str, FloatArray] = {}
        if given is not None and alone:
            result = _of_map(given, source, photographs, rig, normals_y)
        try:
            if photographed is not None:
                result = _of_photographs(
                    photographed,
                    preset,
                    changes,
                    lambda stage, fraction: progress(stage, 0.15 + 0.65 * fraction),
                    kept if keep_steps else None,
                    given=given,
                    y=normals_y,
                )
            findings = worst_first((*notes, *result.findings))
            if strict:
                _refuse_doubts(findings)
            timings = {"reading": read_s, **result.timings_s}
            result = replace(result, timings_s=timings, findings=findings)
            progress("writing", 0.8)
            facts = _written(result, small, target, kept, keep_steps=keep_steps)
        except BadInput as error:  # stages know arrays only
            raise BadInput(f"{source}: {error}") from error
    progress("done", 1.0)
    total_s = time.perf_counter() - started
    facts |= {"out": str(out), "area_mm2": facts["result"]["area_mm2"], "total_s": total_s}
    return Report(facts, tuple(_lines(facts)))


def _lines(facts: dict[str, Any]) -> Iterator[str]:
    """What was written, for people; what spoils it first."""
    result, out = facts["result"], facts["out"]
    area = f"{result['area_px']} px (scale unknown)"
    if result["scale_known"]:
        area = f"{facts['area_mm2']:.0f} mm²"
    findings = [
        f"{SEVERITY_WORDS[each['severity']]}: {each['message']}" for each in facts["findings"]
    ]
    # the worst stand first
    doubts = sum(each["severity"] != Severity.NOTE for each in facts["findings"])
    yield from findings[:doubts]
    yield f"{area} reconstructed with preset {facts['preset']} in {facts['total_s']:.1f} s."
    yield f"Written to {out}: {', '.join(facts['files'])}."
    yield from findings[doubts:]
    for preset, figure in facts["comparison"].items():
        yield (
            f"Against the truth ({preset}): surface rms {figure['surface_rms_mm']:.3f} mm, ridge"
            f" correlation {figure['ridge_correlation']:.2f}, ridge gain"
            f" {figure['ridge_gain']:.2f}."
        )
    yield f"Open {Path(out) / 'report.html'} in a browser."


def _check_sources(
    capture: AnyPath | None, normals: AnyPath | None, photographs: GivenPhotographs
) -> None:
    """Refuse none, or two sources of photographs, and what is stated of others."""
    require(
        capture is None or photographs.images is None,
        "name a capture folder, or photographs with `images`; both were given.",
    )
    alone = capture is None and photographs.images is None
    require(
        not alone or normals is not None,
        "name a capture folder, photographs with `images` DIR `lights` FILE, or a normal map with"
        " `normals`.",
    )
    photographs.refuse_without_images(*(("px_per_mm", "mask") if alone else OF_CAPTURES))


def _refuse_doubts(findings: Sequence[Finding]) -> None:
    for finding in findings:
        require(finding.severity == Severity.NOTE, f"{str(finding).rstrip('.')} (`strict`).")


def _written(
    result: Reconstruction,
    small: Capture | None,
    target: Path,
    kept: dict[str, FloatArray],
    *,
    keep_steps: bool,
) -> dict[str, Any]:
    """Write the result; return the facts of its report."""
    from splitknit.report.result import write_files, write_steps

    comparisons = []
    compare = registered(IMPORTS).get("truth")  # the simulator's
    if compare and small is not None and small.truth is not None and result.scale_known:
        comparisons.append(resolve_name(compare)(result, small))
    step_facts, step_files = write_steps(kept, target)
    if keep_steps:
        result = replace(result, facts={**result.facts, "steps": step_facts})
    return write_files(result, small, target, comparisons, step_files)


def _small(capture: Capture) -> Capture:
    """The capture with its images as small as the report shows them."""
    from splitknit.report.photos import small_images

    bands = {
        name: replace(band, pixels=small_images(band), ambient=None)
        for name, band in capture.bands.items()
    }
    return replace(capture, bands=bands)


NormalMap = tuple["FloatArray", dict[str, str]]
"""Normals (H, W, 3), and the SHA-256 of their file."""


def _of_photographs(
    capture: Capture,
    preset: str,
    changes: dict[str, Any],
    progress: Progress,
    kept: dict[str, FloatArray] | None,
    *,
    given: NormalMap | None,
    y: Literal["up", "down"] | None,
) -> Reconstruction:
    """The surface of photographs; or that of a `given` normal map, compared with it."""
    from splitknit.methods.normals import compared, surface_of_normals
    from splitknit.pipeline import located, reconstruct

    if given is None:
        return reconstruct(capture, preset, changes, progress, kept=kept)
    finger = located(capture, preset, changes)
    photometric = reconstruct(finger, preset, changes, progress, kept=kept)
    require(
        photometric.normals_measured is not None,
        "`normals` are compared with photographs of an opaque object, not of `material` skin.",
    )
    normals, hashes = given
    camera = finger.observation.rig.camera
    surface = surface_of_normals(normals, photometric.mask, camera=camera, y=y)
    return compared(replace(surface, hashes=hashes), finger, photometric)


def _of_map(
    given: NormalMap,
    source: Path,
    photographs: GivenPhotographs,
    rig: AnyPath | None,
    y: Literal["up", "down"] | None,
) -> Reconstruction:
    """The surface of a normal map alone."""
    from splitknit.io.normal_maps import read_mask
    from splitknit.io.rig import read_rig
    from splitknit.methods.normals import surface_of_normals

    normals, hashes = given
    scale = photographs.px_per_mm
    require(rig is None or scale is None, "`rig` and `px_per_mm` both give the scale; choose one.")
    camera = None if rig is None else read_rig(rig).camera
    mask = None
    if photographs.mask is not None:
        mask, of_mask = read_mask(photographs.mask, (normals.shape[0], normals.shape[1]))
        hashes = {**hashes, **of_mask}
    surface = naming(source, lambda: surface_of_normals(normals, mask, scale, camera=camera, y=y))
    return replace(surface, hashes=hashes)


def _read(
    capture_folder: AnyPath | None, rig_file: AnyPath | None, photographs: GivenPhotographs
) -> tuple[Capture, list[Finding]]:
    """The capture, with what was stated in place of its own; and notes on it."""
    from splitknit.io.capture import read_capture, with_rig

    rig = None if rig_file is None else Path(rig_file)
    if capture_folder is None:
        require(
            rig is None or photographs.lights is None,
            "`rig` and `lights` both give the lights; choose one.",
        )
        named = rig is None or rig.suffix.lower() == ".json"
        require(
            named,
            f"`rig` must name a rig file (.json), not '{rig}'; name a list of lights with"
            " `lights`.",
        )
        return capture_of(photographs if rig is None else replace(photographs, lights=rig))
    capture = read_capture(capture_folder)
    if rig is not None:
        capture = with_rig(capture, rig)
    if photographs.tip_direction_deg is not None:
        capture = replace(capture, tip_direction_deg=photographs.tip_direction_deg)
    return _with_frame_and_scale(capture, capture_folder, photographs, photographs.px_per_mm)
