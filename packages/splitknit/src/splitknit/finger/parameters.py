"""Constants of the finger stage that could have been chosen otherwise, by module."""

# --- contrast

HISTOGRAM_BINS = 256
"""Bins of the histograms; the mapping between them is interpolated.

Unit: none. Chosen on: not known. Range: 128 to 512 (validation/parameters).
"""

MIN_CELL_PX = 8
"""Smallest side of a cell.

Unit: px. Chosen on: judgement. Range: 4 to 16 (validation/parameters).
"""

WHITE_PERCENTILE = 99.9
"""This percentile of the finger becomes white before equalisation.

Unit: percentile. Chosen on: not known. Range: none within 0.7 to 1.4 (validation/parameters).
"""

# --- hand

HAND_PX_PER_MM = 10.0
"""Several fingers are searched for on images reduced to about this scale.

Unit: px/mm. Chosen on: speed. Range: not known.
"""

CUT_MARGIN_MM = 4.0
"""Background that is kept around each finger, where the view has it.

Unit: mm. Chosen on: not known. Range: not known.
"""

LITTLE_SHORTER_MM = 3.0
"""The little finger's tip lies at least this far behind the tip of the index finger.

Unit: mm. Chosen on: not known. Range: not known.
"""

# --- locate

SURVEY_PX_PER_MM = 26.0
"""The finger is searched for on images reduced to about this scale.

Unit: px/mm. Chosen on: speed. Range: not known.
"""

SURVEY_SIDE = 64
"""The reduced images keep this many pixels a side, where the image has them, whatever scale was
stated.

Unit: px. Chosen on: judgement. Range: not known.
"""

QUALITY_MARGIN_MM = 3.0
"""Background around the finger that quality is measured with: the widest filter that measures
motion reaches so far.

Unit: mm. Chosen on: judgement. Range: not known.
"""

BEYOND_CREASE_MM = 2.5
"""Skin beyond the crease is reconstructed too, and then cut: light from it reaches the phalange
under the skin.

Unit: mm. Chosen on: judgement. Range: 1.25 to 5 (validation/parameters).
"""

# --- mask

COARSE_PX_PER_MM = 10.0
"""Scale of the copy that is clustered.

Unit: px/mm. Chosen on: speed. Range: 5 to 14 (validation/parameters).
"""

FINE_PX_PER_MM = 20.0
"""Scale of the copy on which the outline is traced.

Unit: px/mm. Chosen on: speed (finer than the blur of skin, a tenth of the work). Range: 10 to 20
(validation/parameters).
"""

SEED_BLUR_MM = 0.25
"""Gaussian blur (sigma) of the chromaticity before clustering.

Unit: mm. Chosen on: not known. Range: 0.125 to 0.5 (validation/parameters).
"""

OUTLINE_BLUR_MM = 0.06
"""Gaussian blur (sigma) of the images on which the outline is traced.

Unit: mm. Chosen on: not known. Range: 0.03 to 0.12 (validation/parameters).
"""

BACKGROUND_SAMPLES = 8000
"""The background is fitted to about so many pixels.

Unit: px. Chosen on: speed. Range: not known.
"""

EDGE_FRACTION = 0.12
"""A pixel is finger if it rises from the background by this fraction of the finger's median rise.

Unit: fraction. Chosen on: not known. Range: 0.06 to 0.168 (validation/parameters).
"""

NOISE_FACTOR = 5.0
"""A pixel is finger if it also rises by this many standard deviations of the background's noise.

Unit: standard deviations. Chosen on: not known. Range: not known.
"""

SPUR_FRACTION = 0.4
"""Parts narrower than this fraction of the finger's own width are cut off.

Unit: fraction. Chosen on: not known. Range: not known.
"""

OUTLINE_SPECK_MM = 1.0
"""Bumps of the outline narrower than twice this (dust on the background beside the finger) are cut
off.

Unit: mm. Chosen on: not known. Range: 0.5 to 2 (validation/parameters).
"""

