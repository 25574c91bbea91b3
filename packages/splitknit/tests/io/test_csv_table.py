"""Tables that a spreadsheet opens: no cell of them runs, and all come back as they were."""

import csv
import io

import pytest

from splitknit.io.csv_table import csv_text, plain_text

_TEXTS = [
    '=HYPERLINK("http://x","open")',
    "+1+1",
    "-1+1",
    "@SUM(A1)",
    "\tx",
    "'=x",
    "''-1+1",
    "＝1",
    "'",
    "'tis",
    "S01",
]


@pytest.mark.parametrize("text", [*_TEXTS, "-0.5", "+1", "", "a,b", 'a"b', "\n"])
def test_texts_come_back_and_none_runs_as_a_formula(text):
    ((cell,),) = csv.reader(io.StringIO(csv_text([[text]]), newline=""))
    assert plain_text(cell) == text
    assert cell[:1] not in "=@\t\r＝" or not cell
    assert cell[:1] not in "+-" or text in ("-0.5", "+1", "")


def test_numbers_are_untouched():
    assert (
        csv_text([["a", "b"], [-0.5, "-1.25e-09"], [None, True]]) == "a,b\n-0.5,-1.25e-09\n,True\n"
    )
