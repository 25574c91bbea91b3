"""What the tests of `io` share."""

from collections.abc import Callable

from splitknit.model import Capture

Build = Callable[..., Capture]
