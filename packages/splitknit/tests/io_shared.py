"""What the tests of `io` share."""

from collections.abc import Callable
from typing import Any, NamedTuple

from splitknit.capture import Capture
from splitknit.findings import Finding
from splitknit.folders import capture_of
from splitknit.io.photographs import GivenPhotographs

Build = Callable[..., Capture]


class Photographs(NamedTuple):
    """Photographs as a capture, and what was assumed of them."""

    capture: Capture
    notes: list[Finding]


def import_photographs(*arguments: Any, **options: Any) -> Photographs:
    return Photographs(*capture_of(GivenPhotographs(*arguments, **options)))
