"""A gallery of enrolled fingers: who is in it, and pictures of what its templates keep."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import numpy as np

from splitknit import BadInput, encode_image, require
from splitknit_match.gallery.file import GalleryFile
from splitknit_match.gallery.key import Key, key_of
from splitknit_match.matching.template import unpack

_GREYS = np.array([255, 176, 80, 0], dtype=np.uint8)  # deep valley to high ridge: ridges dark, as in a print


class People:
    """The rows of a gallery, read when it is opened; templates are read one by one."""

    def __init__(self, path: Path, key: Key | None = None) -> None:
        """Raises BadInput if it is not a gallery, damaged, or the key is missing or wrong."""
        self._path, self._key = path, key
        self._lock = threading.Lock()
        with GalleryFile(path, key) as gallery:
            self._rows = gallery.entries()

    def document(self) -> list[dict[str, Any]]:
        """For the page."""
        names = ("person", "finger", "session", "area_mm2")
        facts = ({name: getattr(one, name) for name in names} for one in self._rows)
        each = zip(self._rows, facts, strict=True)
        return [{"row": one.row, "acquired": one.template_bytes > 0, **about} for one, about in each]

    def picture(self, row: str) -> bytes:
        """Return the template of a row as PNG: tip up, as the camera sees it, one pixel for each of its own. Raises
        BadInput if there is no such row, or it holds no template.
        """
        known = row.isascii() and row.isdigit() and len(row) < 12 and any(one.row == int(row) for one in self._rows)
        require(known, "there is no such row in the gallery.")
        with self._lock, GalleryFile(self._path, self._key) as gallery:
            payload = gallery.templates([int(row)]).get(int(row), b"")
        template = unpack(payload)
        if template.empty:
            raise BadInput("this finger could not be acquired; there is no template.")
        picture = np.where(template.valid, _GREYS[template.level], np.uint8(255))
        return encode_image(picture.astype(np.uint8), ".png")


def open_people(path: Path, key_file: Path | None) -> People:
    """Open a gallery, by its key where it is encrypted. Raises BadInput as :class:`People` does."""
    return People(path, key_of(key_file))
