"""Constants of prints that could have been chosen otherwise, by module."""

from __future__ import annotations

import numpy as np

# --- curvature

MIN_FRACTION = 0.75
"""Fraction of the window that must lie on the finger; elsewhere the curvature is unknown.

Unit: fraction. Chosen on: not known. Range: not known.
"""

# --- enhance

GABOR_SIGMA_PERIODS = 0.5
"""Standard deviation of a Gabor filter, in local ridge periods.

Unit: ridge periods. Chosen on: not known. Range: not known.
"""

CONTRAST = 2.0
"""Steepness of the grey curve of an enhanced print; 0.5 is soft, 3 is nearly black and white.

Unit: none. Chosen on: not known. Range: not known.
"""

ENHANCED_FLOOR = 0.15
"""Ridges weaker than this fraction of the print's median are not raised further.

Unit: fraction. Chosen on: not known. Range: not known.
"""

# --- fingerphoto

THICKNESS = 0.8
"""Depth over breadth of a fingertip.

Unit: fraction. Chosen on: not known. Range: not known.
"""

PHOTO_SLANT_DEG = 70.0
"""Skin that is steeper is left out of the print of a photograph.

Unit: deg. Chosen on: not known. Range: not known.
"""

PHOTO_LENGTH = 1.5
"""Length from the tip that is kept: about to the first crease.

Unit: widths of the finger. Chosen on: not known. Range: not known.
"""

MIN_WIDTH_PX = 130
"""Smallest width of a finger in a photograph.

Unit: px. Chosen on: not known. Range: not known.
"""

KEPT_WIDTH_PX = 700
"""Largest width of a finger in the picture that is kept; a larger picture is reduced.

Unit: px. Chosen on: speed. Range: not known.
"""

RIM_PX = 8
"""Rim of a print that is left out.

Unit: px. Chosen on: not known. Range: not known.
"""

SHADING_PX = 9.0
"""Sigma over which shading is taken out of the print of a photograph.

Unit: px. Chosen on: not known. Range: not known.
"""

MIN_QUALITY = 10
"""Least quality of a photograph; without ridges in view it is 0 to 22.

Unit: %. Chosen on: simulated fingers (drawn telephone photographs, validation/match/telephone.py).
Range: not known.
"""

GOOD = 50
"""Quality of a photograph from which on nothing has to be changed.

Unit: %. Chosen on: not known. Range: not known.
"""

PHOTO_CLEAR = 0.4
"""Confidence from which on the ridges of a photograph are clear.

Unit: none. Chosen on: not known. Range: not known.
"""

PHOTO_FAINT_WAVE = 0.003
"""Least height of a ridge's wave over the light around it: steps of 8 bits look like half as much.

Unit: fraction. Chosen on: not known. Range: not known.
"""

NEARER = 1.04
"""Scale of the pad over that of the outline, 7 mm behind it, for a camera about 18 cm away.

Unit: none. Chosen on: not known. Range: not known.
"""

PAD = (0.3, 1.1)
"""Range from the tip along the skin where ridges are as far apart as contact prints show them;
below they are wider apart.

Unit: widths of the finger. Chosen on: not known. Range: not known.
"""

# --- folder

MAX_SENTENCES = 3
"""Findings on the quality of one print, at most.

Unit: none. Chosen on: judgement. Range: not known.
"""

MIN_RATING = 0.7
"""A figure of a lower rating is mentioned.

Unit: none. Chosen on: simulated fingers (with and without a fault, scale 0.4). Range: not known.
"""

FULL_RATING = 0.95
"""Rating of the ridges' height from which on soft edges are the finger's own.

Unit: none. Chosen on: simulated fingers (with and without a fault, scale 0.4). Range: not known.
"""

# --- from_file

USUAL_PERIOD_MM = 0.46
"""Usual distance between ridges of adults' fingers; people differ by 8 %.

Unit: mm. Chosen on: not known. Range: not known.
"""

