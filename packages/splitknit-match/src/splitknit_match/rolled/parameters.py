"""Constants of rolled fingers that could have been chosen otherwise, by module."""

from __future__ import annotations

import numpy as np

# --- chart

BEYOND_MM = 16.0
"""The camera's rays are followed from this far above the finger's axis.

Unit: mm. Chosen on: judgement. Range: not known.
"""

# --- finger

ROLL_OF_SHEAR = -3.1
"""Roll to the right for each unit of a body's shear.

Unit: rad. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors). Range:
not known.
"""

MAX_ROLL_RAD = 0.3
"""Largest roll that a body's shear shows.

Unit: rad. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors). Range:
not known.
"""

PITCH_MM = 0.035
"""Pitch of the chart of the print, finer than the camera resolves.

Unit: mm. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors). Range: not
known.
"""

AROUND_SKIN_DEG = 105.0
"""The chart of the print reaches this far to either side of the front.

Unit: deg. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors). Range:
not known.
"""

SHAPE_PITCH_MM = 0.25
"""Pitch of the chart of the smooth finger.

Unit: mm. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors). Range: not
known.
"""

FAN_DEG = 75.0
"""How far the chart bends over the tip.

Unit: deg. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors). Range:
not known.
"""

BELOW_MM = 4.0
"""The chart goes on below what the outlines show: light from there matters.

Unit: mm. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors). Range: not
known.
"""

AROUND_DEG = 172.0
"""The chart of the smooth finger reaches this far to either side of the front.

Unit: deg. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors). Range:
not known.
"""

STATIONS = 60
"""Sections of a body of which the typical one is taken.

Unit: none. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors). Range:
not known.
"""

SEARCH_PITCH_MM = 0.1
"""Pitch of the chart on which ridges are compared.

Unit: mm. Chosen on: speed. Range: not known.
"""

MIN_COSINE = 0.25
"""Views are compared where both see the skin less steeply than this.

Unit: cosine. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors). Range:
not known.
"""

MIN_MEETING = 0.3
"""Correlation of two views' ridges below which they do not lie on each other.

Unit: none. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors). Range:
not known.
"""

SURE_MEETING = 0.4
"""Correlation of two views' ridges below which they may not lie on each other.

Unit: none. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors). Range:
not known.
"""

STEEPEST_DEG = 72.0
"""Slant, as a view sees it, from which it counts for nothing.

Unit: deg. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors). Range:
not known.
"""

FADE_MM = 0.8
"""Width over which a view fades in from the outline of what it shows.

Unit: mm. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors). Range: not
known.
"""

MAX_DEVIATION_MM = 0.035
"""Where the relief's standard deviation exceeds this, ridges are unknown; a view loses weight from
three quarters of it on.

Unit: mm. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors). Range: not
known.
"""

POWER = 8.0
"""Views weigh with this power of what their slant leaves: high hands over fast, low mixes over a
wide zone.

Unit: none. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors). Range:
not known.
"""

DEVIATION_FLOOR_MM = 0.004
"""Added to the relief's standard deviation, so that no view is trusted without limit.

Unit: mm. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors). Range: not
known.
"""

# --- register

KNOT_MM = 2.5
"""Distance of the knots of the correction of the surface.

Unit: mm. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors). Range: not
known.
"""

POSE_PRIOR = (0.004, 0.002, 0.05)
"""Standard deviations of a mirror's two turns (rad) and its shift (mm).

Unit: rad, rad, mm. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors).
Range: not known.
"""

DEPTH_PRIOR_MM = 0.15
"""Standard deviation of the surface against where it is taken to be.

Unit: mm. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors). Range: not
known.
"""

UNSEEN_PRIOR_MM = 0.03
"""The same standard deviation where no two views show the surface.

Unit: mm. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors). Range: not
known.
"""

OUTLINE_PRIOR_MM = 0.05
"""The same standard deviation where the front's outline determines the surface.

Unit: mm. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors). Range: not
known.
"""

OUTLINE_DEG = 15.0
"""The front's outline determines the surface so near to a right angle from the front.

Unit: deg. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors). Range:
not known.
"""

BEND_PRIOR_MM = 0.04
"""Standard deviation of the correction's second difference from knot to knot.

Unit: mm. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors). Range: not
known.
"""

CORRELATED_MM = 0.3
"""Ridges are independent at about this distance.

Unit: mm. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors). Range: not
known.
"""

