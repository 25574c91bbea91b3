"""Critical sections that Ctrl-C and SIGTERM wait for."""

from __future__ import annotations


class Unfinished:
    """Counts open critical sections; Ctrl-C and SIGTERM wait until it is zero.

    A section, such as removing a temporary folder, begins with ``UNFINISHED.depth += 1`` (a call
    could be interrupted before it counts) and ends with :meth:`leave` in a ``finally``.
    """

    depth = 0
    signal = 0
    """What came meanwhile."""

    def leave(self) -> None:
        """One part is done; if it was the last, what came meanwhile comes now."""
        self.depth -= 1
        if self.signal and not self.depth:
            import signal

            number, self.signal = self.signal, 0
            signal.raise_signal(number)


UNFINISHED = Unfinished()
