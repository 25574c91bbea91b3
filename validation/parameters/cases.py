"""Small simulated captures, and what is measured on each against its truth."""

from __future__ import annotations

import copy
import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any
from unittest.mock import patch

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.finger.ridge_period import ridge_period
from splitknit.finger.ridges import ink, surface_print
from splitknit.imaging.geometry import BAND_SIGMA_MM, EROSION_MM, bounding_box, eroded, high_passed
from splitknit.methods import METHODS, method_for, metric
from splitknit.methods.photographs import (
    FingerPhotographs,
    on_mirror_shape,
    photographs_of,
    placed,
)
from splitknit.model import Rig
from splitknit.nominal import default_rig
from splitknit.presets import PipelineSettings, chosen_settings
from splitknit.reconstruction import Reconstruction
from splitknit.settings import override
from splitknit.skin.grid import Grid
from splitknit.skin.polarised import SpecularImages, polarised_heights
from splitknit_simulator.accuracy import compare
from splitknit_simulator.finger.finger import FingerPose
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.twin import simulate_capture

Truth = Mapping[str, NDArray[Any]]

SEED = 9401
"""The simulated finger; no constant was chosen on it."""
OTHER_SEED = 9402
"""A second finger between mirrors, on which more constants show an effect."""
SCALE = 0.2
"""Size of the images of a whole finger: 440 x 640 pixels, 15 px/mm."""
TIP_SCALE = 0.35
"""Scale of the images of a fingertip: 26 px/mm, which networks and films need."""
TIP_SIZE = (330, 640)
"""Their rows and columns."""
STRIP_MM = 2.6
"""Length of the strip, from the finger's middle to its side, on which films are measured."""
RING = 7
"""White lights around the camera; those after them stand at the finger's side."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What one run gives."""

    figures: Mapping[str, float]
    findings: str
    """Codes of what was found wrong, with spaces between."""
    digest: str
    """Of every array of the result, the figures and the findings."""


Measure = Callable[[], Outcome]


@dataclass(frozen=True, slots=True)
class Case:
    """A capture on which the constants of some modules are varied."""

    modules: tuple[str, ...]
    make: Callable[[], Measure]
    """Simulates the capture and does what the constants do not change; what is returned does the
    rest."""


def outcome(
    figures: Mapping[str, float], arrays: Sequence[NDArray[Any] | None], findings: str = ""
) -> Outcome:
    """The outcome, with its digest."""
    digest = hashlib.sha256(repr((sorted(figures.items()), findings)).encode())
    for array in arrays:
        digest.update(b"none" if array is None else np.ascontiguousarray(array).tobytes())
    return Outcome(figures, findings, digest.hexdigest()[:16])


def of_result(
    result: Reconstruction, truth: Truth, names: Sequence[str]
) -> tuple[dict[str, float], list[NDArray[Any] | None]]:
    """Figures of these names, the error over the stated one, and the arrays."""
    comparison = compare(result, truth)
    figures = {name: comparison.figures[name] for name in names}
    if result.uncertainty_um is not None:
        stated = result.uncertainty_um[comparison.band]
        error = comparison.ridge_error_um[comparison.band]
        figures["error_over_stated"] = rms(error) / rms(stated)
    return figures, [result.height_mm, result.ridge_mm, result.mask, result.uncertainty_um]


def rms(values: NDArray[Any]) -> float:
    """Root mean square of the known values."""
    return float(np.sqrt(np.nanmean(np.square(values.astype(np.float64)))))


SURFACE = ("surface_rms_mm", "ridge_rms_um", "ridge_gain", "ridge_correlation")


# The finger in the photographs: its mask, direction, crease and motion. The surface is that of the
# quickest preset.


