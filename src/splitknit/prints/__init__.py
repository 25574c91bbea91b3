"""From a finger in space to a flat print: sampling, unrolling, curvature, ink, enhancement."""

from splitknit.prints.curvature import Curvature, CurvatureSettings, curvature
from splitknit.prints.enhance import Enhanced, as_print, gabor_enhance, ridge_mask, stft_enhance, thin
from splitknit.prints.phase_minutiae import PhaseMinutiae, PhaseMinutiaeSettings, phase_minutiae
from splitknit.prints.print_map import PrintMap, plane_map, resample, unrolled_map
from splitknit.prints.print_quality import (
    Part,
    PrintQuality,
    PrintQualitySettings,
    QualityFigures,
    print_quality,
    quality_figures,
    score_of,
)
from splitknit.prints.ridge_field import RidgeField, ridge_field
from splitknit.prints.ridges import PrintSettings, ink, relief_print
from splitknit.prints.unroll import Distortion, Unrolled, UnrollSettings, distortion, unroll
from splitknit.prints.unroll_grid import GridSettings, SurfaceGrid, surface_grid

__all__ = [
    "Curvature",
    "CurvatureSettings",
    "Distortion",
    "Enhanced",
    "GridSettings",
    "Part",
    "PhaseMinutiae",
    "PhaseMinutiaeSettings",
    "PrintMap",
    "PrintQuality",
    "PrintQualitySettings",
    "PrintSettings",
    "QualityFigures",
    "RidgeField",
    "SurfaceGrid",
    "UnrollSettings",
    "Unrolled",
    "as_print",
    "curvature",
    "distortion",
    "gabor_enhance",
    "ink",
    "phase_minutiae",
    "plane_map",
    "print_quality",
    "quality_figures",
    "relief_print",
    "resample",
    "ridge_field",
    "ridge_mask",
    "score_of",
    "stft_enhance",
    "surface_grid",
    "thin",
    "unroll",
    "unrolled_map",
]
