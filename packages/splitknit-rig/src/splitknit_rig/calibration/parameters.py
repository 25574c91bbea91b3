"""Constants of the calibration that could have been chosen otherwise, by module."""

# --- camera

MAX_FOCAL_SIDES = 40.0
"""A focal length above this many sides of the image is a sign that the fit ran away.

Unit: sides of the image. Chosen on: judgement. Range: not known.
"""

SIGNIFICANCE = 4.0
"""A term is kept where it differs from nothing by more than this many standard deviations.

Unit: standard deviations. Chosen on: judgement. Range: not known.
"""

PRINCIPAL_LIMIT = 0.05
"""The principal point is held in the image's middle where its standard deviation exceeds this
fraction of the image's longer side.

Unit: fraction. Chosen on: judgement. Range: not known.
"""

GROSS_ASPECT = 0.015
"""A ratio of the focal lengths that differs by more from one is kept before any distortion is
tried.

Unit: fraction. Chosen on: not known. Range: not known.
"""

MIN_VIEWS = 5
"""Photographs of the board that are needed.

Unit: none. Chosen on: judgement. Range: not known.
"""

OUTLIER_RATIO = 1.6
"""A view is rejected if its error exceeds the median by this factor and by `OUTLIER_SPREAD`.

Unit: none. Chosen on: judgement. Range: not known.
"""

OUTLIER_SPREAD = 5.0
"""A view is rejected if its error exceeds the median by this many times the robust spread of all
errors, and by `OUTLIER_RATIO`.

Unit: standard deviations. Chosen on: judgement. Range: not known.
"""

SAME_VIEW_PX = 0.3
"""Views whose corners differ by less than this (rms) are one view, photographed twice.

Unit: px. Chosen on: judgement. Range: not known.
"""

MAX_FOCAL_ERROR = 0.01
"""Relative standard deviation of the focal length from which views are refused.

Unit: fraction. Chosen on: judgement. Range: not known.
"""

FOCAL_ERROR_NOTED = 0.003
"""Relative standard deviation of the focal length from which there is a finding: the goal of the
camera's calibration.

Unit: fraction. Chosen on: judgement. Range: not known.
"""

MAX_ASPECT = 0.02
"""Difference of fx / fy from one that is refused: sensors have square pixels.

Unit: fraction. Chosen on: judgement. Range: not known.
"""

MIN_VARIETY_DEG = 10.0
"""Two of the boards' normals should differ by more than this.

Unit: deg. Chosen on: judgement. Range: not known.
"""

MIN_COVERAGE = 0.5
"""Fraction of the picture that the corners of all views together should span.

Unit: fraction. Chosen on: judgement. Range: not known.
"""

# --- camera_photos

MAX_CAMERA_TILT_DEG = 1.0
"""A camera that looks on the base more obliquely gets a finding.

Unit: deg. Chosen on: judgement. Range: not known.
"""

FINGER_DEPTH_MM = 8.0
"""Depth of the finger that the camera sees, in the finding on an oblique camera.

Unit: mm. Chosen on: judgement. Range: not known.
"""

POSES_HEIGHT = 0.003
"""Photographs of one plane whose heights differ by more, relative to the height, get a finding.

Unit: fraction. Chosen on: judgement. Range: not known.
"""

POSES_TILT_DEG = 0.3
"""Photographs of one plane whose normals differ by more from their mean get a finding.

Unit: deg. Chosen on: judgement. Range: not known.
"""

# --- card_model

MIN_LOBE_EXPONENT = 0.02
"""Smallest exponent of a beam: below it an aim has no meaning.

Unit: none. Chosen on: judgement. Range: not known.
"""

MAX_AIM_TILT = 0.7
"""Largest tilt of an aim from the direction to the origin, as a tangent: 35 deg.

Unit: none. Chosen on: judgement. Range: not known.
"""

# --- flat_field

FIT_STAGES = 10
"""Fits of one model, each with new weights of the card's places, at most.

Unit: none. Chosen on: speed. Range: not known.
"""

GLOSS_WIDTHS_DEG = (3.0, 6.0)
"""Widths of the spot of a card that shines: standard deviation of the angle from the card's normal
to the half vector of LED and camera.

Unit: deg. Chosen on: not known. Range: not known.
"""

ROBUST_PERCENT = 0.5
"""Places whose residuals under all LEDs (in the median) lie beyond this count less and less: dust.

Unit: percent. Chosen on: not known. Range: not known.
"""

