"""What the tests of `io` share."""

from __future__ import annotations

from collections.abc import Callable

from splitknit.model import Capture

Build = Callable[..., Capture]