OBJECT_SPLITS = 3
"""How often the brighter part is split again while it touches a border of the image.

Unit: none. Chosen on: drawn scenes (tests/finger/test_object.py). Range: not known.
"""

MIN_OBJECT_AREA = 0.02
"""Smallest object that is told from what lies behind it.

Unit: fraction of the image. Chosen on: judgement. Range: not known.
"""

MIN_OBJECT_STEP = 2.0
"""An object is at least so many times as bright as what lies beyond its outline.

Unit: ratio. Chosen on: drawn scenes (tests/finger/test_object.py). Range: not known.
"""

MIN_OBJECT_CONTOUR = 0.9
"""Least part of its outline along which it is.

Unit: fraction. Chosen on: drawn scenes (tests/finger/test_object.py). Range: not known.
"""

CONTOUR_REACH = 0.01
"""How far on either side of its outline both are measured.

Unit: longer sides of the image. Chosen on: judgement. Range: not known.
"""

MIN_SHADING_DEG = 4.0
"""Least median angle between the brightness over the lights of an object's pixels and its mean.

Unit: degrees. Chosen on: drawn scenes (tests/finger/test_object.py). Range: not known.
"""

EDGE_MARGIN_MM = 1.0
"""Width of the zone along the outline that counts neither as finger nor as background while either
is measured.

Unit: mm. Chosen on: not known. Range: 0.5 to 2 (validation/parameters).
"""

MIN_WIDTH_MM = 4.0
"""A region that is nowhere as wide as this is not a finger.

Unit: mm. Chosen on: judgement. Range: not known.
"""

BRIGHT_BACKGROUND = 0.1
"""A background at least this bright against the brightest of the image may be darker than skin in
some places only.

Unit: fraction. Chosen on: simulated fingers (coloured paper, validation/conditions). Range: not
known.
"""

COLOURED_BACKGROUND = 0.3
"""A bright background whose channels differ by more than this fraction is distinguished by its
colour.

Unit: fraction. Chosen on: simulated fingers (coloured paper, validation/conditions). Range: not
known.
"""

MIN_EDGE_STEP = 0.15
"""A region across whose outline neither brightness nor colour changes by this fraction is not a
finger.

Unit: fraction. Chosen on: not known. Range: not known.
"""

ROUGH_PX_PER_MM = 5.5
"""Scale of the copy on which a finger is located roughly, where time counts.

Unit: px/mm. Chosen on: speed. Range: not known.
"""

OUTLINE_PX_PER_MM = 10.0
"""Scale of the copy on which the outline around a rough mask is traced.

Unit: px/mm. Chosen on: speed. Range: not known.
"""

FEW_BACKGROUND_SAMPLES = 2000
"""In these two steps, the background is fitted to about so many pixels.

Unit: px. Chosen on: speed. Range: not known.
"""

MIN_FINGER_AREA = 0.2
"""Smallest area of a finger, over that of the largest finger in view.

Unit: fraction. Chosen on: not known. Range: not known.
"""

# --- motion

MOTION_BANDS_MM = (0.3, 0.15, 0.08)
"""Fine ends (sigma) of the band-pass filters, coarse to fine; a finger may move by about twice the
first.

Unit: mm. Chosen on: not known. Range: 1 to 2 times these values (validation/parameters).
"""

MOTION_ITERATIONS = 6
"""Maximum refinements in each band.

Unit: none. Chosen on: speed. Range: not known.
"""

MOTION_SAMPLES = 20_000
"""Pixels that are compared in each band, at least, of those on the finger and around it.

Unit: px. Chosen on: speed. Range: not known.
"""

MOTION_PX_PER_MM = 10.0
"""Scale of the copies that are compared in the finest band.

Unit: px/mm. Chosen on: speed. Range: not known.
"""

WARN_MM = 0.05
"""Motion from here on is warned of: a ninth of a ridge period blurs the combined relief visibly.

Unit: mm. Chosen on: judgement. Range: not known.
"""