ENOUGH_PERCENT = 0.05
"""The simplest model is taken whose rms exceeds the best one's by no more than this, added in
squares, or by no more than `ENOUGH_FRACTION`.

Unit: percent. Chosen on: not known. Range: not known.
"""

ENOUGH_FRACTION = 0.05
"""The simplest model is taken whose rms exceeds the best one's by no more than this fraction of it,
or by no more than `ENOUGH_PERCENT`.

Unit: fraction. Chosen on: not known. Range: not known.
"""

MIN_FIELD = 0.3
"""A cell that is darker than this fraction of the model's brightness does not show the card.

Unit: fraction. Chosen on: judgement. Range: not known.
"""

MAX_EMPTY = 0.005
"""Fraction of the cells that may not show the card.

Unit: fraction. Chosen on: judgement. Range: not known.
"""

MAX_DUST = 0.05
"""Largest fraction of dust; beyond it the card is not uniform.

Unit: fraction. Chosen on: judgement. Range: not known.
"""

DUST_PERCENT = 2.0
"""A cell that departs further under all LEDs is counted as dust and left out of the residuals.

Unit: percent. Chosen on: judgement. Range: not known.
"""

# --- light_sources

NAIL_SD_MM = 0.05
"""Standard deviation of the nail's place in photographs; 0.01 mm in the twin, but nails stand a
little askew.

Unit: mm. Chosen on: judgement. Range: not known.
"""

RIM_AGREED = 0.5
"""Fraction of all rays that must agree on a ball's rim: 0.53 on a photographed chrome ball that is
half dark on dark, 0.55 and more on drawn ones, up to 0.40 where there is nothing but noise.

Unit: fraction. Chosen on: real photographs (a chrome ball; drawn balls beside it). Range: 0.40 to
0.53.
"""

RIM_OFF = 0.005
"""Fraction of the radius by which the rim must lie off the mask to replace it.

Unit: fraction. Chosen on: not known. Range: not known.
"""

# --- lights

MIN_TIP_MM = 0.2
"""A tip nearer to its nail than this shows no shadow.

Unit: mm. Chosen on: judgement. Range: not known.
"""

# --- lights_found

BEYOND_BORDER = 0.02
"""Fraction of the image's size by which a pixel may lie beyond its border: clicked beside the last
pixel, not elsewhere.

Unit: fraction. Chosen on: judgement. Range: not known.
"""

COPY_MM = 0.4
"""Shadow tips of two nail positions that are nearer than this on the finger plane repeat; the
thesis's copies lie up to 0.22 mm apart.

Unit: mm. Chosen on: real photographs (the thesis's own table). Range: not known.
"""

MOVE_MM = 1.0
"""Nail positions that are nearer than this are one position.

Unit: mm. Chosen on: judgement. Range: not known.
"""

SAME_NAIL_MM = 1.0
"""The nail's place may differ so much between the rows of one position.

Unit: mm. Chosen on: judgement. Range: not known.
"""

# --- nail

NAIL_HEIGHT_SD_MM = 1.0
"""Standard deviation of the nail's height, where it is known.

Unit: mm. Chosen on: judgement. Range: not known.
"""

CIRCLE_SD_MM = 1.0
"""Standard deviation of the circle's centre (each way), radius and height from the drawing's
values.

Unit: mm. Chosen on: judgement. Range: not known.
"""

FREE_SD_MM = 30.0
"""Takes the place of all deviations of LEDs and circle where the nail's height is known.

Unit: mm. Chosen on: judgement. Range: not known.
"""

TIP_SD_PX = 1.0
"""Standard deviation of a shadow tip in the image, along each axis.

Unit: px. Chosen on: judgement. Range: not known.
"""

LED_SD_MM = 1.0
"""Standard deviation of each LED's distance from the circle, radially and in height.

Unit: mm. Chosen on: judgement. Range: not known.
"""

STRAY_TIP = 4.0
"""A tip this many standard deviations from its place is named, and has lost most of its weight.

Unit: standard deviations. Chosen on: judgement. Range: not known.
"""

STRAY_LED_MM = 10.0
"""An LED further than this off the fitted circle is refused.

Unit: mm. Chosen on: judgement. Range: not known.
"""

MAX_NAIL_HEIGHT = 0.6
"""A nail is taken to be lower than this fraction of the LEDs' height.

Unit: fraction. Chosen on: judgement. Range: not known.
"""

# --- nail_photos

NAIL_TILE_PX = 400
"""Width of one photograph in the picture of the tips.

Unit: px. Chosen on: judgement. Range: not known.
"""

# --- polarisers