def found_finger(changes: Mapping[str, Any], settings: Mapping[str, Any]) -> Measure:
    """Mask, yaw, crease and motion in the white images of a whole finger."""
    capture, truth = simulate_capture(SEED, None, {"scale": SCALE, **changes})
    capture = replace(capture, bands={"white": capture.bands["white"]})
    _, chosen = chosen_settings("ea", settings)
    known: dict[str, tuple[dict[str, float], list[NDArray[Any] | None]]] = {}

    def measure() -> Outcome:
        photographs = photographs_of(capture, chosen.finding())
        finger = photographs.finger
        pixels = photographs.observation.white.at(4).grey
        upright = finger.upright.input_from_upright
        place = outcome({}, [finger.mask, finger.wider, pixels, upright]).digest
        if place not in known:  # the surface follows from these
            surface = METHODS[method_for(photographs, chosen)](photographs, chosen)
            result = placed(photographs, surface, 0.0)
            figures, arrays = of_result(
                result, truth, (*SURFACE, "mask_overlap", "mask_on_finger", "ridge_area_mm2")
            )
            yaw_deg = float(np.rad2deg(truth["landmark_yaw_rad"]))
            figures["yaw_error_deg"] = abs(finger.facts["yaw_deg"] - yaw_deg)
            known[place] = figures, [*arrays, upright]
        figures, arrays = known[place]
        line = finger.facts["crease_line"]
        if line is not None:
            row = float(np.mean([end[1] for end in line]))
            true_row = float(np.median(truth["landmark_crease_px_0"][:, 1]))
            figures = {
                **figures,
                "crease_error_mm": abs(row - true_row) * capture.rig.camera.pitch_mm,
            }
        return outcome(figures, arrays, " ".join(f.code for f in finger.findings))

    return measure


# The surface of skin, by networks and by colours; what follows from it.


def tip_settings(changes: Mapping[str, Any]) -> TwinSettings:
    """The twin's settings for a fingertip that fills a small image."""
    rig = default_rig(TIP_SCALE, 0)
    camera = replace(rig.camera, image_size=TIP_SIZE)
    pose = FingerPose(
        yaw_rad=0.05, roll_rad=0.1, insertion_mm=round(TIP_SIZE[0] * camera.pitch_mm - 1.1, 1)
    )
    settings = TwinSettings(scale=TIP_SCALE, rig=replace(rig, camera=camera), pose=pose)
    return override(settings, changes)


def opened(
    settings: TwinSettings, preset: str, changes: Mapping[str, Any], seed: int = SEED
) -> tuple[FingerPhotographs, PipelineSettings, Truth]:
    """Photographs in which the finger was found, the settings, and the truth."""
    capture, truth = simulate_capture(seed, None, settings)
    _, chosen = chosen_settings(preset, changes)
    return photographs_of(capture, chosen.finding()), chosen, truth


def surface_of(photographs: FingerPhotographs, settings: PipelineSettings) -> Reconstruction:
    """The surface of photographs, which are kept."""
    surface = METHODS[method_for(photographs, settings)](copy.copy(photographs), settings)
    result = placed(photographs, surface, 0.0)
    return replace(result, findings=surface.findings)


def skin_surface(relief: str) -> Measure:
    """The surface of a fingertip by the default preset, the relief by `network` or `colour`."""
    photographs, settings, truth = opened(tip_settings({}), "metric", {"metric.relief": relief})

    def measure() -> Outcome:
        result = surface_of(photographs, settings)
        codes = " ".join(finding.code for finding in result.findings)
        return outcome(*of_result(result, truth, SURFACE), codes)

    return measure