MIN_RELIABILITY = 0.8
"""Motion of a shot with less reliability than this is ignored.

Unit: correlation. Chosen on: not known. Range: 0.4 to 0.8 (validation/parameters).
"""

# --- orientation

LONGEST_SIDE = 512
"""Longer side of the reduced mask.

Unit: px. Chosen on: speed. Range: 256 to 1024 (validation/parameters).
"""

FULL_WIDTH = 0.85
"""Rows at least this fraction as wide as the widest count as full width.

Unit: fraction. Chosen on: not known. Range: 0.425 to 0.85 (validation/parameters).
"""

TIP_EXCLUSION = 0.5
"""Rows nearer to the tip than this fraction of the widest row are left out of the fit.

Unit: fraction. Chosen on: not known. Range: 0.25 to 1 (validation/parameters).
"""

MAX_TURN_DEG = 75.0
"""Largest turn from the expected direction that is accepted (captures guarantee 60 deg).

Unit: deg. Chosen on: judgement. Range: not known.
"""

SEARCHED_SIDE = 96
"""Longer side of the copy on which the direction of the tip is searched.

Unit: px. Chosen on: speed. Range: not known.
"""

TIP_STEP_DEG = 5.0
"""Step between the directions that are tried.

Unit: deg. Chosen on: simulated fingers (seeds 7501 to 7503, turned). Range: not known.
"""

TIP_LENGTHS = (0.45, 0.65, 0.9)
"""Lengths of the rounded tip that are tried: blunt to slender.

Unit: widths of the finger. Chosen on: simulated fingers (seeds 7501 to 7503, turned). Range: not
known.
"""

HIDDEN_TIPS = (0.0, 0.5, 1.5)
"""Lengths of the tip beyond the image's border that are tried.

Unit: widths of the finger. Chosen on: simulated fingers (seeds 7501 to 7503, turned). Range: not
known.
"""

CLEAR_TIP = 0.03
"""The direction is clear if all others, more than 60 deg away, differ from the mask by so much
more.

Unit: squared widths of the finger. Chosen on: simulated fingers (seeds 7501 to 7503, turned).
Range: not known.
"""

UNLIKE_FINGER = 0.3
"""A mask that differs from every finger by this much shows no direction.

Unit: squared widths of the finger. Chosen on: simulated fingers (seeds 7501 to 7503, turned).
Range: not known.
"""

UPRIGHT_MARGIN = 0.02
"""Margin around the finger in the upright frame, as a fraction of its longer side.

Unit: fraction. Chosen on: judgement. Range: 0.01 to 0.04 (validation/parameters).
"""

# --- phalange

CREASE_PX_PER_MM = 8.0
"""Scale of the copy that is searched: a crease is half a millimetre wide and more, and ridges must
not show.

Unit: px/mm. Chosen on: not known. Range: 4 to 11.2 (validation/parameters).
"""

CREASE_BLUR_MM = 0.3
"""Blur (sigma) across the crease; removes ridges of 0.43 mm period.

Unit: mm. Chosen on: not known. Range: 0.15 to 0.6 (validation/parameters).
"""

CREASE_SIDE_MM = 1.6
"""A valley must be darker than the skin this far above and below it.

Unit: mm. Chosen on: not known. Range: 0.8 to 2.24 (validation/parameters).
"""

MIN_CREASE_DEPTH = 0.025
"""Minimum relative darkening, averaged over the finger's width.

Unit: fraction. Chosen on: not known. Range: not known.
"""

MIN_CREASE_COVERAGE = 0.6
"""Fraction of the finger's width along which the valley must show.

Unit: fraction. Chosen on: not known. Range: 0.3 to 0.84 (validation/parameters).
"""

MIN_CREASE_PROMINENCE = 2.5
"""Minimum depth in units of what lines across this finger usually show (80th percentile of the
profile).

Unit: none. Chosen on: not known. Range: not known.
"""

