"""``splitknit records what FILE``: what a file of another system is, and what it holds."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from splitknit.arguments import AnyPath, Report, count
from splitknit.errors import BadInput

_FIRST_BYTES = 4096


def what_file(file: AnyPath) -> Report:
    """Tell what a record, a picture or a template is, and what it holds.

    Parameters
    ----------
    file
        Any file.

    Returns
    -------
    Report
        That a file cannot be read is a result, where it is known what it is.

    Raises
    ------
    BadInput
        If there is no such file.

    Examples
    --------
    >>> what_file("finger.fmr").facts["what"]  # doctest: +SKIP
    'ANSI/INCITS 378-2004'
    """
    from splitknit.errors import open_file
    from splitknit.io.prints import PrintFile
    from splitknit.io.provenance import file_hash
    from splitknit_match.records.fmr_bytes import standard_of, what_bytes_are
    from splitknit_match.records.print_formats import FORMATS, read_prints

    path = Path(file)
    with open_file(path, 1 << 50) as (stream, size):
        first = stream.read(_FIRST_BYTES)
    form = next((form for form in FORMATS.values() if first.startswith(form.starts)), None)
    what = standard_of(first) or (form.words if form else what_bytes_are(first, "of an unknown kind"))
    facts: dict[str, Any] = {"file": str(path), "bytes": size, "sha256": file_hash(path), "what": what, "holds": []}
    lines = [f"{path}: {what}, {size:,} bytes."]
    try:
        prints = read_prints(path) if form is not None else ()
    except BadInput as error:
        return Report({**facts, "damage": str(error)}, (*lines, f"It cannot be read: {error}"))
    for number, item in enumerate(prints, start=1):
        about: dict[str, Any] = {"finger": item.finger, "impression": item.impression}
        if isinstance(item, PrintFile):
            rows, columns = item.image.shape
            about |= {"rows": rows, "columns": columns, "ppi": item.resolution_ppi}
            words = "resolution unknown" if item.resolution_ppi is None else f"{item.resolution_ppi:.0f} ppi"
        else:
            rows, columns = item.size
            about |= {"rows": rows, "columns": columns, "ppcm": list(item.resolution_ppcm)}
            about |= {"minutiae": item.count, "quality": item.finger_quality}
            words = f"{count(item.count, 'minutia', 'minutiae')}, quality {item.finger_quality}"
        facts["holds"].append(about)
        finger = item.finger.replace("_", " ")
        lines.append(f"{number}. {finger}, {item.impression}: {columns} x {rows} pixels, {words}.")
    return Report(facts, tuple(lines))
