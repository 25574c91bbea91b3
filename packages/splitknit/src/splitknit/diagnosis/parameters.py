"""Tuned constants of the diagnosis: from which figures photographs and lights are doubted."""

# --- brightness

EQUAL_SPREAD = 0.02
"""Spread (standard deviation of the logarithm) up to which lights are equal.

Unit: none. Chosen on: not known. Range: not known.
"""
CLEAR_SPREAD = 2.5
"""Spread over the light left unexplained from which the estimate is better than equal lights. Gloss
looks like a spread of up to 2.0 times that (a glazed bear; 1.5 on the rendered objects).

Unit: none. Chosen on: simulated objects (24 of three glosses). Range: from 2.0.
"""
SURELY_UNEQUAL = 0.18
"""Spread (standard deviation of the logarithm) from which more than five lights surely differ.

Unit: none. Chosen on: not known. Range: not known.
"""
LEFT_BY_UNEQUAL = 0.7
"""Unequal lights leave less than this fraction of the residual: 0.66 where they differ by 6 %,
equal ones 0.77.

Unit: fraction. Chosen on: simulated objects (rendered, glossy or not). Range: 0.66 to 0.77.
"""
WEAK_COLOUR = 0.1
"""Below this fraction of the mean, a colour channel is too dark to judge a light's brightness.

Unit: fraction. Chosen on: not known. Range: not known.
"""

# --- diagnose

CURVED_RESIDUAL = 0.05
"""Light left unexplained from which the other encoding is tried: of linear photographs declared
sRGB 0.07 to 0.1.

Unit: fraction. Chosen on: not known. Range: up to 0.07.
"""
DISTANT_RESIDUAL = 0.15
"""Light left unexplained from which the lights are not distant, so that no photograph is compared
with the others.

Unit: fraction. Chosen on: not known. Range: not known.
"""

# --- frames

