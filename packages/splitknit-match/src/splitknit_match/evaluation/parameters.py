"""Constants of evaluation that could have been chosen otherwise, by module."""

# --- evaluate

MAX_SYSTEMS = 12
"""Systems and variants on one page, at most.

Unit: systems. Chosen on: judgement. Range: not known.
"""

# --- fusion

FOLDS = 5
"""Folds of the cross-validation; fewer where there are fewer subjects.

Unit: none. Chosen on: judgement. Range: not known.
"""

PENALTY = 1e-3
"""Penalty of the logistic regression: on half the sum of the squared weights, where the mean loss
is 1.

Unit: none. Chosen on: not known. Range: not known.
"""

# --- gallery_scores

KEPT_FINGERS = 32
"""Fingers kept ready at a time: 2 to 16 MB each.

Unit: fingers. Chosen on: speed. Range: not known.
"""

# --- intervals

FEW = 5
"""Fingers (subjects, comparisons) below which percentiles of replicates are not trusted alone.

Unit: none. Chosen on: not known. Range: not known.
"""

# --- pair

STEP_MM = 0.05
"""Smallest pitch on which surfaces are compared.

Unit: mm. Chosen on: not known. Range: not known.
"""

ELASTIC_MM = 2.5
"""Longest wavelength that is compared on skin that may shift.

Unit: mm. Chosen on: not known. Range: not known.
"""

BLOCK_MM = 2.0
"""Side of the blocks that are resampled.

Unit: mm. Chosen on: not known. Range: not known.
"""

MIN_BLOCKS = 6
"""With fewer blocks a figure has no interval.

Unit: blocks. Chosen on: not known. Range: not known.
"""

REPLICATES = 1000
"""Replicates of the bootstrap of blocks.

Unit: none. Chosen on: judgement. Range: not known.
"""

MIN_SIMILARITY = 0.4
"""Least similarity of the ridges of one finger; ridges of two fingers have about 0.2.

Unit: none. Chosen on: not known. Range: not known.
"""

MIN_COSINE = 0.5
"""Surface seen at more than 60 deg is not compared.

Unit: cosine. Chosen on: not known. Range: not known.
"""

EDGE_MM = 0.4
"""Surface nearer to its edge is not compared.

Unit: mm. Chosen on: not known. Range: not known.
"""

SWEEPS = 6
"""Steps of the elastic fit.

Unit: none. Chosen on: not known. Range: not known.
"""

SKIN_MM = 1.0
"""Sigma over which skin's shifts are averaged.

Unit: mm. Chosen on: not known. Range: not known.
"""

STEPS = 25
"""Steps of the rigid fit, at most.

Unit: none. Chosen on: not known. Range: not known.
"""

ORDER = 9
"""Order of the polynomial for the slow shape.

Unit: none. Chosen on: not known. Range: not known.
"""

# --- pair_page

LONGEST_PX = 700
"""Longest side of a picture.

Unit: px. Chosen on: judgement. Range: not known.
"""

APART_UM = 20.0
"""Largest difference that has a colour of its own.

Unit: um. Chosen on: judgement. Range: not known.
"""

HIGH_UM = 60.0
"""Largest height that has a colour of its own.

Unit: um. Chosen on: judgement. Range: not known.
"""

# --- rates

SLACK = 1e-12
"""Relative slack of rates: 0.001 of 1000 impostors is one, whatever the last bit of 0.001 is.

Unit: fraction. Chosen on: judgement. Range: not known.
"""

CONFIDENCE = 0.95
"""Confidence of all intervals.

Unit: fraction. Chosen on: judgement. Range: not known.
"""

# --- scores

MAX_BYTES = 500_000_000
"""Longest score file: ten million comparisons.

Unit: bytes. Chosen on: judgement. Range: not known.
"""
