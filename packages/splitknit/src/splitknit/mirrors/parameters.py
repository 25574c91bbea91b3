"""Constants of the shape from mirrors that could have been chosen otherwise, by module."""

# --- body

OVAL_NODES = 400
"""Nodes of the table of an oval's normals.

Unit: none. Chosen on: speed. Range: 200 to 800 (validation/parameters).
"""

MAX_SQUARE = 0.45
"""Largest squareness: beyond, the oval is no longer convex.

Unit: none. Chosen on: judgement. Range: not known.
"""

STATIONS = 120
"""Sections along the finger in the table of heights.

Unit: none. Chosen on: speed. Range: 60 to 240 (validation/parameters).
"""

SECTION_ANGLES = 181
"""Angles at which each of these sections is computed.

Unit: none. Chosen on: speed. Range: 90 to 362 (validation/parameters).
"""

SECTION_NODES = 121
"""Places across each section in the table of heights.

Unit: none. Chosen on: speed. Range: 60 to 242 (validation/parameters).
"""

STEEPEST_DEG = 24.0
"""Slopes of the skin are used up to here: steeper skin looks flatter than it is.

Unit: deg. Chosen on: not known. Range: none within 0.7 to 1.4 (validation/parameters).
"""

# --- captured

DETAIL_MM = 1.5
"""Finer detail comes from white light (creases); light by way of the mirrors bends what is wider.
With 5 mm the surface of eight fingers is 0.189 mm off, with 1.5 mm 0.160 mm.

Unit: mm. Chosen on: simulated fingers (eight, docs/explain/tried.md, "Mirrors"). Range: 1.05 to 1.5
(validation/parameters).
"""

SLOPES_MM = 0.25
"""Pitch of the images from which slopes are measured.

Unit: mm. Chosen on: not known. Range: 0.125 to 0.5 (validation/parameters).
"""

SLOPES_APART_MM = 1.0
"""Distance of the places whose slopes are used.

Unit: mm. Chosen on: not known. Range: 0.5 to 2 (validation/parameters).
"""

RIM_MM = 1.2
"""Skin nearer to the outline than this is not used: light is lost there.

Unit: mm. Chosen on: not known. Range: 0.6 to 2.4 (validation/parameters).
"""

# --- fit

DIFFERENCES = {
    "tip_mm": 1e-3,
    "squareness": 1e-4,
    "shear": 1e-4,
    "shear_slope": 1e-4,
    "turn_rad": 1e-5,
    "lean_rad": 1e-5,
    "shift_mm": 1e-3,
}
"""Steps of the difference quotients, by parameter.

Unit: that of the parameter. Chosen on: judgement. Range: 0.5 to 2 times these values
(validation/parameters).
"""

MAX_STEPS = {
    "tip_mm": 1.0,
    "squareness": 0.15,
    "shear": 0.2,
    "shear_slope": 0.2,
    "turn_rad": 0.04,
    "lean_rad": 0.04,
    "shift_mm": 2.0,
}
"""Largest steps of one correction, by parameter.

Unit: that of the parameter. Chosen on: not known. Range: 0.5 to 2 times these values
(validation/parameters).
"""

ANGLE_DEG = 1.5
"""Standard deviation of the mirrors' angles about their nominal ones.

Unit: deg. Chosen on: judgement. Range: none within 0.7 to 1.4 (validation/parameters).
"""

OFFSET_MM = 1.5
"""Standard deviation of the mirrors' places about their nominal ones.

Unit: mm. Chosen on: judgement. Range: 1.05 to 3 (validation/parameters).
"""

OUTLINE_MM = 0.05
"""Standard deviation of a point of an outline.

Unit: mm. Chosen on: not known. Range: none within 0.7 to 1.4 (validation/parameters).
"""

SQUARENESS_SD = 0.08
"""Standard deviation of the expected squareness; slopes weigh more.

Unit: none. Chosen on: not known. Range: none within 0.7 to 1.4 (validation/parameters).
"""

SLOPE_ERROR = 0.1
"""Standard deviation of a measured slope of the skin, which looks flatter than it is.

Unit: slope. Chosen on: not known. Range: none within 0.7 to 1.4 (validation/parameters).
"""

SHEAR_SD = 0.05
"""Standard deviation of the shear: a roll by 8 deg gives about 0.045.

Unit: none. Chosen on: judgement. Range: none within 0.7 to 1.4 (validation/parameters).
"""

INDEPENDENT_SLOPES = 20.0
"""All slopes weigh as so many independent ones: they err together at specular reflections, and
where light by way of a mirror ends.

Unit: none. Chosen on: not known. Range: none within 0.7 to 1.4 (validation/parameters).
"""

MIN_SLOPES = 20
"""Fewer slopes are not used.

Unit: none. Chosen on: judgement. Range: not known.
"""

TIP_SD_MM = 0.05
"""Standard deviation of the tip's place by the front view's outline.

Unit: mm. Chosen on: not known. Range: 0.025 to 0.1 (validation/parameters).
"""

COMMON_MM = 4.0
"""Points of an outline that are nearer to each other than this err together.

Unit: mm. Chosen on: not known. Range: 2.8 to 5.6 (validation/parameters).
"""

