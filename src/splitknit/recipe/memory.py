"""What reconstructions of one capture in several cases have in common, made once."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any, TypeVar

from splitknit.errors import require
from splitknit.model import Capture

T = TypeVar("T")


class Memory:
    """Intermediate results of one capture, by what they follow from.

    Give the same memory to :func:`splitknit.reconstruct` for every case of a capture: what two cases share (the
    finger's outline, the slopes of direct light) is made once, and every result is the same as without it. It keeps
    some ten images of the finger's window and goes when it is dropped.
    """

    def __init__(self, capture: Capture) -> None:
        """Remember nothing yet of `capture`."""
        self._capture = capture
        self._known: dict[Hashable, Any] = {}

    def check(self, capture: Capture) -> None:
        """Refuse another capture than the one whose results are remembered.

        Raises
        ------
        BadInput
            If `capture` is another object.
        """
        require(capture is self._capture, "a memory serves one capture; make another for this one.")

    def __call__(self, key: Hashable, make: Callable[[], T]) -> T:
        """Return what was made for `key`, or make it; errors are not remembered."""
        if key not in self._known:
            self._known[key] = make()
        found: T = self._known[key]
        return found
