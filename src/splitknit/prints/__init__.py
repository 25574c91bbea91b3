"""From a finger in space to a flat print: sampling, unrolling, curvature, ink, enhancement."""

from splitknit.prints.curvature import Curvature, CurvatureSettings, curvature
from splitknit.prints.enhance import Enhanced, gabor_enhance, stft_enhance
from splitknit.prints.ink import ink
from splitknit.prints.phase_minutiae import PhaseMinutiae, PhaseMinutiaeSettings, phase_minutiae
from splitknit.prints.print_map import PrintMap, plane_map, unrolled_map
from splitknit.prints.print_quality import Part, PrintQuality, PrintQualitySettings, print_quality, score_of
from splitknit.prints.print_quality_figures import QualityFigures, quality_figures
from splitknit.prints.resample import resample
from splitknit.prints.ridge_field import RidgeField, ridge_field
from splitknit.prints.ridges import PrintSettings, relief_print
from splitknit.prints.thin import as_print, ridge_mask, thin
from splitknit.prints.unroll import Unrolled, UnrollSettings, unroll
from splitknit.prints.unroll_distortion import Distortion, distortion
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
