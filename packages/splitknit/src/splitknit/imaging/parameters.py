"""Tuned constants of linear light, rays and the encoding of photographs."""

# --- band

CHUNK_ROWS = 64
"""Rows of an image that are made at a time.

Unit: px. Chosen on: speed. Range: not known.
"""

# --- coloured

BALANCE_ROUNDS = 200
"""Rounds of the colours' balance at most: with LEDs of each colour all around the finger a handful
is enough.

Unit: none. Chosen on: speed. Range: not known.
"""
BALANCE_SETTLED = 1e-6
"""The balance has settled when no factor changes by more than this part.

Unit: fraction. Chosen on: speed. Range: not known.
"""
BALANCE_PIXELS = 40_000
"""About so many pixels of the finger are balanced.

Unit: px. Chosen on: speed. Range: not known.
"""
COMPOSED_BLACK = 0.02
"""Stored level of no light in composed exposures, so that noise below it is kept.

Unit: fraction. Chosen on: judgement. Range: not known.
"""

# --- crop

FLAT_BRIGHTEST = 0.9
"""Brightest value of a flat image that is stored, in full scale.

Unit: fraction. Chosen on: judgement. Range: not known.
"""

# --- geometry

PLACES_IN_LINE = 128
"""Places in one row of what OpenCV reads, which takes no long ones.

Unit: none. Chosen on: judgement. Range: not known.
"""

# --- light_field

SIDE_DEG = (30.0, 45.0)
"""Bounds of the angle off the camera's axis beyond which a light stands to the side of a finger.
One more light at 38 deg beside a ring at 20 took the surface error of two fingers from 0.06 and
0.07 to 0.10 mm.

Unit: deg. Chosen on: simulated fingers (two). Range: not known.
"""
SIDE_RATIO = 1.5
"""The angle itself, over that of the light with the sixth smallest one.

Unit: none. Chosen on: simulated fingers (two). Range: not known.
"""
LIGHTS_AROUND = 6
"""Which of the smallest angles that is: six lights stand all around.

Unit: none. Chosen on: judgement. Range: not known.
"""
FEW_LIGHTS = 4
"""So many lights, or fewer, are warned of.

Unit: none. Chosen on: judgement. Range: not known.
"""

# --- polarised

EVEN_MM = 0.5
"""Size over which a specular picture is made even: a ridge's period.

Unit: mm. Chosen on: not known. Range: not known.
"""
AS_ALIKE = 0.1
"""Difference of two correlations below which they count as equal: an LED halfway between two others
matches both.

Unit: none. Chosen on: not known. Range: not known.
"""
IN_FRONT = 4
"""So many lights in front of the finger do without those to its side.

Unit: none. Chosen on: judgement. Range: not known.
"""

# --- response

RESPONSE_EXPONENTS = (0.30, 0.36, 0.45, 0.55, 0.67, 0.82, 1.0, 1.22)
"""Exponents of the camera's response that are tried: sRGB code is about the power 1 / 2.2 of light.

Unit: none. Chosen on: judgement. Range: not known.
"""
CURVED_UP_TO = 0.7
"""Best exponent up to which values are sRGB: 0.45 to 0.7 of sRGB photographs, 0.82 and more of
linear ones.

Unit: none. Chosen on: simulated objects (52 captures of 26). Range: 0.7 to 0.82.
"""
CLEARLY_LINEAR = 1.15
"""Loss as sRGB over that as linear from which values may be linear: 1.25 and more of linear
photographs. Gloss on a shallow relief hides the curve, so that the pixels that fit best must agree.

Unit: none. Chosen on: real photographs (DiLiGenT's bear, Washington's grey ball; renders by
others). Range: up to 1.25.
"""
CLEARLY_FREE = 2.5
"""Loss as sRGB over that as linear from which values are linear where the brightness of the lights
is estimated: up to 2.3 on objects stored as sRGB, but for one glossy pillow (3.6).

Unit: none. Chosen on: simulated objects (52 captures of 26). Range: 2.3 to 2.9.
"""
BEST_PIXELS = 0.25
"""Part of the pixels, those that fit best, whose residuals must agree.

Unit: fraction. Chosen on: not known. Range: not known.
"""
BEST_RATIO = 0.98
"""Residual of these pixels as sRGB over that as linear from which values are linear: 1.01 to 1.72
of linear photographs, 0.56 to 0.94 of the same as sRGB.

Unit: none. Chosen on: real photographs (DiLiGenT's bear, Washington's grey ball; renders by
others). Range: 0.94 to 1.01.
"""
CODE_NOISE = 0.003
"""Residual of 8 bits, below which no two models differ.

Unit: fraction. Chosen on: judgement. Range: not known.
"""
UNEQUAL_LOSS = 0.25
"""Loss with the brightness estimated over that of equal lights, below which they differ: 0.18 and
less where they do by 15 %, 0.36 and more where they are equal.

Unit: none. Chosen on: simulated objects (52 captures of 26). Range: 0.18 to 0.36.
"""
SURE_ERRORS = 5.0
"""Standard errors by which one of the two fits better, where it decides.

Unit: none. Chosen on: not known. Range: not known.
"""
FULL_DIFFERENCE = 0.02
"""Differences to the model that count in full, of the full scale: gloss and shadow differ by more.

Unit: fraction. Chosen on: not known. Range: not known.
"""
FEWEST_LIGHTS = 5
"""Lights of known brightness from which shading shows the curve; one more where it is estimated.

Unit: none. Chosen on: judgement. Range: not known.
"""
FEWEST_VALUES = 1000
"""Lit values from which shading shows the curve.

Unit: none. Chosen on: judgement. Range: not known.
"""
RESPONSE_PIXELS = 1500
"""About so many pixels are fitted.

Unit: px. Chosen on: speed. Range: not known.
"""

# --- view

LATTICE_PX = 16
"""Distortion is computed at every so many pixels and interpolated by cubic splines.

Unit: px. Chosen on: speed. Range: not known.
"""