MIN_PPI = 200.0
"""Below there are no ridges (telephones and browsers state 72 and 96, of screens).

Unit: ppi. Chosen on: judgement. Range: not known.
"""

MAX_PPI = 5080.0
"""Highest resolution of a print: no scanner is above.

Unit: ppi. Chosen on: judgement. Range: not known.
"""

FINE_PPI = 1000.0
"""Above, the level of ridges is sought in a copy of 500 ppi.

Unit: ppi. Chosen on: speed. Range: not known.
"""

MIN_SIDE_PX = 40
"""Smallest side of a print at 500 ppi: 2 mm.

Unit: px. Chosen on: judgement. Range: not known.
"""

TILE_PX = 32
"""Side of a tile in whose spectrum ridges are sought.

Unit: px. Chosen on: not known. Range: not known.
"""

TILE_PURITY = 0.5
"""Part of a tile's power that lies in one wave, where it shows ridges.

Unit: fraction. Chosen on: not known. Range: not known.
"""

USUAL_PERIODS = (0.76, 1.47)
"""Lowest and highest distance of ridges over the usual one: those of 95 % of 280 real prints.

Unit: none. Chosen on: real prints (280 prints of seven sensors, validation/prints/any_print.py).
Range: not known.
"""

RIDGES = 0.4
"""Fraction of a picture's strong tiles with ridges from which on they lie as its resolution has
them; else they are sought at other scales.

Unit: fraction. Chosen on: not known. Range: not known.
"""

CLEAR_SCORE = 0.2
"""Score of a picture's ridges from which their distance is measured; 280 real prints have 0.25 or
more.

Unit: none. Chosen on: real prints (280 prints of seven sensors, validation/prints/any_print.py).
Range: not known.
"""

BLANK_LEVEL = 4.0
"""Standard deviation in grey levels below which a picture is blank.

Unit: grey levels. Chosen on: not known. Range: not known.
"""

PART_MM2 = 25.0
"""Area of ridges from which on their distance is taken at the stated resolution.

Unit: mm2. Chosen on: not known. Range: not known.
"""

DARK = 0.15
"""Mean level beside a print, at its rim and at the picture's edge over that of its middle, from
which on its ridges are dark; 280 real prints have -0.1 to 0.9.

Unit: contrasts of the ridges. Chosen on: real prints (280 prints of seven sensors,
validation/prints/any_print.py). Range: not known.
"""

WHITE = -0.2
"""The same level up to which ridges are white.

Unit: contrasts of the ridges. Chosen on: real prints (280 prints of seven sensors,
validation/prints/any_print.py). Range: not known.
"""

# --- minutiae

EDGE_MM = 0.6
"""Minutiae nearer to the outline are left out: about one and a third ridge periods.

Unit: mm. Chosen on: simulated fingers (1,200 pairs of 20 fingers). Range: 0.4 and more.
"""

PRESSED_EDGE_MM = 0.3
"""Minutiae of pressed prints, which fade out, nearer to the outline are left out.

Unit: mm. Chosen on: not known. Range: not known.
"""

PAPER = 235
"""Brighter is paper (or the middle of a valley).

Unit: grey levels. Chosen on: not known. Range: not known.
"""

CLOSED_MM = 1.0
"""Radius by which a print is closed: valleys and small gaps belong to it.

Unit: mm. Chosen on: not known. Range: not known.
"""

OPENED_MM = 0.6
"""Radius by which a print is opened: thin lines beside it do not belong to it.

Unit: mm. Chosen on: not known. Range: not known.
"""

MINDTCT_SIDE_PX = 64
"""A smaller image (3.3 mm at 500 ppi) holds no print; mindtct, given very small ones, ends the
whole process.

Unit: px. Chosen on: not known. Range: not known.
"""

# --- minutiae_record

LARGEST_MM2 = 3600.0
"""Of one finger: a print with what is white about it, a template's box, a surface. A rolled print
has 1,600 (40 x 40 mm); four fingers side by side have 6,200 and are no print of one. Work and
memory (0.4 GB) grow with it.

Unit: mm2. Chosen on: judgement. Range: not known.
"""

