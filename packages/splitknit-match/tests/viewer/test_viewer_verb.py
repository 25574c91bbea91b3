"""``splitknit view`` from the command line: what it says, how it ends, what it refuses."""

from __future__ import annotations

import json
import os
import signal
import socket
import stat
import subprocess
import sys
import urllib.request
import webbrowser
from pathlib import Path
from urllib.parse import unquote, urlparse

import numpy as np
import pytest

from splitknit.cli.main import main
from splitknit.io.npz import write_npz
from splitknit.viewer.server import opened_page
from splitknit_match.gallery.entry import Entry, NewCapture
from splitknit_match.gallery.file import GalleryFile
from splitknit_match.gallery.key import KEY_VARIABLE
from splitknit_match.matching.template import Template, pack
from viewer_server import started

Captured = pytest.CaptureFixture[str]


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_it_serves_until_it_is_stopped(shown: Path, how: signal.Signals) -> None:
    before = sorted(path for path in shown.rglob("*"))
    running, facts = started(shown / "metric")
    assert facts["results"] == 1
    assert facts["url"].startswith(f"http://127.0.0.1:{facts['port']}/")
    with urllib.request.urlopen(facts["url"]) as page:
        assert b"splitknit" in page.read()
    running.send_signal(how)
    out, err = running.communicate(timeout=30)
    assert (running.returncode, out, err) == (0, "", "")
    with pytest.raises(OSError, match="refused"):
        urllib.request.urlopen(facts["url"])
    assert sorted(path for path in shown.rglob("*")) == before


def test_a_port_in_use_is_said(shown: Path, capsys: Captured) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert main(["view", str(shown / "metric"), "--port", str(port), "--no-browser"]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.count("\n") == 1
    assert f"port {port} cannot be used" in said.err and "--port" in said.err


@pytest.mark.parametrize("port", ["-1", "70000", "x", "٣"])
def test_a_port_that_is_none_is_refused(shown: Path, capsys: Captured, port: str) -> None:
    assert main(["view", str(shown / "metric"), f"--port={port}"]) == 2
    assert "must be a port" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda folder: folder / "nowhere", "there is no"),
        (lambda folder: folder, "there is no result in"),
        (lambda folder: _file(folder / "a.txt", b"words"), "is a file"),
        (lambda folder: _file(folder / "capture.json", b"{}").parent, "capture.json: format is missing"),
        (lambda folder: _file(folder / "height.npz", b"PK\3\4").parent, "damaged"),
        (lambda folder: _result(folder, {"height_mm": np.zeros((2, 2), np.float32)}), "holds no"),
        (lambda folder: _file(folder / "people.sqlite", b"SQLite format 3\0" + bytes(100)), "people.sqlite"),
    ],
    ids=["missing", "empty", "file", "capture", "damaged", "other", "database"],
)
def test_what_is_no_result_is_refused_in_one_sentence(tmp_path: Path, capsys: Captured, make, words: str) -> None:
    assert main(["view", str(make(tmp_path)), "--no-browser"]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.count("\n") == 1
    assert words in said.err


def test_more_that_does_not_fit_is_refused(shown: Path, tmp_path: Path, capsys: Captured) -> None:
    os.mkfifo(tmp_path / "pipe")
    for arguments, words in (
        ([shown / "metric", shown / "ea", shown / "metric"], "one result, a folder of results, two results"),
        ([shown / "metric", shown], "not a result"),
        ([shown / "metric", shown / "capture"], "not a result"),
        ([shown / "capture", "--capture", shown / "capture"], "leave --capture out"),
        ([shown / "metric", "--capture", tmp_path], "not the capture that this was made from"),
        ([shown / "metric", "--key-file", tmp_path], "is not a gallery"),
        ([tmp_path / "pipe"], "pipe"),
    ):
        assert main(["view", *map(str, arguments), "--no-browser"]) == 2
        assert words in capsys.readouterr().err


def _file(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


def _result(folder: Path, arrays: dict) -> Path:
    write_npz(folder / "height.npz", arrays)
    return folder


def test_a_gallery_shows_its_people(tmp_path: Path) -> None:
    template = Template(np.full((50, 40), 3, np.uint8), np.ones((50, 40), bool), 0.1)
    with GalleryFile(tmp_path / "people.gallery") as gallery:
        gallery.add([
            NewCapture(Entry("Ada", "right_index", "1", "result", "0" * 64, 20.0), pack(template)),
            NewCapture(Entry("Ben", "left_thumb", "1", "result", "1" * 64, 0.0), b""),
        ], "0" * 64)  # fmt: skip
    running, facts = started(tmp_path / "people.gallery")
    try:
        with urllib.request.urlopen(facts["url"] + "api/catalogue") as answer:
            people = json.load(answer)["people"]
        assert [(one["person"], one["acquired"]) for one in people] == [("Ada", True), ("Ben", False)]
        with urllib.request.urlopen(facts["url"] + f"api/people/{people[0]['row']}") as answer:
            import cv2

            picture = cv2.imdecode(np.frombuffer(answer.read(), np.uint8), cv2.IMREAD_GRAYSCALE)
        assert picture.shape == (50, 40)
        assert (picture == 0).all()  # high ridges are dark
        with pytest.raises(urllib.error.HTTPError):
            urllib.request.urlopen(facts["url"] + f"api/people/{people[1]['row']}")
    finally:
        running.send_signal(signal.SIGINT)
        running.communicate(timeout=30)


def test_the_browser_gets_neither_the_token_nor_a_key(monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[str] = []
    monkeypatch.setenv(KEY_VARIABLE, "secret")
    monkeypatch.setattr(webbrowser, "open", lambda url: opened.append(url) or KEY_VARIABLE not in os.environ)
    with opened_page("http://127.0.0.1:1/token/") as done:
        assert done
        assert os.environ[KEY_VARIABLE] == "secret"
        assert "token" not in opened[0]
        page = Path(unquote(urlparse(opened[0]).path))
        assert stat.S_IMODE(page.stat().st_mode) == 0o600
        assert stat.S_IMODE(page.parent.stat().st_mode) == 0o700
        assert "http://127.0.0.1:1/token/" in page.read_text()
    assert not page.exists()


def test_vendored_files_are_those_of_the_package() -> None:
    root = Path(__file__).resolve().parents[4]
    done = subprocess.run([sys.executable, str(root / "tools" / "vendor_three.py"), "--check"], check=False)
    assert done.returncode == 0
