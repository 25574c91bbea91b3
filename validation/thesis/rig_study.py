"""The thesis's own experiment (4.1.1) on the twin: how a candidate rig is photographed and judged.

An opaque finger or skin, a sensor's or a rendering program's camera, tremor while the shutter is
open, the finger's outline given, and Hausdorff distances from the true surface.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from rig_candidates import (
    FIELD_MM,
    FULL_PX_PER_MM,
    FULL_WELL_E,
    LAMPS,
    MIN_LEVEL,
    READ_NOISE_E,
    W_PER_UNIT,
    BuildSettings,
    PhotonSettings,
    PlannedExposure,
    PrintPoints,
    RigCandidate,
    candidate_rig,
    electrons_per_s,
    glare_fault,
    led_intensities,
    plan_exposure,
)
from scipy.spatial import cKDTree

from splitknit.capture import Band, Capture
from splitknit.errors import BadInput, require
from splitknit.imaging.geometry import high_passed
from splitknit.model import BoolArray, Camera, FloatArray, Led, Rig
from splitknit.pipeline import reconstruct
from splitknit.reconstruction import Reconstruction
from splitknit_simulator.camera.lens import blur_sigma_px, defocus
from splitknit_simulator.camera.sensor import SensorSettings, record
from splitknit_simulator.finger.finger import (
    FingerPose,
    PoseRanges,
    SimulatedFinger,
    draw_finger,
    finger_surface,
    placement_of,
)
from splitknit_simulator.finger.master_print import MasterPrint
from splitknit_simulator.finger.shape import FingerBody
from splitknit_simulator.light.lighting import cut_out, irradiance, white_card
from splitknit_simulator.light.renderer import RenderSettings, render_band
from splitknit_simulator.light.skin import BAND_CHANNELS, SkinOptics, SkinRanges
from splitknit_simulator.scene import finger_depth
from splitknit_simulator.surface import SimulatedSurface

Array = NDArray[np.float64]

TRUTH_PX_PER_MM = 10.0
"""Density of the points of the true surface."""
BAND_SIGMA_MM = 0.32
"""Standard deviation of the Gaussian whose complement is the ridge band
(``docs/explain/conventions.md``)."""
ABOVE_CREASE_MM = 0.5
"""The phalange is what lies further towards the tip than this, seen from its crease."""
_TREMOR_UM = 30.0
"""Amplitude of a resting finger's tremor (Growdon et al. 2000: about 30 um)."""
_TREMOR_HZ = 9.0
"""Frequency of the tremor."""
OPAQUE_ALBEDO = 0.5
CLOTH_ALBEDO = 0.006
"""Albedo of the black cloth below the finger."""
CLOTH_DEPTH_MM = 10.0
"""Distance of the cloth below the finger plane."""
FOCUS_DEPTH_MM = 1.5
"""The lens is focused this far below the finger's highest point."""


FIRST_SEED = 400  # seeds of the fingers
# the print is where the shape is flatter than this (``docs/explain/conventions.md``)
MAX_SLANT_DEG = 60.0


@dataclass(frozen=True, slots=True)
class ThesisStudy:
    """Everything that a candidate's figures follow from, besides the candidate."""

    method: str = "ea"
    """``ea``: the thesis's plain photometric stereo; ``ea-poisson``: its normals, integrated over
    the mask alone; or ``metric``."""
    fingers: int = 3
    """Number of fingers; all candidates photograph the same ones."""
    build: BuildSettings = field(default_factory=BuildSettings)
    photons: PhotonSettings = field(default_factory=PhotonSettings)
    material: str = "opaque"
    """``opaque``: a Lambertian finger, as the thesis's sculpture; or the twin's ``skin``."""
    camera: str = "sensor"
    """``sensor``: the rig's, with photons, noise and defocus; or a ``renderer``'s: pin-hole, no
    noise, one fixed exposure, bare isotropic lamps, 8 bits sRGB."""

    @property
    def seeds(self) -> tuple[int, ...]:
        """Seeds of the fingers."""
        return tuple(range(FIRST_SEED, FIRST_SEED + self.fingers))

    @property
    def bands(self) -> tuple[str, ...]:
        """Bands that the method looks at."""
        return ("white", "nir") if self.method == "metric" else ("white",)

    def record(self, candidate: RigCandidate) -> dict[str, Any]:
        """Judge and measure one candidate: ``status`` (``done``; ``refused`` where specular
        reflection hides the print; ``failed`` where a finger could not be exposed or
        reconstructed), ``reason``, and the figures of all ``fingers`` and their ``mean``.
        """
        record: dict[str, Any] = {"candidate": {**asdict(candidate), "name": candidate.name}}
        record |= {"fingers": [], "mean": None}
        if reason := glare_fault(candidate, self.build, _typical(FIRST_SEED)):
            return {**record, "status": "refused", "reason": reason}
        try:
            fingers = [_measure(candidate, self, seed) for seed in self.seeds]
        except BadInput as error:
            return {**record, "status": "failed", "reason": str(error)}
        mean = {name: float(np.mean([finger[name] for finger in fingers])) for name in fingers[0]}
        return {**record, "status": "done", "reason": None, "fingers": fingers, "mean": mean}


