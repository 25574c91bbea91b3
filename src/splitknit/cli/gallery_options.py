"""Options of the verbs that open a gallery, and how they count."""

from __future__ import annotations

import argparse
from pathlib import Path

from splitknit.gallery import COUNTER, KEY_VARIABLE


def add_gallery(verb: argparse.ArgumentParser) -> None:
    """Add the gallery and its key."""
    verb.add_argument("gallery", type=Path, metavar="GALLERY", help="file of the gallery")
    add_key(verb)


def add_key(verb: argparse.ArgumentParser) -> None:
    """Add ``--key-file``."""
    verb.add_argument(
        "--key-file",
        type=Path,
        metavar="FILE",
        help=f"key of an encrypted gallery: a passphrase, or 64 hexadecimal digits (or the variable {KEY_VARIABLE}); "
        f"FILE{COUNTER}, where it is there, remembers the last change, so that older copies of a gallery are refused",
    )


def count(number: int, one: str, many: str | None = None) -> str:
    """Number and word."""
    return f"{number} {one if number == 1 else many or one + 's'}"
