"""Tuned constants of the simulated calibration targets."""

# --- flat

BOARD_TRIES = 200
"""Poses that are drawn, for each wanted one, before a board counts as too large for the picture.

Unit: none. Chosen on: judgement. Range: not known.
"""
BOARD_TILT_DEG = (10.0, 35.0)
"""Range of a held board's tilt against the finger plane, about any axis in it, drawn evenly.

Unit: deg. Chosen on: judgement. Range: not known.
"""
BOARD_TURN_DEG = (-15.0, 15.0)
"""Range of a held board's turn about its own normal, drawn evenly.

Unit: deg. Chosen on: judgement. Range: not known.
"""
BOARD_HEIGHT_MM = (-5.0, 5.0)
"""Range of the height of a held board's centre over the finger plane, drawn evenly.

Unit: mm. Chosen on: judgement. Range: not known.
"""
BOARD_MARGIN = 0.02
"""Margin that a held board leaves free on every side, over the picture's height.

Unit: fraction. Chosen on: judgement. Range: not known.
"""

# --- solids

RELIEF_STEPS = 10
"""Steps in which a line of sight finds a relief.

Unit: none. Chosen on: judgement. Range: not known.
"""
RIM_SAMPLES = 12
"""Samples across a pixel in which the rim of an LED's mirror image lies.

Unit: none. Chosen on: speed. Range: not known.
"""
