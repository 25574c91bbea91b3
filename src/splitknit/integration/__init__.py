"""From gradients to heights: masked Poisson, Frankot-Chellappa, shapelets.

All integrators take dz/dx and dz/dy with y up (dimensionless: height in pixels per pixel) and return heights in pixels,
NaN outside the mask. Multiply by the pitch for millimetres.
"""

from splitknit.integration.frankot_chellappa import frankot_chellappa
from splitknit.integration.poisson import PoissonSettings, poisson
from splitknit.integration.shapelets import ShapeletSettings, shapelet_response, shapelets

__all__ = [
    "PoissonSettings",
    "ShapeletSettings",
    "frankot_chellappa",
    "poisson",
    "shapelet_response",
    "shapelets",
]