MAX_CREASE_TILT_DEG = 15.0
"""Creases may lean by this much against the finger's axis.

Unit: deg. Chosen on: not known. Range: not known.
"""

CREASE_RATIOS = (0.95, 2.4)
"""Where the first crease may lie: smallest and largest distance from the tip.

Unit: widths of the finger. Chosen on: not known. Range: 0.7 to 1 times these values
(validation/parameters).
"""

CREASE_DISTANCES_MM = (14.0, 38.0)
"""Where it may lie in millimetres.

Unit: mm. Chosen on: not known. Range: 0.7 to 1.4 times these values (validation/parameters).
"""

EXPECTED_CREASE_RATIO = 1.55
"""Distance of the first crease from the tip, on average.

Unit: widths of the finger. Chosen on: not known. Range: not known.
"""

CREASE_RATIO_SD = 0.35
"""Standard deviation of that ratio, with which two candidates are weighed against each other.

Unit: widths of the finger. Chosen on: not known. Range: not known.
"""

EQUALISED_ROUNDS = 3
"""Rounds of equalisation and blur for `cut_at_crease=equalised`. The thesis gives no number.

Unit: none. Chosen on: not known. Range: 2 to 4 (validation/parameters).
"""

EQUALISED_BLUR_MM = 0.5
"""Sigma of that blur.

Unit: mm. Chosen on: not known. Range: 0.25 to 0.5 (validation/parameters).
"""

MIN_ROW_PROMINENCE = 0.2
"""A row is a candidate there if it has so many fewer light pixels than the rows beside it, over the
width.

Unit: fraction. Chosen on: not known. Range: 0.1 to 0.28 (validation/parameters).
"""

DOUBLET_MM = 5.0
"""Two creases nearer than this are the two lines of one joint.

Unit: mm. Chosen on: not known. Range: not known.
"""

DOUBLET_FRACTION = 0.75
"""Least depth of the upper of two such lines, over that of the lower one, for the upper to be
taken.

Unit: fraction. Chosen on: not known. Range: not known.
"""

# --- quality

SPECK_DIRECTIONS = 16
"""Directions of the lines that a mark may hold.

Unit: none. Chosen on: simulated fingers (seeds 7401 to 7406 in every condition, people S16 and
S17). Range: not known.
"""

SPECK_ENLARGEMENT = 2
"""Lines are laid over the copy enlarged by this factor, so that a thin hair does not fall into
beads.

Unit: none. Chosen on: simulated fingers (seeds 7401 to 7406 in every condition, people S16 and
S17). Range: 2 to 4 (validation/parameters).
"""

SPECK_BLUR_MM = 0.04
"""Sigma of a Gaussian before lines are laid: pixels of the copy leave no steps.

Unit: mm. Chosen on: simulated fingers (seeds 7401 to 7406 in every condition, people S16 and S17).
Range: 0.02 to 0.056 (validation/parameters).
"""

SPECK_LEVEL_MM = 0.3
"""Brightness is relative to its surroundings, smoothed by a Gaussian of this sigma.

Unit: mm. Chosen on: simulated fingers (seeds 7401 to 7406 in every condition, people S16 and S17).
Range: not known.
"""

SLANTED_EDGE_MM = 1.5
"""Pixels nearer to the outline are left out: skin is slanted there.

Unit: mm. Chosen on: not known. Range: not known.
"""

SPECK_PX_PER_MM = 12.0
"""Scale of the copy on which specks are measured; coarser images are not.

Unit: px/mm. Chosen on: simulated fingers (seeds 7401 to 7406 in every condition, people S16 and
S17). Range: 8.4 to 12 (validation/parameters).
"""

DARK_SPECK_MM = 0.35
"""Dark marks that are longer in any direction are valleys, wrinkles or hairs.

Unit: mm. Chosen on: simulated fingers (seeds 7401 to 7406 in every condition, people S16 and S17).
Range: 0.245 to 0.7 (validation/parameters).
"""

