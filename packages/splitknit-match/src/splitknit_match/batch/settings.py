"""What a batch does: its cases, its matchers, and how it is run."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from types import MappingProxyType
from typing import Annotated, Any

from splitknit import preset_settings
from splitknit.errors import require
from splitknit.io.provenance import settings_hash
from splitknit.presets import PipelineSettings
from splitknit.settings import Checked, Limits, check_fields, override
from splitknit_match.matching.surface import MatchingSettings

MATCHERS = ("ridge", "thesis", "thesis-code", "minutiae")


@dataclass(frozen=True, slots=True)
class Case:
    """One method of reconstruction: a preset and what is changed in it."""

    name: str  # name of the folder in the store: letters, digits, ``.``, ``-`` and ``_``
    preset: str
    changes: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))  # from ``stage.field`` to a value

    def __post_init__(self) -> None:
        fault = f"'{self.name}' cannot be the name of a case: use up to 64 letters, digits,"
        require(re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,63}", self.name) is not None, f"{fault} dots, - and _.")
        object.__setattr__(self, "changes", dict(self.changes))
        self.settings()

    def settings(self) -> PipelineSettings:
        """All settings of the reconstruction."""
        return override(preset_settings(self.preset), self.changes)

    def document(self) -> dict[str, Any]:
        """For the store: the preset, all settings, and their hash."""
        settings = asdict(self.settings())
        sha256 = settings_hash({"preset": self.preset, "settings": settings})
        return {"preset": self.preset, "settings_sha256": sha256, "settings": settings}


def preset_cases(names: tuple[str, ...] = ("metric", "snk", "pr", "ea")) -> tuple[Case, ...]:
    """Cases of the presets `names`, unchanged; the thesis's and `metric` where none are named."""
    return tuple(Case(name, name) for name in names)


@dataclass(frozen=True, slots=True)
class BatchSettings(Checked):
    """What is reconstructed and compared."""

    cases: tuple[Case, ...] = field(default_factory=preset_cases)
    """Methods of reconstruction, at least one, each by its own name; as shipped `metric`, `snk`, `pr` and `ea`."""
    matchers: tuple[str, ...] = ("ridge",)
    """Names in :data:`MATCHERS`; none: reconstruct only."""
    impostors: Annotated[float, Limits(0, 1)] = 1.0
    """Fraction of the comparisons of different fingers that is made; genuine ones are all made."""
    seed: Annotated[int, Limits(0)] = 0
    """Which of them, where not all are."""
    matching: MatchingSettings = field(default_factory=MatchingSettings)
    surfaces: bool = True
    """Keep the surfaces, about 2.3 MB a reconstruction at 30 px/mm: the thesis's matcher needs them."""
    chunk_captures: Annotated[int, Limits(0, 1000)] = 0
    """Captures that are reconstructed, and stored, together: what a killed run loses at most, for each job. 0: a 32nd
    of the plan, at most ten, so that a small population keeps several jobs at work too."""

    def __post_init__(self) -> None:
        check_fields(self)
        require(len(self.cases) > 0, "a batch needs at least one case.")
        names = [case.name for case in self.cases]
        twice = next((name for name in names if names.count(name) > 1), "")
        require(not twice, f"two cases are called '{twice}'; give each its own name.")
        unknown = [name for name in self.matchers if name not in MATCHERS]
        require(not unknown, f"there is no matcher '{unknown[0] if unknown else ''}'; known are {', '.join(MATCHERS)}.")
        require(len(set(self.matchers)) == len(self.matchers), "a matcher is named twice.")
