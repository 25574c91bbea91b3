"""``splitknit view --live``: a folder of frames as the source, over HTTP, and the page in a real Chromium."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from chromium import Page, why_not
from gel_frames import PITCH_MM, SIZE, cap, dots, frame, shading
from splitknit.cli.main import main
from splitknit.io.images import read_image, write_image
from splitknit.io.results import read_result
from splitknit.photometric.shading import write_shading
from viewer_server import started

HEIGHT = cv2.GaussianBlur(cap(100, 50, 45, 27), (0, 0), 1.5)


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[dict[str, Any], Path, subprocess.Popen[str]]]:
    """A live view of a pressed ball under dots that moved: its facts, its folder, its process."""
    folder = tmp_path_factory.mktemp("live")
    write_shading(folder / "shading.npz", shading())
    write_image(folder / "flat.png", frame(np.zeros(SIZE), dots(24, 6, 8)))
    (folder / "frames").mkdir()
    for k in range(2):
        write_image(folder / "frames" / f"{k}.png", frame(HEIGHT, dots(24, 6, 11)))
    running, facts = started(
        "--live", folder / "frames", "--shading", folder / "shading.npz", "--flat", folder / "flat.png",
        "--marker-px", 6, "--out", folder / "out",
    )  # fmt: skip
    yield facts, folder, running
    running.send_signal(signal.SIGINT)
    out, err = running.communicate(timeout=30)
    assert (running.returncode, out, err) == (0, "", "")


def get(url: str, method: str = "GET") -> tuple[bytes, Any]:
    with urllib.request.urlopen(urllib.request.Request(url, method=method), timeout=60) as answer:
        return answer.read(), answer.headers


def test_the_page_and_its_frames_come_over_http(live: tuple[dict[str, Any], Path, Any]) -> None:
    facts, folder, _ = live
    url = facts["url"]
    page = get(url)[0].decode()
    for name in re.findall(r'(?:src|href)="([^"]+)"', page):
        assert get(url + name)[0]
    meta = json.loads(get(url + "api/live")[0])
    assert (meta["source"], meta["pitch_mm"]) == ("frames", PITCH_MM)
    assert {"flat", "photo", "save"} <= set(meta["actions"])

    body, headers = get(url + "api/live/frame?after=0")
    first = json.loads(headers["X-Frame"])
    assert (first["rows"], first["columns"]) == SIZE
    heights = np.frombuffer(body, "<f4", SIZE[0] * SIZE[1]).reshape(SIZE)
    assert float((heights - 1000 * PITCH_MM * HEIGHT).std()) < 25  # um, of a cap of 1.1 mm
    photo = cv2.imdecode(np.frombuffer(body[4 * heights.size :], np.uint8), cv2.IMREAD_COLOR)
    assert photo.shape == (*SIZE, 3)
    later = json.loads(get(url + f"api/live/frame?after={first['number']}")[1]["X-Frame"])
    assert later["number"] > first["number"] and later["per_second"] > 0

    assert json.loads(get(url + "api/live/hold?on=1", "POST")[0]) == {"done": "frozen"}
    get(url + "api/live/photo", "POST")
    assert np.array_equal(read_image(folder / "out" / "0001.png"), read_image(folder / "frames" / "0.png"))
    said = json.loads(get(url + "api/live/save", "POST")[0])["done"]
    result = read_result(said.removeprefix("written to "))
    assert (folder / "out" / "0001" / "report.html").is_file() and result.pitch_mm == PITCH_MM
    inside = result.mask
    assert 0.8 < float(inside.mean()) < 0.95  # without the dots
    assert float((1000 * result.height_mm - 1000 * PITCH_MM * HEIGHT)[inside].std()) < 25
    assert np.allclose(result.height_mm[inside], result.ridge_mm[inside] + result.shape_mm[inside], atol=1e-5)
    get(url + "api/live/hold?on=0", "POST")
    for path, method in (("api/live/none", "POST"), ("api/live/photo", "GET"), ("api/live/frame?after=x", "GET")):
        with pytest.raises(urllib.error.HTTPError, match="404"):
            get(url + path, method)
    get(url + "api/live/flat", "POST")  # the ball itself is the flat one now
    while True:
        body, headers = get(url + f"api/live/frame?after={later['number']}")
        later = json.loads(headers["X-Frame"])
        if abs(np.frombuffer(body, "<f4", SIZE[0] * SIZE[1])).max() < 60:
            break


def test_without_a_calibration_frames_alone_are_shown(tmp_path: Path) -> None:
    write_image(tmp_path / "1.png", frame(HEIGHT))
    running, facts = started("--live", tmp_path, "--out", tmp_path / "out")
    try:
        body, headers = get(facts["url"] + "api/live/frame")
        assert json.loads(headers["X-Frame"])["rows"] == 0
        assert body.startswith(b"\xff\xd8")
        assert json.loads(get(facts["url"] + "api/live")[0])["actions"] == ["photo"]
    finally:
        running.send_signal(signal.SIGTERM)
        assert running.communicate(timeout=30)[1] == ""


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--live", "nowhere"], "neither a camera's number nor a folder"),
        (["--flat", "flat.png"], "--flat belongs to --live"),
        (["result", "--live", "0"], "a live view is shown alone"),
        (["--live", "0", "--marker-px", "6"], "--marker-px needs --shading"),
        (["--live", "0", "--shading", "nowhere.npz"], "nowhere.npz"),
    ],
)
def test_what_cannot_be_shown_is_one_sentence(
    words: list[str], message: str, capfd: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["view", *words, "--no-browser"]) == 2
    said = capfd.readouterr()
    assert said.out == "" and said.err.count("\n") == 1 and message in said.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.skipif(bool(why_not()), reason=why_not() or "there is a browser")
def test_the_page_shows_heights_freezes_and_saves(live: tuple[dict[str, Any], Path, Any]) -> None:
    facts, folder, _ = live
    seen = Page(1280, 800)
    try:
        seen.driver.get(facts["url"])
        seen.wait("return Number(document.body.dataset.frames) > 2", "frames")
        seen.click("#hold")
        seen.wait("return document.getElementById('hold').textContent === 'Go on'")
        before = seen.run("return document.body.dataset.frames")
        canvas = seen.find("#heights")
        assert (canvas.get_property("width"), canvas.get_property("height")) == SIZE[::-1]
        seen.run("arguments[0].focus()", canvas)
        from selenium.webdriver.common.keys import Keys

        seen.press(Keys.ARROW_RIGHT)
        assert re.fullmatch(r"-?\d+\.\d µm", seen.find("#height").text)
        assert seen.find(".scale").text.endswith("mm")
        already = len(list((folder / "out").glob("*.png")))
        seen.click("#photo")
        seen.wait("return document.getElementById('said').textContent.startsWith('written to')")
        assert len(list((folder / "out").glob("*.png"))) == already + 1
        for colour in ("relief", "shaded", "height"):
            seen.choose("#colour", colour)
            seen.picture(f"live-{colour}")
        assert int(seen.run("return document.body.dataset.frames")) <= int(before) + 1
        assert seen.complaints() == []
    finally:
        seen.close()
