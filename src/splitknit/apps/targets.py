"""Folders that verbs write into: an earlier one of the same kind may be replaced, nothing else."""

from __future__ import annotations

from pathlib import Path

from splitknit.check import BadInput, require
from splitknit.io.fields import read_json


def check_target(out: Path, marker: str, words: str, *, keep: Path | None = None, form: str | None = None) -> None:
    """Refuse to replace a folder that is not empty and not of our kind, or that is read from (`keep`).

    :func:`splitknit.io.atomic_folder` refuses files that are not ours; this keeps one kind of ours from replacing
    another, such as a result a capture.

    Parameters
    ----------
    out : folder to write
    marker : file that every folder of the kind holds
    words : for the kind, such as "an earlier result"
    keep : what is read from, if that is a folder
    form : the field "format" of `marker`, where that is a JSON file that folders of other kinds have as well

    Raises
    ------
    BadInput
        If `out` must not be replaced, or cannot be looked into.
    """
    out = out.expanduser()
    try:
        if keep is not None and out.exists():
            source = keep.expanduser().resolve()
            inside = out.resolve() in (source, *source.parents)
            require(not inside, f"'{out}' holds the input itself; name another folder to write into.")
        if out.is_dir() and any(out.iterdir()):
            known = (out / marker).is_file() and (form is None or _format_of(out / marker) == form)
            require(known, f"'{out}' is not empty and is not {words}; name another folder.")
    except OSError as error:
        raise BadInput(f"'{out}' cannot be written ({error.strerror}); name another folder.") from error


def _format_of(file: Path) -> object:
    try:
        document, _ = read_json(file)
    except BadInput:
        return None
    return document.get("format") if isinstance(document, dict) else None
