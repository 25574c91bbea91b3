"""``splitknit records what FILE ...``: identify fingerprint records and list their contents."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from splitknit.arguments import AnyPath, Report, count
from splitknit.errors import BadInput


def what(file: AnyPath, *others: AnyPath) -> Report:
    """Tell what a record, a picture or a template is, and what it holds.

    Parameters
    ----------
    file
        Any file.
    others
        More files.

    Returns
    -------
    Report
        Of several files one a file, as ``files``. That one cannot be read is a result, where it is
        known what it is.

    Raises
    ------
    BadInput
        If there is no such file.

    Examples
    --------
    >>> what("print.wsq").facts["what"]  # doctest: +SKIP
    'a picture (WSQ)'
    """
    reports = [_what(Path(each)) for each in (file, *others)]
    if not others:
        return reports[0]
    lines = [line for report in reports for line in report.lines]
    return Report({"files": [report.facts for report in reports]}, tuple(lines))


def _what(path: Path) -> Report:
    """Report on one file."""
    from splitknit.files import open_file
    from splitknit.io.provenance import file_hash
    from splitknit_match.records.fmr_bytes import standard_of, what_bytes_are
    from splitknit_match.records.pictures import PrintFile
    from splitknit_match.records.print_formats import FORMATS, read_prints

    with open_file(path, 1 << 50) as (stream, size):
        first = stream.read(4096)
    form = next((known for known in FORMATS.values() if first.startswith(known.starts)), None)
    kind = standard_of(first) or (
        form.words if form else what_bytes_are(first, "of an unknown kind")
    )
    facts: dict[str, Any] = {
        "file": str(path),
        "bytes": size,
        "sha256": file_hash(path),
        "what": kind,
        "holds": [],
    }
    lines = [f"{path}: {kind}, {size:,} bytes."]
    try:
        prints = read_prints(path) if form is not None else ()
    except BadInput as error:
        return Report({**facts, "damage": str(error)}, (*lines, f"It cannot be read: {error}"))
    for number, item in enumerate(prints, start=1):
        about: dict[str, Any] = {"finger": item.finger, "impression": item.impression}
        if isinstance(item, PrintFile):
            rows, columns = item.image.shape
            ppi = about["ppi"] = item.resolution_ppi
            words = "resolution unknown" if ppi is None else f"{ppi:.0f} ppi"
        else:
            rows, columns = item.size
            about |= {
                "ppcm": list(item.resolution_ppcm),
                "minutiae": item.count,
                "quality": item.finger_quality,
            }
            words = f"{count(item.count, 'minutia', 'minutiae')}, quality {item.finger_quality}"
        facts["holds"].append(about | {"rows": rows, "columns": columns})
        finger = item.finger.replace("_", " ")
        lines.append(f"{number}. {finger}, {item.impression}: {columns} x {rows} pixels, {words}.")
    return Report(facts, tuple(lines))
