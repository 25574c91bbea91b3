"""The report in a real Chromium, offline: its surface turns, is lit, and is cut between two
points."""

import itertools
import re
import time

import cv2
import numpy as np
import pytest

from chromium import Page, why_not

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(900),
    pytest.mark.skipif(bool(why_not()), reason=why_not() or "there is a browser"),
]


@pytest.fixture
def page():
    page = Page(1000, 1400)
    yield page
    page.close()


def test_a_mailed_report_turns_and_measures_a_section(written, page, tmp_path):
    mailed = tmp_path / "mailed.html"
    mailed.write_bytes((written[0] / "report.html").read_bytes())
    page.open(mailed.as_uri())

    def shot(name):
        return cv2.imread(str(page.picture(name))).astype(int)

    pictures = [shot("surface")]
    page.slide("#exaggeration", 4)
    pictures.append(shot("relief"))
    page.run("document.querySelector('canvas').focus()")
    page.press("\ue014", "+", "\ue013")
    pictures.append(shot("turned"))
    page.find("input[value=light]").click()
    page.move_over("canvas", 150, -100)
    pictures.append(shot("lit"))
    for before, after in itertools.pairwise(pictures):
        assert np.abs(before - after).mean() > 0.5

    page.find("input[value=section]").click()
    page.click_at("canvas", 0, 60)
    note_of_section = "return document.getElementById('section-note').textContent"
    assert page.run(note_of_section) == "Choose the other end."
    page.click_at("canvas", 0, -60)
    time.sleep(0.5)
    note = page.run(note_of_section)
    figures = re.fullmatch(
        r"Section from .* mm: ([\d.]+) mm long, ([\d.]+) \u00b5m from lowest to highest\.", note
    )
    assert figures is not None, note
    assert 1.0 < float(figures[1]) < 12.0
    page.find("#alone").click()
    relief = page.run(note_of_section)
    # of the spiral, 60 um from valley to ridge
    assert 50.0 < float(relief.split(", ")[1].split()[0]) < 70.0
    assert page.run("return document.querySelectorAll('#section path').length") > 5
    page.picture("section")
    assert page.complaints() == []


def test_the_report_fits_the_width_of_a_telephone(written):
    page = Page(390, 800)
    try:
        page.open((written[0] / "report.html").as_uri())
        assert page.run("return document.documentElement.scrollWidth") <= 390
        assert page.run("return document.documentElement.scrollHeight") <= 7_000
        page.picture("telephone")
        assert page.complaints() == []
    finally:
        page.close()
