"""The page in a real Chromium: it draws the surface, its sliders change the picture, its console is silent."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator

import cv2
import numpy as np
import pytest

from chromium import Page, why_not
from splitknit.viewer.server import PageServer

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(900),
    pytest.mark.skipif(bool(why_not()), reason=why_not() or "there is a browser"),
]


@pytest.fixture
def page() -> Iterator[Page]:
    page = Page()
    yield page
    page.close()


def test_a_finger_is_looked_at(server: PageServer, page: Page) -> None:
    page.open(server.url)
    assert page.run("return document.title") == "metric · splitknit"
    assert "flexion crease" in page.run("return document.getElementById('warnings').textContent")
    seen = [cv2.imread(str(page.picture("surface")))]
    page.find("#canvas").click()
    assert page.wait("return document.getElementById('place').textContent").endswith(" mm")
    for slider, value in (("#relief", 8), ("#azimuth", 300)):
        page.slide(slider, value)
        time.sleep(0.5)
        seen.append(cv2.imread(str(page.picture(slider[1:]))))
    page.press("\ue014", "+")
    time.sleep(0.5)
    seen.append(cv2.imread(str(page.picture("turned"))))
    for before, after in itertools.pairwise(seen):
        assert np.abs(before.astype(int) - after).mean() > 1
    assert page.complaints() == []
