"""From gradients to heights: masked Poisson, Frankot-Chellappa, shapelets.

All integrators take dz/dx and dz/dy with y up (dimensionless: height in pixels per pixel) and
return heights in pixels, NaN outside the mask. Multiply by the pitch for millimetres.
"""
