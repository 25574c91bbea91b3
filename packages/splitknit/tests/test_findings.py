"""Findings: their order, their lengths in pixels, and a row of the documentation for each code."""

import re
from pathlib import Path
from typing import get_args

import splitknit
from refusals import bad_input
from splitknit.diagnosis.codes import CODES
from splitknit.diagnosis.photographs import Fault
from splitknit.findings import Finding, Severity, refuse, worst_first
from splitknit.methods.metric import HARDLY_MEASURED

WIDE = Finding(
    "odd-finger-width",
    "it is {:.1f mm} wide, where {:g mm-} to {:g mm} is usual.",
    lengths_mm=(40.0, 6.0, 30.0),
)


def test_lengths_are_in_pixels_where_the_scale_is_unknown():
    assert str(WIDE) == "it is 40.0 mm wide, where 6 to 30 mm is usual."
    assert str(WIDE.in_pixels(20.0)) == "it is 800 px wide, where 120 to 600 px is usual."
    assert str(Finding("jpeg", "a {name}").in_pixels(2.0)) == "a {name}"


def test_hardly_measured_ridges_are_given_in_um():
    finding = Finding("hardly-measured", HARDLY_MEASURED, lengths_mm=(0.012, 0.02))
    assert str(finding).endswith(": 12 um rms with an expected error of 20 um.")


NOTE, DOUBT = Finding("jpeg", "a"), Finding("jpeg", "b", Severity.DOUBT)
SPOILS = Finding("one-light", "c.", Severity.SPOILS, files=("x.png",), effect_deg=4.0)


def test_the_worst_finding_comes_first_and_each_once():
    assert worst_first([NOTE, DOUBT, SPOILS, NOTE]) == (SPOILS, DOUBT, NOTE)


def test_only_findings_that_spoil_the_result_are_refused():
    refuse([NOTE, DOUBT, SPOILS], keep=True)
    refuse([NOTE, DOUBT], keep=False)
    with bad_input(r"^c; `keep`"):
        refuse([NOTE, SPOILS], keep=False)


def test_a_finding_states_its_facts_and_its_band():
    assert SPOILS.facts == {
        "code": "one-light",
        "severity": "spoils",
        "message": "c.",
        "files": ["x.png"],
        "effect_deg": 4.0,
    }
    assert str(NOTE.of_band("nir")) == "nir band: a"


def test_every_code_has_a_row_and_every_row_is_used():
    sources = [
        path.read_text(encoding="utf-8") for path in Path(splitknit.__file__).parent.rglob("*.py")
    ]
    table = next(text for text in sources if "CODES: dict" in text)
    used = set(
        re.findall(
            r'"([a-z]+(?:-[a-z]+)*)"', "\n".join(text for text in sources if text is not table)
        )
    )
    used |= {f"{kind}-photograph" for kind in get_args(Fault)}
    constructed = set(re.findall(r'Finding\(\s*"([a-z-]+)"', "\n".join(sources)))
    assert constructed <= set(CODES)
    assert set(CODES) <= used
