"""Constants of galleries that could have been chosen otherwise, by module."""

# --- file

WAIT_S = 10.0
"""How long one waits for another program's transaction.

Unit: s. Chosen on: judgement. Range: not known.
"""

MAX_NAME = 100
"""Longest name of a person.

Unit: characters. Chosen on: judgement. Range: not known.
"""

MAX_KEY_BYTES = 4096
"""Longest file of a key.

Unit: bytes. Chosen on: judgement. Range: not known.
"""

WRITER_S = 2.0
"""How long a pipe may be without a program that writes into it.

Unit: s. Chosen on: judgement. Range: not known.
"""

# --- folder

MAX_TABLE_BYTES = 50_000_000
"""Longest table of an exported folder: a quarter of a million captures.

Unit: bytes. Chosen on: judgement. Range: not known.
"""

# --- gallery

DISSIMILAR_FMR = 0.01
"""False match rate from which on captures of one finger are called dissimilar: so often other
fingers are at least as similar.

Unit: fraction. Chosen on: judgement. Range: not known.
"""

# --- identify

ALL_PRINTS = 200
"""In a gallery of no more captures all are compared.

Unit: captures. Chosen on: speed. Range: not known.
"""

NEAREST = 0.001
"""Fraction of a larger gallery that is compared, or as many as are to be reported: those whose
minutiae agree best.

Unit: fraction. Chosen on: speed (what is lost: real prints, validation/gallery/index.py). Range:
not known.
"""

# --- minutia_index

TABLES = 80
"""Tables of the index.

Unit: none. Chosen on: not known. Range: not known.
"""

BITS = 12
"""Bits of a key.

Unit: bits. Chosen on: not known. Range: not known.
"""

MEAN = 0.157
"""Mean of a cylinder's numbers.

Unit: none. Chosen on: real prints (validation/gallery/index.py). Range: not known.
"""

ROTATIONS = 32
"""Steps of a full turn; votes of two neighbours are added.

Unit: none. Chosen on: not known. Range: not known.
"""

PEAKS = 2
"""Rotations of a capture whose votes are counted by shift.

Unit: none. Chosen on: not known. Range: not known.
"""

CELL_MM = 2.0
"""Side of a cell in which shifts are counted.

Unit: mm. Chosen on: not known. Range: not known.
"""

CELLS = 15
"""Shifts are counted in so many cells along x and y; votes of two neighbours are added.

Unit: none. Chosen on: not known. Range: not known.
"""

COMMON = 2.0
"""A key that more minutiae have than so many times the mean is left out.

Unit: none. Chosen on: speed. Range: not known.
"""

RARE = 8
"""Such a key is kept where no more minutiae have it than these.

Unit: minutiae. Chosen on: speed. Range: not known.
"""

ROTATED_FRACTION = 0.05
"""Fraction of the captures whose shifts are counted.

Unit: fraction. Chosen on: speed. Range: not known.
"""

ALIGNED = 200
"""Captures whose minutiae are laid on the probe's.

Unit: captures. Chosen on: speed. Range: not known.
"""

AGREEMENT_WEIGHT = 20.0
"""Weight of agreeing minutiae beside votes.

Unit: none. Chosen on: not known. Range: not known.
"""

DISTANCE_MM = 0.5
"""Distance at which a minutia laid on another counts 1/e.

Unit: mm. Chosen on: not known. Range: not known.
"""

ANGLE_RAD = 0.35
"""Difference of directions at which a minutia laid on another counts 1/e.

Unit: rad. Chosen on: not known. Range: not known.
"""

REACH_MM2 = 2.25
"""Squared distance beyond which minutiae do not agree: they would count less than 0.0002 each.

Unit: mm2. Chosen on: speed. Range: not known.
"""

FEW = 9.0
"""Minutiae that are added to those that could agree.

Unit: minutiae. Chosen on: not known. Range: not known.
"""

# --- serve

MAX_BODY = 10_000_000
"""Longest request: a print of 7 MB as base64.

Unit: bytes. Chosen on: judgement. Range: not known.
"""

PATIENCE_S = 20.0
"""So long may a body take to arrive, and a connection wait without a request that is complete.

Unit: s. Chosen on: judgement. Range: not known.
"""

WORK_S = 60.0
"""So long may the work of a request take, with its waiting for a free core.

Unit: s. Chosen on: judgement. Range: not known.
"""

MIN_TOKEN = 16
"""Shortest token.

Unit: characters. Chosen on: judgement. Range: not known.
"""