# The fingers that all rigs of a sweep photograph: surfaces, and their truth as points.


@dataclass(frozen=True, slots=True, eq=False)
class _Points:
    """A surface as points."""

    phalange: Array
    """(N, 3) mm, all that the camera sees of the phalange."""
    print: BoolArray
    """(N,) which of them carry the print: slant of the shape up to 60 deg."""


@functools.lru_cache(maxsize=16)
def _person(seed: int) -> tuple[SimulatedFinger, MasterPrint]:
    """A finger and its master print; drawing the print is what takes long."""
    finger = draw_finger(seed)
    return finger, finger.master()


def _pose_of(seed: int, camera: Camera) -> FingerPose:
    """How this finger lies: in the same place under any camera, whose rows are only about
    `FIELD_MM` long."""
    even = Camera(px_per_mm=100.0, image_size=(round(100 * FIELD_MM[0]), round(100 * FIELD_MM[1])))
    rng = np.random.default_rng(np.random.SeedSequence([seed, 0x0C]))
    pose = PoseRanges(height_mm=(0.0, 0.0), insertion_mm=(25.0, 27.0)).draw(rng, even)
    rows_mm = camera.image_size[0] / camera.px_per_mm
    return replace(
        pose, insertion_mm=pose.insertion_mm + 0.5 * (rows_mm - even.image_size[0] / even.px_per_mm)
    )


def view_of(seed: int, camera: Camera) -> SimulatedSurface:
    """The finger on the pixels of `camera`."""
    finger, master = _person(seed)
    return finger_surface(
        replace(finger, printed=master), _pose_of(seed, camera), camera, workers=1
    )


def phalange_of(seed: int, surface: SimulatedSurface) -> BoolArray:
    """(H, W) pixels of the distal phalange: the finger above its first crease."""
    finger, _ = _person(seed)
    placement = placement_of(
        FingerBody(finger.shape), _pose_of(seed, surface.camera), surface.camera
    )
    x, y = _places(surface)
    z = np.where(surface.mask, surface.shape_mm, 0.0).astype(np.float64)
    along = np.asarray(placement.to_finger(x.ravel(), y.ravel(), z.ravel())[1]).reshape(z.shape)
    return np.asarray(surface.mask & (along >= ABOVE_CREASE_MM))


def _printed(surface: SimulatedSurface, where: BoolArray) -> BoolArray:
    """(H, W) pixels of `where` whose shape is flat enough to carry the print."""
    return np.asarray(where & (surface.shape_normals[..., 2] > np.cos(np.deg2rad(MAX_SLANT_DEG))))


def _places(surface: SimulatedSurface) -> tuple[Array, Array]:
    """(H, W) x and y of what each pixel sees, mm; of the pixel on the finger plane beside the
    finger."""
    x, y, _ = surface.sight().at(np.where(surface.mask, surface.height_mm, 0.0))
    return x, y


def _grid_places(camera: Camera) -> tuple[Array, Array]:
    """(H, W) x and y of where each pixel looks on the finger plane, mm."""
    rows, columns = camera.image_size
    x = (np.arange(columns) - (columns - 1) / 2) * camera.pitch_mm
    y = ((rows - 1) / 2 - np.arange(rows)) * camera.pitch_mm
    across, up = np.meshgrid(x, y)
    return across, up


@functools.lru_cache(maxsize=8)
def _truth(seed: int, px_per_mm: float) -> _Points:
    """The true surface, seen straight from above, whatever the rig: what every reconstruction is
    measured against."""
    size = (round(FIELD_MM[0] * px_per_mm), round(FIELD_MM[1] * px_per_mm))
    surface = view_of(seed, Camera(px_per_mm=px_per_mm, image_size=size))
    whole = phalange_of(seed, surface)
    x, y = _places(surface)
    points = np.stack([x, y, surface.height_mm.astype(np.float64)], axis=-1)
    return _Points(points[whole], _printed(surface, whole)[whole])


