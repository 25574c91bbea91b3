"""From what was named on the command line to a service."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from splitknit.apps.viewer.catalogue import Catalogue, make_catalogue
from splitknit.apps.viewer.service import Service
from splitknit.errors import require

_DATABASE = b"SQLite format 3\0"


def open_paths(paths: Sequence[Path], capture: Path | None = None, key_file: Path | None = None) -> Service:
    """Return a service for a result, two results, a folder of results, or a gallery.

    What was named itself is read at once: what is damaged is said before a page opens.

    Raises
    ------
    BadInput
        If there is nothing to show, or it cannot be read.
    """
    if _is_database(paths[0]):
        return _gallery(paths, key_file)
    require(key_file is None, f"'{paths[0]}' is no gallery; --key-file is for galleries.")
    service = Service(make_catalogue(paths, capture))
    for chosen in service.catalogue.chosen:
        service.surface(service.catalogue.entry(chosen))
    return service


def _gallery(paths: Sequence[Path], key_file: Path | None) -> Service:
    from splitknit.apps.gallery_options import key_of  # noqa: PLC0415 - a result needs none of it
    from splitknit.apps.viewer.people import People  # noqa: PLC0415

    require(len(paths) == 1, "a gallery is shown alone; name nothing else.")
    return Service(Catalogue(paths[0].name, (), ()), People(paths[0], key_of(key_file)))


def _is_database(path: Path) -> bool:
    try:
        with path.expanduser().open("rb") as stream:
            return stream.read(len(_DATABASE)) == _DATABASE
    except (OSError, ValueError, RuntimeError):
        return False
