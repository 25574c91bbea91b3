"""The state of a finger's skin when it is photographed: wet, dry, dusty, scarred, glossy;
``docs/experiments/conditions.md``."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal, get_args

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from splitknit import Camera
from splitknit.model import Array, FloatArray
from splitknit.settings import Checked, Limits
from splitknit_simulator.finger.finger import FingerPose, SimulatedFinger, finger_surface
from splitknit_simulator.finger.master_print import MasterPrint
from splitknit_simulator.finger.ridges import around, smooth_noise
from splitknit_simulator.finger.skin_map import SkinMap, skin_map
from splitknit_simulator.light.coat import draw_grains, stamp
from splitknit_simulator.light.skin import CHANNELS, SkinOptics, diffusion_profile
from splitknit_simulator.surface import Coat, Film, SimulatedSurface, soft_step

KERATIN_INDEX = 1.55
"""Refractive index of the dry horny layer. Source: Duck 1990, Physical Properties of Tissue."""


# Dry and scarred skin: what becomes of its relief, its pigment and its roughness, on the map of the
# skin.


@dataclass(frozen=True, slots=True, eq=False)
class _Weathered:
    """Skin after what happened to it, on the master print's grid."""

    displacement: Array  # (H, W) mm
    fraction: Array  # (H, W) 0 to 1: how far a place is affected (in a scar; under a scale)
    reflectance: Array | None = None  # (H, W) diffuse white reflectance of the scales


def _scale_reflectance(plates: Array) -> Array:
    """Reflectance of a pile of transparent plates with air between them, light falling straight on.
    Source: Stokes 1862, On the intensity of the light reflected from or transmitted through a pile
    of plates.
    """
    single = ((KERATIN_INDEX - 1.0) / (KERATIN_INDEX + 1.0)) ** 2
    return 2.0 * plates * single / (1.0 + (2.0 * plates - 1.0) * single)


def _ridge_angle(ridge: NDArray[np.float32], sigma_px: float) -> Array:
    """(H, W) direction of the ridges from u towards v, rad, from the gradient's structure
    tensor."""
    smooth = cv2.GaussianBlur(ridge, (0, 0), 1.0)
    du = cv2.Sobel(smooth, cv2.CV_64F, 1, 0, scale=0.125)
    dv = -cv2.Sobel(smooth, cv2.CV_64F, 0, 1, scale=0.125)
    uu, vv, uv = (cv2.GaussianBlur(part, (0, 0), sigma_px) for part in (du * du, dv * dv, du * dv))
    return np.asarray(0.5 * np.arctan2(2.0 * uv, uu - vv) + 0.5 * np.pi, dtype=np.float64)


def _dried(
    displacement: Array, master: MasterPrint, severity: float, rng: np.random.Generator
) -> _Weathered:
    """Lower the ridges, break them, roughen them and let scales come off.

    Ours, at severity 1: ridges have shrunk by a quarter, 0.5 fissures a square millimetre run
    across them (0.5 to 1.6 mm long, 25 to 70 um deep), skin is rough by 5 um, scales stand 8 um
    above a third of the ridges. Sources: the horny layer comes off in clumps (Velthuizen et al.
    2008), and drier skin is rougher (Dabrowska et al. 2016).
    """
    pitch = float(master.u_mm[1] - master.u_mm[0])
    smooth = cv2.GaussianBlur(displacement, (0, 0), 0.32 / pitch)
    relief = displacement - smooth
    calm = np.exp(-((np.minimum(smooth + 0.12, 0.0) / 0.1) ** 2))  # creases stay as they are
    new = smooth + relief * (1.0 - 0.25 * severity * calm)
    new = new + 1e-3 * 5.0 * severity * smooth_noise(rng, displacement.shape, 0.06 / pitch)
    angle = _ridge_angle(master.ridge, 0.5 / pitch)
    new = new - severity * _fissures(rng, angle, pitch, 0.5 * severity)
    lumps = smooth_noise(rng, displacement.shape, 0.22 / pitch)
    coarse = smooth_noise(rng, displacement.shape, 1.5 / pitch)
    field = (lumps + 0.5 * coarse) / np.sqrt(1.25)
    threshold = float(np.quantile(field, 1.0 - 0.45 * severity))
    scale = np.clip((field - threshold) / 0.12, 0.0, 1.0) * (master.ridge > 0.35)
    scale = cv2.GaussianBlur(scale, (0, 0), 0.6)
    # at most four horny plates with air between them
    plates = scale * np.clip(1.0 + 1.5 * (field - threshold), 1.0, 4)
    edge = np.abs(scale * (1.0 - scale)) * 4.0
    new = new + 1e-3 * (8.0 * scale + 6.0 * edge) * calm
    return _Weathered(new, scale, _scale_reflectance(plates))


