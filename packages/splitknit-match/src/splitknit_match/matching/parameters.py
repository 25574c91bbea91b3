"""Constants of matching that could have been chosen otherwise, by module."""

from __future__ import annotations

import numpy as np

# --- coarse

COARSE_PITCH_MM = 0.15
"""Side of a pixel of the coarse grid.

Unit: mm. Chosen on: not known. Range: not known.
"""

COARSE_GRID_PX = (216, 216)
"""Rows and columns of the coarse grid; of a finger that is larger the centre is used.

Unit: px. Chosen on: not known. Range: not known.
"""

ROTATION_STEP_DEG = 5.0
"""Step between two rotations whose directions of ridges are compared.

Unit: deg. Chosen on: not known. Range: not known.
"""

ROTATIONS = 6
"""Rotations that are tried on the ridges, each there and half a step on, to the side of the better
neighbour.

Unit: none. Chosen on: real prints (FVC2002 DB1_B). Range: 6 to 8.
"""

UPRIGHT_ROTATIONS = 3
"""Upright rotations that are tried in any case: most fingers lie upright, and where little
overlaps, directions alone find them too seldom.

Unit: none. Chosen on: not known. Range: not known.
"""

UPRIGHT_STEPS = 6
"""Steps to each side of no rotation that count as upright.

Unit: steps. Chosen on: not known. Range: not known.
"""

BLOCK_MM = 1.5
"""Side of a block that has one direction.

Unit: mm. Chosen on: not known. Range: not known.
"""

BLOCKS = (27, 24)
"""Rows and columns of the grid of blocks.

Unit: blocks. Chosen on: not known. Range: not known.
"""

DIRECTION_WINDOW_MM = 1.05
"""Side of the square over which a direction is averaged.

Unit: mm. Chosen on: not known. Range: not known.
"""

CANDIDATES = 2
"""Peaks of a correlation that are looked at closely.

Unit: none. Chosen on: not known. Range: 2 to 3.
"""

MIN_HEIGHT = 0.7
"""Peaks lower than this fraction of the highest are not looked at.

Unit: fraction. Chosen on: speed (2,024 pairs: ten led to another score, by at most 0.04, and none
changed a rate). Range: not known.
"""

WHITENING = 0.5
"""Power of the magnitude that each spectrum is divided by: 0 correlates, 1 keeps phase alone.

Unit: none. Chosen on: not known. Range: not known.
"""

CYCLES_PER_MM = (1.2, min(3.8, 0.5 / COARSE_PITCH_MM))
"""Frequencies of ridges: periods of 0.3 (the grid's finest) to 0.83 mm.

Unit: 1/mm. Chosen on: not known. Range: not known.
"""

POSE_STEP_DEG = 4.0
"""Step between two rotations of a small print.

Unit: deg. Chosen on: not known. Range: not known.
"""

POSES = 8
"""Alignments of a small print that are looked at closely.

Unit: none. Chosen on: not known. Range: not known.
"""

APART_MM = 0.6
"""Alignments of a small print at nearly one rotation lie at least so far apart.

Unit: mm. Chosen on: not known. Range: not known.
"""

OVERLAP_ROTATIONS = 3
"""Rotations for which the overlap of a small print is computed once.

Unit: none. Chosen on: speed. Range: not known.
"""

MIN_POSE_MM2 = 6.0
"""A smaller overlap of a small print counts as if it were this large.

Unit: mm2. Chosen on: not known. Range: not known.
"""

# --- elastic

PATCH_MM = 2.4
"""Side of a patch.

Unit: mm. Chosen on: not known. Range: 1.8 to 3.0 (photographs against simulated presses;
docs/explain/tried.md).
"""

STEP_MM = 1.6
"""Distance between the centres of two patches.

Unit: mm. Chosen on: not known. Range: not known.
"""

SEARCH_MM = 0.4
"""Largest shift of a patch along either axis.

Unit: mm. Chosen on: not known. Range: 0.4 to 0.7 (photographs against simulated presses;
docs/explain/tried.md).
"""

MIN_OVERLAP = 0.6
"""Fraction of a patch that must be valid on both sides.

Unit: fraction. Chosen on: not known. Range: not known.
"""

