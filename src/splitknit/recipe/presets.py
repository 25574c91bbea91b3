"""Settings of the whole pipeline, and the presets."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

from splitknit.errors import require
from splitknit.finger import (
    ClaheSettings,
    MaskSettings,
    MotionSettings,
    QualitySettings,
)
from splitknit.integration import PoissonSettings, ShapeletSettings
from splitknit.integration.knit import KnitSettings
from splitknit.mirrors import MirrorShapeSettings
from splitknit.photometric import HanrahanKruegerSettings, RobustSettings
from splitknit.skin import MetricSettings, SkinSettings

REFERENCE_PX_PER_MM = 75.7
"""Scale at which the thesis gives its sizes in pixels."""


@dataclass(frozen=True, slots=True)
class EnhanceSettings:
    """Contrast enhancement before photometric stereo."""

    clahe: bool = False
    """Equalise every image adaptively."""
    cells: ClaheSettings = field(default_factory=ClaheSettings)


@dataclass(frozen=True, slots=True)
class DirectSettings:
    """Separation of direct light before photometric stereo: the thesis's cases only."""

    method: str = "none"
    """``network`` (the thesis's U-Net) or ``none``."""
    network: str = "direct"
    """Name of a network in the package, or path of an ``.onnx`` file with its card beside it."""
    from_colours: bool = False
    """Find the share of direct light in the colours, where there are any, and apply it to the grey images; the thesis
    gives the network the grey images themselves."""

    def __post_init__(self) -> None:
        require(self.method in ("network", "none"), f"direct.method must be network or none, not '{self.method}'.")


@dataclass(frozen=True, slots=True)
class NormalsSettings:
    """Photometric stereo of opaque surfaces and of the thesis's cases."""

    method: str = "near_light"
    """``lambertian``, ``robust``, ``near_light``, or ``hanrahan_krueger`` (two-layer skin under distant lights)."""
    robust: RobustSettings = field(default_factory=RobustSettings)
    """Weights of ``robust`` and ``near_light``."""
    rounds: int = 3
    """Turns of ``near_light`` and integration."""
    max_slope: float = 6.0
    """Steeper slopes are shortened to this."""
    hanrahan_krueger: HanrahanKruegerSettings = field(default_factory=HanrahanKruegerSettings)
    """Of that method alone."""

    def __post_init__(self) -> None:
        known = ("lambertian", "robust", "near_light", "hanrahan_krueger")
        require(self.method in known, f"normals.method must be one of {', '.join(known)}, not '{self.method}'.")
        require(1 <= self.rounds <= 20, "normals.rounds must lie between 1 and 20.")
        require(self.max_slope > 0, "normals.max_slope must be positive.")


@dataclass(frozen=True, slots=True)
class HeightSettings:
    """Integration of normals to heights."""

    method: str = "poisson"
    """``poisson`` (masked least squares) or ``frankot_chellappa``."""
    padding: str = "zero"
    """Of Frankot-Chellappa: ``zero`` as the thesis, or ``mirror``."""
    poisson: PoissonSettings = field(default_factory=PoissonSettings)

    def __post_init__(self) -> None:
        known = ("poisson", "frankot_chellappa")
        require(self.method in known, f"height.method must be one of {', '.join(known)}, not '{self.method}'.")


@dataclass(frozen=True, slots=True)
class SmoothSettings:
    """Smoothing of a finished surface: Kumar's case only."""

    sigma_mm: float = 0.0
    """Of the Gaussian that heights and relief are convolved with; 0 leaves them as they are."""

    def __post_init__(self) -> None:
        require(0.0 <= self.sigma_mm <= 1.0, f"smooth.sigma_mm must lie between 0 and 1, but it is {self.sigma_mm}.")


@dataclass(frozen=True, slots=True)
class LightsSettings:
    """Coloured LEDs: Lin's case only."""

    compose: int = 0
    """Put so many coloured exposures together from the images under white LEDs, three images for each (fewer where
    images are few); 0, and any capture under coloured LEDs: take the images as they are."""
    balance: bool = False
    """Divide the images of each colour by how bright the finger is in it; one factor a colour."""

    def __post_init__(self) -> None:
        require(0 <= self.compose <= 3, f"lights.compose must be 0 to 3 exposures, but it is {self.compose}.")


@dataclass(frozen=True, slots=True)
class ShapeSettings:
    """Where the finger's shape comes from."""

    source: str = "nir"
    """``nir`` (the white band where there is none), ``white``, or ``mirror``: outlines in mirrors beside the finger."""
    mirror: MirrorShapeSettings = field(default_factory=MirrorShapeSettings)
    """How the last is done."""

    def __post_init__(self) -> None:
        known = ("nir", "white", "mirror")
        require(self.source in known, f"shape.source must be nir, white or mirror, not '{self.source}'.")


