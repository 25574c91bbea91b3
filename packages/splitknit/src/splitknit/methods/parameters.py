"""Tuned constants of the methods."""

# --- metric

TURNED = (5, 6)
"""Orientations (90 and 270 degrees) averaged with the upright one in the relief estimate.

Unit: none. Chosen on: not known. Range: not known.
"""
RELIEF_ROUNDS = 2
"""Estimates of the relief.

Unit: none. Chosen on: not known. Range: not known.
"""
SIDE_ROUNDS = 3
"""The same behind films with lights to the side: the second refinement of the shape adds a seventh
of the first, a third hardly anything. Surfaces of nine simulated fingers differ by -1.8 [-3.2,
-0.4] um of 51, ridges below 60 deg by +0.07 [-0.10, 0.25] um of 4.6; the surface of a path-traced
one by -5 um of 24. With front lights alone it may lead astray (docs/explain/tried.md).

Unit: none. Chosen on: simulated fingers (seeds 8101 to 8105 of validation/path_traced/polarised.py;
on 7101, 7102, 7107 and 7108 nothing was). Range: 3 to 4.
"""
BOTH_FROM_DEG = 30.0
"""Slant of the skin from which the relief becomes the mean of two estimates, from both series of a
polarised capture and from the crossed one: the first is too high there, the second too low.

Unit: deg. Chosen on: not known. Range: not known.
"""
BOTH_DEG = 10.0
"""Further slant at which the relief is the mean of both estimates.

Unit: deg. Chosen on: not known. Range: not known.
"""
UNKNOWN_MM = 0.02
"""Standard deviation of the relief where no network gives a first one.

Unit: mm. Chosen on: not known. Range: not known.
"""
FAINT = 3.0
"""Specular reflection over noise below which heights do not follow from it.

Unit: none. Chosen on: not known. Range: not known.
"""
DOUBTFUL = 0.5
"""Expected error of the relief, over the relief's rms height, from which a warning is due.

Unit: fraction. Chosen on: judgement. Range: not known.
"""
JPEG_LOSS = 0.3
"""Fraction of the relief that JPEG may have taken, as a standard deviation: 0.06 to 0.31 was taken
at 15 to 30 px/mm.

Unit: fraction. Chosen on: simulated fingers (two, qualities of 60 to 97). Range: 0.06 to 0.31.
"""
JPEG_LOSS_COARSE = 0.9
"""Fraction of the relief that JPEG may have taken below `JPEG_COARSE` px/mm: 0.75 and more at 11.

Unit: fraction. Chosen on: simulated fingers (two, qualities of 60 to 97). Range: not known.
"""
JPEG_COARSE = 14.0
"""Scale below which JPEG takes far more of the relief.

Unit: px/mm. Chosen on: simulated fingers (two, qualities of 60 to 97). Range: 11 to 15.
"""
WHITE_ROUGHNESS = 0.45
"""Roughness up to which white light shows ridges better than the front lights alone.

Unit: none. Chosen on: not known. Range: not known.
"""
WHITE_SCATTERED = 10.0
"""Scattered over specular light up to which white light shows ridges better: of eight fingers one
is worse beyond each of both limits.

Unit: none. Chosen on: not known. Range: not known.
"""
RED_PART = 0.5
"""Part of the red light, in the colour of the skin, that is taken from the blue to leave white
light.

Unit: fraction. Chosen on: path-traced fingers (validation/path_traced/polarised.py). Range: 0.3
to 0.65.
"""
SHAPE_MM = 2.0
"""Standard deviation of the Gaussian mean of the heights that white light does not show: it follows
from how much of the light is scattered, which colours show only roughly.

Unit: mm. Chosen on: simulated fingers (and path-traced ones, docs/explain/tried.md). Range: not
known.
"""
COLOUR_MM = 1.0
"""Standard deviation of the Gaussian mean whose colour is that of the skin.

Unit: mm. Chosen on: not known. Range: not known.
"""
WALL_PART = 0.002
"""Fraction of a surface whose slopes are cut from which it has walls.

Unit: fraction. Chosen on: not known. Range: not known.
"""
WALL_OF_STEEP = 0.25
"""Fraction of the pixels steeper than a quarter of the longest slope whose slopes are cut, from
which a surface has walls: 0.09 on the ball, 0.6 to 0.8 on the coins.

Unit: fraction. Chosen on: simulated objects (a ball, coins with rims of 80 to 89 deg). Range:
0.09 to 0.6.
"""
ROUNDS = 3
"""Rounds of near-light photometric stereo and integration.

Unit: none. Chosen on: not known. Range: not known.
"""

# --- photometry

MAX_SLOPE = 6.0
"""Steeper slopes are shortened to this.

Unit: none. Chosen on: not known. Range: not known.
"""
SLOW_MM = 0.32
"""Standard deviation of the Gaussian whose mean is the slow part of a surface that is not split:
the ridge band's.

Unit: mm. Chosen on: not known. Range: not known.
"""
LEAST_CERTAINTY = 0.003
"""Certainty of slopes beyond 4 (76 deg), which shadows and the longest slope bend more than noise
does. The coins have the same heights over the whole range; the balls 1.62 um at 0.01, 1.48 at
0.003, 1.36 at 0.001, where the integration takes four times as long as at 0.01.

Unit: none. Chosen on: simulated objects (coins with rims of 60 to 89 deg; then photographed
balls in a gel). Range: 0.0001 to 0.01.
"""
CLIPPED = 0.985
"""Fraction of the full scale from which a stored value counts as clipped.

Unit: fraction. Chosen on: not known. Range: not known.
"""
