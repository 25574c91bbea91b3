"""A row of the documentation for each code of the rig's findings."""

import re
from pathlib import Path

import splitknit_rig
from splitknit.diagnosis.codes import CODES as CORE
from splitknit_rig.codes import CODES
from splitknit_simulator import twin_devices


def test_every_code_has_a_row_and_every_row_is_used():
    root = Path(splitknit_rig.__file__).parent
    files = [path for path in root.rglob("*.py") if path.name != "codes.py"]
    files.append(Path(twin_devices.__file__))  # opened by `capture`
    sources = "\n".join(path.read_text(encoding="utf-8") for path in files)
    constructed = re.findall(r'Finding\(\s*"([a-z-]+)"', sources)
    assert len(constructed) == sources.count("Finding(")
    assert set(constructed) <= {*CODES, *CORE}
    assert set(CODES) <= set(constructed)
    assert not set(CODES) & set(CORE)
