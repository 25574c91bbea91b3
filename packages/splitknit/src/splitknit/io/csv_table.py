"""Tables as CSV: what a spreadsheet would run as a formula is written as text, and read back as it
was.

Source: RFC 4180, Common Format and MIME Type for CSV Files; OWASP, CSV Injection.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable
from typing import Any

# what a formula begins with; signs of full width count in East Asian sheets
_FORMULA = frozenset("=+-@\t\r\n＝＋－＠")


def csv_text(rows: Iterable[Iterable[Any]]) -> str:
    """Rows as the text of a CSV file. A text that a spreadsheet would run begins with an
    apostrophe, which spreadsheets do not show and :func:`plain_text` takes off.

    >>> csv_text([["name", "height"], ['=HYPERLINK("x")', -0.5], ["-0.5", "@a"]]).splitlines()
    ['name,height', '"\\'=HYPERLINK(""x"")",-0.5', "-0.5,'@a"]
    """
    stream = io.StringIO()
    csv.writer(stream, lineterminator="\n").writerows(
        [[_defused(cell) for cell in row] for row in rows]
    )
    return stream.getvalue()


def plain_text(cell: str) -> str:
    """Return a cell of :func:`csv_text` as it was before.

    >>> plain_text("'=1+1"), plain_text("'tis"), plain_text("-0.5")
    ('=1+1', "'tis", '-0.5')
    """
    return cell[1:] if cell[:1] == "'" and cell.lstrip("'")[:1] in _FORMULA else cell


def _defused(cell: Any) -> Any:
    if isinstance(cell, str) and cell.lstrip("'")[:1] in _FORMULA:
        try:
            float(cell)
        except ValueError:
            return f"'{cell}"
    return cell
