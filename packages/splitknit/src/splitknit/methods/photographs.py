"""Input and output of a method: photographs with the finger found in them, and the surface in the
finger's window."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from splitknit.capture import Capture
from splitknit.diagnosis.diagnose import diagnose
from splitknit.findings import Finding, Severity, worst_first
from splitknit.finger.locate import Finger, FingerSettings
from splitknit.finger.steady import find_steady_finger, without_moved_side
from splitknit.integration.knit import place
from splitknit.model import BoolArray, FloatArray, Rig
from splitknit.observation.films import specular_of
from splitknit.observation.light import Light
from splitknit.observation.observe import Observation, observe
from splitknit.observation.processed import findings_on_processing
from splitknit.presets import PipelineSettings
from splitknit.reconstruction import Reconstruction
from splitknit.steps import step

NO_NIR = (
    "there is no near-infrared band: the shape comes from the white band, in which ridges,"
    " scattering and specular reflection bend it."
)
_SIDE_UNUSED = (
    "the {} white images lit far more from the side than the others are not used: by the published"
    " cases, and where no network estimates the ridges, the shadows in them would be taken for the"
    " skin's shape."
)


def side_unused(count: int) -> Finding:
    """A note that images lit from the side were not used."""
    return Finding("side-unused", _SIDE_UNUSED.format(count))


@dataclass(frozen=True, slots=True)
class FingerBand:
    """One band's light on the finger."""

    light: Light
    """On the pixels of the finger's window."""
    material: str
    finger: Finger
    plane_mm: float = 0.0
    """Assumed mean height of the surface above the finger plane, for near lights."""

    @property
    def rig(self) -> Rig:
        """`rig.leds[k]` lights image k."""
        return self.light.rig

    @property
    def inside(self) -> BoolArray:
        """(h, w) pixels of the window that are reconstructed."""
        return self.finger.inside

    @property
    def px_per_mm(self) -> float:
        """Scale on the finger plane."""
        return self.light.built.camera.px_per_mm

    @property
    def pitch_mm(self) -> float:
        """Side of a pixel on the finger plane."""
        return self.light.pitch_mm


@dataclass(frozen=True, slots=True, eq=False)
class FingerPhotographs:
    """Photographs of a finger, the finger in them, and what is wrong with them: what all methods
    begin with."""

    observation: Observation
    finger: Finger
    settings: FingerSettings
    """By which the finger was found."""
    findings: tuple[Finding, ...] = ()
    specular: FloatArray | None = None
    """(H, W) picture of the specular reflection, of a polarised capture."""

    def bands(self, settings: PipelineSettings) -> tuple[Light, ...]:
        """The white band, and the near-infrared one if the shape is to come from it."""
        light = self.observation.bands
        used = ("white", "nir") if _shape_from_nir(settings) else ("white",)
        return tuple(light[name] for name in used if name in light)

    def white_and_nir(
        self, settings: PipelineSettings, plane_mm: float
    ) -> tuple[FingerBand, FingerBand]:
        """The white band and the band that gives the shape, which is the white one if there is no
        other."""
        window, material = self.finger.window, self.observation.material
        light = [
            FingerBand(band.at(1, window), material, self.finger, plane_mm)
            for band in self.bands(settings)
        ]
        return light[0], light[-1]


def _shape_from_nir(settings: PipelineSettings) -> bool:
    return settings.shape.source == "nir" and not settings.visible_alone


def photographs_of(capture: Capture, settings: FingerSettings) -> FingerPhotographs:
    """Locate the finger, undo its motion between the shots, and leave out photographs that do not
    fit the others. Raises BadInput if there is no finger.
    """
    observation, finger = locate_finger(capture, settings)
    observation, finger, findings = diagnose(
        observation, finger, fit_places=settings.lights.places == "auto"
    )
    specular = specular_of(observation.white, finger.mask, observation.rig.camera.px_per_mm)
    findings = (*findings, *finger.findings)
    return FingerPhotographs(observation, finger, settings, findings, specular)


@step("finger")
def locate_finger(capture: Capture, settings: FingerSettings) -> tuple[Observation, Finger]:
    """Segmentation mask, pose, crease and quality, in aligned photographs."""
    observation = observe(capture, settings.lights, settings.camera)
    steady, finger = find_steady_finger(observation, settings)
    steady, of_side = without_moved_side(steady, finger)
    processed, of_files = findings_on_processing(observation, finger.window, finger.mask)
    findings = (*of_files, *observation.findings, *finger.findings, *of_side)
    facts = {**finger.facts, **observation.facts, **processed}
    return steady.without_films(), replace(finger, facts=facts, findings=findings)