def _fissures(rng: np.random.Generator, angle: Array, pitch: float, per_mm2: float) -> Array:
    """(H, W) depth of short cracks across the ridges, mm."""
    rows, columns = angle.shape
    count = int(rng.poisson(per_mm2 * rows * columns * pitch * pitch))
    canvas = np.zeros(angle.shape)
    places = rng.random((2, count)) * np.array([[rows - 1], [columns - 1]])
    lengths = rng.uniform(0.5, 1.6, count) / pitch
    turns = rng.normal(0.0, np.deg2rad(20.0), count) + 0.5 * np.pi
    widths = rng.uniform(0.025, 0.05, count) / pitch
    depths = 1e-3 * rng.uniform(25.0, 70.0, count)
    for (row, column), length, turn, width, depth in zip(
        places.T, lengths, turns, widths, depths, strict=True
    ):
        way = angle[int(row), int(column)] + turn
        window, dv, du = around(angle.shape, row, column, int(0.5 * length + 3.0 * width) + 1)
        along = du * np.cos(way) - dv * np.sin(way)
        across = -du * np.sin(way) - dv * np.cos(way)
        taper = np.clip(1.0 - (2.0 * along / length) ** 2, 0.0, 1.0)
        patch = canvas[window]
        np.maximum(patch, depth * taper * np.exp(-0.5 * (across / max(width, 0.7)) ** 2), out=patch)
    return canvas


def _scarred(
    displacement: Array, master: MasterPrint, severity: float, rng: np.random.Generator
) -> _Weathered:
    """Draw up to three scars across the pad: strips without ridges or pores, sunken or raised, with
    soft edges.

    At severity 1 there are three, about 1.1 mm wide (0.1 mm at severity 0: a healed scratch), 6 to
    14 mm long; three in four are sunken by up to 60 um, the others raised as much. Skin does not
    grow ridges again where the dermis was cut (Maceo 2011, in The Fingerprint Sourcebook, chapter
    2). Ridges that were sewn together out of line are not modelled.
    """
    pitch = float(master.u_mm[1] - master.u_mm[0])
    u, v = master.u_mm[None, :], master.v_mm[:, None]
    fraction, lift = np.zeros((2, *displacement.shape))
    places = rng.permutation(3)
    for number in range(3):
        cu, cv = rng.uniform(-4.0, 4.0), 8.0 + 4.0 * places[number] + rng.uniform(0.0, 3.0)
        way, bend = rng.uniform(0.0, np.pi), rng.uniform(-0.03, 0.03)
        half_mm, length = (0.05 + 0.5 * severity) * rng.uniform(0.7, 1.3), rng.uniform(6.0, 14.0)
        rise = 1e-3 * severity * rng.uniform(20.0, 60.0) * (1.0 if rng.random() < 0.25 else -1.0)
        wave = rng.uniform(0.0, 2.0 * np.pi)
        if number >= np.ceil(3.0 * severity):
            continue
        along = (u - cu) * np.cos(way) + (v - cv) * np.sin(way)
        across = -(u - cu) * np.sin(way) + (v - cv) * np.cos(way)
        across = across - bend * along**2 - 0.15 * np.sin(1.3 * along + wave)
        half = half_mm * np.clip(1.0 - (2.0 * along / length) ** 4, 0.0, 1.0)
        inside = soft_step(0.5 + (half - np.abs(across)) / 0.12) * (half > 0.0)
        fraction = np.maximum(fraction, inside)
        profile = np.exp(-0.5 * (across / max(half_mm, 0.1)) ** 2)
        lift = lift + rise * profile * (half > 0.0) * np.clip(half / half_mm, 0, 1)
    level = cv2.GaussianBlur(displacement, (0, 0), 0.5 / pitch)
    smooth = cv2.GaussianBlur(lift, (0, 0), 0.1 / pitch)
    return _Weathered((1.0 - fraction) * displacement + fraction * level + smooth, fraction)


