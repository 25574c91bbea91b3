"""Tuned constants of the simulated rigs, bench photographs, scenes and mirrors."""

# --- bench_photos

NAIL_HEIGHT_MM = 13.0
"""Height of the nail whose shadows are photographed.

Unit: mm. Chosen on: not known. Range: not known.
"""
NAIL_PLACES_MM = ((-5.0, -3.5), (5.5, -3.0), (4.5, 4.0), (-5.5, 3.5))
"""Where the nail stands, x and y: all shadows stay in a picture of 42 x 29 mm.

Unit: mm. Chosen on: judgement. Range: not known.
"""
CARD_EXPOSURES_S = (0.002, 0.004, 0.006, 0.008, 0.010, 0.012)
"""Exposure times of the series of the white card, which shows the sensor's response.

Unit: s. Chosen on: judgement. Range: not known.
"""
PUPIL_MM = 1.6
"""Diameter of the lens's pupil, as of 12.8 mm at f/8: boards that are held obliquely are blurred by
up to a few pixels.

Unit: mm. Chosen on: judgement. Range: not known.
"""
BRIGHTEST_LEVEL = 0.9
"""Fraction of full scale that the brightest light reaches in the longest exposure of the card.

Unit: fraction. Chosen on: judgement. Range: not known.
"""
CROSSED_EXPOSURE_FACTOR = 64.0
"""How many times longer than up to that level the ball behind a crossed analyser is exposed, at
most.

Unit: none. Chosen on: judgement. Range: not known.
"""

# --- mirror_scene

PLASTIC_ALBEDO = 0.04
"""Albedo of the mirrors' holders and of the tube around the finger: black print.

Unit: fraction. Chosen on: judgement. Range: not known.
"""
GLASS_ALBEDO = 0.12
"""Albedo of the mirrors' ground upper edge.

Unit: fraction. Chosen on: judgement. Range: not known.
"""
TUBE_RADIUS_MM = 52.0
"""Inner radius of the tube around the finger.

Unit: mm. Chosen on: judgement. Range: not known.
"""
STRAY_FRACTION = 0.1
"""Light that reaches the tube by way of other things, relative to that on a white card under the
LED.

Unit: fraction. Chosen on: judgement. Range: not known.
"""
LID_FRACTION = 0.2
"""Light from what hangs above the finger, which a second mirror shows, relative to that from the
tube.

Unit: fraction. Chosen on: judgement. Range: not known.
"""

# --- mirror_twin

MIRROR_INSERTION_MM = (28.7, 30.3)
"""Range of the distance from the lower image border to the tip of a finger between mirrors, in
place of the pose ranges' own; cut to the tip's stop.

Unit: mm. Chosen on: judgement. Range: not known.
"""
RIDGE_FADE_MM = 3.0
"""Width over which the ridges fade at the end of the ridged skin.

Unit: mm. Chosen on: judgement. Range: not known.
"""
MAP_AROUND_MM = 12.0
"""How much further than the master print the skin's map reaches, to either side.

Unit: mm. Chosen on: judgement. Range: not known.
"""
MAP_OVER_TIP_MM = 10.0
"""How much further than the master print the skin's map reaches, beyond the tip.

Unit: mm. Chosen on: judgement. Range: not known.
"""
TRUTH_PROXIMAL_MM = 6.0
"""How far from the first crease towards the palm the truth of the whole finger reaches.

Unit: mm. Chosen on: judgement. Range: not known.
"""

# --- mirror_view

MIRROR_TURN_MAX_DEG = 3.0
"""Largest turn of a true mirror about any axis, to which larger ones are cut.

Unit: deg. Chosen on: judgement. Range: not known.
"""
MIRROR_SHIFT_MAX_MM = 2.0
"""Largest shift of a true mirror along any axis, to which larger ones are cut.

Unit: mm. Chosen on: judgement. Range: not known.
"""
REFLECTION_MARGIN_MM = 3.0
"""How far beyond a mirror's outline the reflected skin is rendered, since light diffuses across the
outline.

Unit: mm. Chosen on: judgement. Range: not known.
"""
SHOWN_PROXIMAL_MM = 32.0
"""How far from the first crease towards the palm a mirror shows the finger: the hand's sleeve
follows.

Unit: mm. Chosen on: judgement. Range: not known.
"""
COVERAGE_SAMPLES = 8
"""Samples across a pixel in which a flat outline's coverage is counted.

Unit: none. Chosen on: speed. Range: not known.
"""