EDGE_SD_MM = 0.1
"""Standard deviation of the error that a whole edge of a view has in common, at its middle and from
there to its end: shading, blur and the threshold move it as a whole, which a mirror's pose would
otherwise explain.

Unit: mm. Chosen on: not known. Range: 0.05 to 0.2 (validation/parameters).
"""

FIT_ROUNDS = 9
"""Maximum corrections of a fit.

Unit: none. Chosen on: speed. Range: 6 to 18 (validation/parameters).
"""

SURE_FROM = 4
"""Corrections before points of an outline may be left out altogether.

Unit: none. Chosen on: not known. Range: 2 to 8 (validation/parameters).
"""

HELD_ROUNDS = 3
"""Corrections in which mirrors keep their nominal place.

Unit: none. Chosen on: not known. Range: 2 to 6 (validation/parameters).
"""

HELD_PRIORS = {"lean_rad": (0.0, 1e-3), "shift_mm": (0.0, 0.05)}
"""Expected value and standard deviation that hold mirrors in their nominal place in these first
corrections, in which the body's size is estimated: under spreading rays a wrong size is otherwise
taken for another height, and mirrors follow it.

Unit: that of the parameter. Chosen on: not known. Range: not known.
"""

SETTLED_MM = 0.01
"""A correction of the splines below this is the last one.

Unit: mm. Chosen on: speed. Range: not known.
"""

DISAGREEING_MM = 0.12
"""Views that agree no better than this (rms) have a wrong edge; usual are 0.02 to 0.07.

Unit: mm. Chosen on: simulated fingers. Range: not known.
"""

MISFIT_MM = 0.6
"""Views that agree no better than this (median) are not of one finger.

Unit: mm. Chosen on: not known. Range: not known.
"""

THICKNESS = (0.4, 1.4)
"""Thickness of fingers over their breadth, from and to.

Unit: none. Chosen on: judgement. Range: not known.
"""

MAX_MIRROR_DEG = 7.0
"""A mirror that would be further off its place in the rig file than this is rejected.

Unit: deg. Chosen on: judgement. Range: not known.
"""

# --- mirror

KNOTS = 11
"""Spans of the splines along the finger.

Unit: none. Chosen on: not known. Range: 8 to 22 (validation/parameters).
"""

MAX_TURN_RAD = 0.12
"""Mirrors are not turned by more.

Unit: rad. Chosen on: judgement. Range: 0.06 to 0.24 (validation/parameters).
"""

TURN_SD_DEG = 0.2
"""Standard deviation of a mirror's turn as the views' tips show it.

Unit: deg. Chosen on: not known. Range: 0.1 to 0.4 (validation/parameters).
"""

CUT_TURN_SD_DEG = 0.6
"""The same where the view is cut.

Unit: deg. Chosen on: not known. Range: not known.
"""

MIN_POINTS = 20
"""A view with fewer points of its outline is not used.

Unit: none. Chosen on: judgement. Range: not known.
"""

MAX_MISSING = 0.4
"""Largest missing fraction of the pad's outline; the rest may be the mirror's edge.

Unit: fraction. Chosen on: not known. Range: not known.
"""

NEAR_EDGE_MM = 3.0
"""A straight outline this near to the mirror's nominal edge is that edge.

Unit: mm. Chosen on: not known. Range: not known.
"""

CUT_ROUNDS = 20
"""Maximum corrections of the fit where views are cut: the first guess is further off.

Unit: none. Chosen on: speed. Range: not known.
"""

# --- outline

ROW_MM = 0.15
"""Distance of the rows in which the outlines are measured.

Unit: mm. Chosen on: not known. Range: 0.075 to 0.3 (validation/parameters).
"""

ROWS_A_POINT = 2
"""Every so many rows give one point of an outline in the fit.

Unit: none. Chosen on: speed. Range: none within 0.7 to 1.4 (validation/parameters).
"""

STRAIGHT_MM = 0.012
"""Rms below which an outline is a mirror's edge: pads bulge.

Unit: mm. Chosen on: not known. Range: not known.
"""

MASK_BLUR_PX = 1.2
"""A mask is smoothed by this much before its outline is measured between the pixels.

Unit: px. Chosen on: not known. Range: 0.6 to 1.68 (validation/parameters).
"""

BORDER_PX = 3.0
"""An outline this near to the image's border is cut by it.

Unit: px. Chosen on: judgement. Range: 1.5 to 6 (validation/parameters).
"""

# --- reflection

GRAZING = 0.04
"""Cosine of incidence up to which a light fades in: the ridges of skin catch it here and there.

Unit: none. Chosen on: not known. Range: 0.02 to 0.08 (validation/parameters).
"""

MIRROR_EDGE_MM = 0.4
"""Width over which light by way of a mirror fades out at the mirror's edge.

Unit: mm. Chosen on: not known. Range: 0.2 to 0.8 (validation/parameters).
"""

# --- views

VIEWS_PX_PER_MM = 22.0
"""Scale of the copy on which the outlines are measured.

Unit: px/mm. Chosen on: speed. Range: not known.
"""

REACH_MM = 3.0
"""A mirror's picture is searched for this far beyond its nominal outline.

Unit: mm. Chosen on: judgement. Range: 1.5 to 6 (validation/parameters).
"""

SEARCH_PX_PER_MM = 4.0
"""Views are searched for on a copy of about this scale.

Unit: px/mm. Chosen on: speed. Range: 2 to 8 (validation/parameters).
"""
