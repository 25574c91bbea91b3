"""Constants of the networks' use that could have been chosen otherwise, by module."""

# --- augmentation

MAX_RESTORED = 0.25
"""Largest power that is restored, over the estimate's own.

Unit: fraction. Chosen on: not known. Range: not known.
"""

# --- unet

MAX_NETWORK_BYTES = 500_000_000
"""Largest file of a network; the shipped ones have less than 1 MB.

Unit: bytes. Chosen on: judgement. Range: not known.
"""

MAX_CARD_BYTES = 1_000_000
"""Largest file of a network's card; the shipped ones have 3 kB.

Unit: bytes. Chosen on: judgement. Range: not known.
"""

TILE_PX = 724
"""Side of a tile's square; a network of width 12 then needs 0.4 GB, of width 64 2 GB.

Unit: px. Chosen on: speed. Range: not known.
"""

MAX_THREADS = 8
"""Maximum threads of a network by default.

Unit: none. Chosen on: speed. Range: not known.
"""

CUDA_TOLERANCE = 1e-3
"""Largest difference between cpu and cuda, over a result's largest value (sums in another order,
TF32 off). Set without a GPU at hand.

Unit: fraction. Chosen on: judgement. Range: not known.
"""
