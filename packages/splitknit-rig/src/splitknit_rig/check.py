"""``splitknit rig check``: the acceptance test of a rig that was built."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from splitknit.arguments import AnyPath, Positive, Progress, checked, refuse_given, silent, text_of
from splitknit.errors import require

if TYPE_CHECKING:
    from splitknit_rig.acceptance.questions import Answer
else:
    Answer = Any

_FOLDERS = Parameter(group="Photographs (capture folders), where no device takes them")


@dataclass(frozen=True, slots=True)
class RigCheck:
    """Result of the acceptance test."""

    answers: tuple[Answer, ...]
    """A row for each question: ``question``, ``measured``, ``limit``, ``unit``, ``passed``,
    ``at_least`` (whether the limit is the smallest value that passes), and ``note``: the LED or
    band, or the reason why nothing was measured."""
    facts: dict[str, Any]
    """``answer``: passed or failed; ``rows``, ``rig``, ``ball_mm``, ``tested_at``, and hashes of
    all files."""

    @property
    def passed(self) -> bool:
        """Whether every question passed."""
        return all(answer.passed for answer in self.answers)

    def __str__(self) -> str:
        rows = [("question", "measured", "limit", "unit", "where", ""), *_rows(self.answers)]
        widths = [max(len(row[k]) for row in rows) for k in range(4)]
        lines = []
        for question, measured, limit, unit, note, verdict in rows:
            cells = (
                question.ljust(widths[0]),
                measured.rjust(widths[1]),
                limit.rjust(widths[2]),
                unit.ljust(widths[3]),
                verdict.ljust(6),
                note,
            )
            lines.append("  ".join(cells).rstrip())
        failed = sum(not answer.passed for answer in self.answers)
        verdict = f"{failed} of {len(self.answers)} questions failed." if failed else "All passed."
        return text_of(
            [*lines, f"{verdict} Written to {self.facts['out']}: check.html, check.json."]
        )


def _rows(answers: Sequence[Answer]) -> list[tuple[str, str, str, str, str, str]]:
    rows = []
    earlier = ""
    for answer in answers:
        again = answer.measured is None and answer.note == earlier
        earlier = answer.note
        rows.append(
            (
                answer.question,
                "-" if answer.measured is None else f"{answer.measured:.3g}",
                f"{'>=' if answer.at_least else '<='} {answer.limit:g}",
                answer.unit,
                "as above" if again else answer.note,
                "passed" if answer.passed else "failed",
            )
        )
    return rows


@checked
def check_rig(
    rig: AnyPath,
    *,
    out: AnyPath,
    device: Literal["pi", "twin"] | None = None,
    card: Annotated[AnyPath | None, _FOLDERS] = None,
    phantom: Annotated[AnyPath | None, _FOLDERS] = None,
    ball: Annotated[AnyPath | None, _FOLDERS] = None,
    finger: Annotated[Sequence[AnyPath], _FOLDERS] = (),
    ball_mm: Positive = 16.0,
    progress: Progress = silent,
) -> RigCheck:
    """Test a built and calibrated rig with a matt card, a printed phantom, a ball and a finger: for
    each question a number, its limit, and whether it passed.

    Parameters
    ----------
    rig
        Rig file, as calibrated.
    out
        Folder to write: check.html to keep with the rig, check.json, and the photographs of
        `device`.
    device
        Photograph now: pi, the Raspberry Pi's rig; twin, the simulated one.
    card
        A white matt card under every LED, with radiometry.json.
    phantom
        The printed phantom that ``python -m hardware.phantom`` draws, tip up on dark ground, its
        top at the finger plane.
    ball
        A matt grey ball on the finger plane, on dark ground.
    finger
        A bare finger; given twice, for two captures between which it stayed.
    ball_mm
        Diameter of the ball.

    Returns
    -------
    RigCheck

    Raises
    ------
    BadInput
        Naming the folder or file at fault; nothing is written.

    Examples
    --------
    >>> check_rig("rig.json", device="twin", out="check").passed  # doctest: +SKIP
    True
    """
    from splitknit import read_rig
    from splitknit.io.atomic import atomic_folder
    from splitknit.io.provenance import file_hash, json_text, provenance
    from splitknit.io.targets import check_target
    from splitknit.report import template
    from splitknit_rig.acceptance.photographs import (
        PARTS,
        answers_of,
        read_photographs,
        take_photographs,
    )
    from splitknit_rig.capture.openers import opener_of

    photographs = {"card": card, "phantom": phantom, "ball": ball, "finger": finger}
    if device is not None:
        refuse_given("does not go with `device`, which photographs it.", **photographs)
    else:
        alone = (card, phantom, ball)
        require(
            None not in alone and len(finger) == 2,
            "name the photographs, `card`, `phantom`, `ball` and twice `finger`, or a `device` that"
            " takes them.",
        )
    check_target(Path(out), "check.json", "an earlier acceptance test")
    base = read_rig(rig)
    with atomic_folder(Path(out)) as folder:
        if device is None:
            named = [Path(place) for place in (*alone, *finger) if place is not None]
            places = dict(zip(PARTS, named, strict=True))
        else:
            openers = {
                part: opener_of(device, {}, rig, None, target=None if part == "finger" else part)
                for part in (*PARTS[:3], "finger")
            }
            asks = device == "pi" and sys.stdin.isatty()
            places = take_photographs(
                openers, folder, _ask if asks else lambda part: None, progress
            )
        taken, series, hashes = read_photographs(places, base)
        answers = tuple(answers_of(taken, series, base, ball_mm, progress))
        hashes["rig.json"] = file_hash(Path(rig))
        facts = {
            "answer": "passed" if all(answer.passed for answer in answers) else "failed",
            "rig": str(rig),
            "ball_mm": ball_mm,
            "tested_at": datetime.now(UTC).strftime("%Y-%m-%d"),
            "rows": [asdict(answer) for answer in answers],
            **provenance({"device": device}, hashes),
            "out": str(out),
        }
        (folder / "check.json").write_text(json_text(facts), encoding="utf-8")
        page = template(Path(__file__).parent / "acceptance" / "page.html")
        page = page.render(facts, rig=Path(rig).name, rows=_rows(answers))
        (folder / "check.html").write_text(page, encoding="utf-8")
    progress("done", 1.0)
    return RigCheck(answers, facts)


_LAY = {
    "card": "the matt card on the finger plane",
    "phantom": "the printed phantom on dark ground, tip up, its top at the finger plane",
    "ball": "the grey ball on the finger plane, on dark ground",
    "finger": "a bare finger, and leave it there until the end",
}


def _ask(part: str) -> None:
    sys.stderr.write(f"\nLay {_LAY[part]}, then press Enter: ")
    sys.stderr.flush()
    require(sys.stdin.readline() != "", "nobody answered on the terminal.")