SHIFT_LEVELS_PX = (8.0, 4.0, 2.0)
"""Standard deviations of the blur under which both images of the card are brought onto each other.

Unit: px. Chosen on: not known. Range: not known.
"""

MIN_LIKENESS = 0.5
"""Correlation of both images' details that is needed; a card without print has none.

Unit: none. Chosen on: judgement. Range: not known.
"""

FILM_CELLS = 60
"""Cells along the longer side of the printed card's picture.

Unit: none. Chosen on: not known. Range: not known.
"""

LED_STEADINESS = 0.004
"""Relative deviation of an LED's light from one photograph to the next, with its shot noise.

Unit: fraction. Chosen on: not known. Range: not known.
"""

NEIGHBOUR_MM = 1.0
"""LEDs beside each other are mirrored on the ball at most so far apart.

Unit: mm. Chosen on: judgement. Range: not known.
"""

MATT_PERCENT = 1.0
"""A card gets a finding whose crossed image departs by more (rms) from a parallel one of other
brightness.

Unit: percent. Chosen on: judgement. Range: not known.
"""

MAX_LEAK = 0.05
"""Fraction of the specular light in the crossed image above which there is a finding.

Unit: fraction. Chosen on: judgement. Range: not known.
"""

LEAK_ERROR = 2.5e-4
"""Half of the largest error of what is left of the specular light.

Unit: fraction. Chosen on: simulated objects (rigs with films). Range: not known.
"""

# --- radiometry

CARD_CELLS = 40
"""Cells along the longer side of the white card's image.

Unit: none. Chosen on: not known. Range: not known.
"""

CELL_BLOCKS = 5
"""A cell's brightness is the median of the means of this many blocks a side.

Unit: none. Chosen on: not known. Range: not known.
"""

MAX_CLIPPED_PERCENT = 0.5
"""An image is refused if more of its pixels are at full scale.

Unit: percent. Chosen on: judgement. Range: not known.
"""

FULL_SCALE = 0.985
"""A value from this fraction of full scale on is clipped.

Unit: fraction. Chosen on: judgement. Range: not known.
"""

MIN_CARD_LIGHT = 0.02
"""An image whose median is below this fraction of full scale is black.

Unit: fraction. Chosen on: judgement. Range: not known.
"""

GLOSS_PERCENT = 2.0
"""A card whose mirror spot is brighter than this, and than five of its errors, shines.

Unit: percent. Chosen on: judgement. Range: not known.
"""

AMBIENT_PERCENT = 5.0
"""Light from elsewhere, relative to the LEDs', above which there is a finding.

Unit: percent. Chosen on: judgement. Range: not known.
"""

MAX_RESIDUAL_PERCENT = 1.0
"""Largest rms of an LED's residuals: the goal of the radiometric calibration.

Unit: percent. Chosen on: judgement. Range: not known.
"""

DRIFT_PERCENT = 3.0
"""Departure of an LED from the calibration above which there is a finding.

Unit: percent. Chosen on: judgement. Range: not known.
"""

PATTERN_PERCENT = 1.0
"""Departure of an LED's pattern on the card (robust deviation) above which it has moved or turned.

Unit: percent. Chosen on: judgement. Range: not known.
"""

# --- radiometry_folder

MAX_BASE_TILT_DEG = 5.0
"""A larger tilt of the base in the rig file is not taken for the card's.

Unit: deg. Chosen on: judgement. Range: not known.
"""

RESIDUAL_SCALE_PERCENT = 2.0
"""Ends of the colours in the picture of residuals.

Unit: percent. Chosen on: judgement. Range: not known.
"""

RESIDUAL_TILE_PX = 240
"""Width of one LED's residuals in their picture.

Unit: px. Chosen on: judgement. Range: not known.
"""

PATCHES_ACROSS = 40
"""Patches along the longer side of an image of the exposure series.

Unit: none. Chosen on: not known. Range: not known.
"""

MAX_TEXTURE = 0.04
"""Deviation within a patch, as a fraction of full scale, up to which it counts as even.

Unit: fraction. Chosen on: judgement. Range: not known.
"""

# --- sensor

RESPONSE_DEGREE = 5
"""Degree of the polynomial of the inverse response.

Unit: none. Chosen on: not known. Range: not known.
"""

MAX_NONLINEAR_PERCENT = 1.0
"""Values are linear if they depart from a line by no more than this part of full scale.

Unit: percent. Chosen on: judgement. Range: not known.
"""

