"""Codes of the findings of the matching verbs."""

import re
from pathlib import Path

import splitknit_match
from splitknit.diagnosis.codes import CODES as CORE_CODES
from splitknit_match.codes import CODES


def test_the_codes_are_those_that_the_sources_use():
    folder = Path(splitknit_match.__file__).parent
    sources = "\n".join(
        path.read_text(encoding="utf-8") for path in folder.rglob("*.py") if path.name != "codes.py"
    )
    assert set(re.findall(r'Finding\(\s*"([a-z-]+)"', sources)) <= set(CODES) | set(CORE_CODES)
    assert not set(CODES) & set(CORE_CODES)
    assert set(CODES) <= set(re.findall(r'"([a-z]+(?:-[a-z]+)*)"', sources))