# --- rigs

LED_POSITION_SD_MM = 0.7
"""Standard deviation of a built LED's position, per axis: a printed hole is 0.2 to 0.3 mm off, a 5
mm LED's collar rocks in its seat, and its die is up to 0.3 mm off its lens's axis and 1 mm along it
from lot to lot.

Unit: mm. Chosen on: judgement (tolerances). Range: not known.
"""
LED_BEAM_SD_DEG = 2.0
"""Standard deviation of a built LED's beam, per axis: data sheets allow the beam +-5 deg against
the package (2 deg as a deviation); the seat adds 0.5.

Unit: deg. Chosen on: judgement (data sheets). Range: not known.
"""
LED_HALF_ANGLE_SD = 0.08
"""Standard deviation, relative, of the angle at which an LED has half its light: lots of one type
differ by 5 to 10 %.

Unit: fraction. Chosen on: judgement (tolerances). Range: not known.
"""
LED_INTENSITY_SD = 0.1
"""Standard deviation of a built LED's intensity, relative: one brightness bin spans about a factor
of 1.4, and 5 % resistors add to it.

Unit: fraction. Chosen on: judgement (tolerances). Range: not known.
"""
FOCAL_LENGTH_SD = 0.01
"""Standard deviation of the focal length, relative: those of board lenses are stated to 1 or 2 %,
and turning the lens for focus changes them.

Unit: fraction. Chosen on: judgement (tolerances). Range: not known.
"""
CAMERA_HEIGHT_SD_MM = 0.5
"""Standard deviation of the pupil's height: 0.2 mm of the print, and the pupil's place in the lens,
which its drawing lacks.

Unit: mm. Chosen on: judgement (tolerances). Range: not known.
"""
CAMERA_TILT_SD_DEG = 0.3
"""Standard deviation of the camera's tilt against the base, per axis: 0.15 mm over a seat of 25 mm.

Unit: deg. Chosen on: judgement (tolerances). Range: not known.
"""
CAMERA_SHIFT_SD_MM = 0.3
"""Standard deviation of the camera's shift against the LEDs' circle, per axis: the play of its
screws.

Unit: mm. Chosen on: judgement (tolerances). Range: not known.
"""
PRINCIPAL_POINT_SD = 0.005
"""Standard deviation of the principal point, per axis, over the image's width: a lens holder is
glued within 0.02 mm on a sensor 3.7 mm wide.

Unit: fraction. Chosen on: judgement (tolerances). Range: not known.
"""
CORNER_DISTORTION = 0.005
"""Largest relative shift of the corners by distortion, drawn evenly with either sign: long lenses'
is below 1 %.

Unit: fraction. Chosen on: judgement (tolerances). Range: not known.
"""
CORNER_VIGNETTING = (0.10, 0.20)
"""Range of the light lost at the corners beside the cosine law, drawn evenly: small lenses cut
oblique beams.

Unit: fraction. Chosen on: judgement. Range: not known.
"""
COLOURED_INTENSITY_SD = 0.1
"""Standard deviation of the coloured LEDs' intensities, relative, as of the default rig's white
ones.

Unit: fraction. Chosen on: judgement. Range: not known.
"""

# --- scene

BACKGROUND_MM = 10.0
"""Distance of the background below the finger plane.

Unit: mm. Chosen on: judgement. Range: not known.
"""
SPECK_ALBEDO = 0.3
"""Largest albedo of a speck of dust on the background; specks have a tenth of it to all of it.

Unit: fraction. Chosen on: judgement. Range: not known.
"""
SHADED_ROWS = 0.25
"""Fraction of the frame's rows, from the last one, that the hand's shadow covers.

Unit: fraction. Chosen on: judgement. Range: not known.
"""