MIN_CORRELATION = 0.2
"""Patches that correlate less do not count in a fit.

Unit: none. Chosen on: not known. Range: not known.
"""

SPAN_MM = 5.0
"""Affine fit: length over which a linear part of 1 is penalised.

Unit: mm. Chosen on: not known. Range: not known.
"""

AFFINE_NEAR_MM = 0.2
"""Affine fit: residual at which a patch counts half.

Unit: mm. Chosen on: not known. Range: not known.
"""

SMOOTH = 1.0
"""Sigma over which the shifts of patches are averaged, in steps of their grid: skin stretches
smoothly.

Unit: steps. Chosen on: not known. Range: not known.
"""

FIRM = 0.16
"""Weight of a shift that two minutiae show: that of a patch whose correlation is 0.6.

Unit: none. Chosen on: not known. Range: not known.
"""

STILL = 0.05
"""Weight of no shift among those that minutiae show, relative to `FIRM`.

Unit: none. Chosen on: not known. Range: not known.
"""

# --- features

STRIP = 64
"""Rows whose codes are found at once: few enough for the cache.

Unit: rows. Chosen on: speed. Range: not known.
"""

# --- fusion

BENDS = 2
"""Times that the shifts of patches are smoothed and followed.

Unit: none. Chosen on: not known. Range: 2 to 8 (photographs against simulated presses;
docs/explain/tried.md).
"""

PER_MINUTIA = 0.2
"""What an agreeing minutia counts when alignments are compared, beside correlation times the root
of the patches.

Unit: none. Chosen on: simulated presses with pulls. Range: 0.1 to 0.3.
"""

BY_BOTH = (3.5044, 19.9267, -10.2292)
"""Logistic regression of prints that both show minutiae: weights of agreeing minutiae and of
correlation, and offset, which is also the score where nothing was compared. Both classes have equal
weight.

Unit: none. Chosen on: simulated prints (validation/match/fvc.py --fit). Range: not known.
"""

BY_MINUTIAE = (0.8927, -3.947)
"""Logistic regression of prints of which only minutiae could be compared: weight of the support of
their alignment, and offset. Both classes have equal weight.

Unit: none. Chosen on: simulated prints (validation/match/fvc.py --fit). Range: not known.
"""

BY_OVERLAP = (8.4813, 0.5001, -5.6423)
"""Logistic regression of prints without minutiae: weights of the correlation and of that times the
root of the area that overlaps, and offset. Both classes have equal weight.

Unit: none. Chosen on: real prints (windows of them, validation/match/windows.json). Range: not
known.
"""

BY_OVERLAP_AND_MINUTIAE = (4.8715, 8.1117, 0.5104, -6.1373)
"""Logistic regression of small prints: weights of agreeing minutiae, of the correlation, and of
that times the root of the area that overlaps, and offset. Both classes have equal weight.

Unit: none. Chosen on: real prints (windows of them, validation/match/windows.json). Range: not
known.
"""

SMALL_MM2 = 100.0
"""A print that shows less is small: tried in every pose, and rated by what overlaps.

Unit: mm2. Chosen on: not known. Range: not known.
"""

POSES_BENT = 3
"""Poses of a small print that are bent.

Unit: none. Chosen on: not known. Range: not known.
"""

SURE = 9.0
"""Support of an alignment by minutiae from which ridges propose none: 429 of 548 matching pairs of
real prints have it, none of the 14,000 pairs of other fingers that are most similar by minutiae.

Unit: none. Chosen on: real prints (validation/gallery/index.py). Range: not known.
"""

SCALES = (1.0, 0.94, 1.06, 0.88, 1.12)
"""Scales at which a photograph is tried, relative to that at which its ridges lie as far apart as
the other side's do, which is wrong by 7 % (standard deviation).

Unit: none. Chosen on: not known. Range: not known.
"""

MAX_LOG_SCALE = 0.15
"""Natural logarithm of the largest change of a photograph's scale that its ridges are believed.

Unit: none. Chosen on: not known. Range: not known.
"""

ONE_LOG_SCALE = 0.06
"""Natural logarithm of a difference in the distance of ridges that says nothing: pairs of one
finger have 0.03.

Unit: none. Chosen on: not known. Range: not known.
"""

