from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Literal

import pytest

from refusals import bad_input
from splitknit.errors import require
from splitknit.presets import preset_settings
from splitknit.settings import Checked, Limits, check_fields, flatten, override


@dataclass(frozen=True, slots=True)
class Inner:
    sigma: float = 1.0
    count: int = 3
    mode: Literal["a", "b"] = "a"
    weights: tuple[float, ...] = (1.0, 2.0)
    limit: float | None = None
    on: bool = True

    def __post_init__(self):
        require(self.sigma > 0, "sigma must be positive.")


@dataclass(frozen=True, slots=True)
class Outer:
    inner: Inner = field(default_factory=Inner)
    name: str = "x"


def test_override_changes_the_named_fields_only():
    changed = override(
        Outer(), {"inner.sigma": 2, "inner": {"weights": [3, 4.5]}, "inner.limit": 0.5}
    )
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
def test_wrong_settings_are_refused_with_a_remedy(changes, words):
    with bad_input(words):
        override(Outer(), changes)


def test_flatten_joins_names():
    assert flatten({"a": {"b": {"c": 1}}, "d.e": 2}) == {"a.b.c": 1, "d.e": 2}


@pytest.mark.parametrize("value", ["\ud800", "a\nb", "a" * 1001, 10**400])
def test_a_value_that_could_not_be_printed_is_refused_in_a_short_line(value):
    with bad_input(r"setting|must") as caught:
        override(preset_settings("metric"), {"knit.method": value})
    assert str(caught.value).isprintable() and len(str(caught.value)) < 300
    with bad_input("there is no setting") as caught:
        override(preset_settings("metric"), {f"knit.{value}": 1})
    assert str(caught.value).isprintable() and len(str(caught.value)) < 300


@dataclass(frozen=True, slots=True)
class LampSettings(Checked):
    power_w: Annotated[float, Limits(0, 5, above=True)] = 1.0
    span_mm: Annotated[tuple[float, float], Limits(-2, 3)] = (0.0, 1.0)
    seed: Annotated[int | None, Limits(0)] = None
    model: Literal["point", "disc"] = "point"


@dataclass(frozen=True, slots=True)
class PairSettings(Checked):
    _group = "both"
    low: Annotated[float, Limits(max=2)] = 0.0
    high: float = 1.0

    def __post_init__(self):
        check_fields(self)
        require(self.low <= self.high, "low above high.")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"power_w": 0.0}, "lamp.power_w must be above 0 to 5, but it is 0.0."),
        ({"power_w": float("nan")}, "lamp.power_w must be above 0 to 5, but it is nan."),
        ({"span_mm": (0.0, 4.0)}, "lamp.span_mm must be from -2 to 3, but it is (0.0, 4.0)."),
        (
            {"seed": 10**5000},
            "lamp.seed must be zero or more, but it is a number of thousands of digits.",
        ),
        ({"seed": -1}, "lamp.seed must be zero or more, but it is -1."),
        ({"model": "lens"}, "lamp.model must be one of point, disc, but it is 'lens'."),
    ],
)
def test_a_value_outside_its_declared_limits_is_refused(change, message):
    with bad_input() as caught:
        LampSettings(**change)
    assert str(caught.value) == message


def test_limits_include_their_bounds_and_rules_between_fields_hold():
    assert LampSettings(power_w=5.0, span_mm=(-2.0, 3.0), seed=None).seed is None
    with bad_input(r"^both\.low must be at most 2, but it is 3\.0\.$"):
        PairSettings(low=3.0, high=4.0)
    with bad_input(r"^low above high\.$"):
        PairSettings(low=2.0)