# --- phase_minutiae

PHASE_EDGE_MM = 0.6
"""Nearer to the print's outline no minutia is taken: every ridge ends there.

Unit: mm. Chosen on: not known. Range: not known.
"""

SURE = 0.25
"""Confidence of ridges that do not lower the quality of minutiae.

Unit: none. Chosen on: not known. Range: not known.
"""

WAVE_LIKENESS = 0.7
"""Minutiae about which the print follows the wave less are left out.

Unit: none. Chosen on: not known. Range: not known.
"""

AGAIN = (-1.824, -0.332, 0.531, 0.814)
"""Logistic regression behind the quality of a minutia: offset, and weights of the logarithm of what
is missing to full likeness, of the distance to the outline, and of that to the nearest opposite
minutia.

Unit: none. Chosen on: real prints (30 fingers of six sensors, validation/records/quality.py).
Range: not known.
"""

MIN_MISSING = 0.003
"""What is missing to full likeness adds nothing to the quality of a minutia below this.

Unit: none. Chosen on: not known. Range: not known.
"""

FAR_MM = 4.0
"""The distance to the outline adds nothing beyond this.

Unit: mm. Chosen on: not known. Range: not known.
"""

APART_MM = 2.0
"""The distance to the nearest opposite minutia adds nothing beyond this.

Unit: mm. Chosen on: not known. Range: not known.
"""

OPPOSITE = -0.5
"""Opposite minutiae differ in direction by more than 120 deg.

Unit: cosine. Chosen on: not known. Range: not known.
"""

# --- photo_mask

SEARCH_PX = 96
"""Longer side of the picture in which fingers are sought.

Unit: px. Chosen on: speed. Range: not known.
"""

FIT_PX = 256
"""Longer side of the picture in which fingers are fitted.

Unit: px. Chosen on: speed. Range: not known.
"""

FINE_PX = 512
"""Longer side of the picture in which the outline is found.

Unit: px. Chosen on: speed. Range: not known.
"""

WIDTHS = tuple(0.11 * 1.18**k for k in range(11))
"""Widths of fingers that are tried.

Unit: longer sides of the picture. Chosen on: simulated fingers (100 drawn photographs over natural
pictures, 16 pictures without a finger). Range: not known.
"""

TIP_TURNS = 32
"""Directions of the tip that are tried.

Unit: none. Chosen on: simulated fingers (100 drawn photographs over natural pictures, 16 pictures
without a finger). Range: not known.
"""

EDGE_TURNS = 16
"""Directions of edges that are told apart.

Unit: none. Chosen on: simulated fingers (100 drawn photographs over natural pictures, 16 pictures
without a finger). Range: not known.
"""

LAB_WEIGHTS = np.array([0.6, 1.5, 1.5], np.float32)
"""Weights of L*, a* and b*: a finger's flanks and shadows differ in lightness alone.

Unit: none. Chosen on: simulated fingers (100 drawn photographs over natural pictures, 16 pictures
without a finger). Range: not known.
"""

CAP = 0.6
"""Length of the tip's half ellipse.

Unit: widths of the finger. Chosen on: simulated fingers (100 drawn photographs over natural
pictures, 16 pictures without a finger). Range: not known.
"""

CANDIDATES = 7
"""Places that are fitted.

Unit: none. Chosen on: speed. Range: not known.
"""

RATED_LENGTH = 2.2
"""Length of the outline that is rated.

Unit: widths of the finger. Chosen on: simulated fingers (100 drawn photographs over natural
pictures, 16 pictures without a finger). Range: not known.
"""

MAX_LENGTH = 5.0
"""Greatest length of the outline.

Unit: widths of the finger. Chosen on: simulated fingers (100 drawn photographs over natural
pictures, 16 pictures without a finger). Range: not known.
"""

