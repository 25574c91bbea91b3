"""Constants of the separation of light that could have been chosen otherwise, by module."""

# --- direct

LEVEL_BLOCK_PX = 8
"""Side of the blocks over which the local brightness is averaged.

Unit: px. Chosen on: speed. Range: 4 to 16 (validation/parameters).
"""

LEVEL_SIGMA_PX = 16.0
"""Standard deviation of the neighbourhood whose mean brightness the network takes as one; it was
trained with it.

Unit: px. Chosen on: not known. Range: 8 to 32 (validation/parameters).
"""

MIN_LEVEL = 0.05
"""The local brightness does not fall below this fraction of the image's white: in the dark there is
noise alone.

Unit: fraction. Chosen on: not known. Range: not known.
"""

# --- folder

RIDGES_A_FINGER = 45
"""Periods of ridges that a picture of a finger is about long.

Unit: none. Chosen on: judgement. Range: not known.
"""

REPORTED_LEVEL = 0.1
"""Figures of the report are over pixels brighter than this fraction of the brightest.

Unit: fraction. Chosen on: judgement. Range: not known.
"""

# --- stacks

MAX_CLIPPED = 0.02
"""A stack with more clipped pixels is refused: its maximum, so its direct light, is wrong.

Unit: fraction. Chosen on: not known. Range: not known.
"""

LIT_LEVEL = 0.1
"""Only pixels brighter than this fraction of the brightest ones are checked: no black background,
and nothing that 8 bits cannot resolve.

Unit: fraction. Chosen on: judgement. Range: not known.
"""

MIN_CONTRAST = 0.005
"""A pixel that changes by less than this fraction of its maximum was never lit, or never dark.

Unit: fraction. Chosen on: not known. Range: not known.
"""

MAX_CONSTANT = 0.05
"""A stack with more such pixels among the bright ones is refused.

Unit: fraction. Chosen on: not known. Range: not known.
"""

BLACK_IMAGE = 0.03
"""An image whose bright pixels stay below this fraction of the other images' is black.

Unit: fraction. Chosen on: not known. Range: not known.
"""

CLIP_LEVEL = 0.99
"""Linear light from which on a value of a file counts as clipped.

Unit: full scale. Chosen on: judgement. Range: not known.
"""

STATE_EDGE = 0.1
"""Known states are lit from one less this, dark up to this; the rim of a check is left out.

Unit: none. Chosen on: not known. Range: 0.05 to 0.2 (validation/parameters).
"""

DECIDED_PART = 1 - 2 * 0.2
"""Part of half the range of its neighbours beyond which a pixel's state is decided.

Unit: fraction. Chosen on: not known. Range: not known.
"""
