"""``splitknit rig target``: the printed targets."""

from __future__ import annotations

from pathlib import Path

from splitknit.arguments import AnyPath, Report

_SHEET = Path(__file__).parent / "calibration" / "target.pdf"  # hardware/target.py draws it


def write_target(*, out: AnyPath) -> Report:
    """Write checkerboards and the calibration disc as a PDF at true scale.

    Parameters
    ----------
    out
        Folder to write, for target.pdf; or a PDF file.

    Returns
    -------
    Report
        The file, and how to print it.

    Raises
    ------
    BadInput
        If `out` holds something else.

    Examples
    --------
    >>> write_target(out="targets")  # doctest: +SKIP
    """
    from splitknit.io.atomic import atomic_folder, write_file
    from splitknit.io.targets import check_file, check_target

    place, data = Path(out), _SHEET.read_bytes()
    sheet = place if place.suffix.lower() == ".pdf" else place / _SHEET.name
    if sheet == place:
        check_file(sheet, "a sheet of targets", lambda earlier: earlier == data)
        write_file(sheet, data)
    else:
        check_target(place, _SHEET.name, "an earlier sheet of targets")
        with atomic_folder(place) as folder:
            (folder / _SHEET.name).write_bytes(data)
    boards = "16 checkerboards of 9 x 6 inner corners (10 x 7 squares of 3 mm)"
    return Report(
        {"out": str(out)},
        (
            f"{sheet}: {boards}, and the disc with 61 dots, on one sheet of A4.",
            "Print it at 100 %; the ruler must measure 100 mm.",
        ),
    )