OUTLINE_STEP = 0.05
"""Step along an outline.

Unit: widths of the finger. Chosen on: simulated fingers (100 drawn photographs over natural
pictures, 16 pictures without a finger). Range: not known.
"""

ACROSS = 41
"""Places across an outline that are tried.

Unit: none. Chosen on: simulated fingers (100 drawn photographs over natural pictures, 16 pictures
without a finger). Range: not known.
"""

BESIDE = 0.8
"""How far one of both sides must be seen from the middle of the finger, or ridges may be taken for
the outline.

Unit: widths of the finger. Chosen on: simulated fingers (100 drawn photographs over natural
pictures, 16 pictures without a finger). Range: not known.
"""

BLOCK = 48
"""Side of the windows in which ridges are sought.

Unit: px. Chosen on: simulated fingers (100 drawn photographs over natural pictures, 16 pictures
without a finger). Range: not known.
"""

BLOCK_STEP = 24
"""Step from one of these windows to the next.

Unit: px. Chosen on: simulated fingers (100 drawn photographs over natural pictures, 16 pictures
without a finger). Range: not known.
"""

MAX_BLOCKS = 40
"""Windows that are looked at, at most.

Unit: none. Chosen on: speed. Range: not known.
"""

SEARCHED_WIDTH_PX = 400
"""Largest width of the finger in the picture that is searched for ridges.

Unit: px. Chosen on: speed. Range: not known.
"""

RIDGE_COUNTS = (23.5, 61.0)
"""Fewest and most ridges to a finger's width; some 38 are usual.

Unit: ridges. Chosen on: simulated fingers (100 drawn photographs over natural pictures, 16 pictures
without a finger). Range: not known.
"""

MAX_CONTRAST = 0.6
"""Greatest standard deviation of the logarithm of light in windows of skin.

Unit: none. Chosen on: simulated fingers (drawn photographs have up to 0.2). Range: not known.
"""

NO_RIDGES = 0.2
"""What is left of the likeness of an outline without ridges.

Unit: fraction. Chosen on: simulated fingers (100 drawn photographs over natural pictures, 16
pictures without a finger). Range: not known.
"""

CLEAR_RIDGES = 0.3
"""From this likeness by ridges on, the contrast of a tip is judged by its ground's variation.

Unit: none. Chosen on: drawn photographs on pale grounds (tests/prints/test_fingerphoto.py); smooth
strips have 0.2. Range: not known.
"""

FULL_CONTRAST = 12.0
"""Contrast of a tip to any ground from which on more does not count.

Unit: weighted CIELAB. Chosen on: simulated fingers (100 drawn photographs over natural pictures, 16
pictures without a finger). Range: not known.
"""

PLAIN_CONTRAST = 5.0
"""The same to a ground without any texture.

Unit: weighted CIELAB. Chosen on: drawn photographs on pale grounds
(tests/prints/test_fingerphoto.py). Range: 4 to 6 found the same fingers.
"""

SEARCHED_LIKENESS = 0.01
"""Least likeness by shape and colour of what is searched for ridges.

Unit: none. Chosen on: speed. Range: not known.
"""

MIN_LIKENESS = 0.17
"""Least likeness of a finger: drawn fingers have 0.18 to 1, pictures without one less than 0.16.

Unit: none. Chosen on: simulated fingers (drawn photographs, validation/match/telephone.py). Range:
0.16 to 0.18.
"""

MIN_IN_BOX = 0.01
"""Least likeness where somebody states that there is a finger.

Unit: none. Chosen on: simulated fingers (100 drawn photographs over natural pictures, 16 pictures
without a finger). Range: not known.
"""

# --- pressed

PRESSED_WINDOW_PX = 32
"""Side of a window at 500 ppi: some four ridges.

Unit: px. Chosen on: simulated prints (validation/match/pressed_prints.py). Range: not known.
"""

STEP_PX = 8
"""Step from window to window at 500 ppi.

Unit: px. Chosen on: simulated prints (validation/match/pressed_prints.py). Range: not known.
"""

