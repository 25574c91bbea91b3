"""How tests say that bad input is refused."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from splitknit.errors import BadInput


@contextmanager
def bad_input(words: str | None = None) -> Iterator[pytest.ExceptionInfo[BadInput]]:
    """Expect :class:`BadInput` whose message, one line, holds a regular expression."""
    with pytest.raises(BadInput, match=words) as caught:
        yield caught
    assert "\n" not in str(caught.value)
