"""The command line of ``splitknit rig target``: the printed target for the camera's calibration."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from splitknit.cli.verb import Outcome, new_verb

_SHEET = "target.pdf"


def add_target(kinds: Any) -> None:
    """Add the verb."""
    verb = new_verb(kinds, "target", "write checkerboards and the calibration disc as a PDF at true scale", _run)
    verb.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="folder to write, for target.pdf; or a PDF file"
    )
    verb.add_argument("--board", default="9x6", metavar="CxR", help="inner corners each way (default: 9x6)")
    verb.add_argument("--square-mm", type=float, default=3.0, metavar="N", help="side of a square (default: 3)")
    verb.add_argument(
        "--dot-mm", type=float, default=10.0, metavar="N", help="spacing of the disc's dots (default: 10)"
    )


def _run(options: argparse.Namespace) -> Outcome:
    """Write the sheet."""
    from splitknit.calibration.targets import Board  # noqa: PLC0415
    from splitknit.io.atomic import atomic_file, atomic_folder  # noqa: PLC0415
    from splitknit.io.targets import check_file, check_target  # noqa: PLC0415
    from splitknit.rig.target import (  # noqa: PLC0415
        DOT_MM,
        PRODUCER,
        RULER_MM,
        TargetSettings,
        dots_mm,
        target_pdf,
    )

    as_file = options.out.suffix.lower() == ".pdf"  # as before, when only a file was taken
    if not as_file:
        check_target(options.out, _SHEET, "an earlier sheet of targets")
    check_file(
        options.out if as_file else None,
        "a sheet of targets",
        lambda data: data.startswith(b"%PDF") and PRODUCER in data,
    )
    board = Board.named(options.board, options.square_mm)
    settings = TargetSettings(
        columns=board.columns, rows=board.rows, square_mm=options.square_mm, spacing_mm=options.dot_mm
    )
    data = target_pdf(settings)
    if as_file:
        with atomic_file(options.out) as stream:
            stream.write(data)
    else:
        with atomic_folder(options.out) as folder:
            (folder / _SHEET).write_bytes(data)
    across, down = settings.copies
    width, height = settings.board_mm
    facts = {
        "out": str(options.out),
        "board": {"inner_corners": [board.columns, board.rows], "square_mm": options.square_mm},
        "board_mm": [width, height],
        "copies": across * down,
        "disc": {"dots": len(dots_mm(settings)), "dot_mm": DOT_MM, "spacing_mm": settings.spacing_mm},
        "ruler_mm": RULER_MM,
    }
    sheet = options.out if as_file else options.out / _SHEET
    lines = [
        f"{sheet}: {across * down} checkerboards of {width:g} x {height:g} mm ({board.columns} x "
        f"{board.rows} inner corners), and the disc with {len(dots_mm(settings))} dots, on one sheet of A4.",
        f"Print it at 100 %; the ruler must measure {RULER_MM:g} mm.",
    ]
    return facts, lines
