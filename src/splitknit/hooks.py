"""What a result does by modules above its own: :mod:`splitknit` puts these functions here when it is imported."""

from __future__ import annotations

TYPE_CHECKING = False  # as in __init__
if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

RESULT_HOOKS: dict[str, Callable[..., Any]] = {}
"""``save``, ``plot``, ``show`` and ``preview`` of :class:`splitknit.model.Reconstruction`."""
