from __future__ import annotations

import base64
import hashlib
import html
import html.parser
import json
import re
from dataclasses import replace

import pytest

from handmade import capture_of, comparison_of, finger
from splitknit.findings import Finding
from splitknit.report.result import make_report, write_files


class _Page(html.parser.HTMLParser):
    """Collects what a page would load, its unclosed elements and its words."""

    VOID = frozenset({"meta", "img", "br", "rect", "line", "polyline", "link", "input"})

    def __init__(self):
        super().__init__()
        self.addresses: list[str] = []
        self.open: list[str] = []
        self.words: list[str] = []
        self.tags: set[str] = set()

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)
        self.addresses += [
            value or "" for name, value in attrs if name in ("src", "href", "data", "action")
        ]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        if tag not in self.VOID:
            assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)


def _page(text):
    page = _Page()
    page.feed(text)
    assert page.open == []
    return page


def test_page_is_self_contained(written):
    text = (written[0] / "report.html").read_text(encoding="utf-8")
    page = _page(text)
    assert len(page.addresses) >= 8
    assert all(address.startswith("data:image/") for address in page.addresses)
    assert "link" not in page.tags
    assert "default-src 'none'" in text
    assert "connect-src" not in text
    markup = re.sub(r'"data:[^"]*"|<script.*?</script>', "", text, flags=re.DOTALL)
    assert not re.search(r"url\(|@import|https?://", markup)
    assert len(text) < 4_000_000


def test_scripts_are_allowed_by_their_hash_alone(written):
    text = (written[0] / "report.html").read_text(encoding="utf-8")
    allowed = re.search(r"script-src ([^;]*);", html.unescape(text))
    assert allowed is not None
    scripts = re.findall(r"<script>(.*?)</script>", text, flags=re.DOTALL)
    digests = [
        base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() for script in scripts
    ]
    assert allowed[1].split() == [f"'sha256-{digest}'" for digest in digests]


def test_the_page_shows_every_picture_finding_and_figure(written):
    words = " ".join(_page((written[0] / "report.html").read_text(encoding="utf-8")).words)
    for needed in (
        "Finger found",
        "Surface normals",
        "Relief",
        "Shape",
        "From above",
        "Photographs",
        "Print",
        "Uncertainty",
        "No flexion crease is in view",
        "Ridge band, gain",
        "preprocess",
        "scattering mm",
        "crossover",
        "led brightness",
        "focus",
        "white_0.png",
    ):
        assert needed in words, needed


def test_report_json_holds_the_facts_of_the_page(written):
    facts = written[1]
    assert facts["format"] == "splitknit-report"
    assert facts["preset"] == "metric"
    assert [each["code"] for each in facts["findings"]] == ["no-crease"]
    assert facts["timings_s"] == {"preprocess": 0.5, "normals": 1.25}
    assert facts["inputs_sha256"] == {"white_0.png": "ab" * 32}
    assert facts["comparison"]["metric"]["ridge_gain"] == pytest.approx(1.0, abs=1e-3)
    assert facts["settings"]["knit"]["mode"] == "crossover"
    assert facts["software"]["name"] == "splitknit"


def test_strings_cannot_become_markup():
    result, _ = finger()
    evil = "<script>alert(1)</script><img src=http://x>"
    capture = replace(capture_of(result), subject={"id": evil, evil: "x"}, captured_at=evil)
    spiked = replace(
        result,
        findings=(Finding("no-crease", evil),),
        facts={evil: evil, "nested": {evil: [1.0, evil]}},
        quality={"list": [evil], evil: [1.0, 2.0]},
        settings={evil: {evil: evil}},
        hashes={evil: evil},
        timings_s={evil: 1.0},
        preset=evil,
    )
    text = make_report(spiked, capture).html
    page = _page(text)
    # the surface's data, three.js, and what draws with it
    assert len(re.findall("<script", text)) == 3
    assert "<img src=http" not in text
    assert all(address.startswith("data:image/") for address in page.addresses)
    assert text.count("&lt;script&gt;") >= 6


def test_presets_are_compared_side_by_side():
    result, _ = finger()
    plain_result = replace(result, preset="ea")
    comparisons = [comparison_of(result), comparison_of(plain_result, 0.3)]
    report = make_report(result, capture_of(result), comparisons, [plain_result])
    assert set(report.facts["comparison"]) == {"metric", "ea"}
    words = " ".join(_page(report.html).words)
    assert "Ridge error, ea" in words
    assert "Ridge error, metric" in words
    assert report.facts["comparison"]["ea"]["ridge_gain"] == pytest.approx(0.3, abs=1e-3)


def test_a_result_without_facts_has_a_report():
    """No quality, no facts, no warnings, NaN among the facts, a capture of three grey images."""
    result, _ = finger()
    bare = replace(
        result,
        quality={},
        facts={"odd": float("nan")},
        findings=(),
        timings_s={},
        settings={},
        hashes={},
        uncertainty_um=None,
    )
    report = make_report(bare, capture_of(result, 3))
    assert "No warnings" in report.html
    assert report.facts["facts"] == {"odd": None}
    json.dumps(report.facts, allow_nan=False)


def test_the_page_escapes_control_and_bidi_characters(tmp_path):
    result, _ = finger()
    capture = replace(capture_of(result), subject={"id": "evil\x1b[2J\u202eexe"})
    write_files(result, capture, tmp_path)
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "\\x1b[2J\\u202eexe" in text
    assert all(c.isprintable() or c in "\n\t" for c in text)