def prints() -> Measure:
    """Prints of the reconstructed relief against those of the true one, by the constants as they
    are, and the distance of the ridges against the true one."""
    photographs, settings, truth = opened(tip_settings({}), "metric", {})
    result = surface_of(photographs, settings)
    true_ridges = np.where(result.mask, truth["height_mm"] - truth["shape_mm"], np.nan)
    true = replace(result, ridge_mm=true_ridges.astype(np.float32))
    weight = result.mask.astype(np.float32)

    def both(result: Reconstruction) -> list[NDArray[Any]]:
        return [surface_print(result), ink(np.nan_to_num(result.ridge_mm), weight)]

    references = both(true)

    def measure() -> Outcome:
        images = both(result)
        period = ridge_period(result.normals, result.mask)
        figures = {
            "print_correlation": correlation(images[0], references[0]),
            "ink_correlation": correlation(images[1], references[1]),
            "period_error": abs(
                period.period_px * result.pitch_mm / float(truth["landmark_period_mm"]) - 1
            ),
        }
        return outcome(figures, images)

    return measure


def correlation(first: NDArray[Any], second: NDArray[Any]) -> float:
    """Of two pictures."""
    return float(np.corrcoef(first.ravel(), second.ravel())[0, 1])


@cache
def specular_reflection(kind: str) -> tuple[Rig, Truth, tuple[Any, ...]]:
    """A fingertip under lights from the front and from the side, behind films of a `kind`, and what
    the step that measures heights by specular reflection is given."""
    settings = tip_settings({"side_lights": RING, "films.kind": kind})
    photographs, chosen, truth = opened(settings, "metric", {})
    calls: list[tuple[Any, ...]] = []

    def recorded(*arguments: Any) -> Any:
        calls.append(arguments)
        return polarised_heights(*arguments)

    with patch.object(metric, "polarised_heights", recorded):
        surface_of(photographs, chosen)
    return photographs.observation.rig, truth, calls[0]


def specular_heights(kind: str, lights: int) -> Measure:
    """Heights by specular reflection on a strip of a fingertip, from the network's surface, under
    the first `lights`."""
    rig, truth, (images, grid, start, deviation, separated) = specular_reflection(kind)
    strip = strip_of(grid)
    own = grid_of(grid, strip)
    part = SpecularImages(
        images.stack[(slice(lights), *strip)],
        images.noise,
        replace(images.rig, leds=images.rig.leds[:lights]),
    )
    height, shape = (on_grid(truth[name], grid, rig)[strip] for name in HEIGHTS)
    inside = own.mask & np.isfinite(height)
    counted = eroded(inside, EROSION_MM / own.pitch_mm)
    sigma = BAND_SIGMA_MM / own.pitch_mm
    true_band = high_passed(np.where(inside, height - shape, 0), inside, sigma)

    def measure() -> Outcome:
        estimate, stated, _ = polarised_heights(
            part, own, start[strip], deviation[strip], separated
        )
        band = high_passed(np.where(inside, estimate - shape, 0), inside, sigma)
        e, t = band[counted], true_band[counted]
        figures = {
            "ridge_rms_um": 1000 * rms(e - t),
            "ridge_gain": float(e @ t / (t @ t)),
            "ridge_correlation": correlation(e, t),
            "error_over_stated": rms(e - t) / rms(stated[counted]),
        }
        if separated:  # without films, the shape is not taken from here
            figures["surface_rms_mm"] = float(np.std((estimate - height)[counted]))
        return outcome(figures, [estimate, stated])

    return measure


HEIGHTS = ("height_mm", "shape_mm")


