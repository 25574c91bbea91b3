"""The result: a metric fingerprint on the input's pixel grid."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pkgutil import resolve_name
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.capture import Capture
from splitknit.errors import require
from splitknit.findings import Finding
from splitknit.model import BoolArray, Camera, FloatArray
from splitknit.units import MILLIMETRES, LengthUnit, pixels

_PREVIEW, _SAVE = "splitknit.report.result:preview_html", "splitknit.report.result:write_results"
"""What a result does by modules above this one, each imported when it is first used."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Reconstruction:
    """A metric fingerprint on the input's pixel grid."""

    height_mm: FloatArray
    """(H, W) knitted surface, NaN outside the mask."""
    ridge_mm: FloatArray
    """(H, W) relief alone, NaN outside the mask; of an unsplit surface (`whole`) height less its
    slow part."""
    shape_mm: FloatArray
    """(H, W) finger shape alone, NaN outside the mask."""
    mask: BoolArray
    """(H, W)."""
    normals: FloatArray
    """(H, W, 3) of the knitted surface, unit length, zero outside the mask."""
    albedo: FloatArray
    """(H, W) relative, NaN outside the mask."""
    pitch_mm: float
    input_from_upright: NDArray[np.float64]
    """(3, 3) on (column, row, 1): where an upright pixel (tip up) lies in the input."""
    upright_size: tuple[int, int]
    """Rows, columns of the upright frame."""
    preset: str
    x_mm: FloatArray | None = None
    """(H, W) x of each pixel's point, NaN outside the mask; None: parallel rays, pixels at their
    pitch."""
    y_mm: FloatArray | None = None
    """(H, W) y, likewise."""
    whole: bool = False
    """Whether the surface was not split (the thesis's EA and PR): its matcher takes the height
    itself as the relief."""
    uncertainty_um: FloatArray | None = None
    """(H, W) standard deviation of the relief where the skin's blur was inverted, NaN outside the
    mask."""
    normals_measured: FloatArray | None = None
    """(H, W, 3) of photometric stereo before integration, zero outside the mask; None without
    (skin)."""
    specular: FloatArray | None = None
    """(H, W) of a polarised capture: what the surface reflects under all lights, of even brightness
    and contrast, in standard deviations from the local mean, NaN outside the mask; see
    :func:`splitknit.observation.films.specular_picture`."""
    misfit: FloatArray | None = None
    """(H, W) part of the photographs' light that no matt surface with given normals explains, rms
    over rms, NaN outside the mask; None without given normals or photographs."""
    colour: FloatArray | None = None
    """(H, W, 3) albedo in red, green and blue, relative, zero outside the mask; None of skin and of
    photographs without colour."""
    scale_known: bool = True
    """False: the scale is unknown, arrays are in mm of an assumed one; files and pages in pixels
    (`unit`)."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    quality: Mapping[str, Any] = field(default_factory=dict)
    facts: Mapping[str, Any] = field(default_factory=dict)
    """What the pipeline found or assumed (yaw, crease row, scattering, ...)."""
    findings: tuple[Finding, ...] = ()
    """What is wrong with the photographs, or was assumed of them, worst first."""
    timings_s: Mapping[str, float] = field(default_factory=dict)
    hashes: Mapping[str, str] = field(default_factory=dict)

    def __repr__(self) -> str:
        facts = ", ".join(f"{name} {value}" for name, value in self._summary().items())
        return f"Reconstruction({facts})"

    def _repr_html_(self) -> str:
        """Preview and table of a notebook."""
        from html import escape

        rows = "".join(
            f"<tr><th>{escape(k)}</th><td>{escape(v)}</td></tr>" for k, v in self._summary().items()
        )
        warnings = "".join(f"<li>{escape(warning)}</li>" for warning in self.warnings)
        picture = "" if not bool(self.mask.any()) else resolve_name(_PREVIEW)(self)
        return f"{picture}<table>{rows}</table><ul>{warnings}</ul>"

    @property
    def warnings(self) -> tuple[str, ...]:
        """The findings as sentences."""
        return tuple(map(str, self.findings))

    @property
    def unit(self) -> LengthUnit:
        """What its lengths are written and shown in."""
        return MILLIMETRES if self.scale_known else pixels(self.pitch_mm)

    def _summary(self) -> dict[str, str]:
        known = self.mask & np.isfinite(self.height_mm)
        unit = self.unit
        pitch = f" at {1000 * self.pitch_mm:.1f} um" if unit.known else ", scale unknown"
        summary = {
            "preset": f"'{self.preset}'",
            "size": f"{self.mask.shape[0]} x {self.mask.shape[1]} px{pitch}",
            "area": f"{float(known.sum()) * (self.pitch_mm * unit.per_mm) ** 2:.0f} {unit.name}2",
        }
        if bool(known.any()):
            low, high = np.percentile(self.height_mm[known], (1, 99))
            summary["height range"] = f"{(high - low) * unit.per_mm:.2f} {unit.name}"
            relief = float(np.std(self.ridge_mm[known])) * unit.small_per_mm
            summary["relief"] = f"{relief:.1f} um rms" if unit.known else f"{relief:.2f} px rms"
        return summary | {"warnings": str(len(self.findings))}

    def save(self, folder: str | os.PathLike[str], capture: Capture | None = None) -> None:
        """Write all files of a result: surface, mesh, print, pictures and report.

        Parameters
        ----------
        folder : path
            Appears complete or not at all; an earlier result in it is replaced.
        capture : Capture, optional
            What the result was made from: the report shows its photographs.

        Raises
        ------
        BadInput
            If the folder holds something else, or cannot be written.

        Examples
        --------
        >>> import splitknit
        >>> import splitknit_simulator
        >>> capture, truth = splitknit_simulator.simulate_capture(1, settings={"scale": 0.08})
        >>> splitknit.reconstruct(capture, "ea").save("result", capture)
        """
        resolve_name(_SAVE)(self, capture, folder)


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """What a reconstruction got right, by the truth of a simulator
    (``splitknit_simulator.compare``)."""

    preset: str
    figures: Mapping[str, float]
    """``surface_rms_mm``, ``shape_rms_mm``, ``normals_mean_deg``, ``ridge_correlation``,
    ``ridge_gain``, ``ridge_rms_um``, ``ridge_truth_std_um``, ``ridge_good_area``, the same for the
    whole height (``height_band_*``), ``mask_on_finger`` (fraction of the mask on the true finger),
    ``mask_overlap`` (intersection over union; the true mask goes on below the crease) and
    ``ridge_area_mm2``."""
    height_error_mm: FloatArray
    """(H, W) estimate minus truth, mean removed, NaN outside the common mask."""
    ridge_error_um: FloatArray
    """(H, W) estimated minus true ridge band, NaN outside the common mask."""
    surface: BoolArray
    """(H, W) where the surface's figures count."""
    band: BoolArray
    """(H, W) where the ridge band's figures count."""


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """The part of a reconstruction that prints and matching need."""

    ridge_mm: FloatArray
    shape_mm: FloatArray
    normals: FloatArray
    mask: BoolArray
    pitch_mm: float
    input_from_upright: NDArray[np.float64]
    upright_size: tuple[int, int]
    whole: bool = False
    """See :class:`Reconstruction`."""
    x_mm: FloatArray | None = None
    y_mm: FloatArray | None = None


UNKNOWN_SCALE = (
    "scale unknown, heights in pixels: give `px_per_mm`, or `ridge_period_mm` 0.45 where it is a"
    " finger."
)
NO_SCALE = (
    "its scale is unknown, and this needs millimetres: give `px_per_mm` (here, or where it is"
    " reconstructed), or `ridge_period_mm` 0.45 to take the scale from the ridges."
)


def require_scale(measured: Camera | Reconstruction) -> None:
    """Raise BadInput where nobody has measured the scale."""
    require(measured.scale_known, NO_SCALE)


def surface_of(result: Reconstruction) -> Surface:
    """Part of a reconstruction that matching needs. Raises BadInput where its scale is unknown."""
    require_scale(result)
    return Surface(**{item.name: getattr(result, item.name) for item in fields(Surface)})
