"""What the tests of `io` share."""

from collections.abc import Callable
from typing import Any

from splitknit.io.photographs import GivenPhotographs
from splitknit.io.plain import Photographs, capture_from_photographs
from splitknit.model import Capture

Build = Callable[..., Capture]


def import_photographs(*arguments: Any, **options: Any) -> Photographs:
    return capture_from_photographs(GivenPhotographs(*arguments, **options))