@dataclass(frozen=True, slots=True)
class PipelineSettings:
    """Everything that can be changed in a reconstruction."""

    method: str = "metric"
    """``metric``, or ``thesis``: distant lights, and integration as the thesis has it."""
    camera: str = "calibrated"
    """``calibrated``: rays run as the rig file's camera model says; ``orthographic``: parallel, whatever it says."""
    top_mm: float = 0.0
    """Assumed height of the finger's highest point above the finger plane; with a perspective camera sizes follow from
    it, 0.7 % for each mm at 140 mm."""
    mask: MaskSettings = field(default_factory=MaskSettings)
    cut_at_crease: bool = True
    """Keep only the finger's first phalange."""
    enhance: EnhanceSettings = field(default_factory=EnhanceSettings)
    direct: DirectSettings = field(default_factory=DirectSettings)
    normals: NormalsSettings = field(default_factory=NormalsSettings)
    height: HeightSettings = field(default_factory=HeightSettings)
    shape: ShapeSettings = field(default_factory=ShapeSettings)
    shapelets: ShapeletSettings = field(default_factory=ShapeletSettings)
    knit: KnitSettings = field(default_factory=KnitSettings)
    smooth: SmoothSettings = field(default_factory=SmoothSettings)
    lights: LightsSettings = field(default_factory=LightsSettings)
    skin: SkinSettings = field(default_factory=SkinSettings)
    metric: MetricSettings = field(default_factory=MetricSettings)
    quality: QualitySettings = field(default_factory=QualitySettings)
    motion: MotionSettings = field(default_factory=MotionSettings)

    def __post_init__(self) -> None:
        require(self.method in ("metric", "thesis"), f"method must be metric or thesis, not '{self.method}'.")
        rough = not self.smooth.sigma_mm
        require(self.method == "thesis" or rough, "smooth.sigma_mm smooths the thesis's cases only; set method=thesis.")
        require(
            self.camera in ("calibrated", "orthographic"),
            f"camera must be calibrated or orthographic, not '{self.camera}'.",
        )


def _thesis(split: bool, knit: Literal["addition", "none"]) -> PipelineSettings:
    """`split`: with contrast enhancement and direct light."""
    return PipelineSettings(
        method="thesis",
        camera="orthographic",
        enhance=EnhanceSettings(clahe=split),
        direct=DirectSettings(method="network" if split else "none"),
        normals=NormalsSettings(method="lambertian"),
        height=HeightSettings(method="frankot_chellappa"),
        shapelets=ShapeletSettings(scales=3),
        knit=KnitSettings(method=knit),
    )


def _kumar() -> PipelineSettings:
    """Case EA, and a Gaussian over the finished surface.

    Kumar and Kwong reconstruct from seven visible images by Lambertian least squares and Frankot-Chellappa, and smooth
    the surface before curvatures are computed. How much is not said; 0.05 mm, a ninth of a ridge's period, keeps three
    quarters of the ridges' height.

    References
    ----------
    A. Kumar and C. Kwong, "Towards contactless, low-cost and accurate 3D fingerprint identification", IEEE Trans. PAMI
    37(3), 2015; A. Kumar, "Contactless 3D Fingerprint Identification", Springer 2018.
    """
    return replace(_thesis(split=False, knit="none"), smooth=SmoothSettings(sigma_mm=0.05))


def _xie() -> PipelineSettings:
    """Case EA with a two-layer model of skin in place of Lambert's: all lights count alike, as in EA.

    References
    ----------
    W. Xie, Z. Song and R. C. Chung, "Real-time three-dimensional fingerprint acquisition via a new photometric stereo
    means", Optical Engineering 52 (2013); the thesis, (2.1) to (2.3).
    """
    skin = HanrahanKruegerSettings(weights="equal")
    normals = NormalsSettings(method="hanrahan_krueger", hanrahan_krueger=skin)
    return replace(_thesis(split=False, knit="none"), normals=normals)


def _lin() -> PipelineSettings:
    """Case EA under coloured LEDs, three of which share an exposure.

    Lin and Kumar reconstruct as Kumar and Kwong do, from the red, green and blue images of coloured LEDs. Colour images
    under white LEDs are put together into two such exposures first.

    References
    ----------
    C. Lin and A. Kumar, "Tetrahedron based fast 3D fingerprint identification using colored LEDs illumination", IEEE
    Trans. PAMI 40(12), 2018.
    """
    return replace(_thesis(split=False, knit="none"), lights=LightsSettings(compose=2, balance=True))


PRESETS: dict[str, PipelineSettings] = {
    "metric": PipelineSettings(shapelets=ShapeletSettings(scales=4)),
    "snk": _thesis(split=True, knit="addition"),
    "pr": _thesis(split=True, knit="none"),
    "ea": _thesis(split=False, knit="none"),
    "kumar": _kumar(),
    "zheng": _thesis(split=False, knit="none"),
    "lin": _lin(),
    "xie": _xie(),
}
