"""What is wrong with photographs, or was assumed of them: each finding has a code, a severity and a
sentence.

:mod:`splitknit.diagnosis.codes` says of every code what it means and what to do.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

from splitknit.errors import require
from splitknit.files import AnyPath


class Severity(StrEnum):
    """What a finding means for the result."""

    NOTE = "note"
    """The result holds; something was assumed, or could be better."""
    DOUBT = "doubt"
    """The result may be wrong; it is not written where `strict` is asked for."""
    SPOILS = "spoils"
    """The result is worthless; it is refused unless `keep` is asked for."""


SEVERITY_WORDS = {
    Severity.NOTE: "Please note",
    Severity.DOUBT: "The surface may be wrong",
    Severity.SPOILS: "The surface is spoilt",
}
"""How a finding is introduced."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that is wrong with photographs, or was assumed of them.

    >>> narrow = Finding("odd-finger-width", "the finger is {:.1f mm} wide.", lengths_mm=(4.0,))
    >>> print(narrow, narrow.in_pixels(20.0))
    the finger is 4.0 mm wide. the finger is 80 px wide.
    """

    code: str
    """Stable name for programs, as ``clipped-photograph``."""
    message: str
    """One sentence; where there are `lengths_mm`, a template with a field for each: ``{:.1f mm}``,
    ``{:.0f um}``, or ``{:g mm-}`` without the unit."""
    severity: Severity = Severity.NOTE
    files: tuple[str, ...] = ()
    """Photographs at fault."""
    effect_deg: float | None = None
    """By how much the normals turn (median), where it was measured."""
    lengths_mm: tuple[float, ...] = ()
    band: str = "white"
    """Whose photographs it is about."""

    def __str__(self) -> str:
        return (
            self.message.format(*map(_Length, self.lengths_mm)) if self.lengths_mm else self.message
        )

    def in_pixels(self, px_per_mm: float) -> Finding:
        """The finding with its lengths in pixels, for a capture whose scale is unknown."""
        if not self.lengths_mm:
            return self
        message = self.message.format(*(_Pixels(length * px_per_mm) for length in self.lengths_mm))
        return replace(self, message=message, lengths_mm=())

    def of_band(self, name: str) -> Finding:
        """The finding of a band other than the white one, which its sentence then names."""
        return (
            self
            if name == "white"
            else replace(self, message=f"{name} band: {self.message}", band=name)
        )

    def of_file(self, path: AnyPath) -> Finding:
        """The finding of a file, which its sentence then names."""
        name = os.fspath(path)
        return replace(self, message=f"{name}: {self}", files=(name,), lengths_mm=())

    @property
    def facts(self) -> dict[str, Any]:
        """The same as plain JSON."""
        known = {"files": list(self.files), "effect_deg": self.effect_deg}
        return {
            "code": self.code,
            "severity": str(self.severity),
            "message": str(self),
            **{name: value for name, value in known.items() if value},
        }


class _Length(float):
    """In mm."""

    def __format__(self, spec: str) -> str:
        number, unit = spec.split()
        text = format(float(self) * (1000.0 if unit.startswith("um") else 1.0), number)
        return text if unit.endswith("-") else f"{text} {unit}"


class _Pixels(float):
    """In pixels, whatever the unit of the field."""

    def __format__(self, spec: str) -> str:
        return f"{float(self):.3g}" if spec.endswith("-") else f"{float(self):.3g} px"


def escaped(name: str) -> str:
    """The name of a file in a message that is a template."""
    return name.replace("{", "{{").replace("}", "}}")


def worst_first(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Findings by severity, each once; those of one severity as they come."""
    order = [Severity.SPOILS, Severity.DOUBT, Severity.NOTE]
    return tuple(sorted(dict.fromkeys(findings), key=lambda finding: order.index(finding.severity)))


def refuse(findings: Iterable[Finding], *, keep: bool) -> None:
    """Refuse photographs that spoil the surface, unless they are to be kept. Raises BadInput."""
    for finding in findings:
        sound = keep or finding.severity != Severity.SPOILS
        require(
            sound, f"{str(finding).rstrip('.')}; `keep` (the setting keep) goes on all the same."
        )