# Water on the skin: it fills the valleys, creeps up the ridges, and at last lies over them.


def _water_surface(displacement: Array, pitch_mm: float, severity: float) -> Array:
    """(H, W) displacement of the water's surface, mm, if all skin is wet: from sweat in the
    valleys' corners to a hand that comes out of water.

    Water that wets the skin (contact angle zero) meets it in menisci of one curvature: the closing
    of the relief by a ball of that radius, here by the paraboloid that osculates it, along rows and
    columns in turn. The body's own curvature (a radius of 8 mm) is left out. Sources: Orchard 1962,
    On surface levelling in viscous liquids and gels; de Gennes, Brochard-Wyart and Quere 2004,
    Capillarity and Wetting Phenomena, sections 1.1.3 and 2.2; van den Boomgaard et al. 1996,
    Quadratic structuring functions in mathematical morphology.
    """
    # from 0.05 mm (only sharp corners are rounded) to 2 mm (valleys are full; water's capillary
    # length is 2.7 mm)
    meniscus_mm = 0.05 * 40.0**severity
    filled = _closed(displacement, pitch_mm, meniscus_mm)
    # above one half a film of up to 15 um closes over the ridges
    closed = max(0.0, 2.0 * severity - 1.0)
    if closed > 0.0:  # 20 um level out over 5 mm in seconds: such a film shows no ridges
        level = cv2.GaussianBlur(filled, (0, 0), 0.6 * closed / pitch_mm)
        filled = _closed(
            np.maximum(level + 1e-3 * (15.0 * closed), displacement), pitch_mm, meniscus_mm
        )
    return filled


def _water_level(
    displacement: Array, pitch_mm: float, severity: float, rng: np.random.Generator
) -> Array:
    """(H, W) displacement of skin and water, mm: below one half, part of the skin is dry."""
    filled = _water_surface(displacement, pitch_mm, severity)
    if severity >= 0.5:
        return filled
    # patches of 2 mm with soft edges; a normal variable lies below the threshold over the wanted
    # fraction
    noise = smooth_noise(rng, displacement.shape, 1.0 / pitch_mm)
    threshold = float(np.quantile(noise, 2.0 * severity))
    patch = soft_step(0.5 + (threshold - noise) / 0.3)
    return displacement + patch * (filled - displacement)


def _closed(values: Array, pitch_mm: float, radius_mm: float) -> Array:
    """Closing of `values` by the paraboloid x^2 / (2 radius) turned down."""
    reach = int(np.ceil(np.sqrt(2.0 * radius_mm * float(np.ptp(values))) / pitch_mm)) + 1
    fall = (np.arange(-reach, reach + 1) * pitch_mm) ** 2 / (2.0 * radius_mm)
    result = values
    operations: tuple[Any, ...] = ndimage.grey_dilation, ndimage.grey_erosion
    for operation in operations:
        for structure in (-fall[:, None], -fall[None, :]):
            result = operation(result, structure=structure, mode="nearest")
    return np.maximum(result, values)


# From the map of the skin to the picture: values at the points that the camera sees, and directions
# in space.


def _on_chart(values: Array, surface: SimulatedSurface, laid: SkinMap) -> Array:
    """(H, W) values of the skin's map at the points of the picture, zero beside the finger."""
    assert surface.chart is not None
    chart = np.nan_to_num(surface.chart).astype(np.float64)
    rows, columns = (
        (laid.v0_mm - chart[..., 1]) / laid.pitch_mm,
        (chart[..., 0] - laid.u0_mm) / laid.pitch_mm,
    )
    sampled = ndimage.map_coordinates(values, [rows, columns], order=1, mode="mirror")
    return np.where(surface.mask, sampled, 0.0)


