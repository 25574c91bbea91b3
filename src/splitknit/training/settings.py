"""Settings of the training; the defaults are the thesis's where it gives a number."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from splitknit.errors import require
from splitknit.simulator.light.skin import SkinRanges

MAY_CHANGE = ("threads", "device", "precision", "epochs", "decay")
"""Settings that may differ when a training is taken up again: where it runs, and how long it goes on."""


def wide_skin() -> SkinRanges:
    """Ranges beyond those of plausible fingers: what lies at their edge is then inside for the network."""
    return SkinRanges(scattering_factor=(0.5, 2.0), glare=(0.0, 1.5), roughness=(0.12, 0.45))


@dataclass(frozen=True, slots=True)
class DataSettings:
    """The data set: photographs of simulated skin with and without its global light."""

    palms: int = 50
    """Palms; the thesis has 50."""
    fingers: int = 0
    """Fingers beside them; the thesis has none."""
    views: int = 1
    """Photographs of each, every one under other light and with other optics of the skin; the thesis has one."""
    patches: int = 750
    """Patches of each photograph."""
    patch_px: int = 72
    """Side of a patch."""
    least_skin: float = 0.25
    """Patches of which less than this part is skin are discarded (the thesis: those that are all black)."""
    image_size: tuple[int, int] = (1018, 768)
    """Rows and columns of a palm's photograph."""
    labels: str = "stack"
    """``stack``: direct light from 25 shifted checkerboards through the separation code, as the thesis.
    ``truth``: the twin's own direct light, by one convolution; about ten times faster."""
    check_mm: float = 0.42
    """Side of the checks. About a ridge period: direct light is defined only together with it."""
    pitch_um: tuple[float, float] = (13.0, 40.0)
    """Size of a palm's pixels on the finger plane, log-uniform; fingers have 20 um at least."""
    led_radius_mm: tuple[float, float] = (20.0, 75.0)
    """Distance of the light from the camera's axis, at the camera's height."""
    skin: SkinRanges = field(default_factory=wide_skin)
    held_out: int = 4
    """Palms, and as many fingers, that are set apart for the learning curve."""

    def __post_init__(self) -> None:
        for name, low, high in (
            ("palms", 0, 10_000),
            ("fingers", 0, 10_000),
            ("views", 1, 100),
            ("patches", 1, 100_000),
            ("patch_px", 16, 1024),
            ("held_out", 1, 1000),
        ):
            value = getattr(self, name)
            require(low <= value <= high, f"data.{name} must lie between {low} and {high}, but it is {value}.")
        require(self.palms + self.fingers >= 1, "there must be at least one palm or finger to train on.")
        require(0 <= self.least_skin <= 0.9, "data.least_skin must lie in [0, 0.9].")
        require(
            min(self.image_size) >= 2 * self.patch_px,
            f"data.image_size must be at least two patches ({2 * self.patch_px} pixels) each way.",
        )
        require(self.labels in ("stack", "truth"), f"data.labels must be stack or truth, not '{self.labels}'.")
        require(0.1 <= self.check_mm <= 5, "data.check_mm must lie between 0.1 and 5.")
        require(
            5 <= self.pitch_um[0] <= self.pitch_um[1] <= 50,
            "data.pitch_um must be (low, high) within 5 to 50 micrometres.",
        )
        require(0 <= self.led_radius_mm[0] <= self.led_radius_mm[1], "data.led_radius_mm must be (low, high).")


@dataclass(frozen=True, slots=True)
class TrainSettings:
    """Network and training."""

    width: int = 64
    """Channels of the first block; they double from block to block. The thesis: 64."""
    depth: int = 3
    """Encoder blocks, and decoder blocks."""
    dropout: float = 0.5
    """Share dropped after the last encoder block and the bridge, while training."""
    start_fraction: float = 0.0
    """The untrained network gives this fraction of its image: a shorter way to go than from noise. 0 = all random."""
    epochs: int = 50
    """How often every patch is seen, 1 to 100,000."""
    batch: int = 32
    """Patches a step, 1 to 4096."""
    learning_rate: float = 1e-3
    """Step of the optimiser Adam; positive."""
    decay: float = 0.0
    """Over this last part of the training the learning rate falls to zero along a cosine; the thesis keeps it."""
    enhanced_share: float = 0.5
    """Part of the patches that are given as grey, CLAHE-enhanced images, as the thesis's presets do; the others are
    linear colour images."""
    border_px: int = 0
    """Pixels at a patch's border that the loss leaves out: there the network sees zeros where an image would go on."""
    seed: int = 0
    """What weights, order and dropout are drawn from, 0 or more."""
    device: str = "cpu"
    """``cpu`` or ``cuda``."""
    threads: int = 1
    """Of torch on the processor; a training is repeatable for a fixed number."""
    precision: str = "auto"
    """``float32``; ``mixed`` (bfloat16 products, float32 weights and sums); ``auto``: mixed on a GPU alone."""

    def __post_init__(self) -> None:
        for name, low, high in (
            ("width", 1, 1024),
            ("depth", 1, 6),
            ("epochs", 1, 100_000),
            ("batch", 1, 4096),
            ("border_px", 0, 512),
            ("threads", 1, 1024),
        ):
            value = getattr(self, name)
            require(low <= value <= high, f"training: {name} must lie between {low} and {high}, but it is {value}.")
        require(self.seed >= 0, "training: seed must not be negative.")
        require(0 <= self.dropout < 1, "training: dropout must lie in [0, 1).")
        require(
            math.isfinite(self.learning_rate) and self.learning_rate > 0, "training: learning_rate must be positive."
        )
        require(0 <= self.start_fraction <= 1, "training: start_fraction must lie in [0, 1].")
        require(0 <= self.decay <= 1, "training: decay must lie in [0, 1].")
        require(0 <= self.enhanced_share <= 1, "training: enhanced_share must lie in [0, 1].")
        require(self.device in ("cpu", "cuda"), f"training: device must be cpu or cuda, not '{self.device}'.")
        known = ("auto", "float32", "mixed")
        require(
            self.precision in known,
            f"training: precision must be one of {', '.join(known)}, not '{self.precision}'.",
        )

    @property
    def stride(self) -> int:
        """Both sides of what the network sees are multiples of this."""
        return int(2**self.depth)

    @property
    def mixed(self) -> bool:
        """Whether products are formed in half precision."""
        return self.precision == "mixed" or (self.precision == "auto" and self.device == "cuda")
