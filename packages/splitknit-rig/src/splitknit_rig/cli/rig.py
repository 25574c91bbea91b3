"""``splitknit rig target``: the printed targets."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated

from splitknit.cli.verb import Outcome, Verb
from splitknit.verbs import AnyPath, Help, Job, Progress, path

_SHEET = Path(__file__).parents[1] / "calibration" / "target.pdf"  # hardware/target.py draws it


@dataclass(frozen=True, slots=True)
class TargetJob(Job):
    """Write checkerboards and the calibration disc as a PDF at true scale.

    Returns
    -------
    dict, list of str
        The file, and how to print it.
    """

    _: KW_ONLY
    out: Annotated[AnyPath, Help("folder to write, for target.pdf; or a PDF file", "DIR")]

    def run(self, progress: Progress) -> Outcome:
        """Write it."""
        from splitknit.io.atomic import atomic_folder, write_file
        from splitknit.io.targets import check_file, check_target

        out, data = path(self.out), _SHEET.read_bytes()
        sheet = out if out.suffix.lower() == ".pdf" else out / _SHEET.name
        if sheet == out:
            check_file(sheet, "a sheet of targets", lambda earlier: earlier == data)
            write_file(out, data)
        else:
            check_target(out, _SHEET.name, "an earlier sheet of targets")
            with atomic_folder(out) as folder:
                (folder / _SHEET.name).write_bytes(data)
        return {"out": str(out)}, [
            f"{sheet}: 16 checkerboards of 9 x 6 inner corners (10 x 7 squares of 3 mm), and the disc with 61 dots, on "
            "one sheet of A4.",
            "Print it at 100 %; the ruler must measure 100 mm.",
        ]


TARGET = Verb(TargetJob)
