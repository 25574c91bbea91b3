"""Tuned constants of light on the skin and below it: dust, films, lamps, relief."""

# --- coat

GRAIN_MEDIAN_UM = 20.0
"""Median diameter of dust grains, by number; with the spread below their mean by area is 47 um.
Dust under 100 um sticks to skin (Cao et al. 2012).

Unit: um. Chosen on: judgement. Range: not known.
"""
GRAIN_SPREAD = 1.8
"""Geometric standard deviation of the diameters of dust grains.

Unit: none. Chosen on: judgement. Range: not known.
"""
DUST_DENSITY_MG_PER_MM3 = 2.0
"""Density of dust; soil and house dust have 1.5 to 2.6.

Unit: mg/mm3. Chosen on: judgement. Range: not known.
"""
GRAIN_ALBEDO = (0.08, 0.6)
"""Range of the albedo of single grains, drawn evenly: from soot and soil to flour and skin scales.

Unit: fraction. Chosen on: judgement. Range: not known.
"""

# --- films

CROSSED_LED_DISTANCE_MM = 6.0
"""Distance of the LEDs of the crossed series from the first ones, where they have their own.

Unit: mm. Chosen on: judgement. Range: not known.
"""

# --- lighting

LED_RADIUS_MM = 1.5
"""Radius of an LED's emitting face, which widens the specular reflection.

Unit: mm. Chosen on: not known. Range: not known.
"""
SHADOW_MAX_SINE = 0.7
"""Sine of the elevation below which a light casts shadows of the finger on itself; the ring's
lights stand higher and would cast them only in creases.

Unit: none. Chosen on: judgement. Range: not known.
"""
MIN_VIEW_COSINE = 0.12
"""Cosine between a facet and the direction to the camera, at least: the picture's pixels do not
resolve facets that lean away further.

Unit: none. Chosen on: not known. Range: not known.
"""
MAX_FACET_AREA = 3.0
"""Area of a facet over that of the smooth skin, at most: larger ones are walls of pores, a small
part of their pixel.

Unit: none. Chosen on: not known. Range: not known.
"""

# --- renderer

RELIEF_SMOOTHING_MM = 0.03
"""Standard deviation of the Gaussian that smooths the relief in the relief term.

Unit: mm. Chosen on: not known. Range: not known.
"""
RELIEF_HIGH_PASS_MM = 0.32
"""Standard deviation of the Gaussian that is subtracted from the relief in the relief term.

Unit: mm. Chosen on: not known. Range: not known.
"""

# --- skin

REFRACTIVE_INDEX = 1.42
"""Refractive index of the skin, which light enters and leaves as one homogeneous medium.

Unit: none. Chosen on: not known. Range: 1.36 (dermis) to 1.49 (epidermis), from 300 to 1600 nm
(Ding et al. 2006, Physics in Medicine and Biology 51, 1479).
"""
