"""Tuned constants of photometric stereo."""

# --- equations

RIDGE = 1e-6
"""Minimum pivot of M relative to its trace.

Unit: fraction. Chosen on: judgement. Range: not known.
"""

# --- robust

CLEAN = 0.5
"""A pixel whose residuals all lie within this part of the tolerance keeps its least-squares fit.

Unit: fraction. Chosen on: speed. Range: not known.
"""
SETTLED = 1e-3
"""A pixel is done when its albedo-scaled normal moves by less than this part of its length.

Unit: fraction. Chosen on: speed. Range: not known.
"""
LARGEST_MISFIT = 100.0
"""Larger misfits, in tolerances, count as this: a pixel without light keeps weights that sum to
something.

Unit: none. Chosen on: judgement. Range: not known.
"""
FLATTEST_PIVOT = 5e-4
"""Smallest pivot, relative to the trace, of lights that determine a normal; three neighbours on the
rig give 4e-3.

Unit: fraction. Chosen on: not known. Range: up to 0.004.
"""
FAINT = 1e-2
"""Smallest light, relative to the brightest one's, by which lights are weighted where those that
are lit do not determine a normal.

Unit: fraction. Chosen on: judgement. Range: not known.
"""
SHADOW = 0.03
"""A light is in shadow where its image, divided by its strength, is below this part of the
brightest one's.

Unit: fraction. Chosen on: not known. Range: not known.
"""
TOLERANCE = 0.03
"""Residual, relative to the albedo, at which a light's weight has fallen to one half.

Unit: fraction. Chosen on: not known. Range: not known.
"""
ITERATIONS = 20
"""Rounds of reweighting at most.

Unit: none. Chosen on: speed. Range: not known.
"""
FORGIVENESS = 2.0
"""Residuals below the fit get this many times the tolerance: light adds, it does not subtract.

Unit: none. Chosen on: real photographs (DiLiGenT's bear). Range: 2 to 4.
"""

# --- uncalibrated

FEWEST = 6
"""Photographs that lights need which nobody knows.

Unit: none. Chosen on: not known. Range: not known.
"""
REDUCED_SIDE = 220
"""Longest side of the reduced images.

Unit: px. Chosen on: speed. Range: not known.
"""
UNCALIBRATED_SHADOW = 0.15
"""A light is in shadow where its image is below this part of the brightest one's.

Unit: fraction. Chosen on: not known. Range: not known.
"""
STRENGTH_SD = 0.05
"""Standard deviation of the logarithm of the lights' brightness.

Unit: none. Chosen on: not known. Range: not known.
"""
ALBEDO_PLACES = 30.0
"""Independent places of the object's albedo.

Unit: none. Chosen on: not known. Range: not known.
"""
ALBEDO_SD = 0.15
"""Standard deviation of the logarithm of the albedo.

Unit: none. Chosen on: not known. Range: not known.
"""
CURL_PLACES = 60.0
"""Independent places of the curl.

Unit: none. Chosen on: not known. Range: not known.
"""
CURL_LEFT = 0.05
"""Curl over the slopes' own change that blur and gloss leave.

Unit: fraction. Chosen on: not known. Range: not known.
"""
RIVAL_DEG = 10.0
"""Other lights that explain the photographs nearly as well differ by this, at least.

Unit: deg. Chosen on: not known. Range: not known.
"""
RIVAL_COST = 1.5
"""Other lights explain the photographs nearly as well if they cost less than this more.

Unit: none. Chosen on: not known. Range: not known.
"""
GLOSSY_SD = 0.2
"""Standard deviation of the factor a of the heights that is not noise: a glazed bear comes out 1.23
times too deep.

Unit: none. Chosen on: real photographs (DiLiGenT's bear). Range: not known.
"""
RANK = 2.0
"""Third singular value of the photographs over the fourth, at least: 4 on a glazed bear, 1 of
copies and of noise.

Unit: none. Chosen on: real photographs (DiLiGenT's bear). Range: 1 to 4.
"""
FITTED_PLACES = 1000
"""Places of the object that the fit looks at.

Unit: none. Chosen on: speed. Range: not known.
"""
SEARCHED_PLACES = 500
"""Places of the object that the search for the fit's start looks at.

Unit: none. Chosen on: speed. Range: not known.
"""