DARK_SPECK_DEPTH = 0.08
"""How much darker than its surroundings a pixel of a dark speck is.

Unit: fraction. Chosen on: simulated fingers (seeds 7401 to 7406 in every condition, people S16 and
S17). Range: 0.056 to 0.112 (validation/parameters).
"""

BRIGHT_SPECK_MM = 0.5
"""Bright marks that are longer in any direction are ridges.

Unit: mm. Chosen on: simulated fingers (seeds 7401 to 7406 in every condition, people S16 and S17).
Range: not known.
"""

BRIGHT_SPECK_RISE = 0.08
"""How much brighter than its surroundings a pixel of a bright speck is.

Unit: fraction. Chosen on: simulated fingers (seeds 7401 to 7406 in every condition, people S16 and
S17). Range: not known.
"""

MAX_DARK_SPECKS = 0.002
"""Fraction of the finger that dark specks may cover.

Unit: fraction. Chosen on: simulated fingers (seeds 7401 to 7406 in every condition, people S16 and
S17). Range: not known.
"""

MAX_BRIGHT_SPECKS = 0.005
"""Fraction of the finger that bright specks may cover.

Unit: fraction. Chosen on: simulated fingers (seeds 7401 to 7406 in every condition, people S16 and
S17). Range: not known.
"""

SATURATION = 0.98
"""Values from here on are saturated, unless the caller gives another level.

Unit: full scale. Chosen on: judgement. Range: not known.
"""

MAX_SATURATED = 0.02
"""Fraction of the finger that may be saturated in any image.

Unit: fraction. Chosen on: not known. Range: not known.
"""

MIN_RIDGE_CONTRAST = 0.006
"""Minimum relative contrast (standard deviation over mean) of the ridge band.

Unit: fraction. Chosen on: not known. Range: not known.
"""

MAX_AMBIENT = 0.3
"""Ambient light as a fraction of the median lit brightness.

Unit: fraction. Chosen on: not known. Range: not known.
"""

MIN_BRIGHTNESS = 0.02
"""Median brightness of the mean image, below which it is called dark.

Unit: full scale. Chosen on: not known. Range: not known.
"""

LED_RANGE = (0.5, 2.0)
"""Brightness of an image relative to what its LED should give; outside, the LED is suspect.

Unit: none. Chosen on: judgement. Range: not known.
"""

DEAD_LED = 0.1
"""Relative brightness below which an LED is called dead.

Unit: none. Chosen on: judgement. Range: not known.
"""

MIN_LENGTH_MM = 12.0
"""Visible length of the finger below which a warning is given.

Unit: mm. Chosen on: not known. Range: not known.
"""

LIT_FRACTION = 0.03
"""A light reaches a pixel if it is brighter than this fraction of the finger's median brightness.

Unit: fraction. Chosen on: not known. Range: 0.015 to 0.06 (validation/parameters).
"""

PINHOLE_MM2 = 1.0
"""Holes up to this area are filled: a few unreliable pixels harm less than a hole in the surface.

Unit: mm2. Chosen on: judgement. Range: not known.
"""

# --- regions

SMALL_DISC_PX = 2.0
"""Up to this radius a mask is eroded by a disc, beyond it by distances: the same pixels, sooner.

Unit: px. Chosen on: speed. Range: any (the result is the same).
"""

# --- registration

TURN_MM = 8.0
"""A turn's parameter is the shift that it causes at this distance.

Unit: mm. Chosen on: simulated fingers (seeds 9101 to 9104). Range: 4 to 16 (validation/parameters).
"""

SETTLED_MM = 5e-4
"""Shots that move by less than this, or than `SETTLED_PX` if that is larger, are settled.

Unit: mm. Chosen on: speed. Range: not known.
"""

SETTLED_PX = 0.02
"""The same in pixels; images are resampled to 1/32 px.

Unit: px. Chosen on: speed. Range: 0.01 to 0.04 (validation/parameters).
"""