def findings_for(photographs: FingerPhotographs, settings: PipelineSettings) -> tuple[Finding, ...]:
    """What is wrong with the photographs that a method uses, or was assumed of them, the worst
    first."""
    observation = photographs.observation
    findings = list(photographs.findings)
    alone = len(photographs.bands(settings)) == 1
    if alone:  # what is wrong with a band that is not used spoils nothing
        findings = [
            each for each in findings if each.severity == Severity.NOTE or each.band == "white"
        ]
    if observation.side is not None and settings.method == "thesis":
        findings.append(side_unused(observation.side.photographs))
    if _shape_from_nir(settings) and alone and observation.material == "skin":
        findings.append(Finding("no-nir", NO_NIR))
    return worst_first(findings)


@dataclass(frozen=True, slots=True, eq=False)
class FingerSurface:
    """A surface in the finger's window: arrays (h, w), finite inside the mask."""

    height_mm: FloatArray
    ridge_mm: FloatArray
    shape_mm: FloatArray
    albedo: FloatArray
    normals: FloatArray | None = None
    """(h, w, 3) measured by photometric stereo, in the rig's frame; None where the method measures
    none."""
    colour: FloatArray | None = None
    """(h, w, 3) albedo in red, green and blue."""
    uncertainty_um: FloatArray | None = None
    whole: bool = False
    """Whether the surface is not split into relief and shape: its height is what the thesis's
    matcher takes."""
    facts: Mapping[str, Any] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()


@step("result")
def placed(photographs: FingerPhotographs, surface: FingerSurface, top_mm: float) -> Reconstruction:
    """The window's surface in the full image, cut to the mask, with the normals of the knitted
    height.

    `top_mm`: assumed height of the highest point above the finger plane.
    """
    observation, finger = photographs.observation, photographs.finger
    mask, window, camera = finger.mask, finger.window, observation.rig.camera
    inside = mask[window]
    height_mm, shape_mm, normals, x_mm, y_mm = place(
        surface.height_mm, surface.shape_mm, inside, camera, window, top_mm
    )

    def whole(part: FloatArray) -> FloatArray:
        image = np.full(mask.shape, np.nan, dtype=np.float32)
        np.copyto(image[window], part, where=inside)
        return image

    def whole_vectors(part: FloatArray) -> FloatArray:
        image = np.zeros((*mask.shape, 3), dtype=np.float32)
        # no negative zeros, which pack badly
        np.copyto(image[window], part, where=inside[..., None])
        return image

    return Reconstruction(
        height_mm=whole(height_mm),
        ridge_mm=whole(surface.ridge_mm if x_mm is None else height_mm - shape_mm),
        shape_mm=whole(shape_mm),
        mask=mask,
        normals=whole_vectors(normals),
        normals_measured=None if surface.normals is None else whole_vectors(surface.normals),
        albedo=whole(surface.albedo),
        colour=None if surface.colour is None else whole_vectors(surface.colour),
        pitch_mm=camera.pitch_mm,
        scale_known=camera.scale_known,
        x_mm=None if x_mm is None else whole(x_mm),
        y_mm=None if y_mm is None else whole(y_mm),
        input_from_upright=finger.upright.input_from_upright,
        upright_size=finger.upright.size,
        preset="",
        whole=surface.whole,
        specular=photographs.specular,
        uncertainty_um=None if surface.uncertainty_um is None else whole(surface.uncertainty_um),
        quality=finger.quality,
        facts={"material": observation.material, **finger.facts, **surface.facts},
        hashes=observation.hashes,
    )


@step("finger")
def on_mirror_shape(
    photographs: FingerPhotographs, surface: FingerSurface, settings: PipelineSettings
) -> tuple[FingerPhotographs, FingerSurface]:
    """Put the surface's relief on the shape from mirrors; the finger's mask is cut to what the
    mirrors show. Except in the thesis's cases, the new shape keeps the fine detail of the old one
    (creases). Raises BadInput if the mirrors do not show one finger.
    """
    # large, and needed where there are mirrors
    from splitknit.mirrors.captured import mirror_shape_of, seen_in_mirrors

    seen = seen_in_mirrors(photographs.observation)
    detail_mm = None if settings.method == "thesis" else surface.shape_mm
    shape_mm, mask, facts = mirror_shape_of(photographs.finger, seen, detail_mm)
    surface = replace(
        surface,
        height_mm=shape_mm + surface.ridge_mm,
        shape_mm=shape_mm,
        facts={**surface.facts, **facts},
        findings=(*surface.findings, *seen.shape.findings),
    )
    return replace(photographs, finger=replace(photographs.finger, mask=mask)), surface
