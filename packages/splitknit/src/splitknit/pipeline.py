"""From a capture to a metric fingerprint: :func:`reconstruct` picks a method and its parameters.

The algorithm is in :mod:`splitknit.methods`, one function a method; presets are in
:mod:`splitknit.presets`. Time and progress wrap the steps from outside (:mod:`splitknit.steps`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from typing import Any

from splitknit import steps
from splitknit.capture import Capture
from splitknit.diagnosis.size import doubt_of_size
from splitknit.errors import require
from splitknit.findings import Finding, refuse, worst_first
from splitknit.methods import METHODS, method_for
from splitknit.methods.photographs import (
    FingerPhotographs,
    findings_for,
    on_mirror_shape,
    photographs_of,
    placed,
)
from splitknit.methods.scale import with_scale, with_working_scale
from splitknit.model import FloatArray
from splitknit.plausible import TOP
from splitknit.presets import PipelineSettings, chosen_settings
from splitknit.reconstruction import UNKNOWN_SCALE, Reconstruction

__all__ = ["located", "reconstruct", "reconstruct_images", "with_scale"]

NO_MIRRORS = (
    "the rig has no mirrors, so that the shape cannot come from them: add them to rig.json, or"
    " take `shape` nir or white."
)


def reconstruct(
    capture: Capture | FingerPhotographs,
    preset: str = "metric",
    settings: Mapping[str, Any] | PipelineSettings | None = None,
    progress: Callable[[str, float], None] | None = None,
    *,
    kept: dict[str, FloatArray] | None = None,
) -> Reconstruction:
    """Reconstruct one finger.

    Parameters
    ----------
    capture : Capture
        From :func:`splitknit.read_capture` or a simulator; or what :func:`located` returns, which
        several presets share.
    preset : a name of :data:`PRESETS`
    settings : mapping from ``stage.field`` to a value, or whole settings, optional
        Changes to the preset (mappings may be nested), of which the result says ``snk, changed``;
        whole settings instead of a preset are named after the one that they are, or are nearest to.
    progress : called with the name of the stage and the fraction done, optional
    kept : dict, optional
        Takes the images of those steps that the preset has, linear light:
        ``chromaticity`` (h, w, 3) and its cluster ``raw_mask`` (h, w), reduced, and ``enhanced``,
        ``direct`` and ``global`` (L, h, w) of the finger's window under each white light.

    Returns
    -------
    Reconstruction
        On the input's pixel grid.

    Raises
    ------
    BadInput
        If the capture shows no finger, lacks a band, or a setting is not known; if the finger was
        located by other settings than the preset's; if photographs of skin contradict each other or
        their lights (setting ``keep``).

    Examples
    --------
    >>> import splitknit
    >>> import splitknit_simulator
    >>> capture, truth = splitknit_simulator.simulate_capture(1, settings={"scale": 0.08})
    >>> splitknit.reconstruct(capture, "snk", {"shapelets.scales": 4}).height_mm.shape
    (176, 256)

    References
    ----------
    A. Srivastava, "Split and Knit Algorithm for 3D fingerprint reconstruction using Single Camera",
    chapter 3.
    """
    name, chosen = chosen_settings(preset, settings)
    notes = TOP.notes(chosen.top_mm, "it is the setting top_mm")
    with steps.timed_run(progress, kept) as seconds:
        photographs = _photographs(capture, chosen)
        findings = findings_for(photographs, chosen)
        refuse(findings, keep=chosen.keep)
        surface = METHODS[method_for(photographs, chosen)](photographs, chosen)
        if chosen.shape.source == "mirror":
            photographs, surface = on_mirror_shape(photographs, surface, chosen)
        result = placed(photographs, surface, chosen.top_mm)
    odd = doubt_of_size(photographs.observation, result, chosen.method == "metric")
    result = replace(
        result,
        findings=worst_first((*odd, *notes, *findings, *surface.findings)),
        preset=name,
        settings=asdict(chosen),
        timings_s=dict(seconds),
    )
    return result if result.scale_known else _of_unknown_scale(result)


def located(
    capture: Capture,
    preset: str = "metric",
    settings: Mapping[str, Any] | PipelineSettings | None = None,
) -> FingerPhotographs:
    """The finger in a capture, and what is wrong with its photographs, for several calls of
    :func:`reconstruct` by presets that find it in the same way.

    Parameters and errors are those of :func:`reconstruct`.

    Examples
    --------
    >>> import splitknit_simulator
    >>> capture, truth = splitknit_simulator.simulate_capture(1, settings={"scale": 0.08})
    >>> finger = located(capture, "snk")
    >>> [reconstruct(finger, preset).preset for preset in ("snk", "ea")]
    ['snk', 'ea']
    """
    _, chosen = chosen_settings(preset, settings)
    require(
        "white" in capture.bands, "the capture has no band 'white'; every reconstruction needs it."
    )
    require(chosen.shape.source != "mirror" or capture.rig.mirrors, NO_MIRRORS)
    scaled, of_scale = with_working_scale(capture)
    photographs = photographs_of(scaled, chosen.finding())
    return replace(photographs, findings=(*of_scale, *photographs.findings))


def _photographs(
    capture: Capture | FingerPhotographs, settings: PipelineSettings
) -> FingerPhotographs:
    if isinstance(capture, Capture):
        return located(capture, settings=settings)
    require(
        capture.settings == settings.finding(),
        "the finger was located by other settings than this preset's; locate it by the same.",
    )
    return capture


def reconstruct_images(
    images: Any,
    lights: Any,
    mask: Any = None,
    px_per_mm: float | None = None,
    intensities: Any = None,
) -> Reconstruction:
    """Reconstruct an object from arrays: one image for each distant light, by the preset `metric`.

    Parameters
    ----------
    images : (L, H, W) or (L, H, W, 3) of uint8, uint16 or floats
        Grey, or red, green and blue; linear light, or sRGB where images of 8 bits are shaded so.
    lights : (L, 3)
        Directions towards the lights, x right, y up, z to the camera.
    mask : (H, W) bool, optional
        The object; it is looked for by default.
    px_per_mm : float, optional
        Without it heights are in pixels.
    intensities : (L,) or (L, 3), optional
        Brightness of the lights, or of their red, green and blue; estimated with the surface by
        default.

    Returns
    -------
    Reconstruction
        Its warnings name photographs that do not fit the others, as ``image 0`` and so on.

    Raises
    ------
    BadInput
        If shapes, types or numbers disagree or an image is black or overexposed.

    Examples
    --------
    >>> import numpy as np
    >>> y, x = np.mgrid[1:-1:120j, -1:1:120j]
    >>> normals = np.dstack([x, y, np.sqrt(np.maximum(2 - x**2 - y**2, 0.5))]) / np.sqrt(2)
    >>> across = [[0.5, 0, 0.8], [-0.5, 0, 0.8]]
    >>> lights = np.array([*across, [0, 0.5, 0.8], [0, -0.5, 0.8], [0.3, 0.3, 0.9]])
    >>> images = np.clip(normals @ lights.T, 0, 1).transpose(2, 0, 1)
    >>> result = reconstruct_images(images, lights, x**2 + y**2 < 0.8)
    >>> result.height_mm.shape
    (120, 120)
    """
    from splitknit.observation.plain import capture_of_arrays  # large, and needed here alone

    capture, notes = capture_of_arrays(images, lights, mask, px_per_mm, intensities)
    result = reconstruct(capture)
    return replace(result, findings=worst_first((*notes, *result.findings)))


def _of_unknown_scale(result: Reconstruction) -> Reconstruction:
    """The result with its findings in pixels, a note on the scale, and without an uncertainty in
    micrometres."""
    facts = {
        **result.facts,
        "scale": "unknown, heights in pixels",
        "assumed_px_per_mm": result.unit.per_mm,
    }
    in_pixels = [finding.in_pixels(result.unit.per_mm) for finding in result.findings]
    findings = worst_first((Finding("scale-unknown", UNKNOWN_SCALE), *in_pixels))
    return replace(result, uncertainty_um=None, facts=facts, findings=findings)