@functools.lru_cache(maxsize=4)
def _typical(seed: int) -> PrintPoints:
    """Print of a finger, as points and normals of its shape about half a millimetre apart."""
    surface = view_of(seed, Camera(px_per_mm=4.0, image_size=(116, 169)))
    where = _printed(surface, phalange_of(seed, surface))[::2, ::2]
    x, y = _places(surface)
    points = np.stack([x, y, surface.shape_mm.astype(np.float64)], axis=-1)[::2, ::2]
    return PrintPoints(points[where], surface.shape_normals[::2, ::2][where].astype(np.float64))


def _measure(candidate: RigCandidate, study: ThesisStudy, seed: int) -> dict[str, float]:
    """Figures of one finger."""
    rig, known = _rigs(candidate, study)
    surface = _seen(seed, candidate.height_mm, candidate.px_per_mm, study.build)
    whole = phalange_of(seed, surface)
    shot = photograph_candidate(
        surface,
        rig,
        known_rig=known,
        mask=whole,
        skin=_skin(seed) if study.material == "skin" else None,
        photons=study.photons,
        seed=np.random.SeedSequence([seed, 0x0D]),
        rendered=study.camera == "renderer",
    )
    # the surface of ea, ridges by shapelets
    preset = "metric" if study.method == "metric" else "ea-split"
    changes = {"height.method": "poisson"} if study.method == "ea-poisson" else {}
    result = reconstruct(shot.capture, preset, changes)
    return {**_exposed(shot), **compare_surfaces(result, surface, whole, seed, TRUTH_PX_PER_MM)}


def _rigs(candidate: RigCandidate, study: ThesisStudy) -> tuple[Rig, Rig]:
    """The rig that photographs, and the one that the reconstruction assumes: the thesis's methods
    see parallel rays."""
    build = study.build
    if study.camera == "renderer":
        build = replace(build, half_angle_deg=90.0)
        intensities = dict.fromkeys(study.bands, candidate.power_w / (4.0 * np.pi))
    else:
        intensities = led_intensities(candidate, build, study.bands)
    rig = candidate_rig(candidate, build, intensities)
    if study.method == "metric":
        return rig, rig
    return rig, candidate_rig(candidate, replace(build, view="orthographic"), intensities)


def compare_surfaces(
    result: Reconstruction,
    surface: SimulatedSurface,
    whole: BoolArray,
    seed: int,
    truth_px_per_mm: float,
) -> dict[str, float]:
    """Distances between the true and the reconstructed surface.

    The mean height over the print is removed. ``hausdorff_mm``, ``hausdorff95_mm`` and ``rms_mm``
    are those of the print (slant up to 60 deg), whose nearest points are looked for on the whole
    phalange; ``whole_mm`` is the Hausdorff distance of the whole phalange, whose steep sides and
    cut edge decide it. ``normals_deg`` is the mean angle between true and reconstructed normals on
    the print, ``ridge_correlation`` that of the ridge bands there.
    """
    true = _truth(seed, truth_px_per_mm)
    flat = _printed(surface, whole) & np.isfinite(result.height_mm)
    kept = whole & np.isfinite(result.height_mm)
    x, y = _grid_places(surface.camera)
    if result.x_mm is not None and result.y_mm is not None:
        x, y = result.x_mm.astype(np.float64), result.y_mm.astype(np.float64)
    lift = float(
        np.mean(result.height_mm[flat], dtype=np.float64)
        - np.mean(surface.height_mm[flat], dtype=np.float64)
    )
    points = np.stack([x, y, result.height_mm - lift], axis=-1).astype(np.float64)
    there, back = _both_ways(true.phalange, points[kept])
    cosine = np.sum(result.normals[flat].astype(np.float64) * surface.normals[flat], axis=1)
    return {
        **_surface_distances(there[true.print], back[flat[kept]]),
        "whole_mm": _surface_distances(there, back)["hausdorff_mm"],
        "normals_deg": float(np.mean(np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0))))),
        "ridge_correlation": _ridge_correlation(
            result.ridge_mm,
            surface.height_mm - surface.shape_mm,
            kept,
            flat,
            BAND_SIGMA_MM / result.pitch_mm,
        ),
    }


def _exposed(shot: ExposedCapture) -> dict[str, float]:
    return {
        f"{what}_{band}": float(value)
        for band, exposure in shot.exposures.items()
        for what, value in (
            ("exposure_s", exposure.time_s),
            ("gain", exposure.gain),
            ("level", exposure.level),
        )
    }