def _ridges_in_space(angle_rad: Array, surface: SimulatedSurface, laid: SkinMap) -> FloatArray:
    """(H, W, 3) unit vectors along the ridges, in the skin's surface.

    A step in the picture moves the point on the chart by the chart's Jacobian; the inverse takes
    the ridges' direction to the picture, and z follows from the normal.
    """
    assert surface.chart is not None
    u, v = np.moveaxis(surface.chart.astype(np.float64), -1, 0)
    cosine, sine = (
        _on_chart(part, surface, laid)
        for part in (np.cos(2.0 * angle_rad), np.sin(2.0 * angle_rad))
    )
    angle = 0.5 * np.arctan2(sine, cosine)
    wanted_u, wanted_v = np.cos(angle), np.sin(angle)
    u_row, u_x = np.gradient(u)
    v_row, v_x = np.gradient(v)
    u_y, v_y = -u_row, -v_row
    determinant = u_x * v_y - u_y * v_x
    with np.errstate(invalid="ignore", divide="ignore"):
        x = (v_y * wanted_u - u_y * wanted_v) / determinant
        y = (-v_x * wanted_u + u_x * wanted_v) / determinant
        n = surface.normals.astype(np.float64)
        z = -(n[..., 0] * x + n[..., 1] * y) / n[..., 2]
        vectors = np.stack([x, y, z], axis=-1)
        vectors /= np.linalg.norm(vectors, axis=-1, keepdims=True)
    sound = surface.mask & np.isfinite(vectors).all(axis=-1)
    return np.asarray(np.where(sound[..., None], vectors, [1.0, 0.0, 0.0]), dtype=np.float32)


Kind = Literal["none", "wet", "dry", "dusty", "scarred", "glossy"]
KINDS: tuple[Kind, ...] = get_args(Kind)
_SCAR = {"blood": (2.0, 0.1), "scattering_factor": (1.3, 3.0), "melanin": (0.5, 0.05)}
"""A young scar beside its skin, as a factor and a limit: more blood and collagen, less pigment
(Tseng et al. 2012 measured that they differ; how far is our choice)."""


@dataclass(frozen=True, slots=True)
class Condition(Checked):
    """What is the matter with the skin."""

    kind: Kind = "none"
    """``none``, ``wet``, ``dry``, ``dusty``, ``scarred`` or ``glossy``."""
    severity: Annotated[float, Limits(0.0, 1.0)] = 1.0
    """0 (nothing) to 1 (the worst that is modelled)."""

    @property
    def active(self) -> bool:
        """Whether anything is different from clean skin."""
        return self.kind != "none" and self.severity > 0.0


def conditioned_surface(  # noqa: PLR0917
    finger: SimulatedFinger,
    pose: FingerPose,
    camera: Camera,
    skin: SkinOptics,
    condition: Condition,
    seed: np.random.SeedSequence,
    *,
    workers: int = 2,
) -> SimulatedSurface:
    """Show a posed finger whose skin is in some condition, with its coat.

    `seed`: of what changes from one capture to the next; scars follow from the finger instead. Dry
    and scarred skin *is* different: the truth's relief is that of the changed skin. Water and dust
    lie on the skin: the truth stays the skin below them.
    """
    master = finger.master()
    finger = replace(finger, printed=master)
    plain = skin_map(master, finger.skin)
    rows, columns = (plain.pitch_mm * np.arange(length) for length in plain.coefficients.shape)
    relief = plain.displacement(*np.meshgrid(plain.u0_mm + columns, plain.v0_mm - rows))
    rng, severity = np.random.default_rng(seed), condition.severity
    weathered, level = None, None
    if condition.kind == "dry":
        weathered = _dried(relief, master, severity, rng)
    elif condition.kind == "scarred":
        weathered = _scarred(relief, master, severity, np.random.default_rng([finger.seed, 0x5CA]))
    elif condition.kind == "wet":
        level = _water_level(relief, plain.pitch_mm, severity, rng)
    skin_relief = relief if weathered is None else weathered.displacement
    highest = float((skin_relief if level is None else np.maximum(skin_relief, level)).max())
    lower = max(0.0, highest - 0.006)  # rays look for the skin from 8 um over the body on
    laid = (
        plain
        if weathered is None and lower == 0.0
        else _with_relief(plain, skin_relief - lower, weathered)
    )
    surface = finger_surface(finger, pose, camera, workers=workers, skin=laid)
    if level is not None:
        water = finger_surface(
            finger, pose, camera, workers=workers, skin=_with_relief(plain, level - lower, None)
        )
        coat = _wet(surface, water, skin, severity)
    elif weathered is not None:
        coat = _weathered(surface, laid, weathered, skin, condition)
    elif condition.kind == "dusty":
        grains = draw_grains(rng, surface.mask, surface.shape_normals[..., 2], camera, severity)
        cover = stamp(surface.mask.shape, grains.column, grains.row, grains.radius_px)
        fraction = np.where(surface.mask, np.clip(cover, 0.0, 1.0), 0.0).astype(np.float32)
        coat = Coat("dusty", severity, fraction, grains=grains)
    else:
        # Sebum that was wiped along the ridges
        along = _ridges_in_space(_ridge_angle(master.ridge, 0.4 / laid.pitch_mm), surface, laid)
        shape = surface.mask.shape
        across = np.full(
            shape, max(skin.roughness * (1.0 - 0.4 * severity), 0.05), dtype=np.float32
        )
        lengthwise = np.full(
            shape, skin.roughness + severity * (0.05 - skin.roughness), dtype=np.float32
        )
        coat = Coat("glossy", severity, surface.mask.astype(np.float32), across, lengthwise, along)
    return replace(surface, coat=coat, chart=None)