INCONSISTENT_PERCENT = 1.0
"""Residuals (median over images of their rms) that no response explains: the scene moved or the
light changed.

Unit: percent. Chosen on: judgement. Range: not known.
"""

SERIES_CLIP = 0.98
"""Values of the exposure series from this fraction of full scale on are left out.

Unit: fraction. Chosen on: judgement. Range: not known.
"""

MIN_EXPOSURES = 4
"""Different exposure times that are needed.

Unit: none. Chosen on: judgement. Range: not known.
"""

MIN_EXPOSURE_RATIO = 3.0
"""Longest over shortest exposure that is needed.

Unit: none. Chosen on: judgement. Range: not known.
"""

MIN_VALUE_RANGE = 0.3
"""Fraction of full scale that the values must span.

Unit: fraction. Chosen on: judgement. Range: not known.
"""

# --- shadow

EDGE_PX = 0.5
"""Softness of an edge by pixels and lens, as a standard deviation.

Unit: px. Chosen on: not known. Range: not known.
"""

TIP_STRETCH = 1.12
"""A tip's shadow against the tip: for a nail of an eighth to a tenth of the LEDs' height. It hardly
matters.

Unit: none. Chosen on: judgement. Range: not known.
"""

NAIL_LEVEL = 0.45
"""The nail is darker than this fraction of the ground around it under every LED.

Unit: fraction. Chosen on: not known. Range: not known.
"""

SHADOW_LEVEL = 0.5
"""A shadow is darker than this fraction of the same place under the other LEDs.

Unit: fraction. Chosen on: not known. Range: not known.
"""

MIN_NAIL_MM2 = 0.3
"""Smallest area of the nail in the picture.

Unit: mm^2. Chosen on: judgement. Range: not known.
"""

MIN_SHADOW_MM = 0.7
"""A shadow must reach this far beyond the nail.

Unit: mm. Chosen on: judgement. Range: not known.
"""

BORDER_MM = 0.3
"""A shadow that comes nearer to the picture's border leaves it.

Unit: mm. Chosen on: judgement. Range: not known.
"""

OUTLINE_PIXELS = 500
"""Pixels near a shadow's tip that the fit takes, evenly spread; half as many along its sides.

Unit: none. Chosen on: speed. Range: not known.
"""

# --- sphere

MIN_BALL_PX = 8.5
"""Smallest radius of a ball that is found without a mask.

Unit: px. Chosen on: not known. Range: not known.
"""

SECOND_BALL_AREA = 0.25
"""Fraction of the largest ball's area from which another one is reported.

Unit: fraction. Chosen on: judgement (half the radius). Range: not known.
"""

RIM_RAYS = 360
"""Rays from a ball's middle along which its rim is looked for.

Unit: none. Chosen on: not known. Range: not known.
"""

RIM_REACH = 0.1
"""Fraction of a ball's radius by which its rim may lie off the outline.

Unit: fraction. Chosen on: not known. Range: not known.
"""

RIM_AGREEMENT = 0.007
"""Fraction of a ball's radius by which rays that agree on its rim may lie off each other.

Unit: fraction. Chosen on: not known. Range: not known.
"""

MIN_RIM_PX = 40.0
"""Smallest radius of a ball whose rim is looked for: of 12 smaller drawn balls on textures 5 came
out 3 to 12 % beside.

Unit: px. Chosen on: simulated objects (drawn balls on textures). Range: not known.
"""

# --- targets

SEARCH_PX = 1200
"""Longer side of the image in which the board is sought; corners are then refined in the full
image.

Unit: px. Chosen on: speed. Range: not known.
"""

CORNER_WINDOW = 0.3
"""Half the window in which a corner is refined, as a fraction of the shortest side of a square in
the image.

Unit: fraction. Chosen on: not known. Range: not known.
"""

MIN_WINDOW_PX = 3
"""Smallest half window in which a corner is refined.

Unit: px. Chosen on: judgement. Range: not known.
"""

MAX_WINDOW_PX = 40
"""Largest half window in which a corner is refined.

Unit: px. Chosen on: judgement. Range: not known.
"""

CORNER_BLUR_PX = 1.5
"""Blur (sigma, at most 5 % of a square's side) before corners are refined: edges sharp as a pixel
draw corners to its middle.

Unit: px. Chosen on: simulated objects (boards with squares of 57 px: corners 0.05 px off without
it, 0.015 with it). Range: not known.
"""

BOARD_CONTRAST = 0.4
"""Contrast, relative to the board's corners, from which a place one square further is a corner of
the board too.

Unit: fraction. Chosen on: not known. Range: not known.
"""