SHAPE_BLUR = 0.02
"""Blur (sigma) of the slopes, as a fraction of the mask's longer side: shape is judged, not noise
and texture.

Unit: fraction. Chosen on: not known. Range: not known.
"""
RELIEF_BLUR = 0.006
"""Blur (sigma) of the slopes of a relief, such as the text of a coin or the hairs of a carving, as
a fraction of the mask's longer side.

Unit: fraction. Chosen on: not known. Range: not known.
"""
DOUBTED_CURL = 0.15
"""Curl as a fraction of the slopes' change from which lights are doubted: up to 0.03 on sound
objects, 0.3 to 0.6 in a mirrored or turned frame.

Unit: fraction. Chosen on: simulated objects (24 of eight kinds). Range: 0.03 to 0.3.
"""
CURL_LEFT = 0.25
"""Fraction of the stated lights' curl that another frame or order may leave.

Unit: fraction. Chosen on: not known. Range: not known.
"""
FALLS_OFF = 0.1
"""How clearly a relief must fall off outwards to be a hill.

Unit: none. Chosen on: not known. Range: not known.
"""
STEEPEST_SLOPE = 1.5
"""Normals beyond this slope, often in shadow, are shortened to it and left out of the curl.

Unit: none. Chosen on: not known. Range: not known.
"""
WORSE_CURL = 2.0
"""Another frame must be more integrable by this factor to be named; where only there the surface is
wholly convex, it need not be less integrable.

Unit: none. Chosen on: not known. Range: not known.
"""
CONVEX = 0.4
"""Net divergence over its absolute sum from which a surface counts as one convex object: 0.6 to 1
on objects and fingers, 0.07 on a field of balls.

Unit: none. Chosen on: not known. Range: 0.07 to 0.6.
"""
WHOLLY_CONVEX = 0.8
"""Net divergence over its absolute sum, in another frame, from which the surface is wholly convex
there.

Unit: none. Chosen on: not known. Range: not known.
"""
COARSE_FRACTION = 0.4
"""Fraction of the slopes that a blur over an eighth of the object leaves, below which it is not one
convex object: 0.6 to 0.9 on objects and fingers, 0.07 to 0.23 on a field of balls.

Unit: fraction. Chosen on: not known. Range: 0.23 to 0.6.
"""
HIGH_RESIDUAL = 0.2
"""Light left unexplained, as a fraction, from which photographs do not fit their lights: 0.01 to
0.15 on objects and fingers under their own lights (docs/experiments/faults.md).

Unit: fraction. Chosen on: not known. Range: from 0.15.
"""
NO_RESIDUAL = 0.03
"""Light left unexplained up to which no other order is looked for.

Unit: fraction. Chosen on: not known. Range: not known.
"""
FEWEST_ORDERED = 5
"""Lights from which the residual determines an order; with five another order must be better still.

Unit: none. Chosen on: judgement. Range: not known.
"""
BETTER = (0.8, 0.6)
"""Residual in another order over the stated one, from which the order is named: with the
photographs' brightness free, and of the photographs that change their light. Real objects with
brightness wrong by 20 % or directions by 2 deg stay above.

Unit: fraction. Chosen on: real photographs (objects, with brightness wrong by 20 % or directions
by 2 deg). Range: not known.
"""
BETTER_OF_FIVE = (0.4, 0.4)
"""The two ratios of `BETTER` under five lights.

Unit: fraction. Chosen on: not known. Range: not known.
"""
LESS_RESIDUAL = 0.9
"""An order that leaves less than this fraction of the residual is not merely a turn of the lights.

Unit: fraction. Chosen on: not known. Range: not known.
"""
STRANGE = 0.7
"""A photograph does not belong to the rest where without it less than this fraction of the residual
is left that would be for one light less: at least 0.99 on simulated, path-traced and polarised
fingers, 0.2 to 0.65 where a photograph is noise, turned, a copy of a second one or of a second
finger.

Unit: fraction. Chosen on: simulated fingers (and path-traced and polarised ones). Range: 0.65 to
0.99.
"""
FEWEST_OF_STRANGE = 6
"""Photographs from which one is looked for that does not belong to the rest.

Unit: none. Chosen on: judgement. Range: not known.
"""
UNEQUAL_RESIDUAL = 0.5
"""Brightness is at fault where less than this fraction of the residual is left once every
photograph has its own: 0.96 and more under lights of known brightness, 0.25 where that is 10 to 20
% off.

Unit: fraction. Chosen on: not known. Range: 0.25 to 0.96.
"""
STRANGE_TURN_DEG = 0.5
"""A strange photograph of an object is named where it turns the surface by more.

Unit: deg. Chosen on: not known. Range: not known.
"""
ONE_LIGHT = 0.03
"""Photographs of a finger that differ by less than this are under one light: 0.13 and more under
their own.

Unit: none. Chosen on: not known. Range: up to 0.13.
"""
SPOILT_DEG = 3.0
"""From this turn of the normals on a surface is not worth having: on a simulated finger photographs
that turn them by 3 to 11 deg cost up to 0.7 mm (``validation/damaged``).

Unit: deg. Chosen on: simulated fingers (validation/damaged). Range: not known.
"""
SPOILT_RESIDUAL = 0.3
"""Light left unexplained beyond which photographs and lights contradict each other.

Unit: fraction. Chosen on: not known. Range: not known.
"""
SEARCH_STARTS = 300
"""Random orders from which the search for a better order of the lights starts.

Unit: none. Chosen on: speed. Range: not known.
"""
LARGEST_SEARCH = 48
"""With more lights than this the search starts from the stated order and its shifts alone.

Unit: none. Chosen on: speed. Range: not known.
"""
ORDER_PIXELS = 20_000
"""About so many pixels of the object are fitted.

Unit: px. Chosen on: speed. Range: not known.
"""
ON_A_LIGHT = 0.2
"""A turned light falls on another within this fraction of the distance of the two closest lights.

Unit: fraction. Chosen on: not known. Range: not known.
"""
SAME_TURN_DEG = 20.0
"""Largest angle between a frame of the lights and the turn that was found for it to be named.

Unit: deg. Chosen on: not known. Range: not known.
"""

# --- gains