def _with_relief(skin: SkinMap, displacement: Array, weathered: _Weathered | None) -> SkinMap:
    """The map with another displacement; pores and creases of a scar are no darker than the
    rest."""
    pigment = skin.pigment
    if weathered is not None and weathered.reflectance is None:
        pigment = (pigment + weathered.fraction * (1.0 - pigment)).astype(np.float32)
    return replace(
        skin,
        coefficients=ndimage.spline_filter(displacement, order=3, mode="mirror"),
        pigment=pigment,
    )


def _wet(
    surface: SimulatedSurface, water: SimulatedSurface, skin: SkinOptics, severity: float
) -> Coat:
    mask = surface.mask & water.mask
    thickness = np.where(mask, water.relief_um - surface.relief_um, 0.0)
    # a micrometre covers skin's own roughness
    fraction = np.clip(thickness / 1.0, 0.0, 1.0).astype(np.float32)
    normals = np.where(mask[..., None], water.normals, surface.normals)
    # (H, W) variance of the slope inside a pixel, one direction's
    nz = np.where(mask, np.maximum(normals[..., 2], 0.2), 1.0)
    total = np.zeros(mask.shape)
    for axis in (0, 1):
        down, right = np.gradient(np.where(mask, -normals[..., axis] / nz, 0.0))
        total += (down**2 + right**2) / 12.0
    bend = np.minimum(0.5 * total, 0.25)
    # GGX alpha of a water surface at rest on skin: smooth but for what floats on it
    roughness = np.clip(np.sqrt(0.05**2 + 2.0 * bend), 0.0, 1.0).astype(np.float32)
    # GGX alpha of hydrated skin between drops; Dabrowska et al. 2016 found such skin smoother
    moist = min(skin.roughness, 0.18)
    bare = np.full(
        mask.shape, skin.roughness + severity * (moist - skin.roughness), dtype=np.float32
    )
    return Coat("wet", severity, fraction, roughness=bare, film=Film(fraction, normals, roughness))


def _weathered(
    surface: SimulatedSurface,
    laid: SkinMap,
    weathered: _Weathered,
    skin: SkinOptics,
    condition: Condition,
) -> Coat:
    fraction = _on_chart(weathered.fraction, surface, laid).astype(np.float32)
    if weathered.reflectance is not None:
        # GGX alpha of dry skin at severity 1
        rough = max(skin.roughness, skin.roughness + condition.severity * (0.5 - skin.roughness))
        scales = _on_chart(weathered.reflectance, surface, laid).astype(np.float32)
        return Coat(
            "dry",
            condition.severity,
            fraction,
            np.full(fraction.shape, rough, np.float32),
            scales=scales,
        )
    # GGX alpha of a scar in rougher skin
    smooth = skin.roughness + fraction * (min(0.15, skin.roughness) - skin.roughness)
    scar: dict[str, Any] = {
        name: min(factor * float(getattr(skin, name)), most)
        for name, (factor, most) in _SCAR.items()
    }
    tint = _tint(skin, replace(skin, **scar))
    return Coat("scarred", condition.severity, fraction, smooth.astype(np.float32), tint=tint)


def _tint(skin: SkinOptics, affected: SkinOptics) -> dict[str, float]:
    """Diffuse reflectance of another medium over that of the skin, for every channel."""

    def albedo(settings: SkinOptics, name: str) -> float:
        optics = settings.channel(name)  # type: ignore[arg-type]
        return float(diffusion_profile(optics.scattering_per_mm, optics.absorption_per_mm).albedo)

    return {name: albedo(affected, name) / albedo(skin, name) for name in CHANNELS}
