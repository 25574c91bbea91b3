"""Checks before calibrations write a file: only an earlier one of the same kind is replaced."""

from __future__ import annotations

from pathlib import Path

from splitknit.errors import require
from splitknit.io.images import PNG, TIFFS
from splitknit.io.rig import RIG_FORMAT
from splitknit.io.targets import check_file


def check_rig_file(out: Path | None) -> None:
    """Refuse to replace a file that is not a rig file; see :func:`check_file`."""
    check_file(out, "a rig file", form=RIG_FORMAT)


def check_picture(out: Path | None, photographs: Path | None = None) -> None:
    """Refuse to replace a file that is not a PNG or TIFF picture, or is one of the photographs that
    are read."""
    if out is None:
        return
    require(
        out.suffix.lower() in (".png", ".tif", ".tiff"),
        f"'{out}' must end in .png or .tif: it is a picture.",
    )
    check_file(out, "a picture", lambda data: data.startswith((PNG, *TIFFS)))
    place = out.expanduser()
    inside = (
        photographs is not None
        and place.exists()
        and photographs.expanduser().resolve() in place.resolve().parents
    )
    require(not inside, f"'{out}' is one of the photographs in '{photographs}'; name another file.")
