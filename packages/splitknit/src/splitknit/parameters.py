"""Tuned constants of the modules at the root of the package, and of its command line."""

# --- cli.options

SETTINGS_BYTES = 64_000
"""Bytes of a settings document at most: those of this program have 2 kB, and the parser's time
grows with the square of a name's length.

Unit: bytes. Chosen on: judgement. Range: not known.
"""

# --- model

UNKNOWN_SIDE_MM = 25.0
"""Shorter side of the picture of a camera whose scale nobody measured.

Unit: mm. Chosen on: judgement. Range: not known.
"""
FLAT_SIDE = 300
"""Longer side of a coarse flat image: dust and a coat's grain, which move with the object, do not
stay in it.

Unit: px. Chosen on: not known. Range: not known.
"""

# --- pad

PAD_PX_PER_MM = 15.0
"""Scale at which photographs and results are measured for the detection of attacks.

Unit: px/mm. Chosen on: not known. Range: not known.
"""
PAD_FACING = 0.8
"""Cosine between the surface without ridges and the view from which a pixel is measured: flanks are
left out.

Unit: none. Chosen on: not known. Range: not known.
"""
PAD_SLOW_MM = 0.35
"""Standard deviation of the Gaussian that is coarser than the band of ridges.

Unit: mm. Chosen on: not known. Range: not known.
"""
PAD_FINE_MM = 0.06
"""Standard deviation of the Gaussian that is finer than the band of ridges.

Unit: mm. Chosen on: not known. Range: not known.
"""
USUAL_DEVIATION = 0.5
"""Deviation, in standard deviations of live skin, from which it counts.

Unit: none. Chosen on: not known. Range: not known.
"""
LARGEST_DEVIATION = 6.5
"""Deviation up to which it counts.

Unit: none. Chosen on: not known. Range: not known.
"""

# --- settings

LONGEST_NAME = 100
"""Characters of a setting's name at most.

Unit: none. Chosen on: judgement. Range: not known.
"""

# --- steps

IN_MEMORY = 250_000_000
"""Bytes of photographs, or of a band's linear light, in memory at once; a full frame's band has 197
million.

Unit: bytes. Chosen on: speed. Range: not known.
"""

# --- workers

GRACE_S = 1.0
"""Time for workers that are ended to remove what they have half written.

Unit: s. Chosen on: judgement. Range: not known.
"""