LOG_FREQUENCIES = np.linspace(np.log(1 / 0.9), np.log(1 / 0.28), 41)
"""Natural logarithms of the numbers of ridges in a millimetre between which a print's usual one is
sought.

Unit: none. Chosen on: not known. Range: not known.
"""

FEW = 9.0
"""Minutiae that are added to those that could agree, so that few of few count little.

Unit: minutiae. Chosen on: not known. Range: not known.
"""

# --- inputs

MINUTIAE_PER_MM2 = (0.015, 1.0)
"""Density of minutiae on a finger, lowest and highest: 280 real prints have 0.06 to 0.41, squares
of 9 mm of them 0.025 to 0.72.

Unit: 1/mm2. Chosen on: real prints (280 prints of seven sensors). Range: not known.
"""

JUDGED_MM2 = 100.0
"""Area of a print from which on the density of its minutiae is judged.

Unit: mm2. Chosen on: not known. Range: not known.
"""

# --- methods

DECIDED_AT = 1e-4
"""False match rate at which is decided whether it is one finger.

Unit: fraction. Chosen on: judgement. Range: not known.
"""

# --- minutia_pairs

SIGMOID_CENTRE = 0.234
"""Centre of the sigmoid that lets many minutiae in a cell count little more than one.

Unit: none. Chosen on: not known. Range: not known.
"""

SIGMOID_SLOPE = 17.0
"""Slope of that sigmoid.

Unit: none. Chosen on: not known. Range: not known.
"""

MARGIN_MM = 0.5
"""So far beyond the ridges a print would still show its minutiae.

Unit: mm. Chosen on: not known. Range: not known.
"""

MIN_COMMON = 0.5
"""Fraction of a cylinder that both prints must show.

Unit: fraction. Chosen on: not known. Range: not known.
"""

MAX_COMPARED = 100
"""Minutiae that are compared: the most reliable.

Unit: minutiae. Chosen on: speed. Range: not known.
"""

PAIRS = 120
"""Most similar pairs that are relaxed.

Unit: pairs. Chosen on: not known. Range: not known.
"""

PAIRS_NEAR_MM = 0.3
"""Difference of a distance at which two pairs fit each other by 1/e.

Unit: mm. Chosen on: not known. Range: not known.
"""

STRETCH = 0.08
"""Two pairs may differ in their distance by this fraction of it more, as skin stretches.

Unit: fraction. Chosen on: not known. Range: not known.
"""

TURN_RAD = 0.3
"""Difference of an angle at which two pairs fit each other by 1/e.

Unit: rad. Chosen on: not known. Range: not known.
"""

RELAXATION_STEPS = 5
"""Steps of the relaxation.

Unit: none. Chosen on: not known. Range: not known.
"""

MIN_FIT = 0.2
"""Pairs that fit the best one less do not go with it.

Unit: none. Chosen on: not known. Range: not known.
"""

ARM_MM = 3.0
"""Direction of one minutia counts in an alignment as its place so far from the centre does.

Unit: mm. Chosen on: not known. Range: not known.
"""

FITS_MM = 0.4
"""Distance at which a minutia laid on another counts 1/e.

Unit: mm. Chosen on: not known. Range: not known.
"""

FITS_RAD = 0.35
"""Difference of directions at which a minutia laid on another counts 1/e.

Unit: rad. Chosen on: not known. Range: not known.
"""

DRIFT_MM = (0.7, 0.25)
"""Standard deviation of a minutia's place about its partner's, in the first and the last step of
the drift.

Unit: mm. Chosen on: simulated presses with pulls. Range: 0.5 to 1.0, 0.25 to 0.3.
"""

DRIFT_STEPS = 8
"""Steps of the drift.

Unit: none. Chosen on: simulated presses with pulls. Range: 8 to 15.
"""

SLIP_MM = (0.8, 0.3)
"""Standard deviations of skin's shift along one axis: of its smooth part, and of the whole print.

Unit: mm. Chosen on: simulated presses with pulls. Range: 0.4 to 1.0 (the smooth part).
"""

SLIP_REACH_MM = 4.0
"""Distance over which the correlation of the smooth part falls to exp(-1/2).

Unit: mm. Chosen on: simulated presses with pulls. Range: 3 to 6.
"""

