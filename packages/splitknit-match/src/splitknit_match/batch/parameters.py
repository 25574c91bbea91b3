"""Constants of batches that could have been chosen otherwise, by module."""

# --- population

PAIRS = 2048
"""Comparisons of a task at most: what a run that is killed loses, for each of its workers.

Unit: comparisons. Chosen on: judgement. Range: not known.
"""

# --- surfaces

MAX_PIXELS = 40_000_000
"""Pixels of a capture's images, at most: five times the rig's camera. A surface takes 21 bytes a
pixel unpacked.

Unit: px. Chosen on: judgement. Range: not known.
"""

MAX_MM = 1000.0
"""Largest height.

Unit: mm. Chosen on: judgement. Range: not known.
"""

# --- tables

MAX_BYTES = 2_000_000_000
"""Longest columns of one file: surfaces of forty captures.

Unit: bytes. Chosen on: judgement. Range: not known.
"""

# --- tasks

WORKER_BYTES = 1_200_000_000
"""Memory of one worker: a full frame by `metric` takes 0.9 GB.

Unit: bytes. Chosen on: judgement. Range: not known.
"""

AHEAD = 3
"""Tasks that a scheduler is given for each thread of its workers.

Unit: tasks. Chosen on: speed. Range: not known.
"""

PATIENCE_S = 30.0
"""How long a cluster is waited for.

Unit: s. Chosen on: judgement. Range: not known.
"""
