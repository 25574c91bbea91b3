"""Folders and files that verbs write: an earlier one of the same kind may be replaced, nothing
else."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable
from pathlib import Path

from splitknit.errors import BadInput, require
from splitknit.files import open_file
from splitknit.io.capture import CAPTURE_FORMAT
from splitknit.io.fields import read_json


def check_target(
    out: Path, marker: str, words: str, *, keep: Path | None = None, form: str | None = None
) -> None:
    """Refuse to replace a folder that is not empty and not of this kind, or that is read from
    (`keep`).

    :func:`splitknit.io.atomic.atomic_folder` refuses files of other programs; this keeps one kind
    of folder from replacing another, such as a result a capture. `marker`: file that every folder
    of the kind holds; `words`: for the kind, such as "an earlier result"; `form`: the field
    "format" of `marker`, where that is a JSON file that folders of other kinds have as well. Raises
    BadInput if `out` must not be replaced, or cannot be looked into.
    """
    out = out.expanduser()
    try:
        if keep is not None and out.exists():
            source = keep.expanduser().resolve()
            inside = out.resolve() in (source, *source.parents)
            require(
                not inside, f"'{out}' holds the input itself; name another folder to write into."
            )
        if out.is_dir() and any(out.iterdir()):
            known = (out / marker).is_file() and (form is None or _format_of(out / marker) == form)
            require(known, f"'{out}' is not empty and is not {words}; name another folder.")
    except OSError as error:
        raise BadInput(
            f"'{out}' cannot be written ({error.strerror}); name another folder."
        ) from error


def check_capture(
    out: Path,
    *,
    overwrite: bool,
    marker: str = "capture.json",
    words: str = "an earlier capture",
    keep: Path | None = None,
) -> None:
    """Refuse a folder for photographs that holds anything, or, with `overwrite`, anything but ours:
    they cannot be made again. Arguments and BadInput as :func:`check_target`.
    """
    check_target(
        out, marker, words, keep=keep, form=CAPTURE_FORMAT if marker == "capture.json" else None
    )
    taken = (out.expanduser() / marker).exists()
    require(
        overwrite or not taken,
        f"'{out}' exists and is not empty: it is {words}; name another folder, or give"
        " `overwrite`.",
    )


def check_file(
    out: Path | None, words: str, is_own: Callable[[bytes], bool] | None = None, *, form: str = ""
) -> None:
    """Refuse to replace a file that is not of this kind; called before the work, so that none is
    done in vain.

    `out`: file to write, unchecked if None; `words`: for the kind, such as "a template"; `is_own`:
    whether a file that begins with these bytes, at most 16 MB of it, is of the kind; `form`: the
    field "format" of a JSON file of the kind, instead. Raises BadInput if `out` exists and is a
    folder or of another kind, or cannot be looked into.
    """
    if out is None or not os.path.lexists(out := out.expanduser()):
        return
    require(not out.is_dir(), f"'{out}' is a folder; name {words} to write.")
    known = False
    with contextlib.suppress(BadInput):
        with open_file(out, 1 << 50) as (stream, _):
            data = stream.read(16_000_000)
        known = _format_of(out) == form if is_own is None else is_own(data)
    require(known, f"'{out}' exists and is not {words}; name another file.")


def _format_of(file: Path) -> object:
    try:
        return read_json(file)[0].get("format")
    except BadInput:
        return None
