"""Prints of a finger: what is inked (relief, curvature, photograph), and where (finger plane,
unrolled skin)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splitknit import BadInput
from splitknit.errors import require
from splitknit.finger.ridges import ink
from splitknit.model import FloatArray, GreyArray
from splitknit_match.prints.curvature import curvature
from splitknit_match.prints.enhance import Enhanced, gabor_enhance
from splitknit_match.prints.phase_minutiae import by_phase
from splitknit_match.prints.print_map import PrintMap, plane_map, resample, unrolled_map
from splitknit_match.prints.print_quality import PrintQuality, print_quality
from splitknit_match.prints.sources import Source
from splitknit_match.prints.unroll import KINDS, surface_grid, unroll
from splitknit_match.records.minutiae_record import Minutiae


@dataclass(frozen=True, slots=True, eq=False)
class Print:
    """A print, and where its pixels come from."""

    image: GreyArray
    """(h, w) ridges dark."""
    weight: FloatArray
    """(h, w) fraction of the pixel that lies on the finger, 0 to 1."""
    map: PrintMap
    values: FloatArray
    """(h, w) what its quality is measured on: the relief in mm, or the light of the photograph."""
    in_mm: bool
    """Whether it is the relief."""
    distortion: dict[str, float] | None = None
    """By how much lengths are off, of skin laid flat, see
    :func:`splitknit_match.prints.unroll.distortion`."""
    even: GreyArray | None = None
    """(h, w) the same of even contrast, where a print was pressed on glass or paper; its minutiae
    are sought there."""
    confidence: FloatArray | None = None
    """(h, w) 0 to 1, of such a print: how sure its ridges are."""

    @property
    def clearest(self) -> GreyArray:
        """(h, w) the print of even contrast where there is one: in it ridges are followed."""
        return self.image if self.even is None else self.even


def make_print(
    source: Source, method: str, surface: str | None = None, ppi: float = 500.0
) -> Print:
    """Make a print of a finger by a method other than ``rolled``.

    `surface`: ``plane``, or one of :data:`splitknit_match.prints.unroll.KINDS`; by default the
    finger plane, but of ``unroll`` the skin laid flat (``free``). Raises BadInput if the source
    lacks what is needed, or there are no ridges.
    """
    place = checked_surface(method, surface)
    distortion = None
    frame = source.input_from_upright, source.upright_size
    if place == "plane":
        print_map = plane_map(source.pitch_mm, *frame, ppi)
    else:
        shape_mm = _needed(source.shape_mm)
        unrolled = unroll(
            surface_grid(shape_mm, source.mask, source.pitch_mm, *frame, xy_mm=source.xy_mm), place
        )
        print_map = unrolled_map(unrolled, place, ppi)
        distortion = unrolled.distortion

    def read(values: FloatArray) -> tuple[FloatArray, FloatArray]:
        return resample(values, source.mask & np.isfinite(values), source.pitch_mm, print_map)

    if method == "curvature":
        index = curvature(
            _needed(source.height_mm), source.mask, source.pitch_mm, source.xy_mm
        ).shape_index
        require(np.isfinite(index).any(), "the finger is too small for a curvature map.")
        values, weight = read(index)
        ink(values, weight, ppi)  # refuses what has no ridges
        grey = np.clip((values - 0.25) / 0.5, 0.0, 1.0)  # valleys 0, ridges 1
        image = np.round(255.0 * (1.0 - grey * weight)).astype(np.uint8)
        inked, _ = read(_needed(source.ridge_mm))
    else:
        require(
            method != "specular" or source.specular is not None,
            "there is no specular image: it needs a capture through polarising films; print with"
            " `method` unroll.",
        )
        fields = {"photo": source.photo, "specular": source.specular}
        inked, weight = read(_needed(fields.get(method, source.ridge_mm)))
        image = ink(inked, weight, ppi)
    return Print(image, weight, print_map, inked, method not in ("photo", "specular"), distortion)


def checked_surface(method: str, surface: str | None) -> str:
    """Where a print is made. Raises BadInput if it is to be unrolled, and on the plane."""
    unrolls = method in ("unroll", "rolled")
    place = surface or ("free" if unrolls else "plane")
    require(
        not unrolls or place in KINDS,
        f"`method` {method} cannot be printed on the plane; use `method` relief for that.",
    )
    return place


def enhance(printed: Print) -> Enhanced:
    """Enhance a print."""
    return gabor_enhance(printed.clearest, printed.map.ppi, printed.weight > 0.5)


def measured(printed: Print, enhanced: Enhanced) -> PrintQuality:
    """How good a print is; `enhanced` is what :func:`enhance` made of it."""
    values = 1000.0 * printed.values if printed.in_mm else printed.values
    return print_quality(
        values, printed.weight, enhanced.field, printed.map.ppi, in_um=printed.in_mm
    )


def minutiae_by_phase(printed: Print, enhanced: Enhanced) -> Minutiae:
    """Minutiae of a print; `enhanced` is what :func:`enhance` made of it."""
    return by_phase(printed.clearest, enhanced, printed.map.ppi, printed.confidence)


def _needed(values: FloatArray | None) -> FloatArray:
    if values is None:
        raise BadInput(
            "this kind of print needs a reconstruction or a photograph that the input does not"
            " hold."
        )
    return values
