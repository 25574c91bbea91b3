"""What is asked of every candidate of a sweep: which fingers, which method, which physics."""

from __future__ import annotations

from dataclasses import dataclass, field

from splitknit.errors import require
from splitknit.rig.candidates import BuildSettings
from splitknit.rig.constraints import Limits
from splitknit.rig.photons import PhotonSettings

METHODS = {
    "ea": "the thesis's plain photometric stereo: distant lights, Frankot-Chellappa",
    "ea-poisson": "the same normals, integrated over the finger's mask alone",
    "metric": "ours: near lights, a calibrated perspective camera, glare and scattering undone",
}
MATERIALS = {"opaque": "an opaque Lambertian finger, as the thesis's sculpture", "skin": "the twin's skin"}
CAMERAS = {
    "sensor": "the rig's: photons, noise, defocus, exposure chosen within the shutter's range",
    "renderer": "a rendering program's: pin-hole, no noise, one fixed exposure, bare isotropic lamps, 8 bits sRGB",
}


@dataclass(frozen=True, slots=True)
class Study:
    """Everything that a candidate's figures follow from, besides the candidate."""

    method: str = "ea"
    material: str = "opaque"
    camera: str = "sensor"
    fingers: int = 3
    first_seed: int = 400
    """Of the fingers; all candidates photograph the same ones, with the same noise."""
    truth_px_per_mm: float = 10.0
    """Density of the points of the true surface."""
    build: BuildSettings = field(default_factory=BuildSettings)
    photons: PhotonSettings = field(default_factory=PhotonSettings)
    limits: Limits = field(default_factory=Limits)

    def __post_init__(self) -> None:
        for name, known in (("method", METHODS), ("material", MATERIALS), ("camera", CAMERAS)):
            value = getattr(self, name)
            require(value in known, f"the study's {name} must be one of {', '.join(known)}, not '{value}'.")
        require(
            1 <= self.fingers <= 200, f"the number of fingers must lie between 1 and 200, but it is {self.fingers}."
        )
        require(self.first_seed >= 0, "the study's first_seed must not be negative.")
        require(4.0 <= self.truth_px_per_mm <= 60.0, "the study's truth_px_per_mm must lie between 4 and 60.")

    @property
    def seeds(self) -> tuple[int, ...]:
        """Of the fingers."""
        return tuple(range(self.first_seed, self.first_seed + self.fingers))

    @property
    def bands(self) -> tuple[str, ...]:
        """Bands that the method looks at."""
        return ("white", "nir") if self.method == "metric" else ("white",)