def _ridge_correlation(
    relief: FloatArray, true: FloatArray, mask: BoolArray, where: BoolArray, sigma_px: float
) -> float:
    """Correlation of two reliefs, each minus its Gaussian mean over the mask."""
    first, second = (
        high_passed(field, mask, sigma_px)[where].astype(np.float64) for field in (relief, true)
    )
    first, second = first - first.mean(), second - second.mean()
    return float(
        np.sum(first * second) / max(float(np.sqrt(np.sum(first**2) * np.sum(second**2))), 1e-30)
    )


@functools.lru_cache(maxsize=32)
def _seen(seed: int, height_mm: float, px_per_mm: float, build: BuildSettings) -> SimulatedSurface:
    """The finger under this height's camera: the LEDs do not change it."""
    standing = RigCandidate(height_mm, 50.0, 1.0, None, px_per_mm)
    return view_of(seed, candidate_rig(standing, build, {"white": 1.0}).camera)


@functools.lru_cache(maxsize=64)
def _skin(seed: int) -> SkinOptics:
    return SkinRanges().draw(np.random.default_rng(np.random.SeedSequence([seed, 0x51])))


# The photograph.


def tremor_blur_mm(time_s: float) -> float:
    """Standard deviation, per axis, of where a trembling finger is while the shutter is open.

    A sinusoid of amplitude a and a random phase, seen for the time t, varies by a^2 / 2 (1 -
    sinc^2(f t)) on average.
    """
    fraction = 1.0 - float(np.sinc(_TREMOR_HZ * time_s)) ** 2
    return _TREMOR_UM * 1e-3 * float(np.sqrt(0.5 * fraction))


@dataclass(frozen=True, slots=True, eq=False)
class ExposedCapture:
    """A capture and how it was exposed."""

    capture: Capture
    exposures: Mapping[str, PlannedExposure]


def photograph_candidate(
    surface: SimulatedSurface,
    rig: Rig,
    *,
    known_rig: Rig,
    mask: BoolArray,
    skin: SkinOptics | None,
    photons: PhotonSettings,
    seed: np.random.SeedSequence,
    rendered: bool = False,
) -> ExposedCapture:
    """Photograph `surface` under every LED of `rig`.

    Parameters
    ----------
    surface : on the pixels of `rig.camera`
    rig : intensities in W/sr
    known_rig : what the reconstruction is given
    mask : (H, W) what is to be reconstructed
    skin : its optics; None for an opaque Lambertian finger
    photons : lens, shutter, sensor
    seed : of the noise
    rendered : as a rendering program stores it: one fixed exposure (a radiance of 1 W/(m^2 sr) is
    white), pin-hole, no
        noise, 8 bits sRGB

    Returns
    -------
    Shot whose capture is exposed so that the brightest skin reaches the target, where shutter and
    gain allow it.

    Raises
    ------
    BadInput
        If no LED lights the finger.
    """
    bands, exposures = {}, {}
    names = [name for name in BAND_CHANNELS if any(led.band == name for led in rig.leds)]
    require(len(names) > 0, "the rig has no LED of the bands white and nir.")
    sharpness = np.zeros(surface.mask.shape, np.float32) if rendered else _defocus(surface, photons)
    scale = rig.camera.px_per_mm / FULL_PX_PER_MM
    for name, band_seed in zip(names, seed.spawn(len(names)), strict=True):
        members = [k for k, led in enumerate(rig.leds) if led.band == name]
        frames, brightest = _frames(surface, [rig.leds[k] for k in members], name, skin)
        if rendered:
            exposure = PlannedExposure(0.0, 1.0, brightest * W_PER_UNIT)
            sensor = SensorSettings(noise=False, raw_bits=16, encoding="srgb")
        else:
            exposure = plan_exposure(
                electrons_per_s(brightest * W_PER_UNIT, LAMPS[name], photons), photons
            )
            require(
                exposure.level >= MIN_LEVEL,
                f"the {name} band is exposed to {100 * exposure.level:.2g} % of full scale.",
            )
            sensor = SensorSettings(
                full_well_e=FULL_WELL_E / exposure.gain,
                read_noise_e=READ_NOISE_E,
                raw_bits=16,  # binned pixels have more levels than ten bits hold
                bits=16,
            )
        gain = np.float32(exposure.level / brightest)
        blur_px = tremor_blur_mm(exposure.time_s) * rig.camera.px_per_mm
        images = []
        for frame, frame_seed in zip(frames, band_seed.spawn(len(frames)), strict=True):
            light = _trembled(defocus(frame, sharpness), blur_px) * gain
            images.append(record(light, name, frame_seed, sensor, scale))
        bands[name] = Band(
            name=name,
            pixels=np.stack(images),  # type: ignore[arg-type]
            leds=tuple((k,) for k in members),
            exposure=np.ones(len(images)),
            black_level=np.zeros(len(images)),
        )
        exposures[name] = exposure
    material = "opaque" if skin is None else "skin"
    encoding = "srgb" if rendered else "linear"
    return ExposedCapture(
        Capture(rig=known_rig, bands=bands, encoding=encoding, material=material, mask=mask),
        exposures,
    )


