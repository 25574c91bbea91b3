"""Deflate by Intel's ISA-L where it is installed: the same format as zlib's, packed and unpacked several times as fast.

Unpacked bytes are the same; packed ones differ from zlib's, and are somewhat longer than those of its level 1.
"""

from __future__ import annotations

import zlib
from typing import Any

try:
    from isal import isal_zlib
except ImportError:  # where there is no wheel
    engine: Any = zlib
    DAMAGED: tuple[type[Exception], ...] = (zlib.error,)
else:
    engine = isal_zlib
    DAMAGED = (zlib.error, engine.error)
"""What unpacking raises."""