REGISTRATION_ITERATIONS = 20
"""Maximum refinements in each band.

Unit: none. Chosen on: speed. Range: 10 to 40 (validation/parameters).
"""

COARSE_BANDS_MM = (0.5, 0.3, 0.15)
"""Fine ends (sigma) of the band-pass filters in which the outline counts too, coarse to fine.

Unit: mm. Chosen on: simulated fingers (seeds 9101 to 9104). Range: 0.5 to 2 times these values
(validation/parameters).
"""

FINE_BANDS_MM = (0.08,)
"""Fine ends of the filters in which only the skin counts.

Unit: mm. Chosen on: simulated fingers (seeds 9101 to 9104). Range: 0.7 to 1 times these values
(validation/parameters).
"""

BAND_RATIO = 3.2
"""Coarse end of each filter over its fine end.

Unit: none. Chosen on: simulated fingers (seeds 9101 to 9104). Range: 2.24 to 4.48
(validation/parameters).
"""

REGISTRATION_PX_PER_MM = 12.5
"""Scale of the copies that are compared in the finest band.

Unit: px/mm. Chosen on: simulated fingers (seeds 9101 to 9104). Range: 8.75 to 12.5
(validation/parameters).
"""

SURROUND_MM = 0.7
"""Width of the background around the finger that is used, for the sake of its silhouette.

Unit: mm. Chosen on: simulated fingers (seeds 9101 to 9104). Range: 0.35 to 1.4
(validation/parameters).
"""

RIM_MM = 0.8
"""Width of the finger's edge that is left out of the fine bands.

Unit: mm. Chosen on: simulated fingers (seeds 9101 to 9104). Range: 0.4 to 1.6
(validation/parameters).
"""

REGISTRATION_SAMPLES = 16_000
"""Pixels of a level that are used, at least, evenly spread; all where it has fewer.

Unit: px. Chosen on: speed. Range: 8000 to 32000 (validation/parameters).
"""

SAME_SCALE = 1.1
"""Copies are not reduced by less than this: it would blur some pixels more than others.

Unit: none. Chosen on: judgement. Range: 0.55 to 2.2 (validation/parameters).
"""

PRODUCT_SIZE = 200_000
"""Size of the products that sums are made of: below what libraries divide among threads, so that
the bytes do not depend on their number.

Unit: multiplications. Chosen on: not known. Range: not known.
"""

# --- ridge_period

BLOCK_PX = 64
"""Side of a block of the reduced picture.

Unit: px. Chosen on: not known. Range: 32 to 64 (validation/parameters).
"""

STEP_PX = 16
"""Usual distance of the blocks.

Unit: px. Chosen on: not known. Range: 8 to 16 (validation/parameters).
"""

SHORTEST_PX = 4.0
"""Shortest period that is sought in a reduced picture; the next picture has half the size.

Unit: px. Chosen on: not known. Range: 2 to 4 (validation/parameters).
"""

LONGEST_PX = 10.0
"""Longest period that is sought in a reduced picture.

Unit: px. Chosen on: not known. Range: 7 to 20 (validation/parameters).
"""

PERIOD_LEVELS = 6
"""Maximum number of reduced pictures.

Unit: none. Chosen on: judgement. Range: not known.
"""

MIN_FACING = 0.7
"""Cosine of the slant up to which blocks are used.

Unit: none. Chosen on: not known. Range: none within 0.7 to 1.4 (validation/parameters).
"""

MIN_CONCENTRATION = 0.4
"""Fraction of a block's power, of all periods around, that one wave of ridges has at least.

Unit: fraction. Chosen on: not known. Range: 0.2 to 0.56 (validation/parameters).
"""

MIN_BLOCKS = 6
"""At least so many blocks must have one wave.

Unit: none. Chosen on: judgement. Range: not known.
"""

