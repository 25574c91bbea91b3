"""The ways to normals that are compared, and the figures of what they give."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.accuracy import compare
from splitknit.imaging.geometry import gradients_from_normals, height_gradients
from splitknit.imaging.view import view_of
from splitknit.integration.poisson import poisson
from splitknit.integration.shapelets import ShapeletSettings, shapelets
from splitknit.model import BoolArray, FloatArray, Reconstruction, Rig
from splitknit.photometric.hanrahan_krueger import hanrahan_krueger, hanrahan_krueger_near
from splitknit.photometric.hanrahan_krueger_fit import HanrahanKruegerSettings, SkinLayers
from splitknit.photometric.lambertian import lambertian
from splitknit.photometric.near_light import near_light
from splitknit.photometric.robust import robust
from splitknit.presets import PRESETS

Array = NDArray[Any]
SHIPPED = PRESETS["xie"].normals.hanrahan_krueger
"""What the preset has."""


def fresnel_alone(settings: HanrahanKruegerSettings) -> HanrahanKruegerSettings:
    """The same without layers: nothing is scattered once, a matt base below a surface remains."""
    layers = replace(
        settings.layers, epidermis_scattering_per_mm=1e-2, epidermis_absorption_per_mm=5.0,
        dermis_scattering_per_mm=1e-3, dermis_absorption_per_mm=1e3,
    )  # fmt: skip
    return replace(settings, layers=layers, spread_share=0.01, spread_depth=0.01)


def free(settings: HanrahanKruegerSettings) -> HanrahanKruegerSettings:
    """The same with layers that nothing holds but their bounds, as the source has them."""
    return replace(settings, spread_share=10.0, spread_depth=10.0)


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Images of one finger in one channel, and its truth, in a window around it."""

    stack: FloatArray
    rig: Rig
    mask: BoolArray
    truth: Mapping[str, Array]
    window: tuple[slice, slice]

    @property
    def lights(self) -> Array:
        """As distant ones."""
        return self.rig.light_vectors()


Way = Callable[[Scene], tuple[FloatArray, FloatArray]]


def ways(settings: HanrahanKruegerSettings = SHIPPED) -> dict[str, Way]:
    """Ways by name: the reflectance, then the weights, then the lights where they are not distant."""
    equal, weighted = replace(settings, weights="equal"), replace(settings, weights="robust")

    def layered(chosen: HanrahanKruegerSettings) -> Way:
        return lambda scene: hanrahan_krueger(scene.stack, scene.lights, scene.mask, chosen)[:2]

    return {
        "lambertian": lambda scene: lambertian(scene.stack, scene.lights, scene.mask),
        "layers": layered(equal),
        "fresnel": layered(fresnel_alone(equal)),
        "layers free": layered(free(equal)),
        "lambertian robust": lambda scene: robust(scene.stack, scene.lights, scene.mask),
        "layers robust": layered(weighted),
        "lambertian near": lambda scene: near_light(
            scene.stack, scene.rig, *_near(scene), robust=False, view=_view(scene)
        ),
        "layers near": lambda scene: hanrahan_krueger_near(
            scene.stack, scene.rig, *_near(scene), settings=equal, view=_view(scene)
        )[:2],
    }


def _near(scene: Scene) -> tuple[FloatArray, BoolArray]:
    """Light is computed on the true shape: its error is not at issue here."""
    return np.nan_to_num(scene.truth["shape_mm"]).astype(np.float32), scene.mask


def _view(scene: Scene) -> Any:
    return view_of(scene.rig.camera, *scene.window)


def figures(scene: Scene, normals: FloatArray) -> dict[str, float]:
    """Normals, ridge band and shape against the truth: see :mod:`splitknit.accuracy`."""
    camera = scene.rig.camera
    gradients = gradients_from_normals(normals, scene.mask, 6.0)
    pitch = np.float32(camera.pitch_mm)
    bank = ShapeletSettings(scales=3, sigma_px=camera.px_per_mm / 75.7)
    ridge = shapelets(*gradients, scene.mask, bank) * pitch
    height = poisson(*gradients, scene.mask) * pitch
    nothing = np.where(scene.mask, np.float32(0), np.float32(np.nan))
    shown = [np.where(scene.mask, field, np.float32(np.nan)) for field in (height, ridge, height - ridge)]
    result = Reconstruction(*shown, scene.mask, normals, nothing, camera.pitch_mm, np.eye(3), scene.mask.shape, "none")
    compared = compare(result, scene.truth)
    named = {
        "normals_deg": "normals_mean_deg", "ridge_correlation": "ridge_correlation", "ridge_gain": "ridge_gain",
        "shape_rms_mm": "shape_rms_mm", "surface_rms_mm": "surface_rms_mm",
    }  # fmt: skip
    found = {name: compared.figures[key] for name, key in named.items()}
    shape = height_gradients(np.where(scene.mask, scene.truth["shape_mm"], np.nan).astype(np.float32), float(pitch))
    slant = np.rad2deg(np.arctan(np.hypot(*shape)))
    error = error_deg(normals, scene.truth["normals"])
    for low, high in ((0, 30), (30, 60)):
        where = compared.surface & (slant >= low) & (slant < high)
        found[f"normals_{low}_{high}_deg"] = float(error[where].mean())
        power = sum(float(np.sum(true[where] ** 2)) for true in shape)
        along = sum(float(np.sum(got[where] * true[where])) for got, true in zip(gradients, shape, strict=True))
        found[f"slopes_{low}_{high}"] = along / power
    return found


def error_deg(normals: Array, truth: Array) -> Array:
    """Angle between two fields of unit vectors."""
    return np.rad2deg(np.arccos(np.clip((normals.astype(np.float64) * truth).sum(axis=-1), -1, 1)))


def trials() -> dict[str, HanrahanKruegerSettings]:
    """What the shipped settings were chosen from, on other fingers than those reported."""
    spreads = {"held": (0.01, 0.01), "soft": (1.0, 0.7), "loose": (3.0, 2.0)}
    book = (0.79, 0.81)
    chosen = [(n, base, "soft", book) for n in (1.37, 1.4, 1.5) for base in (0.05, 0.15, 0.45)]
    chosen += [(1.5, 0.45, name, book) for name in ("held", "loose")]
    chosen += [(1.5, base, name, (g, g)) for g in (0.4, 0.0) for base in (0.15, 0.45) for name in spreads]
    found = {}
    for n, base, name, (upper, lower) in chosen:
        layers = SkinLayers(refractive_index=n, epidermis_asymmetry=upper, dermis_asymmetry=lower)
        fraction, depth = spreads[name]
        found[f"n {n:g}, base {base:g}, g {upper:g}, {name}"] = replace(
            SHIPPED, layers=layers, base_reflectance=base, spread_share=fraction, spread_depth=depth
        )
    return found
