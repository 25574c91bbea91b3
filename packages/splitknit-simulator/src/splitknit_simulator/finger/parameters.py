"""Tuned constants of simulated fingers: skin conditions, ridges, deformation and motion."""

# --- conditions

MAX_PLATES = 4
"""Horny plates with air between them in the thickest scale of dry skin.

Unit: none. Chosen on: judgement. Range: not known.
"""
WATER_ROUGHNESS = 0.05
"""GGX alpha of a water surface at rest on skin: smooth but for what floats on it.

Unit: none. Chosen on: judgement. Range: not known.
"""
MOIST_ROUGHNESS = 0.18
"""GGX alpha of hydrated skin between drops of water, as in moist sessions; Dabrowska et al. 2016
found such skin smoother.

Unit: none. Chosen on: judgement. Range: not known.
"""
DRY_ROUGHNESS = 0.5
"""GGX alpha of dry skin at severity 1.

Unit: none. Chosen on: judgement. Range: not known.
"""
SCAR_ROUGHNESS = 0.15
"""GGX alpha of a scar in rougher skin.

Unit: none. Chosen on: judgement. Range: not known.
"""
HIGHEST_SKIN_MM = 0.006
"""Height over the body that no skin may exceed, since rays look for the skin from 8 um over the
body on.

Unit: mm. Chosen on: judgement (below the 8 um at which rays begin). Range: not known.
"""

# --- deformation

SAMPLES_PER_SIGMA = 4
"""Grid points of a deformation for each standard deviation of its smoothing: a cubic spline through
them is less than a thousandth off.

Unit: none. Chosen on: speed. Range: not known.
"""

# --- master_print

PERIOD_VARIATION = 0.05
"""Standard deviation of the ridge period within a finger, relative, over distances of about 5 mm.

Unit: fraction. Chosen on: not known. Range: not known.
"""
FAN_WIDENING = 0.8
"""How far ridges that fan out grow wider before new ones start between them: 0 not at all, 1 as far
as they can.

Unit: fraction. Chosen on: not known. Range: not known.
"""
FLANK_ROUGHNESS = 0.06
"""Standard deviation of the irregularity of the ridge flanks, relative to the ridge's amplitude.

Unit: fraction. Chosen on: not known. Range: not known.
"""
PRINT_NOISE_SIGMA_MM = 0.05
"""Standard deviation of the Gaussian that removes a scanner's noise from a real print.

Unit: mm. Chosen on: not known. Range: not known.
"""
MIN_PRINT_CONTRAST = 0.02
"""Contrast of ridges, relative to white, below which an image counts as one without ridges.

Unit: fraction. Chosen on: not known. Range: not known.
"""

# --- motion

SHOT_EXPOSURE_S = 0.02
"""Exposure time of a shot, during which tremor blurs it.

Unit: s. Chosen on: judgement. Range: not known.
"""
TREMOR_FRACTION = 0.05
"""Standard deviation of the tremor relative to the drift's amplitude.

Unit: fraction. Chosen on: judgement. Range: not known.
"""
TURN_DEG_PER_MM = 1.5
"""Largest difference of yaw, and of roll, between two shots, for each mm of the motion's amplitude.

Unit: deg/mm. Chosen on: judgement. Range: not known.
"""
SLIP_FRACTION = 0.1
"""Largest slip of the skin between two shots, relative to the motion's amplitude.

Unit: fraction. Chosen on: judgement. Range: not known.
"""
SLIP_SIGMA_MM = 5.0
"""Standard deviation of the Gaussian that smooths the slip over the skin.

Unit: mm. Chosen on: judgement. Range: not known.
"""
TRUTH_STEP_MM = 0.5
"""Pitch of the grid on which the truth records where the skin went.

Unit: mm. Chosen on: judgement. Range: not known.
"""

# --- ridges

PERIOD_STIFFNESS = 0.02
"""Weight that keeps the logarithm of the ridge period small, against its fit to the divergence of
the ridges.

Unit: 1/mm2. Chosen on: not known. Range: not known.
"""
RING_BANDWIDTH = 0.2
"""Standard deviation of a ring filter relative to its frequency.

Unit: fraction. Chosen on: not known. Range: not known.
"""
RING_SPACING = 1.16
"""Largest ratio between the frequencies of neighbouring ring filters.

Unit: none. Chosen on: not known. Range: not known.
"""
SMOOTHING_PERIODS = 1.1
"""Standard deviation of the smoothing along ridges, in ridge periods.

Unit: periods. Chosen on: not known. Range: not known.
"""

# --- skin_map

UNDULATION_SIGMA_MM = 1.6
"""Standard deviation of the Gaussian that smooths the bumps of ``SkinRelief.undulation_mm``.

Unit: mm. Chosen on: judgement (bumps some 5 mm wide). Range: not known.
"""
