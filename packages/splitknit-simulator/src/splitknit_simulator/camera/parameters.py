"""Tuned constants of the simulated camera, its lens and its sensor."""

# --- device

LONGEST_EXPOSURE_S = 0.2
"""Longest exposure time that the camera accepts, as the Raspberry Pi's camera does.

Unit: s. Chosen on: judgement (14 photographs in 7 s). Range: not known.
"""
TRANSFER_S = 0.07
"""Time from the end of the readout until the program has the picture.

Unit: s. Chosen on: not known. Range: not known.
"""
LAG_FRAMES = 3
"""Frames until a new exposure takes effect.

Unit: frames. Chosen on: not known. Range: not known.
"""
PREVIEW_COLUMNS = 800
"""Approximate width of a preview: the picture is reduced by a whole number.

Unit: px. Chosen on: judgement. Range: not known.
"""
SENSITIVITY_PER_S = 500.0
"""Fraction of full scale that light of radiance one (in the rig's units) gives in a second at gain
one.

Unit: 1/s. Chosen on: not known. Range: not known.
"""
SETTLE_S = 0.02
"""Time until an LED reaches full brightness; the Raspberry Pi's lights wait as long.

Unit: s. Chosen on: judgement (far above what an LED and its supply need). Range: not known.
"""

# --- lens

BLUR_LEVELS_PER_DOUBLING = 2
"""Evenly blurred images for each doubling of the blur's width; pixels interpolate between them.

Unit: none. Chosen on: speed. Range: not known.
"""

# --- sensor

ROWS_AT_A_TIME = 64
"""Rows that are exposed together, which limits memory; noise is drawn in the order of the rows.

Unit: px. Chosen on: speed. Range: any (the result is the same).
"""
