"""Settings of the whole pipeline, and the presets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Annotated, Any, Literal

from splitknit.errors import require
from splitknit.finger.contrast import ClaheSettings
from splitknit.finger.locate import FingerSettings
from splitknit.integration.knit import KnitSettings
from splitknit.integration.shapelets import ShapeletSettings
from splitknit.observation.coloured import LightsSettings
from splitknit.registry import own_object
from splitknit.settings import Checked, Limits, check_fields, differing, override
from splitknit.skin.diffusion import SkinSettings
from splitknit.skin.images import MetricSettings

NOT_SPLIT = (
    "this preset keeps the visible surface whole, so that a shape from mirrors has no place in it:"
    " take `preset` metric or snk."
)


@dataclass(frozen=True, slots=True)
class EnhanceSettings(Checked):
    """Contrast enhancement before photometric stereo."""

    clahe: bool = False
    """Equalise every image adaptively."""
    cells: ClaheSettings = field(default_factory=ClaheSettings)


@dataclass(frozen=True, slots=True)
class DirectSettings(Checked):
    """Separation of direct light before photometric stereo: the thesis's cases only."""

    method: Literal["network", "none"] = "none"
    """``network`` (the thesis's U-Net) or ``none``."""
    network: str = "direct"
    """Name of a network in the package, or path of an ``.onnx`` file with its card beside it."""


@dataclass(frozen=True, slots=True)
class NormalsSettings(Checked):
    """Photometric stereo of opaque surfaces and of the thesis's cases."""

    method: Literal["lambertian", "robust", "near_light"] = "near_light"
    """``lambertian``, ``robust`` or ``near_light``."""


@dataclass(frozen=True, slots=True)
class HeightSettings(Checked):
    """Integration of normals to heights."""

    method: Literal["poisson", "piecewise", "frankot_chellappa"] = "poisson"
    """``poisson`` (masked least squares), ``piecewise`` (keeps steps) or ``frankot_chellappa``."""


@dataclass(frozen=True, slots=True)
class SmoothSettings(Checked):
    """Smoothing of a finished surface: Kumar's case only."""

    sigma_mm: Annotated[float, Limits(0, 1)] = 0.0
    """Standard deviation of the Gaussian over heights and relief; more removes noise and lowers the
    ridges; 0: none."""


@dataclass(frozen=True, slots=True)
class ShapeSettings(Checked):
    """Where the finger's shape comes from."""

    source: Literal["nir", "white", "mirror"] = "nir"
    """``nir`` (the white band where there is none), ``white``, or ``mirror``: outlines in mirrors
    beside the finger."""


@dataclass(frozen=True, slots=True)
class Photometry:
    """How the thesis's cases measure normals: preparation of the images, then photometric
    stereo."""

    balance: bool
    """Bring coloured LEDs to one brightness."""
    enhance: EnhanceSettings
    direct: DirectSettings
    normals: NormalsSettings

    @property
    def prepares(self) -> bool:
        """Whether the images are changed before photometric stereo."""
        return self.balance or self.enhance.clahe or self.direct.method == "network"


@dataclass(frozen=True, slots=True)
class Parameters:
    """Parameters of the methods that measure normals and integrate them."""

    photometry: Photometry
    height: HeightSettings
    shapelets: ShapeletSettings


@dataclass(frozen=True, slots=True)
class PipelineSettings(FingerSettings):
    """Everything that can be changed in a reconstruction."""

    method: Literal["metric", "thesis"] = "metric"
    """``metric``, or ``thesis``: distant lights, and integration as the thesis has it."""
    top_mm: float = 0.0
    """Assumed height of the finger's top over the plane; under a perspective camera 0.7 % of size a
    mm."""
    enhance: EnhanceSettings = field(default_factory=EnhanceSettings)
    direct: DirectSettings = field(default_factory=DirectSettings)
    normals: NormalsSettings = field(default_factory=NormalsSettings)
    height: HeightSettings = field(default_factory=HeightSettings)
    shape: ShapeSettings = field(default_factory=ShapeSettings)
    shapelets: ShapeletSettings = field(default_factory=ShapeletSettings)
    knit: KnitSettings = field(default_factory=KnitSettings)
    smooth: SmoothSettings = field(default_factory=SmoothSettings)
    skin: SkinSettings = field(default_factory=SkinSettings)
    metric: MetricSettings = field(default_factory=MetricSettings)

    def __post_init__(self) -> None:
        check_fields(self)
        require(self.shape.source != "mirror" or not self.visible_alone, NOT_SPLIT)
        rough = not self.smooth.sigma_mm
        require(
            self.method == "thesis" or rough,
            "smooth.sigma_mm smooths the thesis's cases only; set method=thesis.",
        )

    def finding(self) -> FingerSettings:
        """The part that defines how the capture is read and the finger is found in it."""
        return FingerSettings(
            **{item.name: getattr(self, item.name) for item in fields(FingerSettings)}
        )

    def parameters(self, coloured: bool, material: str) -> Parameters:
        """What the methods are given under coloured LEDs or not, for ``skin`` or ``opaque`` things
        (direct light)."""
        direct = self.direct if material == "skin" else DirectSettings()
        photometry = Photometry(
            self.lights.balance and coloured, self.enhance, direct, self.normals
        )
        return Parameters(photometry, self.height, self.shapelets)

    @property
    def visible_alone(self) -> bool:
        """Whether the white band gives the whole surface: the thesis's cases that knit nothing."""
        return self.method == "thesis" and self.knit.method in {"none", "whole"}


