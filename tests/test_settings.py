from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import pytest

from splitknit.check import BadInput, require
from splitknit.pipeline import preset_settings
from splitknit.settings import flatten, override


@dataclass(frozen=True, slots=True)
class Inner:
    sigma: float = 1.0
    count: int = 3
    mode: Literal["a", "b"] = "a"
    weights: tuple[float, ...] = (1.0, 2.0)
    limit: float | None = None
    on: bool = True

    def __post_init__(self) -> None:
        require(self.sigma > 0, "sigma must be positive.")


@dataclass(frozen=True, slots=True)
class Outer:
    inner: Inner = field(default_factory=Inner)
    name: str = "x"


def test_one_field_changes_and_the_rest_stays() -> None:
    changed = override(Outer(), {"inner.sigma": 2, "inner": {"weights": [3, 4.5]}, "inner.limit": 0.5})
    assert changed == Outer(Inner(sigma=2.0, weights=(3.0, 4.5), limit=0.5))
    assert isinstance(changed.inner.sigma, float)
    assert override(changed, {"inner.limit": None}).inner.limit is None
    assert Outer().inner.sigma == 1.0


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"inner.sigmo": 1.0}, "did you mean 'inner.sigma'"),
        ({"outer.sigma": 1.0}, "no setting 'outer.sigma'"),
        ({"inner.sigma": "wide"}, "must be a number"),
        ({"inner.sigma": True}, "must be a number"),
        ({"inner.count": 1.5}, "must be a whole number"),
        ({"inner.mode": "c"}, "one of 'a', 'b'"),
        ({"inner.on": 1}, "true or false"),
        ({"inner": 1.0}, "is a group"),
        ({"name.first": "y"}, "has no parts"),
        ({"inner.sigma": -1.0}, "sigma must be positive"),
        ({"inner.weights": ["a"]}, "must be"),
    ],
)
def test_wrong_settings_are_refused_with_a_remedy(changes: dict[str, object], words: str) -> None:
    with pytest.raises(BadInput, match=words):
        override(Outer(), changes)


def test_flatten_joins_names() -> None:
    assert flatten({"a": {"b": {"c": 1}}, "d.e": 2}) == {"a.b.c": 1, "d.e": 2}


@pytest.mark.parametrize("value", ["\ud800", "a\nb", "a" * 1001, 10**400])
def test_a_value_that_could_not_be_printed_is_refused_in_a_short_line(value: object) -> None:
    with pytest.raises(BadInput, match=r"setting|must") as caught:
        override(preset_settings("metric"), {"knit.method": value})
    assert str(caught.value).isprintable() and len(str(caught.value)) < 300
    with pytest.raises(BadInput, match="there is no setting") as caught:
        override(preset_settings("metric"), {f"knit.{value}": 1})
    assert str(caught.value).isprintable() and len(str(caught.value)) < 300