SHORTEST_PX = 4.5
"""Shortest period of ridges at 500 ppi: 0.23 mm.

Unit: px. Chosen on: simulated prints (validation/match/pressed_prints.py). Range: not known.
"""

LONGEST_PX = 15.0
"""Longest period of ridges at 500 ppi: 0.76 mm.

Unit: px. Chosen on: simulated prints (validation/match/pressed_prints.py). Range: not known.
"""

CONTRAST_PX = 11.0
"""Sigma over which a print's mean and contrast are made even.

Unit: px. Chosen on: simulated prints (validation/match/pressed_prints.py). Range: not known.
"""

PHOTO_CONTRAST_PX = 20.0
"""The same sigma of a photograph, whose weak ridges are noise.

Unit: px. Chosen on: not known. Range: not known.
"""

MIN_LEVEL = 8.0
"""Contrast of fewer grey levels is not raised further.

Unit: grey levels. Chosen on: simulated prints (validation/match/pressed_prints.py). Range: not
known.
"""

RAISED = 0.3
"""Contrast below this fraction of the print's usual one is not raised further.

Unit: fraction. Chosen on: simulated prints (validation/match/pressed_prints.py). Range: not known.
"""

DIRECTIONS = 24
"""Directions that a window may have; means between them are taken.

Unit: none. Chosen on: simulated prints (validation/match/pressed_prints.py). Range: not known.
"""

WINDOW_PERIODS = 10
"""Periods that a window may have.

Unit: none. Chosen on: simulated prints (validation/match/pressed_prints.py). Range: not known.
"""

DIRECTION_SIGMA = np.deg2rad(9.0)
"""Sigma of one of a window's directions.

Unit: rad. Chosen on: simulated prints (validation/match/pressed_prints.py). Range: not known.
"""

PERIOD_SIGMA = 0.11
"""Relative sigma of one of a window's periods.

Unit: fraction. Chosen on: simulated prints (validation/match/pressed_prints.py). Range: not known.
"""

TURN_SIGMA = np.deg2rad(10.0)
"""Sigma of the turn of directions from a window to those about it.

Unit: rad. Chosen on: simulated prints (validation/match/pressed_prints.py). Range: not known.
"""

PERIOD_SPREAD = 0.3
"""Relative sigma of periods about the print's own.

Unit: fraction. Chosen on: simulated prints (validation/match/pressed_prints.py). Range: not known.
"""

PHOTO_PERIOD_SPREAD = 0.2
"""The same of a photograph.

Unit: fraction. Chosen on: not known. Range: not known.
"""

REACHES = (4.0, 3.0, 2.0, 1.5, 1.5, 1.5)
"""Sigma of the surroundings, one pass after the other.

Unit: windows. Chosen on: simulated prints (validation/match/pressed_prints.py). Range: not known.
"""

WEAK = 0.03
"""Power of a window, relative to noise of the evened print's variance, below which it counts for
little.

Unit: none. Chosen on: simulated prints (validation/match/pressed_prints.py). Range: not known.
"""

FANS = np.deg2rad([16.0, 22.0, 30.0, 42.0])
"""Sigmas of the filter across directions, from where the windows agree to where they do not.

Unit: rad. Chosen on: simulated prints (validation/match/pressed_prints.py). Range: not known.
"""

BAND_PER_PX = 0.035
"""Sigma of the filter across frequencies.

Unit: 1/px. Chosen on: simulated prints (validation/match/pressed_prints.py). Range: not known.
"""

FILTER_TURNS = 64
"""Directions of the filters.

Unit: none. Chosen on: simulated prints (validation/match/pressed_prints.py). Range: not known.
"""

STEEPNESS = 1.6
"""Steepness of the grey curve of a print of even contrast.

Unit: none. Chosen on: simulated prints (validation/match/pressed_prints.py). Range: not known.
"""

PURE = 0.42
"""Fraction of its power that a window of parallel ridges has near one direction and period.

Unit: fraction. Chosen on: simulated prints (validation/match/pressed_prints.py). Range: not known.
"""