def _thesis(
    direct: bool = False, knit: Literal["addition", "none", "whole"] = "whole"
) -> PipelineSettings:
    """`direct`: with contrast enhancement and direct light; nothing given: case EA."""
    return PipelineSettings(
        method="thesis",
        camera="orthographic",
        enhance=EnhanceSettings(clahe=direct),
        direct=DirectSettings(method="network" if direct else "none"),
        normals=NormalsSettings(method="lambertian"),
        height=HeightSettings(method="frankot_chellappa"),
        shapelets=ShapeletSettings(scales=3),
        knit=KnitSettings(method=knit),
    )


PRESETS: dict[str, PipelineSettings] = {
    "metric": PipelineSettings(shapelets=ShapeletSettings(scales=4)),
    "snk": _thesis(direct=True, knit="addition"),
    "pr": _thesis(direct=True),
    "ea": _thesis(),
    "pr-split": _thesis(direct=True, knit="none"),
    "ea-split": _thesis(knit="none"),
    # Kumar and Kwong reconstruct from seven visible images by Lambertian least squares and
    # Frankot-Chellappa, and smooth the surface before curvatures are computed. How much is not
    # said; 0.05 mm, a ninth of a ridge's period, keeps three quarters of the ridges' height. A.
    # Kumar and C. Kwong, "Towards contactless, low-cost and accurate 3D fingerprint
    # identification", IEEE Trans. PAMI 37(3), 2015; A. Kumar, "Contactless 3D Fingerprint
    # Identification", Springer 2018.
    "kumar": replace(_thesis(), smooth=SmoothSettings(sigma_mm=0.05)),
    "zheng": _thesis(),
    # Lin and Kumar reconstruct as Kumar and Kwong do, from the red, green and blue images of
    # coloured LEDs, three of which share an exposure. Colour images under white LEDs are put
    # together into two such exposures first. C. Lin and A. Kumar, "Tetrahedron based fast 3D
    # fingerprint identification using colored LEDs illumination", IEEE Trans. PAMI 40(12), 2018.
    "lin": replace(_thesis(), lights=LightsSettings(compose=2, balance=True)),
}


def chosen_settings(
    preset: str, settings: Mapping[str, Any] | PipelineSettings | None
) -> tuple[str, PipelineSettings]:
    """What to run, and its name: a preset's, or ``snk, changed``. `settings`: changes, from
    ``stage.field`` to a value; or whole settings, named after the nearest preset. Raises BadInput
    as :func:`preset_settings`, or if a change is refused.
    """
    if isinstance(settings, PipelineSettings):
        chosen = settings
        # equal: ea and zheng
        names = sorted(PRESETS, key=lambda name: (PRESETS[name] is not settings, name != preset))
        preset = min(names, key=lambda name: len(differing(asdict(PRESETS[name]), asdict(chosen))))
    else:
        chosen = override(preset_settings(preset), settings or {})
    return preset if chosen == preset_settings(preset) else f"{preset}, changed", chosen


def preset_settings(preset: str) -> PipelineSettings:
    """Settings of a preset.

    Parameters
    ----------
    preset : a name of :data:`PRESETS`, or a function without arguments that returns settings:
        an entry point of ``splitknit.presets``, or ``module:function``

    Returns
    -------
    PipelineSettings
        Frozen; :func:`splitknit.settings.override` gives changed ones.

    Raises
    ------
    BadInput
        If there is no such preset.

    Examples
    --------
    >>> preset_settings("snk").knit.method
    'addition'
    """
    if preset in PRESETS:
        return PRESETS[preset]
    settings = own_object("preset", preset, PRESETS)()
    wrong = f"the preset '{preset}' must return PipelineSettings."
    require(isinstance(settings, PipelineSettings), wrong)
    return settings  # type: ignore[no-any-return]
