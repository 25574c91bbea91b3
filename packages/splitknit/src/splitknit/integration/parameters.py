"""Tuned constants of the integration of slopes and of the knitting of relief and shape."""

# --- frankot_chellappa

WORKERS = 2
"""Threads of the transforms; the result does not depend on it.

Unit: none. Chosen on: speed. Range: not known.
"""
TRANSFER_SAMPLES = 8192
"""Samples of a transfer function over the frequency, which ends at sqrt(2) pi: they are 0.0005
rad/px apart, and a smooth transfer function is known to 1e-6.

Unit: none. Chosen on: speed. Range: not known.
"""

# --- knit

COARSE_MM = 0.2
"""Pitch at which the grid's unevenness, which is smooth, is accounted for.

Unit: mm. Chosen on: speed. Range: not known.
"""
TOP_SHARE = 0.998
"""Quantile of the heights that is taken for the highest point.

Unit: fraction. Chosen on: judgement. Range: not known.
"""

# --- poisson

COARSEST = 4
"""Shorter side of the coarsest grid.

Unit: px. Chosen on: speed. Range: not known.
"""
COARSEST_SWEEPS = 48
"""Chebyshev sweeps on the coarsest grid.

Unit: none. Chosen on: speed. Range: not known.
"""
LONGEST_SWEPT = 16
"""A coarsest grid with a longer side is solved directly, not by sweeps.

Unit: px. Chosen on: speed. Range: not known.
"""
WELDED = 0.02
"""Fraction of coarse pixels that may join what is not joined inside them.

Unit: fraction. Chosen on: not known. Range: not known.
"""
MOST_DIRECT = 100_000
"""Unknowns that a direct solver is trusted with.

Unit: none. Chosen on: speed. Range: not known.
"""
GROUND = 1e-9
"""Added to the diagonal of the direct system, relative to its mean: it fixes the free constant of
every part.

Unit: fraction. Chosen on: judgement. Range: not known.
"""
TOLERANCE = 1e-5
"""Stop when the estimated rms error of the solver falls below this part of the rms height.

Unit: fraction. Chosen on: judgement. Range: not known.
"""
ENERGY_EXCESS = 1e-4
"""Part of itself by which the energy of a weighted solution may exceed its minimum.

Unit: fraction. Chosen on: judgement. Range: not known.
"""
ENERGY_ROUNDING = 1e-12
"""Part of the gradients' own energy by which the energy may exceed its minimum.

Unit: fraction. Chosen on: judgement. Range: not known.
"""
MOST_FACTORISED = 30_000
"""Unknowns up to which factorising weighted equations takes less time than iterating.

Unit: none. Chosen on: speed. Range: not known.
"""
RESTARTS = 3
"""Runs of conjugate gradients at most: each starts from the true residual, from which its own
drifts.

Unit: none. Chosen on: speed. Range: not known.
"""
WEIGHT_FLOOR = 1e-3
"""Smaller weights are raised to this, so that a hole in the data is bridged smoothly and not cut
out.

Unit: none. Chosen on: not known. Range: not known.
"""
MAX_ITERATIONS = 300
"""Conjugate-gradient iterations of the integration at most; a finger needs three to five, a maze a
few dozen.

Unit: none. Chosen on: judgement. Range: not known.
"""