MIN_RIDGED = 0.25
"""At least this fraction of all blocks must have one wave. Fingers have 0.6 to 0.8, DiLiGenT's bear
0.08, a ball none.

Unit: fraction. Chosen on: simulated fingers (and photographs of objects without ridges). Range:
0.08 to 0.6 (what it separates).
"""

# --- ridges

CONTRAST_FLOOR = 0.3
"""Contrast below this fraction of the finger's median is not raised further, so flat skin stays
flat.

Unit: fraction. Chosen on: not known. Range: not known.
"""

CONTRAST_WINDOW_MM = 0.6
"""Standard deviation of the Gaussian window over which mean and contrast are made even.

Unit: mm. Chosen on: not known. Range: 0.3 to 1.2 (validation/parameters).
"""

INK_STEEPNESS = 1.1
"""Steepness of the grey curve; 0.5 is soft, 3 is nearly black and white.

Unit: none. Chosen on: not known. Range: 0.55 to 2.2 (validation/parameters).
"""

EMPTY_CONTRAST = 0.1
"""Local contrast, as a fraction of the finger's median, below which skin is paper.

Unit: fraction. Chosen on: not known. Range: not known.
"""

FULL_CONTRAST = 0.3
"""Local contrast, as a fraction of the finger's median, above which skin is all ink.

Unit: fraction. Chosen on: not known. Range: 0.15 to 0.6 (validation/parameters).
"""

NARROW_WINDOW = 0.4
"""The window of that contrast, as a fraction of the other: blank skin at the outline is paper up to
the last ridge.

Unit: fraction. Chosen on: not known. Range: 0.2 to 0.8 (validation/parameters).
"""

# --- steady

CORRECT_MM = 0.02
"""Motion from here on is undone. Still simulated fingers show at most 0.014 mm.

Unit: mm. Chosen on: simulated fingers (80 still captures of the population, and seeds 9101 to 9104
that move). Range: not known.
"""

MOST_LEFT = 0.35
"""Fraction of the details that may be left over once the motion is undone, before the shots are
refused.

Unit: fraction. Chosen on: simulated fingers (seeds 9101 to 9104). Range: not known.
"""

LIGHT_PITCH_MM = 0.6
"""Pitch at which the light of near LEDs is computed.

Unit: mm. Chosen on: simulated fingers (seeds 9101 to 9104). Range: 0.3 to 1.2
(validation/parameters).
"""

RESAMPLED_MARGIN_MM = 2.0
"""Further than this beyond the finger, images are left as they are.

Unit: mm. Chosen on: judgement. Range: 1 to 4 (validation/parameters).
"""

MAX_STILL_UNEXPLAINED = 0.95
"""Undoing motion must bring the residual that no surface explains below this fraction of what it
was.

Unit: fraction. Chosen on: simulated fingers (80 still captures of the population, and seeds 9101 to
9104 that move). Range: not known.
"""

CORRECT_SERIES_MM = 0.01
"""Motion between polarised series in colour from which it is undone. A still path-traced finger
shows 0.004 mm.

Unit: mm. Chosen on: path-traced fingers (one that lies still). Range: not known.
"""

MIN_BESIDE_LIGHTS = 0.1
"""Variance of the shots' shifts beside those along their lights, over all of it, below which
shading moved the ridges, and not the finger; a steady drift has two thirds.

Unit: fraction. Chosen on: path-traced fingers (one that lies still). Range: not known.
"""

MIN_SIDE_SHIFTS = 3
"""Side images whose shift is known: with fewer, a shift common to all is indistinguishable from one
along each light.

Unit: none. Chosen on: judgement. Range: not known.
"""

SURE_SIDE_SHIFT = 3.0
"""Standard errors of the shift of all side images above which they moved: gloss shifts each by up
to 60 um.

Unit: standard errors. Chosen on: not known. Range: not known.
"""

ALONE_SHIFT_MM = 0.08
"""Shift of one of them against the others beyond which it moved.

Unit: mm. Chosen on: not known. Range: not known.
"""
