"""What the tests of `io` share."""

from collections.abc import Callable
from typing import Any

from splitknit.capture import Capture
from splitknit.io.photographs import GivenPhotographs
from splitknit.observation.plain import Photographs, capture_from_photographs

Build = Callable[..., Capture]


def import_photographs(*arguments: Any, **options: Any) -> Photographs:
    return capture_from_photographs(GivenPhotographs(*arguments, **options))
