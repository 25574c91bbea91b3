"""The state of a finger's skin when it is photographed: wet, dry, dusty, scarred, glossy; ``docs/conditions.md``."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from splitknit.errors import require
from splitknit.model import Camera
from splitknit.simulator.coat import Coat, Film
from splitknit.simulator.coat_directions import bend_within_pixels, on_chart, ridges_in_space
from splitknit.simulator.diffusion import diffusion_profile, load_walks
from splitknit.simulator.finger import Finger, Pose, finger_surface
from splitknit.simulator.grains import draw_grains, stamp
from splitknit.simulator.master_print import MasterPrint
from splitknit.simulator.skin import CHANNELS, SkinSettings
from splitknit.simulator.skin_map import SkinMap, skin_map
from splitknit.simulator.surface import Surface
from splitknit.simulator.water import water_level, water_of
from splitknit.simulator.weathered import Weathered, dried, ridge_angle, scarred

Array = NDArray[np.float64]
Kind = Literal["none", "wet", "dry", "dusty", "scarred", "glossy"]
KINDS: tuple[Kind, ...] = ("none", "wet", "dry", "dusty", "scarred", "glossy")

_WATER_ROUGHNESS = 0.05
"""GGX alpha of a water surface at rest on skin: smooth but for what floats on it."""
_MOIST_ROUGHNESS = 0.18
"""Of hydrated skin between the water, as in a population's moist sessions (Dabrowska et al. 2016: smoother)."""
_DRY_ROUGHNESS = 0.5
_SCAR_ROUGHNESS = 0.15
_SCAR = {"blood": 2.0, "scattering_factor": 1.3, "melanin": 0.5}
"""A young scar beside its skin: more blood and collagen, less pigment (Tseng et al. 2012 measured that they differ; how
far is our choice)."""
_TOP_MM = 0.006
"""The skin is sought from 8 um above the body on: nothing may stand higher."""


@dataclass(frozen=True, slots=True)
class Condition:
    """What is the matter with the skin."""

    kind: str = "none"
    """``none``, ``wet``, ``dry``, ``dusty``, ``scarred`` or ``glossy``."""
    severity: float = 1.0
    """0 (nothing) to 1 (the worst that is modelled)."""

    def __post_init__(self) -> None:
        require(
            self.kind in KINDS,
            f"condition.kind must be one of {', '.join(KINDS)}, but it is '{self.kind}'; choose one.",
        )
        require(
            bool(np.isfinite(self.severity)) and 0.0 <= self.severity <= 1.0,
            f"condition.severity must lie in [0, 1], but it is {self.severity}; 0 is nothing, 1 the worst.",
        )

    @property
    def active(self) -> bool:
        """Whether anything is different from clean skin."""
        return self.kind != "none" and self.severity > 0.0


def conditioned_surface(  # noqa: PLR0917
    finger: Finger,
    pose: Pose,
    camera: Camera,
    skin: SkinSettings,
    condition: Condition,
    seed: np.random.SeedSequence,
    *,
    workers: int = 2,
) -> Surface:
    """Show a posed finger whose skin is in some condition, with its coat.

    Parameters
    ----------
    finger, pose, camera, workers : as :func:`splitknit.simulator.finger.finger_surface` takes them
    skin : optics of the finger
    condition : an active one
    seed : of what changes from one capture to the next; scars follow from the finger instead

    Notes
    -----
    Dry and scarred skin *is* different: the truth's relief is that of the changed skin. Water and dust lie on the skin:
    the truth stays the skin below them.
    """
    require(condition.active, "there is no condition to show; use finger_surface.")
    master = finger.master()
    plain = skin_map(master, finger.skin)
    relief = _grid_values(plain)
    rng = np.random.default_rng(seed)
    severity = condition.severity
    weathered, level = None, None
    if condition.kind == "dry":
        weathered = dried(relief, master, severity, rng)
    elif condition.kind == "scarred":
        weathered = scarred(
            relief, master, severity, np.random.default_rng(np.random.SeedSequence([finger.seed, 0x5CA]))
        )
    elif condition.kind == "wet":
        level = water_level(relief, plain.pitch_mm, water_of(severity), rng)
    skin_relief = relief if weathered is None else weathered.displacement
    top = max(float(skin_relief.max()), float(-np.inf if level is None else level.max()))
    lower = max(0.0, top - _TOP_MM)
    laid = plain if weathered is None and lower == 0.0 else _with_relief(plain, skin_relief - lower, weathered)
    surface = finger_surface(finger, pose, camera, master=master, workers=workers, skin=laid, keep_chart=True)
    if level is not None:
        water = finger_surface(
            finger, pose, camera, master=master, workers=workers, skin=_with_relief(plain, level - lower, None)
        )
        coat = _wet(surface, water, skin, severity)
    elif weathered is not None:
        coat = _weathered(surface, laid, weathered, skin, condition)
    elif condition.kind == "dusty":
        grains = draw_grains(rng, surface.mask, surface.shape_normals[..., 2], camera, severity)
        cover = stamp(surface.mask.shape, grains.column, grains.row, grains.radius_px)
        share = np.where(surface.mask, np.clip(cover, 0.0, 1.0), 0.0).astype(np.float32)
        coat = Coat("dusty", severity, share, grains=grains)
    else:
        coat = _glossy(surface, master, skin, severity)
    return replace(surface, coat=coat, chart=None)


