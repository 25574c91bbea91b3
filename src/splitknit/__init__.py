"""splitknit: metric 3D fingerprints from one camera."""

from __future__ import annotations

__version__ = "0.1.0"