def _frames(
    surface: SimulatedSurface, leds: list[Led], name: str, skin: SkinOptics | None
) -> tuple[list[FloatArray], float]:
    """(H, W, 3) radiance of the whole frame under each LED, and that of the brightest skin without
    specular light."""
    if skin is None:
        patch = cut_out(surface)
        window = patch.window
        lit_by = np.stack([irradiance(led, patch.points, patch.normal) for led in leds])
        matt = (lit_by * (patch.mask * np.float32(OPAQUE_ALBEDO / np.pi))).astype(np.float32)
        diffuse, glare = matt[:, None], np.zeros_like(matt)
    else:
        light = render_band(surface, leds, skin.medium(name), RenderSettings(workers=1))
        window, diffuse, glare = light.window, light.diffuse, light.glare
    frames = []
    for k, led in enumerate(leds):
        card = white_card(surface.camera, led, -CLOTH_DEPTH_MM) * np.float32(CLOTH_ALBEDO)
        frame = np.repeat(np.where(surface.mask, np.float32(0.0), card)[..., None], 3, axis=2)
        for c in range(3):
            frame[window][..., c] += diffuse[k, min(c, diffuse.shape[1] - 1)] + glare[k]
        frames.append(frame)
    lit = diffuse[diffuse > 0]
    require(lit.size > 0, "no LED lights the finger; turn the beams towards it.")
    brightest = max(
        float(np.percentile(part[part > 0], 99.9))
        for part in np.moveaxis(diffuse, 1, 0)
        if part.any()
    )
    return frames, brightest


def _defocus(surface: SimulatedSurface, photons: PhotonSettings) -> FloatArray:
    """(H, W) width of the defocus in pixels; beyond the outline that of the outline goes on."""
    camera = surface.camera
    depth, top = finger_depth(surface)
    focus = top - FOCUS_DEPTH_MM
    aperture = photons.focal_mm(camera.height_mm) / photons.f_number
    return blur_sigma_px(depth, focus, camera.height_mm, aperture, camera.px_per_mm)


def _trembled(frame: FloatArray, sigma_px: float) -> FloatArray:
    if sigma_px < 0.05:
        return frame
    return np.asarray(
        cv2.GaussianBlur(frame, (0, 0), sigma_px, borderType=cv2.BORDER_REPLICATE), dtype=np.float32
    )


# How far two surfaces lie apart, as sets of points.


def _both_ways(first: Array, second: Array) -> tuple[Array, Array]:
    """Nearest distances from (N, 3) `first` to (M, 3) `second`, (N,), and back, (M,)."""
    return np.asarray(cKDTree(second).query(first)[0]), np.asarray(cKDTree(first).query(second)[0])


def _surface_distances(there: Array, back: Array) -> dict[str, float]:
    """Hausdorff distance, its 95 % variant and root mean square (mm) of nearest distances, (N,) and
    (M,), in both directions: those of :func:`_both_ways`, or a part of them.

    Where only the middle of two surfaces is measured, a point at its border may have its neighbour
    just beyond; so distances are found on the whole surfaces and those of the middle are kept.
    Source: F. Hausdorff, Grundzuege der Mengenlehre, 1914, chapter 8; D. P. Huttenlocher, G. A.
    Klanderman, W. J. Rucklidge, Comparing images using the Hausdorff distance, IEEE PAMI 15 (1993),
    equations (1) and (2); the percentile is their partial distance, equation (8).
    """
    return {
        "hausdorff_mm": float(max(there.max(), back.max())),
        "hausdorff95_mm": float(max(np.percentile(there, 95), np.percentile(back, 95))),
        "rms_mm": float(np.sqrt(0.5 * (np.mean(there**2) + np.mean(back**2)))),
    }
