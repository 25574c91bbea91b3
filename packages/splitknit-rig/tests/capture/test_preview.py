"""The camera in the browser, asked over HTTP: the twin's picture, its sharpness and histogram."""

import base64
import http.client
import json
import threading
from urllib.parse import urlsplit

import cv2
import numpy as np
import pytest

from refusals import bad_input
from splitknit.cli.main import main
from splitknit_rig import capture_finger
from splitknit_rig.capture.openers import opener_of
from splitknit_rig.capture.preview import Preview, serve_preview


def ask(address, name="", host=None):
    place = urlsplit(address)
    connection = http.client.HTTPConnection(place.netloc, timeout=30)
    connection.request("GET", place.path + name, headers={} if host is None else {"Host": host})
    answer = connection.getresponse()
    return answer.status, answer.read()


@pytest.fixture
def served():
    """A preview of the twin's checkerboard in a thread, its address, and its devices."""
    opener = opener_of("twin", {}, None, 0.1, target="board")
    with opener(0, 0) as devices:
        preview, places, known = Preview(devices, 2), [], threading.Event()

        def ready(address):
            places.append(address)
            known.set()

        thread = threading.Thread(target=serve_preview, args=(preview, 5.0, 0, ready))
        thread.start()
        assert known.wait(10)
        yield places[0], preview, devices
        thread.join()


def test_the_page_shows_sharpness_and_histogram(served):
    address, preview, devices = served
    code, page = ask(address)
    assert code == 200 and b"histogram" in page and b"http" not in page.split(b"<body>")[1]
    for _ in range(4):  # the exposure is found by and by
        code, body = ask(address, "look")
        assert code == 200
    seen = json.loads(body)
    assert 0 < seen["sharpness"] <= seen["best"] == pytest.approx(preview.best, abs=1e-3)
    counts = np.array(seen["histogram"])
    assert counts.sum() > 0 and counts[32:].sum() > 0.05 * counts.sum()
    assert seen["clipped"] < 0.05
    for name in ("picture", "middle"):
        picture = cv2.imdecode(np.frombuffer(base64.b64decode(seen[name]), np.uint8), 1)
        assert picture.shape[2] == 3 and picture.max() > 100
    assert devices.lights.lit == {2}
    assert ask(address, "nothing")[0] == 404
    port = urlsplit(address).port
    with bad_input(f"port {port} of this computer is taken"):
        serve_preview(preview, 0.1, port, print)


def test_who_does_not_know_the_address_gets_no_picture(served):
    address, preview, _ = served
    looks = preview.looks
    bare, secret = f"http://{urlsplit(address).netloc}/", urlsplit(address).path.strip("/")
    assert len(secret) >= 43  # 256 bits
    wrong = secret[:-1] + ("a" if secret[-1] != "a" else "b")
    for guess in ("", "look", "etc/passwd", "/look", f"{wrong}/look", f"x/{secret}/look", "%FF/"):
        code, body = ask(bare, guess)
        assert code == 404 and secret.encode() not in body, guess
    code, body = ask(address, "look", host="evil.example")
    assert code == 403 and secret.encode() not in body
    assert preview.looks == looks


def test_it_is_sharpest_in_focus():
    def sharpness(aperture_mm):
        changes = {"render.aperture_mm": aperture_mm}
        with opener_of("twin", changes, None, 0.2, target="phantom")(0, 0) as devices:
            preview = Preview(devices, 0)
            return [preview.look() for _ in range(4)][-1]["sharpness"]

    assert sharpness(0.0) > 1.1 * sharpness(20.0)  # half of it below the plane in focus


def test_the_command(monkeypatch, capsys):
    monkeypatch.setattr(capture_finger, "PREVIEW_PORT", 0)
    words = ["capture", "--device", "twin", "--preview", "--scale", "0.1", "--target", "board"]
    assert main([*words, "--seconds", "0.3"]) == 0
    printed = capsys.readouterr()
    assert "Open http://127.0.0.1:" in printed.err
    assert "0 pictures, best sharpness" in printed.out
    assert main([*words, "--led", "white 99", "--seconds", "0.3"]) == 2
    assert "the rig has no LED 'white 99'" in capsys.readouterr().err
    assert main([*words, "--out", "there"]) == 2
    assert "preview" in capsys.readouterr().err