NOISE = 0.2
"""Part of that fraction that noise has.

Unit: fraction. Chosen on: simulated prints (validation/match/pressed_prints.py). Range: not known.
"""

CLEAREST = 0.35
"""Confidence of a print's clearest ridges below which there is no print.

Unit: none. Chosen on: simulated prints (validation/match/pressed_prints.py). Range: not known.
"""

CLEAREST_PX = 7750
"""Number of the clearest pixels that set this level: 20 mm2.

Unit: px. Chosen on: simulated prints (validation/match/pressed_prints.py). Range: not known.
"""

CONFIDENCE_EDGE = 0.25
"""Ridges end where their confidence falls below this part of the way from noise to the clearest
ones.

Unit: fraction. Chosen on: simulated prints (validation/match/pressed_prints.py). Range: not known.
"""

PHOTO_EDGE = 0.4
"""The same of a photograph.

Unit: fraction. Chosen on: not known. Range: not known.
"""

FAINT_CONTRAST = 0.4
"""Contrast, relative to that of the clear ridges, below which confidence falls (what others left on
the sensor).

Unit: fraction. Chosen on: simulated prints (validation/match/pressed_prints.py). Range: not known.
"""

PHOTO_FAINT = 0.15
"""The same of a photograph.

Unit: fraction. Chosen on: not known. Range: not known.
"""

CLOSED_PX = 14
"""Radius by which ridges are closed: gaps between them belong to them.

Unit: px. Chosen on: simulated prints (validation/match/pressed_prints.py). Range: not known.
"""

OPENED_PX = 10
"""Radius by which ridges are opened: specks do not belong to them.

Unit: px. Chosen on: simulated prints (validation/match/pressed_prints.py). Range: not known.
"""

MIN_BEND_DEG = 1.5
"""Least median turn of the direction of ridges: 280 real prints have 2.9 to 7.8 deg a mm, squares
of 7 mm of them 1.7.

Unit: deg/mm. Chosen on: real prints (280 prints of seven sensors). Range: not known.
"""

BREAK_DEG = 25
"""Turn from a window to the next at which lines break off.

Unit: deg. Chosen on: not known. Range: not known.
"""

MAX_BREAKS = 0.12
"""Largest fraction of the pairs of windows between which lines break off: 280 real prints have at
most 4 %, squares of 7 mm of them 9 %.

Unit: fraction. Chosen on: real prints (280 prints of seven sensors). Range: not known.
"""

JUDGED_PAIRS = 500
"""Pairs of windows from which on lines are judged: 40 mm2.

Unit: none. Chosen on: not known. Range: not known.
"""

FRAME_STEP = 20
"""Step between a constant border and what is beside it, where that is the sensor's frame and no
paper.

Unit: grey levels. Chosen on: not known. Range: not known.
"""

# --- print_map

MAP_STEP_MM = 0.25
"""Spacing of the coarse grid on the print on which the inverse is computed.

Unit: mm. Chosen on: not known. Range: not known.
"""

NEWTON_STEPS = 8
"""Steps by which the place of a print's pixel is refined.

Unit: none. Chosen on: not known. Range: not known.
"""

MARGIN_MM = 0.5
"""Margin of a print around all that it holds.

Unit: mm. Chosen on: judgement. Range: not known.
"""

SLANT_DEG = 70.0
"""Skin steeper than this is left out of a print: the camera hardly sees it.

Unit: deg. Chosen on: not known. Range: not known.
"""

SIGMA_PX = 0.5
"""Sigma of the Gaussian before a print that is coarser than the input.

Unit: px of the print. Chosen on: not known. Range: not known.
"""

LARGEST_PX = 25_000_000
"""Largest print: 250 x 250 mm at 500 ppi.

Unit: px. Chosen on: judgement. Range: not known.
"""

# --- print_quality

WAVE_SIGMA_PERIODS = 0.75
"""Standard deviation of the window in which a wave is fitted, in ridge periods.

Unit: ridge periods. Chosen on: not known. Range: not known.
"""

