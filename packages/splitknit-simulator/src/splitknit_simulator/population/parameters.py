"""Tuned constants of simulated populations: people, sessions and the use of real prints."""

# --- folder

REAL_PRINT_FRACTION = 1 / 3
"""Fraction of a population's fingers that have the ridges of a real print, where there are enough
prints.

Unit: fraction. Chosen on: judgement. Range: not known.
"""

# --- people

PERIOD_DIGIT = (1.05, 1.02, 1.0, 0.98, 0.95)
"""Ridge period by digit, thumb to little finger, relative to the mean.

Unit: none. Chosen on: judgement. Range: not known.
"""
WIDTH_MM = (20.2, 16.8, 17.0, 16.0, 14.3)
"""Mean breadth of the pad by digit, thumb to little finger, of both sexes; that of the index finger
is Greiner's (1991).

Unit: mm. Chosen on: judgement (four of the five digits). Range: not known.
"""
LENGTH_MM = (30.5, 25.0, 26.0, 25.5, 22.8)
"""Mean length from tip to first crease by digit, thumb to little finger, of both sexes; that of the
index finger is Greiner's (1991), the others follow Buryanov and Kotiuk (2010).

Unit: mm. Chosen on: judgement (four of the five digits). Range: not known.
"""
HABIT_ROLL_SD_DEG = 3.0
"""Standard deviation of each finger's habitual roll.

Unit: deg. Chosen on: judgement. Range: not known.
"""
SIZE_COMMON_TO_PERSON = 0.8
"""Fraction of the variance of breadth and length, within a sex, that all ten fingers share.

Unit: fraction. Chosen on: judgement. Range: not known.
"""
PATTERN_COMMON_TO_PERSON = 0.35
"""Fraction of the latent variance of the class of print that all ten fingers share.

Unit: fraction. Chosen on: judgement. Range: not known.
"""
PATTERN_COMMON_TO_DIGIT = 0.25
"""Fraction of the latent variance of the class of print that the two fingers of one name share.

Unit: fraction. Chosen on: judgement. Range: not known.
"""
BLOOD_FINGER_SD = 0.10
"""Logarithmic standard deviation of the blood content between the fingers of a person.

Unit: none. Chosen on: judgement. Range: not known.
"""
RELIEF_GAIN_FINGER_SD = 0.05
"""Logarithmic standard deviation of the relief gain between the fingers of a person.

Unit: none. Chosen on: judgement. Range: not known.
"""

# --- sessions

INSERTION_MM = (26.0, 28.4)
"""Range of the distance from the lower image border to the tip; cut to what the picture holds.

Unit: mm. Chosen on: judgement. Range: not known.
"""
PARTIAL_INSERTION_MM = (18.0, 22.0)
"""The same range of a finger that is laid down too short.

Unit: mm. Chosen on: judgement. Range: not known.
"""
OXYGENATION = (0.6, 0.85)
"""Range of the oxygenated fraction of the haemoglobin, one for all of a person's fingers.

Unit: fraction. Chosen on: judgement. Range: not known.
"""
FULL_WELL_E = (2500.0, 4700.0)
"""Range of the electrons at full scale: fewer with a higher gain.

Unit: electrons. Chosen on: judgement. Range: not known.
"""
READ_NOISE_E = (2.5, 4.0)
"""Range of the standard deviation of the noise of reading out.

Unit: electrons. Chosen on: judgement. Range: not known.
"""
SWELLING_COMMON = 0.8
"""Fraction of the variance of the swelling that a person's fingers share in a session.

Unit: fraction. Chosen on: judgement. Range: not known.
"""
MOISTURE_COMMON = 0.6
"""Fraction of the variance of the moisture that a person's fingers share in a session.

Unit: fraction. Chosen on: judgement. Range: not known.
"""
BLOOD_COMMON = 0.8
"""Fraction of the variance of the blood content that a person's fingers share in a session.

Unit: fraction. Chosen on: judgement. Range: not known.
"""
YAW_SD_DEG = 5.0
"""Standard deviation of the turn about the camera's axis; no turn is beyond twice that.

Unit: deg. Chosen on: judgement. Range: not known.
"""
PITCH_SD_DEG = 2.0
"""Standard deviation of the lift of the tip; no lift is beyond twice that.

Unit: deg. Chosen on: judgement. Range: not known.
"""
SWELLING_SD = 0.015
"""Standard deviation of the change of breadth and thickness (water, warmth, weight); no change is
beyond twice that.

Unit: fraction. Chosen on: judgement. Range: not known.
"""
DEFORMATION_MM = (0.2, 0.5)
"""Range of the largest shift of the skin against the body.

Unit: mm. Chosen on: judgement. Range: not known.
"""
BLOOD_SD = 0.25
"""Logarithmic standard deviation of the blood content between sessions (warmth, pressure).

Unit: none. Chosen on: judgement. Range: not known.
"""
LED_DRIFT_SD = 0.007
"""Standard deviation of the change of each LED's intensity, relative, since it was calibrated; the
rig file does not have it.

Unit: fraction. Chosen on: judgement. Range: not known.
"""