ROBUST = 1.0
"""Difference of two views' ridges, of unit contrast, from which it counts less and less.

Unit: none. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors). Range:
not known.
"""

ROUNDS = 12
"""Rounds of the registration, at most.

Unit: none. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors). Range:
not known.
"""

FEW = 500
"""Pixels that both views show; with fewer a mirror is left as it is.

Unit: px. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors). Range: not
known.
"""

SEARCHED = 6000
"""So many pixels show which of many guesses is best.

Unit: px. Chosen on: speed. Range: not known.
"""

APART_MM = 0.15
"""Moves that differ by less than this lead to the same place.

Unit: mm. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors). Range: not
known.
"""

OUTER = 0.9
"""How much more the surface bulges for each 20 deg towards the side, over the bulge's standard
deviation.

Unit: none. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors). Range:
not known.
"""

LIKE_PLACES = 20.0
"""A move of a mirror counts as so many measured places.

Unit: none. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors). Range:
not known.
"""

MOVE_MM = 0.05
"""Standard deviation of each of these places.

Unit: mm. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors). Range: not
known.
"""

DOUBT = 0.01
"""Correlation that a number must gain to be believed one standard deviation from what the outlines
show.

Unit: none. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors). Range:
not known.
"""

MIN_CORRELATION = 0.2
"""Correlation of two views' ridges below which nothing is changed.

Unit: none. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors). Range:
not known.
"""

ACROSS_MM = 1.6
"""Largest offset of the mirror's ridges against the front's around the finger.

Unit: mm. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors). Range: not
known.
"""

ACROSS_CUT_MM = 3.0
"""The same offset of views that are cut: their mirrors' poses are known less well.

Unit: mm. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors). Range: not
known.
"""

ALONG_MM = 0.3
"""Largest offset of the mirror's ridges along the finger.

Unit: mm. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors). Range: not
known.
"""

STEP_MM = 0.05
"""Step of these offsets.

Unit: mm. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors). Range: not
known.
"""

BULGE_MM = 0.2
"""Standard deviation of the surface's bulge half-way between front and side, where outlines
determine it.

Unit: mm. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors). Range: not
known.
"""

SHIFT_MM = 0.06
"""Standard deviation of the mirror's place along its normal, where outlines determine it.

Unit: mm. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors). Range: not
known.
"""

TURN_DEG = 0.2
"""Standard deviation of the mirror's turns, where outlines determine them.

Unit: deg. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors). Range:
not known.
"""

SHIFT_CUT_MM = 0.6
"""Standard deviation of the place of a mirror whose view is cut.

Unit: mm. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors). Range: not
known.
"""

TURN_CUT_DEG = 0.6
"""Standard deviation of the turns of a mirror whose view is cut.

Unit: deg. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors). Range:
not known.
"""

CANDIDATES = 6
"""Best guesses that are refined.

Unit: none. Chosen on: speed. Range: not known.
"""

SIMPLEX = np.array([0.003, 0.001, 0.03, 0.03, 0.05, 0.03])
"""First steps of the refinement: two turns (rad), shift and bulges (mm).

Unit: rad, rad, mm. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors).
Range: not known.
"""

# --- views

EDGE_BAND_MM = 0.3
"""So near to its edge a light counts for nothing; as far again it counts in part.

Unit: mm. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors). Range: not
known.
"""

LIT = 0.5
"""Trust from which a light counts.

Unit: none. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors). Range:
not known.
"""

MIN_LIT = 3
"""Lights that a slope needs.

Unit: lights. Chosen on: judgement. Range: not known.
"""

FADE_LIT_MM = 0.2
"""Width over which skin with fewer lights fades out.

Unit: mm. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors). Range: not
known.
"""

UNKNOWN_MM = 0.02
"""Standard deviation of a relief that no network estimated.

Unit: mm. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors). Range: not
known.
"""

SLOPE_PRIOR = 0.5
"""Holds slopes which the lights hardly determine to those of the shape: variance of the images'
relative error over that of the slopes.

Unit: none. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors). Range:
not known.
"""

ROWS = 64
"""Rows of the grid whose normals are computed at once.

Unit: rows. Chosen on: speed. Range: not known.
"""

MAX_SLOPE = 6.0
"""Steeper slopes are shortened to this.

Unit: none. Chosen on: judgement. Range: not known.
"""

SHAPELET_SCALES = 4
"""Scales of the shapelets where no network estimates the relief.

Unit: none. Chosen on: simulated fingers (11, 101, 102 and 201 to 204 between two mirrors). Range:
not known.
"""
