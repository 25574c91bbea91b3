"""What a method works on, photographs of a finger that was found; and what it returns, the surface
in its window."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from splitknit import steps
from splitknit.diagnosis.diagnose import diagnose
from splitknit.diagnosis.jpeg import jpeg
from splitknit.errors import require
from splitknit.findings import Finding, Severity, worst_first
from splitknit.finger.locate import Finger, FingerSettings, prepared_capture
from splitknit.finger.steady import find_steady_finger, without_moved_side
from splitknit.imaging.light_field import flat_promised
from splitknit.imaging.polarised import aligned, specular_of, without_films, without_side_lights
from splitknit.integration.knit import place
from splitknit.model import Band, BoolArray, Capture, FloatArray, Reconstruction, Rig
from splitknit.photometric.uncalibrated import bas_relief_note, bas_relief_of
from splitknit.presets import PipelineSettings
from splitknit.steps import shared, step

if TYPE_CHECKING:
    from splitknit.mirrors.captured import SeenInMirrors

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
    """That images lit from the side were not used."""
    return Finding("side-unused", _SIDE_UNUSED.format(count))


@dataclass(frozen=True, slots=True)
class FingerBand:
    """One band's photographs of the finger."""

    capture: Capture
    band: Band
    finger: Finger
    plane_mm: float = 0.0
    """Assumed mean height of the surface above the finger plane, for near lights."""

    @property
    def rig(self) -> Rig:
        """`rig.leds[k]` lights photograph k."""
        return self.capture.rig.select(self.band.lights)

    @property
    def inside(self) -> BoolArray:
        """(h, w) pixels of the window that are reconstructed."""
        return self.finger.inside

    @property
    def px_per_mm(self) -> float:
        """Scale on the finger plane."""
        return self.capture.rig.camera.px_per_mm

    @property
    def pitch_mm(self) -> float:
        """Side of a pixel on the finger plane."""
        return self.capture.rig.camera.pitch_mm


@dataclass(slots=True, eq=False)
class FingerPhotographs:
    """All photographs of a finger, and the finger in them."""

    capture: Capture
    finger: Finger
    # the white band, and the near-infrared one if the shape is to come from it
    bands: tuple[Band, ...]
    findings: tuple[Finding, ...] = ()
    specular: FloatArray | None = None
    """(H, W) picture of the specular reflection, of a polarised capture."""

    def white_and_nir(self, plane_mm: float) -> tuple[FingerBand, FingerBand]:
        """The white band, and the band of the shape: the same one where there is no other."""
        white, nir = self.bands[0], self.bands[-1]
        return (
            FingerBand(self.capture, white, self.finger, plane_mm),
            FingerBand(self.capture, nir, self.finger, plane_mm),
        )

    def release(self) -> None:
        """Let go of the images, so that their memory is free where nobody else holds them."""
        self.capture, self.bands = replace(self.capture, bands={}), ()
        steps.images_are_read()


def prepared(capture: Capture, settings: PipelineSettings) -> FingerPhotographs:
    """Photographs in which the finger was found; where it moved between the shots, that is undone,
    so that they show it in one place. Raises BadInput if there is none.
    """
    capture, finger = locate_finger(_with_promised_light(capture), settings.finding())
    names = ["white"]
    if settings.shape.source == "nir" and not settings.visible_alone and "nir" in capture.bands:
        names.append("nir")
    return FingerPhotographs(
        capture, finger, tuple(capture.bands[name] for name in names), finger.findings
    )


@shared
@step("finger")
def locate_finger(capture: Capture, settings: FingerSettings) -> tuple[Capture, Finger]:
    """Segmentation mask, pose, crease and quality, in aligned photographs."""
    lit, of_colours = prepared_capture(capture, settings)
    # before motion is measured, which would take the shift of the image for one
    lit, films = aligned(lit)
    steady, finger = find_steady_finger(without_side_lights(lit), settings)
    steady, of_side = without_moved_side(steady, finger)
    saved_as_jpeg, of_files = jpeg(lit, finger)
    findings = (*of_files, *of_colours, *finger.findings, *of_side)
    facts = {**finger.facts, **films, **saved_as_jpeg}
    return without_films(steady), replace(finger, facts=facts, findings=findings)


def diagnosed(photographs: FingerPhotographs, settings: PipelineSettings) -> FingerPhotographs:
    """The photographs without those that do not fit the others, and what is wrong with them, the
    worst first."""
    capture, finger, diagnosis = diagnose(photographs.capture, photographs.finger)
    bands = tuple(capture.bands[band.name] for band in photographs.bands)
    findings = [*diagnosis, *photographs.findings]
    if len(bands) == 1:  # what is wrong with a band that is not used spoils nothing
        findings = [
            each for each in findings if each.severity == Severity.NOTE or each.band == "white"
        ]
    side = bands[0].side
    if side is not None and settings.method == "thesis":
        findings.append(side_unused(len(side.leds)))
    wanted = settings.shape.source == "nir" and not settings.visible_alone
    if wanted and len(bands) == 1 and capture.material == "skin":
        findings.append(Finding("no-nir", NO_NIR))
    if (unsure := bas_relief_of(capture.rig)) is not None:
        findings.insert(0, Finding("bas-relief", bas_relief_note(unsure)))
    return FingerPhotographs(
        capture, finger, bands, worst_first(findings), specular_of(capture, finger.mask)
    )


def _with_promised_light(capture: Capture) -> Capture:
    """Where images are divided by flat ones: with the brightness that the rig's lights have on a
    flat surface."""
    flat = {
        name: (band, band.flat) for name, band in capture.bands.items() if band.flat is not None
    }
    promised = {
        name: replace(band, promised=flat_promised(capture.rig.select(band.lights), image.shape))
        for name, (band, image) in flat.items()
    }
    return replace(capture, bands={**capture.bands, **promised}) if promised else capture


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
    capture, finger = photographs.capture, photographs.finger
    mask, window, camera = finger.mask, finger.window, capture.rig.camera
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
        facts={"material": capture.material, **finger.facts, **surface.facts},
        hashes=capture.hashes,
    )


NOT_SPLIT = (
    "this preset keeps the visible surface whole, so that a shape from mirrors has no place in it:"
    " take `preset` metric or snk."
)


@step("finger")
def mirror_views(capture: Capture, settings: PipelineSettings) -> SeenInMirrors:
    """The finger as mirrors show it. Raises BadInput if there are none, or the settings keep the
    surface whole."""
    # large, and needed where there are mirrors
    from splitknit.mirrors.captured import seen_in_mirrors

    require(not settings.visible_alone, NOT_SPLIT)
    return seen_in_mirrors(capture, settings.shape.mirror)


def on_mirror_shape(
    photographs: FingerPhotographs,
    surface: FingerSurface,
    seen: SeenInMirrors,
    settings: PipelineSettings,
) -> FingerSurface:
    """The surface's relief on the mirrors' shape; the finger ends where no mirror shows it.

    The shape keeps the fine detail of the one before (creases), but in the thesis's cases.
    """
    from splitknit.mirrors.captured import mirror_shape_of

    detail_mm = None if settings.method == "thesis" else surface.shape_mm
    shape_mm, mask, facts = mirror_shape_of(photographs.finger, seen, detail_mm)
    photographs.finger = replace(photographs.finger, mask=mask)
    facts = {**surface.facts, **facts}
    findings = (*surface.findings, *seen.shape.findings)
    return replace(
        surface,
        height_mm=shape_mm + surface.ridge_mm,
        shape_mm=shape_mm,
        facts=facts,
        findings=findings,
    )