UNPAIRED = 0.1
"""Weight of a minutia having no partner, relative to one that lies on it.

Unit: none. Chosen on: simulated presses with pulls. Range: 0.05 to 0.3.
"""

# --- ridge

REFINEMENTS = 2
"""Affine fits to the patches' shifts.

Unit: none. Chosen on: real prints (FVC2002 DB1_B). Range: not known.
"""

MIN_OVERLAP_MM2 = 60.0
"""Where less skin overlaps, and it is not all that the smaller template has, the similarity is
lowered.

Unit: mm2. Chosen on: not known. Range: not known.
"""

FIRST_STEP_MM = 2.4
"""Step of the patches that refine the coarse alignment.

Unit: mm. Chosen on: real prints (FVC2002 DB1_B). Range: not known.
"""

FIRST_SEARCH_MM = 0.8
"""Largest shift of the patches that refine the coarse alignment.

Unit: mm. Chosen on: not known. Range: not known.
"""

CLOSE_STEP_MM = 1.2
"""Step of the patches that bend a small print.

Unit: mm. Chosen on: not known. Range: not known.
"""

CLOSE_SEARCH_MM = 0.4
"""Largest shift of the patches that bend a small print.

Unit: mm. Chosen on: not known. Range: not known.
"""

MIN_PAIRED = 3
"""Fewest minutiae of a small print that are compared; of other prints it is ten.

Unit: minutiae. Chosen on: not known. Range: not known.
"""

# --- ridge_band

FINEST_MM = 1e-3
"""Finer pixels are not a finger's, and need windows that fill the memory.

Unit: mm. Chosen on: judgement. Range: not known.
"""

COARSEST_MM = 10.0
"""Coarser pixels are not a finger's.

Unit: mm. Chosen on: judgement. Range: not known.
"""

LONGEST_MM = 500.0
"""Longer surfaces are not a finger's, and need grids that fill the memory.

Unit: mm. Chosen on: judgement. Range: not known.
"""

LARGEST_PX = 4_000_000
"""Largest ridge band with its margins, 200 x 200 mm; it takes 100 bytes a pixel.

Unit: px. Chosen on: judgement. Range: not known.
"""

PITCH_MM = 0.1
"""Side of a pixel of the band.

Unit: mm. Chosen on: not known. Range: not known.
"""

RIDGE_MM = 0.32
"""Sigma of the Gaussian mean that is subtracted, to remove what is wider than a ridge.

Unit: mm. Chosen on: not known. Range: not known.
"""

NOISE_MM = 0.05
"""Sigma of the low-pass before sampling.

Unit: mm. Chosen on: not known. Range: not known.
"""

WINDOW_MM = 0.6
"""Sigma of the window over which contrast is made even and ridges are tested for one direction.

Unit: mm. Chosen on: not known. Range: not known.
"""

FLOOR = 0.3
"""Contrast below this fraction of the finger's median is not raised further; half of it is not a
ridge at all.

Unit: fraction. Chosen on: not known. Range: not known.
"""

COHERENCE = 0.2
"""Skin whose ridges have less coherence (0 no direction, 1 parallel) is left out.

Unit: none. Chosen on: not known. Range: not known.
"""

SLANT_DEG = 60.0
"""Skin seen at a steeper slant is left out.

Unit: deg. Chosen on: not known. Range: not known.
"""

# --- score

TAIL = 50
"""Impostors by which rates are extrapolated.

Unit: impostors. Chosen on: not known. Range: not known.
"""

FMR_ROUNDING = 1e-5
"""Similarities are lowered by this before a rate is looked up, so that none comes out too low by
rounding.

Unit: none. Chosen on: judgement. Range: not known.
"""

ENTRIES = 64
"""Entries of a table of false match rates, at most.

Unit: none. Chosen on: judgement. Range: not known.
"""

# --- template

LEAST_MM2 = 30.0
"""Smallest area of ridges; less is a failure to acquire.

Unit: mm2. Chosen on: not known. Range: not known.
"""

LARGEST_SIDE = 2048
"""Rows or columns at most.

Unit: px. Chosen on: judgement. Range: not known.
"""

FINEST_UM = 50
"""Finer pixels count as if they were so large: work grows with their number.

Unit: um. Chosen on: speed. Range: not known.
"""
