"""Unpack by Intel's ISA-L where it is installed: the same format as zlib's, several times as fast.

It is not used to pack: in one of a hundred runs it packed the same bytes otherwise, and what it packs depends on the
processor.
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