LEAST_PHOTOGRAPHS = 4
"""Photographs that are left at least: with one less, nothing shows which does not fit.

Unit: none. Chosen on: judgement. Range: not known.
"""
GAINS_SHADOW = 0.1
"""A light is in shadow where its image is below this part of the brightest one's.

Unit: fraction. Chosen on: not known. Range: not known.
"""
GAINS_PIXELS = 8_000
"""Pixels of the object that gains and derivatives are fitted to.

Unit: px. Chosen on: speed. Range: not known.
"""

# --- jpeg

JPEG_GRID = 0.92
"""High frequencies in blocks of 8 pixels on JPEG's grid, of those on the next best of 64 grids,
below which it was JPEG: 0.66 to 0.85 at quality 97, 0.54 to 0.66 at 95, less below; 0.99 and more
without JPEG, and from 99 on.

Unit: fraction. Chosen on: not known. Range: 0.85 to 0.99.
"""
JPEG_SIDE = 1024
"""Side of the part of the finger's window that is looked at.

Unit: px. Chosen on: speed. Range: not known.
"""

# --- lights

SAMPLED_MM = 0.1
"""Distance of the pixels that the lights' places are fitted to.

Unit: mm. Chosen on: speed. Range: not known.
"""
PLACES_MM = 0.8
"""Side of the blocks of pixels in which the lights' places are looked for: ridges are smaller.

Unit: mm. Chosen on: not known. Range: not known.
"""
FEWEST_PLACED = 6
"""Lights from which three of each pixel's values are spare.

Unit: none. Chosen on: judgement. Range: not known.
"""
PLACES_PLANE_MM = 1.0
"""Assumed mean height of the skin above the finger plane.

Unit: mm. Chosen on: not known. Range: not known.
"""
STEEPEST_NZ = (0.5, 0.65)
"""z component of the normals between which a pixel comes to count.

Unit: none. Chosen on: not known. Range: not known.
"""
DARKENING_EXPONENT = 0.15
"""Exponent of the cosine by which skin darkens beside Fresnel's law: 0.1 to 0.4 fit sound fingers.

Unit: none. Chosen on: simulated fingers. Range: 0.1 to 0.4.
"""
DARKENING = 0.3
"""Fall of the logarithm of the albedo over 1 - n_z on sound fingers.

Unit: none. Chosen on: simulated fingers. Range: not known.
"""
DARKENING_SD = 0.04
"""Standard deviation of that fall: of 0.015, 0.04 and 0.12 the one with the narrowest heights on 80
simulated fingers.

Unit: none. Chosen on: simulated fingers (80). Range: not known.
"""
PLACES_NOISE = 0.005
"""Relative residual on sound fingers.

Unit: fraction. Chosen on: simulated fingers. Range: not known.
"""
INDEPENDENT_PLACES = 60.0
"""Number of places whose residuals do not depend on each other.

Unit: none. Chosen on: not known. Range: not known.
"""
PLACES_PRIOR = (0.7, 25.0, 25.0)
"""Standard deviations of the three unknowns: logarithm of the height's factor, and both shifts.

Unit: none, mm, mm. Chosen on: not known. Range: not known.
"""
PLACES_STEPS = (0.02, 0.5, 0.5)
"""Steps of the numerical derivatives by the three unknowns, and their scales in the fit.

Unit: none, mm, mm. Chosen on: judgement. Range: not known.
"""
PLACES_ROUNDS = 12
"""Gauss-Newton steps at most; three to six are usual.

Unit: none. Chosen on: judgement. Range: not known.
"""
PLACES_EXACT = 0.01
"""Change of the unknowns, over `PLACES_STEPS`, at which the fit ends.

Unit: none. Chosen on: judgement. Range: not known.
"""
PLACES_OF_SOUND = (0.0, 0.0, -1.5)
"""What is fitted to sound fingers (mean of the three unknowns), which scattering and the finger's
shape leave.

Unit: none, mm, mm. Chosen on: simulated fingers. Range: not known.
"""
UNFIT_RESIDUAL = 0.025
"""Residual from which places do not follow: 0.003 to 0.023 on dry fingers, up to 0.13 on wet ones.

Unit: fraction. Chosen on: simulated fingers (in all conditions). Range: not known.
"""
NOTED_HEIGHT = 0.18
"""Logarithm of the height's factor that is noted: sound fingers have -0.09 to 0.15, glossy ones
0.19.

Unit: none. Chosen on: simulated fingers (in all conditions). Range: not known.
"""
NOTED_SHIFT_MM = 6.0
"""Shift that is noted: sound fingers have up to 5.8 mm.

Unit: mm. Chosen on: simulated fingers (in all conditions). Range: not known.
"""
CLEAN_RESIDUAL = 0.012
"""The noted height and shift grow with a residual above this.

Unit: fraction. Chosen on: not known. Range: not known.
"""
SURE_HEIGHT = 0.4
"""Logarithm of the height's factor that is doubted: of the sound fingers one had 0.35, five others
up to 0.22 and shifts of up to 11 mm.

Unit: none. Chosen on: simulated fingers (some 230 in all conditions and tones of skin). Range:
not known.
"""
SURE_SHIFT_MM = 13.0
"""Shift that is doubted.

Unit: mm. Chosen on: simulated fingers (some 230 in all conditions and tones of skin). Range: not
known.
"""