def _grid_values(skin: SkinMap) -> Array:
    """(H, W) displacement at the map's own nodes, mm."""
    rows, columns = skin.coefficients.shape
    u = skin.u0_mm + skin.pitch_mm * np.arange(columns)
    v = skin.v0_mm - skin.pitch_mm * np.arange(rows)
    grid_u, grid_v = np.meshgrid(u, v)
    return skin.displacement(grid_u, grid_v)


def _with_relief(skin: SkinMap, displacement: Array, weathered: Weathered | None) -> SkinMap:
    """The map with another displacement; pores and creases of a scar are no darker than the rest."""
    pigment = skin.pigment
    if weathered is not None and weathered.reflectance is None:
        pigment = (pigment + weathered.share * (1.0 - pigment)).astype(np.float32)
    return replace(
        skin,
        coefficients=ndimage.spline_filter(displacement, order=3, mode="mirror"),
        pigment=pigment,
        deepest_mm=float(-displacement.min()),
    )


def _wet(surface: Surface, water: Surface, skin: SkinSettings, severity: float) -> Coat:
    mask = surface.mask & water.mask
    thickness = np.where(mask, water.relief_um - surface.relief_um, 0.0)
    share = np.clip(thickness / 1.0, 0.0, 1.0).astype(np.float32)  # a micrometre covers skin's own roughness
    normals = np.where(mask[..., None], water.normals, surface.normals)
    bend = bend_within_pixels(normals, mask)
    roughness = np.clip(np.sqrt(_WATER_ROUGHNESS**2 + 2.0 * bend), 0.0, 1.0).astype(np.float32)
    moist = min(skin.roughness, _MOIST_ROUGHNESS)
    bare = np.full(mask.shape, skin.roughness + severity * (moist - skin.roughness), dtype=np.float32)
    return Coat("wet", severity, share, roughness=bare, film=Film(share, normals, roughness))


def _weathered(surface: Surface, laid: SkinMap, weathered: Weathered, skin: SkinSettings, condition: Condition) -> Coat:
    share = on_chart(weathered.share, surface, laid)
    if condition.kind == "dry":
        rough = max(skin.roughness, skin.roughness + condition.severity * (_DRY_ROUGHNESS - skin.roughness))
        assert weathered.reflectance is not None
        scales = on_chart(weathered.reflectance, surface, laid)
        return Coat("dry", condition.severity, share, np.full(share.shape, rough, np.float32), scales=scales)
    smooth = skin.roughness + share * (min(_SCAR_ROUGHNESS, skin.roughness) - skin.roughness)
    tint = _tint(skin, replace(skin, **{name: _bounded(skin, name, factor) for name, factor in _SCAR.items()}))
    return Coat("scarred", condition.severity, share, smooth.astype(np.float32), tint=tint)


def _bounded(skin: SkinSettings, name: str, factor: float) -> float:
    most = {"blood": 0.1, "scattering_factor": 3.0, "melanin": 0.05}[name]
    return min(factor * float(getattr(skin, name)), most)


def _tint(skin: SkinSettings, other: SkinSettings) -> dict[str, float]:
    """Diffuse reflectance of another medium over that of the skin, for every channel."""
    walks = load_walks()

    def albedo(settings: SkinSettings, name: str) -> float:
        optics = settings.channel(name)  # type: ignore[arg-type]
        return float(diffusion_profile(walks, optics.scattering_per_mm, optics.absorption_per_mm).albedo)

    return {name: albedo(other, name) / albedo(skin, name) for name in CHANNELS}


def _glossy(surface: Surface, master: MasterPrint, skin: SkinSettings, severity: float) -> Coat:
    """Sebum that was wiped along the ridges: smooth along them, less so across.

    Along the ridges alpha falls to 0.05, across them by two fifths.
    """
    pitch = float(master.u_mm[1] - master.u_mm[0])
    along = ridges_in_space(ridge_angle(master.ridge, 0.4 / pitch), surface, master)
    shape = surface.mask.shape
    across = np.full(shape, max(skin.roughness * (1.0 - 0.4 * severity), 0.05), dtype=np.float32)
    lengthwise = np.full(shape, skin.roughness + severity * (0.05 - skin.roughness), dtype=np.float32)
    return Coat("glossy", severity, surface.mask.astype(np.float32), across, lengthwise, along)
