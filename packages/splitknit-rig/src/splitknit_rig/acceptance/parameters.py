"""Limits of the acceptance test that could have been chosen otherwise, by module.

A rig with one defect at its limit adds at most 0.1 mm rms to a finger's surface and 5 % to the
error of its ridges (validation/rig_check, effects.csv), except motion and focus.
"""

# --- questions

DARK_PERCENT = 1.0
"""Largest value of no light, after the black level that the capture states. An ambient frame takes
it off: twice the limit changes a finger by nothing.

Unit: percent of full scale. Chosen on: judgement, checked on simulated fingers
(validation/rig_check, effects.csv). Range: up to 2, with ambient frames.
"""

NONLINEAR_PERCENT = 0.5
"""Largest departure of the stored values from a line. One of 1 % adds 0.03 to 0.11 mm rms to a
finger's surface and up to 5 % to the error of its ridges; the sound twins have 0.03 %.

Unit: percent of full scale. Chosen on: simulated fingers (validation/rig_check, effects.csv).
Range: at 2 up to 0.24 mm.
"""

MIN_CARD_LEVEL_PERCENT = 25.0
"""The card's darkest image reaches this at least (its 99th percentile). A finger exposed so has up
to 2 % more error in its ridges.

Unit: percent of full scale. Chosen on: judgement, checked on simulated fingers
(validation/rig_check, effects.csv). Range: at 12.5 up to 3 %.
"""

BRIGHTNESS_PERCENT = 3.0
"""Largest departure of an LED's brightness, relative to its band's, from the rig file. One LED at
the limit adds 0.03 to 0.08 mm rms to a finger's surface and 2 % to the error of its ridges.

Unit: percent. Chosen on: judgement, checked on simulated fingers (validation/rig_check,
effects.csv). Range: at 6 up to 0.19 mm.
"""

BEAM_PERCENT = 1.0
"""Largest departure (robust deviation) of an LED's light across the card from the rig file's. One
LED at the limit, tilted by 1.7 deg, adds 0.01 mm rms to a finger's surface.

Unit: percent. Chosen on: judgement, checked on simulated fingers (validation/rig_check,
effects.csv). Range: up to 2 the same.
"""

FLATNESS_DEG = 1.0
"""Largest angle (rms) between a flat card and the surface that a band's LEDs show of it.

Unit: deg. Chosen on: judgement. Range: not known.
"""

LEAK_PERCENT = 1.0
"""Largest light with all LEDs off, relative to the mean under one. An LED that leaks so adds up to
0.02 mm rms to a finger's surface.

Unit: percent. Chosen on: judgement, checked on simulated fingers (validation/rig_check,
effects.csv). Range: at 2 up to 0.04 mm.
"""

BALL_PERCENT = 2.0
"""Largest error of the ball's radius by its outline and the rig file's camera. The finger's lengths
err as much; its heights by 0.01 mm rms.

Unit: percent. Chosen on: judgement, checked on simulated fingers (validation/rig_check,
effects.csv). Range: lengths err in proportion.
"""

DIRECTION_DEG = 1.0
"""Largest angle between an LED as the ball shows it and as the rig file has it. One LED at the
limit adds up to 0.03 mm rms to a finger's surface.

Unit: deg. Chosen on: judgement, checked on simulated fingers (validation/rig_check, effects.csv).
Range: at 2 up to 0.07 mm.
"""

TURN_DEG = 1.0
"""Largest turn that takes all LEDs of the rig file to those that the ball shows. At the limit a
finger changes by less than 0.01 mm rms.

Unit: deg. Chosen on: judgement, checked on simulated fingers (validation/rig_check, effects.csv).
Range: up to 2 the same.
"""

MIN_REPEATABILITY = 0.9
"""Smallest correlation of the ridges of two captures of a finger that stayed. The five
sound twins that it was chosen on have 0.98 or more, twenty others 0.91 or more.

Unit: none. Chosen on: simulated fingers (validation/rig_check, seeds 100 to 104). Range: not known.
"""

ALIGN_MM = 0.5
"""Shift of the finger between its two captures, each way, up to which it is undone.

Unit: mm. Chosen on: judgement. Range: not known.
"""

MIN_SHARPNESS_PERCENT = 1.2
"""Smallest sharpness of the finger (see `measure_focus`) at `FOCUS_PX_PER_MM`. The sound
twins that it was chosen on have 1.4 to 4.2; one that is 6 mm out of focus at f/2 has 1.0 to 1.15,
and 19 to 33 % more error in its ridges; 3 mm cost nothing.

Unit: percent. Chosen on: simulated fingers (validation/rig_check, seeds 100 to 104, effects.csv).
Range: not known.
"""

MOTION_MM = 0.13
"""Largest motion of the finger between the shots of a capture, as a capture allows. It costs more
than any other limit: 39 to 55 % more error in the ridges. The sound twins have 0.04.

Unit: mm. Chosen on: judgement, checked on simulated fingers (validation/rig_check, effects.csv).
Range: at 0.26 up to 150 %.
"""

FOCUS_DEPTH_MM = 3.0
"""Depth below the finger's highest point at which focus is judged again.

Unit: mm. Chosen on: judgement. Range: not known.
"""

FOCUS_RANGE_MM = 1.0
"""Heights within this of a depth count for its focus.

Unit: mm. Chosen on: judgement. Range: not known.
"""

FOCUS_PX_PER_MM = 15.0
"""Finer pictures are reduced to this, so that the sharpness of all cameras can be compared.

Unit: px/mm. Chosen on: simulated fingers (validation/rig_check). Range: not known.
"""

# --- phantom

MIN_RIDGES = 0.9
"""Smallest correlation of the phantom's ridges with the drawn ones, where a pixel is 0.07 mm or
less; the sound twin has 0.97.

Unit: none. Chosen on: simulated phantom (validation/rig_check). Range: not known.
"""

MAX_TURN_DEG = 10.0
"""Turn of the phantom against the picture, each way, up to which it is recognised.

Unit: deg. Chosen on: judgement. Range: not known.
"""

REACH_MM = 4.0
"""Shift of the phantom from the middle of the picture, each way, up to which it is recognised.

Unit: mm. Chosen on: judgement. Range: not known.
"""

EDGE_MM = 0.8
"""What lies nearer to the phantom's outline does not count: it is the steepest.

Unit: mm. Chosen on: judgement. Range: not known.
"""

MIN_LIKENESS = 0.5
"""Smallest correlation of the phantom's relief with the drawing at which it counts as recognised.

Unit: none. Chosen on: judgement. Range: not known.
"""

# --- photographs

SERIES_FRACTIONS = (0.15, 0.3, 0.5, 0.7, 0.85, 1.0)
"""Exposures of the card's series, of the longest.

Unit: fraction. Chosen on: judgement. Range: not known.
"""
