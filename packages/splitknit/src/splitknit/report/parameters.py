"""Tuned constants of the report: its pictures, and the surface inside its page."""

# --- figures

RIM_MM = 0.4
"""Width of an opaque thing's rim that is left out where fine details are drawn: there its sides
bend what separates them from the shape.

Unit: mm. Chosen on: not known. Range: not known.
"""
CLAY_COLOUR = (0.90, 0.80, 0.70)
"""Red, green and blue of the clay that a surface is drawn as.

Unit: none. Chosen on: judgement. Range: not known.
"""
KEY_LIGHT = (-0.55, 0.55, 0.63)
"""Direction towards the main light of the drawing.

Unit: none. Chosen on: judgement. Range: not known.
"""
FILL_LIGHT = (0.70, -0.15, 0.70)
"""Direction towards the second, weaker light.

Unit: none. Chosen on: judgement. Range: not known.
"""
BACKGROUND_GREY = 0.965
"""Brightness around the drawn surface.

Unit: fraction. Chosen on: judgement. Range: not known.
"""

# --- photos

LONGEST_PX = 700
"""Longer side of a picture.

Unit: px. Chosen on: judgement. Range: not known.
"""

# --- surface

FARTHEST = 40_000.0
"""No place of a surface is as far from the origin.

Unit: mm or px. Chosen on: judgement. Range: not known.
"""
RIDGE_SIGMA_MM = 0.32
"""Standard deviation of the Gaussian that parts ridges from the shape along a section.

Unit: mm. Chosen on: not known. Range: not known.
"""
MAX_SAMPLES = 20_000
"""Samples of a section at most.

Unit: none. Chosen on: speed. Range: not known.
"""
MOST_POINTS = 400_000
"""Points of a surface inside a page at most.

Unit: none. Chosen on: speed. Range: not known.
"""
SHAPE_STEP = 0.001
"""Step of the shape's levels inside a page; the relief is added to them.

Unit: mm or px. Chosen on: judgement. Range: not known.
"""
RIDGE_STEP = 0.0002
"""Step of the relief's levels inside a page.

Unit: mm or px. Chosen on: judgement. Range: not known.
"""