# --- masks

DARK_RIM = 0.03
"""Fraction of the rim that is darker in near infrared than in white from which the outlines differ:
below 0 on simulated and path-traced fingers, 0.04 and 0.24 where the NIR images were of another.

Unit: fraction. Chosen on: simulated fingers (and path-traced ones). Range: 0 to 0.04.
"""
DARK_RIM_SPOILS = 0.15
"""Fraction of the rim, as of `DARK_RIM`, from which the near-infrared photographs spoil the shape.

Unit: fraction. Chosen on: not known. Range: not known.
"""
HELD_BORDER = 0.7
"""A mask may be inverted that holds the picture's corners and this fraction of its border.

Unit: fraction. Chosen on: not known. Range: not known.
"""
LEFT_OUT = 0.02
"""A mask may be inverted that leaves out this fraction of the picture's border, lit.

Unit: fraction. Chosen on: not known. Range: not known.
"""
LIT_OBJECT = 0.1
"""Lit is what is brighter than this fraction of the brightest pixels.

Unit: fraction. Chosen on: not known. Range: not known.
"""
INVERTED_TURNS = 2.5
"""Spread of directions (70 % of pixels) of what an inverted mask leaves out, over that of what it
holds.

Unit: none. Chosen on: simulated objects (drawn, on six kinds of tables). Range: not known.
"""
INVERTED_TURNS_DEG = 5.0
"""Spread of directions of what an inverted mask leaves out, at least.

Unit: deg. Chosen on: simulated objects (drawn, on six kinds of tables). Range: not known.
"""

# --- photographs