SMOOTH_MM = 0.6
"""Values are taken relative to their Gaussian mean of this standard deviation.

Unit: mm. Chosen on: not known. Range: not known.
"""

CLOSE_MM = 3.0
"""Radius by which the print is closed: gaps up to about twice as wide, with ridges around, are
distinguished from an outline that has none.

Unit: mm. Chosen on: not known. Range: not known.
"""

MIN_PART = 0.01
"""Least rating of the worst figure: no single one makes the score 0.

Unit: none. Chosen on: judgement. Range: not known.
"""

WAVE_PURITY = 0.3
"""Fraction of what varies around a place that one wave must explain, or there are no ridges.

Unit: fraction. Chosen on: simulated fingers (with and without a fault, scale 0.4). Range: not
known.
"""

MIN_HEIGHT_UM = 10.0
"""Ridges that rise less above their valleys count as none (prints of the relief).

Unit: um. Chosen on: simulated fingers (with and without a fault, scale 0.4). Range: not known.
"""

PERIOD_TOLERANCE = 0.35
"""A ridge period further from the finger's median than this, relative, is not plausible.

Unit: fraction. Chosen on: simulated fingers (with and without a fault, scale 0.4). Range: not
known.
"""

# --- ridge_field

NODE_STEP_MM = 0.2
"""Distance between two nodes, rounded to whole pixels.

Unit: mm. Chosen on: not known. Range: not known.
"""

NARROW_MM = 0.3
"""Standard deviation over which the narrow structure tensor is averaged.

Unit: mm. Chosen on: not known. Range: not known.
"""

WIDE_MM = 0.8
"""Standard deviation over which the wide structure tensor is averaged.

Unit: mm. Chosen on: not known. Range: not known.
"""

SPECTRUM_WINDOW_MM = 1.63
"""Side of the windows whose spectra give the frequency.

Unit: mm. Chosen on: not known. Range: not known.
"""

SHORTEST_MM = 0.25
"""Shortest ridge period that is accepted.

Unit: mm. Chosen on: not known. Range: not known.
"""

LONGEST_PERIOD_MM = 0.9
"""Longest ridge period that is accepted.

Unit: mm. Chosen on: not known. Range: not known.
"""

MIN_STRENGTH = 0.2
"""Contrast below this fraction of the print's strong parts is background.

Unit: fraction. Chosen on: not known. Range: not known.
"""

# --- rolled

SIDE_MM = 14.0
"""Coverage is reported for the rows from the tip's cap downwards, as far as this.

Unit: mm. Chosen on: judgement. Range: not known.
"""

# --- unroll

ITERATIONS = 10
"""Rounds of relaxation of skin that is laid flat, at most.

Unit: none. Chosen on: not known. Range: not known.
"""

CENTRE_WEIGHT = 4.0
"""Weight of the skin as a power of the cosine of its slant: 0 spreads the distortion evenly, larger
values keep the middle undistorted at the cost of the sides.

Unit: none. Chosen on: not known. Range: not known.
"""

NODES_MM = 0.5
"""Distance of the nodes on the finger plane.

Unit: mm. Chosen on: not known. Range: not known.
"""

FIT_WINDOW_MM = 0.3
"""Standard deviation of the Gaussian window of the local fits.

Unit: mm. Chosen on: not known. Range: not known.
"""

FINEST_MM = 1e-3
"""Smallest pitch of a surface that is laid flat.

Unit: mm. Chosen on: judgement. Range: not known.
"""

LONGEST_SURFACE_MM = 200.0
"""Length of a surface that can be a finger's.

Unit: mm. Chosen on: judgement. Range: not known.
"""

FARTHEST_MM = 1e6
"""Largest coordinate of a place of a surface.

Unit: mm. Chosen on: judgement. Range: not known.
"""

RINGS = 3
"""Rings of nodes outside the mask that are extrapolated.

Unit: nodes. Chosen on: not known. Range: not known.
"""
