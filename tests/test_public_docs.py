"""The stable surface says what goes in, what comes out, and what is refused."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import pytest

import splitknit
from splitknit import integration, photometric

PUBLIC = {
    f"{module.__name__}.{name}": getattr(module, name)
    for module in (splitknit, integration, photometric)
    for name in module.__all__
    if inspect.isfunction(getattr(module, name))
}
REFUSES = ("require(", "BadInput(", "check_stack(", "check_lights(", "check_image(")


def lacking(function: Callable[..., Any]) -> list[str]:
    """Sections that the docstring of a public function should have and has not."""
    words, source = inspect.getdoc(function) or "", inspect.getsource(function)
    told = "Parameters are those of" in words
    missing = [] if told or len(inspect.signature(function).parameters) < 2 else ["Parameters"]
    if inspect.signature(function).return_annotation not in (None, "None") and not told:
        missing.append("Returns")
    if any(word in source for word in REFUSES):
        missing.append("Raises")
    words = words.replace("Yields\n------", "Returns\n-------")
    return [section for section in missing if f"{section}\n{'-' * len(section)}" not in words]


@pytest.mark.parametrize("name", sorted(PUBLIC))
def test_public_functions_are_described(name: str) -> None:
    assert lacking(PUBLIC[name]) == []


def test_what_lacks_is_found() -> None:
    def silent(a: int, b: int) -> int:
        """Add."""
        raise splitknit.BadInput(str(a + b))

    assert lacking(silent) == ["Parameters", "Returns", "Raises"]