MOST_LEVERAGE = 0.9
"""Leverage of a light above which the other lights hardly predict it.

Unit: none. Chosen on: not known. Range: not known.
"""
FEWEST_COMPARED = 400
"""Pixels that a comparison needs.

Unit: px. Chosen on: judgement. Range: not known.
"""
SMOOTH_PX = 1.0
"""Blur (sigma) before derivatives: noise is not to look like sharpness.

Unit: px. Chosen on: not known. Range: not known.
"""
COMPARED_SQUARE_PX = 7
"""Side of the square that must be lit and inside the mask around a pixel that is compared.

Unit: px. Chosen on: not known. Range: not known.
"""
LOCAL_PX = 31
"""Side of the square over which the prediction's brightness is that of the photograph: near lights
and gloss.

Unit: px. Chosen on: not known. Range: not known.
"""
FAULT_PX = 0.5
"""Pixels times the fraction that they explain from which a photograph is moved, blurred or double:
up to 0.35 on sound photographs of a bear and a sphere, 0.8 on rendered objects.

Unit: px. Chosen on: real photographs (a bear and a sphere, 19 draws of 5 to 24 lights; then
simulated objects). Range: 0.35 to 0.8.
"""
STANDS_OUT = 3.5
"""A photograph is moved, blurred or double if these pixels times the light that they explain are
more than so many medians of all photographs' explained light.

Unit: none. Chosen on: real photographs (a bear and a sphere, 19 draws of 5 to 24 lights). Range:
not known.
"""
GLOSS_PX = 1.5
"""Gloss on ribs changes their contrast as a blur of up to this sigma would.

Unit: px. Chosen on: not known. Range: not known.
"""
UNLIKE_PART = 0.6
"""Fraction of all residuals that goes with one photograph, beyond its even part, from which it is
unlike the rest.

Unit: fraction. Chosen on: real photographs (a bear and a sphere, 19 draws of 5 to 24 lights).
Range: not known.
"""
UNLIKE_LIGHT = 0.1
"""Residual over the light of a photograph that is unlike the rest, at least.

Unit: fraction. Chosen on: real photographs (a bear and a sphere, 19 draws of 5 to 24 lights).
Range: not known.
"""
UNLIKE_DEG = 0.5
"""Turn of the normals by a photograph that is unlike the rest, at least.

Unit: deg. Chosen on: real photographs (a bear and a sphere, 19 draws of 5 to 24 lights). Range:
not known.
"""
FAULT_LEAVES = 0.85
"""Fraction of the mean difference that a named fault may leave; else the photograph is unlike the
rest.

Unit: fraction. Chosen on: not known. Range: not known.
"""
DOUBLE_LEAVES = 0.9
"""Fraction of what a shift leaves that a double image may leave; else the photograph is shifted.

Unit: fraction. Chosen on: simulated objects (4 domes under 5 to 8 lights). Range: 0.85 to 0.9.
"""
PHOTOGRAPH_CLIPPED = 0.01
"""Fraction of the object that is clipped in one photograph from which it is overexposed.

Unit: fraction. Chosen on: not known. Range: not known.
"""
FAINT_PHOTOGRAPH = 0.12
"""Brightness over the median photograph's below which noise and the steps of the numbers count.

Unit: fraction. Chosen on: not known. Range: not known.
"""
COMPARED_VALUES = 4_000_000
"""Values of all photographs that are compared with each other, at most; larger ones are binned.

Unit: none. Chosen on: speed. Range: not known.
"""
FEW_CLIPPED = 0.002
"""Fraction of the surface that is overexposed in nearly all photographs from which it is noted.

Unit: fraction. Chosen on: not known. Range: not known.
"""
NOTED_DEG = 0.5
"""A fault of one photograph of skin is noted if it turns the surface by more.

Unit: deg. Chosen on: not known. Range: not known.
"""

# --- relief