def strip_of(grid: Grid) -> tuple[slice, slice]:
    """Rows and columns of a strip from the middle of the finger to its right side."""
    rows, columns = bounding_box(grid.mask)
    middle = (rows.start + rows.stop) // 2
    half = round(STRIP_MM / grid.pitch_mm / 2)
    return slice(middle - half, middle + half), slice((columns.start + columns.stop) // 2, None)


def grid_of(grid: Grid, strip: tuple[slice, slice]) -> Grid:
    """The strip's grid."""
    cut = (True, True, True, False)
    return Grid(grid.mask[strip], grid.x_mm[strip[1]], grid.y_mm[strip[0]], grid.pitch_mm, cut)


def on_grid(field: NDArray[Any], grid: Grid, rig: Rig) -> NDArray[np.float32]:
    """A field (H, W) of the image on the grid's places."""
    camera = rig.camera
    rows, columns = camera.image_size
    x = (grid.x_mm / camera.pitch_mm + (columns - 1) / 2).astype(np.float32)
    y = ((rows - 1) / 2 - grid.y_mm / camera.pitch_mm).astype(np.float32)
    places = np.meshgrid(x, y)
    values = field.astype(np.float32)
    return np.asarray(
        cv2.remap(values, *places, cv2.INTER_LINEAR, None, cv2.BORDER_REFLECT), np.float32
    )


# The shape from mirrors, and direct light by the network.


def mirrors(seed: int) -> Measure:
    """The shape of a finger between two mirrors."""
    photographs, settings, truth = opened(
        whole_settings({"mirrors.names": ("left", "right"), "mirrors.nir": False}),
        "metric",
        {"shape.source": "mirror", "metric.relief": "colour"},
        seed,
    )
    surface = METHODS["skin"](copy.copy(photographs), settings)

    def measure() -> Outcome:
        own, on_shape = on_mirror_shape(copy.copy(photographs), surface, settings)
        result = placed(own, on_shape, 0.0)
        figures, arrays = of_result(result, truth, ("shape_rms_mm", "mask_overlap"))
        figures.pop("error_over_stated", None)
        new = on_shape.findings[len(surface.findings) :]
        codes = " ".join(finding.code for finding in new)
        return outcome(figures, arrays, codes)

    return measure


def whole_settings(changes: Mapping[str, Any]) -> TwinSettings:
    """The twin's settings for a whole finger."""
    return override(TwinSettings(scale=SCALE), changes)


def direct_by_network() -> Measure:
    """The thesis's case `snk` of a whole finger, whose direct light a network separates."""
    photographs, settings, truth = opened(whole_settings({}), "snk", {})

    def measure() -> Outcome:
        return outcome(*of_result(surface_of(photographs, settings), truth, SURFACE))

    return measure


FINDING = tuple(
    f"splitknit.finger.{name}"
    for name in (
        *("locate", "mask", "motion", "orientation"),
        *("phalange", "quality", "regions", "steady"),
    )
)
"""Modules that find a finger; those of contrast and of prints need another preset's surface."""
CASES = {
    "whole": Case(
        FINDING,
        lambda: found_finger({}, {}),
    ),
    "dusty": Case(
        ("splitknit.finger.quality",), lambda: found_finger({"condition.kind": "dusty"}, {})
    ),
    "paper": Case(
        ("splitknit.finger.mask",),
        lambda: found_finger({"background.colour": (0.2, 0.4, 0.6, 0.5)}, {}),
    ),
    "moved": Case(
        ("splitknit.finger.motion", "splitknit.finger.registration", "splitknit.finger.steady"),
        lambda: found_finger({"motion.amplitude_mm": 0.5}, {}),
    ),
    "network": Case(
        ("splitknit.skin", "splitknit.methods", "splitknit.networks"),
        lambda: skin_surface("network"),
    ),
    "colour": Case(("splitknit.skin", "splitknit.methods"), lambda: skin_surface("colour")),
    "prints": Case(("splitknit.finger.ridges", "splitknit.finger.ridge_period"), prints),
    "films": Case(
        ("splitknit.skin.polarised",),
        lambda: specular_heights("analyser", RING),
    ),
    "films and side": Case(
        ("splitknit.skin.polarised",),
        lambda: specular_heights("analyser", 2 * RING),
    ),
    "side": Case(("splitknit.skin.polarised",), lambda: specular_heights("none", 2 * RING)),
    "mirrors": Case(("splitknit.mirrors",), lambda: mirrors(SEED)),
    "other between mirrors": Case(("splitknit.mirrors",), lambda: mirrors(OTHER_SEED)),
    "snk": Case(("splitknit.separation", "splitknit.finger.contrast"), direct_by_network),
}
"""All captures, by name."""
