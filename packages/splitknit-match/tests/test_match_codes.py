"""Findings of the matching verbs: a row of the documentation for each code."""

from __future__ import annotations

import re
from pathlib import Path

import splitknit_match
from splitknit.diagnosis.codes import CODES as CORE_CODES
from splitknit_match.codes import CODES


def test_every_code_has_a_row_and_every_row_is_used() -> None:
    folder = Path(splitknit_match.__file__).parent
    sources = "\n".join(
        path.read_text(encoding="utf-8") for path in folder.rglob("*.py") if path.name != "codes.py"
    )
    made = set(re.findall(r'Finding\(\s*"([a-z-]+)"', sources))
    assert made <= set(CODES) | set(CORE_CODES)
    assert not set(CODES) & set(CORE_CODES)
    assert set(CODES) <= set(re.findall(r'"([a-z]+(?:-[a-z]+)*)"', sources))
