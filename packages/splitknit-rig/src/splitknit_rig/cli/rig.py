"""``splitknit rig target``: the printed targets."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import Annotated

from splitknit import AnyPath, Help, Job, Outcome, Progress, Verb, path

_SHEET = "target.pdf"


@dataclass(frozen=True, slots=True)
class TargetJob(Job):
    """Write checkerboards and the calibration disc as a PDF at true scale.

    Returns
    -------
    dict, list of str
        Sizes and counts, and the same in lines.
    """

    # fmt: off
    _: KW_ONLY
    out: Annotated[AnyPath, Help("folder to write, for target.pdf; or a PDF file", "DIR")]
    board: Annotated[str, Help("inner corners each way", "CxR")] = "9x6"
    square_mm: Annotated[float, Help("side of a square", "N")] = 3.0
    dot_mm: Annotated[float, Help("spacing of the disc's dots", "N")] = 10.0
    # fmt: on

    def run(self, progress: Progress) -> Outcome:
        """Draw and write it."""
        from splitknit import atomic_folder, check_file, check_target, write_file
        from splitknit_rig.calibration.sheet import DOT_MM, PRODUCER, RULER_MM, TargetSettings, dots_mm, target_pdf
        from splitknit_rig.calibration.targets import Board

        out = path(self.out)
        as_file = out.suffix.lower() == ".pdf"
        sheet = out if as_file else out / _SHEET
        if as_file:
            check_file(sheet, "a sheet of targets", lambda data: data.startswith(b"%PDF") and PRODUCER in data)
        else:
            check_target(out, _SHEET, "an earlier sheet of targets")
        board = Board.named(self.board, self.square_mm)
        settings = TargetSettings(board.columns, board.rows, self.square_mm, self.dot_mm)
        data = target_pdf(settings)
        if as_file:
            write_file(out, data)
        else:
            with atomic_folder(out) as folder:
                (folder / _SHEET).write_bytes(data)
        across, down = settings.copies
        width, height = settings.board_mm
        facts = {
            "out": str(out),
            "board": {"inner_corners": [board.columns, board.rows], "square_mm": self.square_mm},
            "board_mm": [width, height],
            "copies": across * down,
            "disc": {"dots": len(dots_mm(settings)), "dot_mm": DOT_MM, "spacing_mm": settings.spacing_mm},
            "ruler_mm": RULER_MM,
        }
        lines = [
            f"{sheet}: {across * down} checkerboards of {width:g} x {height:g} mm (`board` {board.columns}x{board.rows}"
            f": inner corners, where four squares meet; {board.columns + 1} x {board.rows + 1} squares), and the disc "
            f"with {len(dots_mm(settings))} dots, on one sheet of A4.",
            f"Print it at 100 %; the ruler must measure {RULER_MM:g} mm.",
        ]
        return facts, lines


TARGET = Verb(TargetJob)
