"""Cases of a batch: the methods by which every capture is reconstructed."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from splitknit import preset_settings
from splitknit.errors import require
from splitknit.io.provenance import settings_hash
from splitknit.presets import PipelineSettings
from splitknit.settings import override

PRESETS = ("metric", "snk", "pr", "ea")
"""Cases of a batch that names none: the thesis's three and `metric`."""


@dataclass(frozen=True, slots=True)
class Case:
    """One method of reconstruction: a preset and the settings that are changed in it."""

    name: str  # name of the folder in the store: letters, digits, ``.``, ``-`` and ``_``
    preset: str
    changes: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        plain = re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,63}", self.name)
        require(
            plain is not None,
            f"'{self.name}' cannot be the name of a case: use up to 64 letters, digits, dots, - and"
            " _.",
        )
        object.__setattr__(self, "changes", dict(self.changes))  # workers receive a copy
        self.settings()

    def settings(self) -> PipelineSettings:
        """All settings of the reconstruction."""
        return override(preset_settings(self.preset), self.changes)

    def document(self) -> dict[str, Any]:
        """The preset, all settings, and their hash, as the store keeps them."""
        settings = asdict(self.settings())
        sha256 = settings_hash({"preset": self.preset, "settings": settings})
        return {"preset": self.preset, "settings_sha256": sha256, "settings": settings}


def preset_cases(names: tuple[str, ...] = PRESETS) -> tuple[Case, ...]:
    """Cases of the presets `names`, unchanged; an own one's module and function by a dot."""
    return tuple(Case(name.replace(":", "."), name) for name in names)