MUCH_BARE = 0.15
"""Part of the finger without ridges that is doubted and not merely noted: one of some 40 sound
fingers in all conditions had 0.11.

Unit: fraction. Chosen on: simulated fingers (some 40 in all conditions). Range: not known.
"""
LEAST_PX_PER_MM = 6.0
"""Scale below which ridges are not seen: three pixels from one to the next.

Unit: px/mm. Chosen on: judgement. Range: not known.
"""
RIDGES_FINE_MM = 0.06
"""Standard deviation of the Gaussian that is finer than ridges, 0.4 to 0.6 mm apart.

Unit: mm. Chosen on: judgement. Range: not known.
"""
RIDGES_LEVEL_MM = 0.35
"""Standard deviation of the Gaussian that is coarser than ridges.

Unit: mm. Chosen on: judgement. Range: not known.
"""
CONTRAST_WINDOW_MM = 0.5
"""Standard deviation of the Gaussian over which the ridges' contrast is a mean.

Unit: mm. Chosen on: not known. Range: not known.
"""
JUDGED_RIM_MM = 1.5
"""Skin nearer to the outline is not judged.

Unit: mm. Chosen on: not known. Range: not known.
"""
CONTRAST_EDGE_MM = 0.4
"""Skin nearer to the outline does not count in the contrast of other places.

Unit: mm. Chosen on: not known. Range: not known.
"""
LIT_SKIN = 0.35
"""Part of the finger's median light that lit skin has.

Unit: fraction. Chosen on: not known. Range: not known.
"""
BRIGHT_SKIN = 0.5
"""Part of the finger's median light that skin has whose ridges are compared between single images.

Unit: fraction. Chosen on: not known. Range: not known.
"""
RIDGED_QUANTILE = 0.75
"""Quantile of the skin that surely has ridges: a plaster may cover half.

Unit: fraction. Chosen on: judgement. Range: not known.
"""
ENERGY_CAP = 0.3
"""Part of that skin's energy at which a pixel counts as part of a ridge.

Unit: fraction. Chosen on: not known. Range: not known.
"""
BARE_CONTRAST = 0.45
"""Part of the ridged skin's contrast below which skin is bare. With 0.5 one of 185 sound fingers, a
glossy one, had a patch of 8 mm2; with 0.45 the largest has 2.5 mm2, and that of four path-traced
fingers 3.5.

Unit: fraction. Chosen on: simulated fingers (185 sound ones, then four path-traced ones). Range:
0.45 to 0.5.
"""
LEAST_BARE_MM2 = 4.0
"""Smallest bare patch that counts.

Unit: mm2. Chosen on: simulated fingers (185 sound ones). Range: not known.
"""
BARE_BEYOND_MM = 1.0
"""How far beyond a bare patch skin is bare as well, since the window reaches over its edge: the
patch so grown had 0.78 to 1.02 of the plasters' area.

Unit: mm. Chosen on: simulated fingers (92 plasters). Range: not known.
"""
FEWEST_RIDGED = 6
"""Lights of which each is judged by the others.

Unit: none. Chosen on: judgement. Range: not known.
"""
UNLIKE_RIDGES = 1.8
"""Error of an image's ridges, as the others predict them, over the images' median: 1.01 to 1.44 on
196 sound simulated fingers and 1.61, 1.74 on two of 190 others (glossy, wet); 2.1 and more with an
image of another finger, 1.4 to 3.6 with one that shows everything twice.

Unit: none. Chosen on: simulated fingers (196 and 190 sound ones). Range: 1.74 to 2.1.
"""

# --- response

BLUE_OVER_RED = 1.3
"""Blue over red light: at most 0.63; from 1.6 where the colours are swapped.

Unit: none. Chosen on: simulated fingers (180 in all conditions). Range: 0.63 to 1.6.
"""
CLIPPED_FINGER = 0.2
"""Fraction of the finger that is clipped in one colour of an image: at most 0.06 (once 0.13); from
0.27 where it is.

Unit: fraction. Chosen on: simulated fingers (180 in all conditions). Range: 0.13 to 0.27.
"""
COLOUR_SPREAD = 0.02
"""Standard deviation of the colours' gains: at most 0.001; from 0.037 where white was balanced.

Unit: none. Chosen on: simulated fingers (180 in all conditions). Range: 0.001 to 0.037.
"""
TONE_DOUBTED = 0.07
"""Departure of the exponent from one that is doubted: 0.03 at most on 126 sound fingers under
unequal lights, 0.12 to 0.75 where a curve or light of 30 % was added.

Unit: none. Chosen on: simulated fingers (126 under unequal lights). Range: 0.03 to 0.12.
"""
TONE_SPOILS = 0.1
"""Departure of the exponent from one that spoils the surface.

Unit: none. Chosen on: not known. Range: not known.
"""
TONE_SURE = 7.0
"""Least t value of the exponent's departure from one.

Unit: none. Chosen on: simulated fingers (126 under unequal lights). Range: not known.
"""
SHADED_EXPONENTS = (0.85, 1.22)
"""Exponents between which shading under equal lights is sound.

Unit: none. Chosen on: simulated fingers (180 in all conditions). Range: not known.
"""
FLAT_FINGER = 0.5
"""Height over half width below which a finger is too flat: 0.61 to 1.06 on 144 sound fingers, 0.63
to 0.75 on path-traced ones, 0.34 to 0.45 with local contrast.

Unit: none. Chosen on: simulated fingers (144, and path-traced ones). Range: 0.45 to 0.61.
"""
HOLLOW_FINGER = 0.1
"""Height over half width below which the finger is not flat but hollow: lights in another order.

Unit: none. Chosen on: not known. Range: not known.
"""
RESPONSE_SIDE = 300
"""Pixels of the coarse images' longer side, at least.

Unit: px. Chosen on: speed. Range: not known.
"""
RESPONSE_RIM_MM = 0.6
"""Width of the rim beside the outline that is not used.

Unit: mm. Chosen on: not known. Range: not known.
"""
RESPONSE_PLANE_MM = 1.0
"""Mean height of the skin above the finger plane, about.

Unit: mm. Chosen on: not known. Range: not known.
"""
FEWEST_LIGHTS = 5
"""Lights from which the response is judged.

Unit: none. Chosen on: judgement. Range: not known.
"""
FEWEST_ANSWERING = 1000
"""Pixels of the coarse images from which the response shows.

Unit: px. Chosen on: judgement. Range: not known.
"""
LIT_RESPONSE = 0.3
"""Fraction of a pixel's brightest light from which a light counts in its fit.

Unit: fraction. Chosen on: not known. Range: not known.
"""
WELL_LIT = 0.5
"""Fraction of a pixel's brightest light from which a light's gain is judged: below, attached
shadows and light scattered in the skin matter more.

Unit: fraction. Chosen on: not known. Range: not known.
"""
FEWEST_LIT = 100
"""Pixels, at least, of which a gain is the median.

Unit: px. Chosen on: judgement. Range: not known.
"""
BRIGHTNESS_SPREAD = 0.01
"""Sum of squares of the lights' log brightness, beside a tilt's, from which it shows the tone: 0.03
to 0.2 of LEDs that differ by 10 %.

Unit: none. Chosen on: not known. Range: up to 0.03.
"""
STATED_SD = 0.002
"""Standard deviation of brightness as it is stated, at best, in the logarithm.

Unit: none. Chosen on: judgement. Range: not known.
"""
TRIED_EXPONENTS = (0.55, 1.8, 9)
"""Lowest and highest exponent of shading that is tried, and how many in between, in a geometric
series.

Unit: none. Chosen on: judgement. Range: not known.
"""
FLANKS_QUANTILE = 0.6
"""Quantile of the pixels, by how much they change with the light, from which they show the tone.

Unit: fraction. Chosen on: not known. Range: not known.
"""
FLANK_PIXELS = 700
"""About so many pixels of the flanks are fitted.

Unit: px. Chosen on: speed. Range: not known.
"""
DRIFT_CHANGE = 0.03
"""Change of a light's brightness from which it has drifted.

Unit: fraction. Chosen on: not known. Range: not known.
"""
DRIFT_ALONE = 0.6
"""Fraction of all gains that one light's change explains alone, at least: gloss, shadows and
scattering move several a little.

Unit: fraction. Chosen on: not known. Range: not known.
"""
DRIFT_ERRORS = 3.0
"""Standard errors of that change, at least.

Unit: none. Chosen on: not known. Range: not known.
"""
FITTED_WIDTH = 0.9
"""Fraction of the half width of a finger, from its axis, on which its height is fitted.

Unit: fraction. Chosen on: not known. Range: not known.
"""

# --- samples

FRAME_SIDE = 300
"""Images of at least so many pixels a side are enough to detect in which frame the lights were
measured.

Unit: px. Chosen on: speed. Range: not known.
"""

# --- size

USUAL_PERIOD_MM = 0.45
"""Distance of the ridges from which a scale is assumed.

Unit: mm. Chosen on: not known. Range: not known.
"""
PERIOD_PX_PER_MM = 20.0
"""Scale that is enough to measure the distance of the ridges.

Unit: px/mm. Chosen on: speed. Range: not known.
"""
SEEN_PX = 5.0
"""Distance of usual ridges below which they may not be seen, and films' gloss or dry skin looks
like wider ones.

Unit: px. Chosen on: not known. Range: not known.
"""
COVERED = 0.5
"""Fraction of the places that must show a wave where ridges may not be seen: fingers have one in
0.6 to 0.8.

Unit: fraction. Chosen on: not known. Range: up to 0.6.
"""
