"""The server as another user of the same machine meets it, and as the page does."""

from __future__ import annotations

import contextlib
import gc
import gzip
import json
import os
import shutil
import socket
import socketserver
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

import cv2
import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit.io.images import read_image
from splitknit.viewer import server as server_module
from splitknit.viewer import service
from splitknit.viewer.server import HEADERS
from splitknit.viewer.surface import ResultSurface, read_surface
from viewer_server import Asking
from written_files import read_glb, read_ply, read_stl

Serve = Callable[..., Asking]


def document(asked: tuple[int, dict[str, str], bytes]) -> dict:
    assert asked[0] == 200, asked
    return json.loads(asked[2])


def test_the_page_and_all_that_it_names_come(shown: Path, asking: Serve) -> None:
    server = asking(shown / "metric")
    status, headers, page = server.get("")
    assert status == 200
    assert headers["Content-Type"].startswith("text/html")
    assert HEADERS.items() <= headers.items()
    text = page.decode()
    assert "http:" not in text.replace("http://www.w3.org", "") and "https:" not in text
    assert " style=" not in text and "onclick" not in text and "<script>" not in text
    for name in (
        "style.css",
        "icon.svg",
        "js/main.js",
        "vendor/three/three.module.min.js",
        "vendor/three/three.core.min.js",
    ):
        assert name in text
        status, headers, _ = server.get(name)
        assert status == 200
    assert headers["Content-Type"].startswith("text/javascript")


def test_every_module_imports_what_is_there() -> None:
    import re

    static = Path(service.__file__).parent / "static"
    for module in static.rglob("*.js"):
        for name in re.findall(r"""from\s*["']([^"']+)["']""", module.read_text(encoding="utf-8")):
            if module.parent.name != "three" or name.startswith("."):
                assert (module.parent / name).is_file(), (module.name, name)


@pytest.mark.parametrize(
    "path",
    [
        "../README.md", "..%2f..%2fREADME.md", "%2e%2e/metric/height.npz", "js/../../service.py",
        "js/%2e%2e/index.html", "api/result/0/picture/height.npz", "api/result/0/picture/../height.npz",
        "api/result/0/picture/..%2freport.json", "api/result/1", "api/result/-1", "api/result/0x0",
        "api/result/%D9%A0", "api/result/0/tile/1/99/0", "api/result/0/tile/1/0", "api/result/0/photo/7",
        "api/result/0/photo/-1", "api/result/0/photo/0?width=99999", "api/result/0/export/exe",
        "api/result/0/export/ply?step=3", "api/result/0/export/ply?step=99999999999", "api/people/1", "api",
        "static/index.html", "vendor/three/source.json", "vendor/three/", "js", "//", "api/pair/0/7",
        "api/result/0/pick", "api/result/0/pick?ox=nan", "api/result/0/section?x0=1&y0=2&x1=inf&y1=0", "index.html/",
        "\\..\\service.py",
    ],
)  # fmt: skip
def test_other_paths_lead_nowhere(shown: Path, asking: Serve, path: str) -> None:
    server = asking(shown / "metric")
    status, headers, body = server.get(path)
    assert status in (400, 404)
    assert len(body) < 300 and b"Traceback" not in body
    assert HEADERS.items() <= headers.items()


def test_answers_are_packed_where_the_browser_takes_it(shown: Path, asking: Serve) -> None:
    server = asking(shown / "metric")
    for path in ("", "vendor/three/three.core.min.js", "style.css", "api/result/0", "api/result/0/first"):
        _, plain, body = server.get(path)
        _, packed, less = server.get(path, Accept_Encoding="br, gzip;q=0.8")
        assert (packed["Content-Encoding"], packed["Vary"]) == ("gzip", "Accept-Encoding")
        assert "Content-Encoding" not in plain
        assert len(less) == int(packed["Content-Length"]) < 0.6 * len(body)
        assert gzip.decompress(less) == body
    for path, offer in (("", "gzip;q=0, br"), ("api/result/0/picture/normals.png", "gzip"), ("nowhere", "gzip")):
        assert "Content-Encoding" not in server.get(path, Accept_Encoding=offer)[1]


def test_strangers_are_refused(shown: Path, asking: Serve) -> None:
    server = asking(shown / "metric")
    assert server.raw("/")[0] == 403
    assert server.raw("/api/catalogue")[0] == 403
    assert server.get("api/catalogue", Host="evil.example")[0] == 403
    assert server.get("api/catalogue", Origin="http://evil.example")[0] == 403
    assert server.get("api/catalogue", Sec_Fetch_Site="cross-site")[0] == 403
    status, headers, _ = server.get("api/catalogue", method="POST")
    assert (status, headers["Allow"]) == (405, "GET, HEAD")
    assert server.server.token.encode() not in server.raw("/")[2]
    assert "Access-Control-Allow-Origin" not in server.get("api/catalogue")[1]


def test_only_the_loopback_address_listens(shown: Path, asking: Serve) -> None:
    server = asking(shown / "metric").server
    assert server.server_address[0] == "127.0.0.1"
    assert server.socket.family == socket.AF_INET


def test_what_is_a_link_in_a_result_is_not_sent(shown: Path, asking: Serve, tmp_path: Path) -> None:
    folder = tmp_path / "result"
    folder.mkdir()
    (folder / "height.npz").write_bytes((shown / "metric" / "height.npz").read_bytes())
    (tmp_path / "secret.png").write_bytes((shown / "metric" / "print.png").read_bytes())
    for name in ("normals.png", "print.png", "preview.png", "phalange.ply", "report.json"):
        (folder / name).symlink_to(tmp_path / "secret.png")
    server = asking(folder)
    assert server.get("api/result/0/picture/normals.png")[0] == 404
    assert server.get("api/result/0/picture/print.png")[0] == 404
    assert server.get("api/result/0/thumb")[0] == 404
    assert document(server.get("api/result/0"))["print"] is None
    assert document(server.get("api/result/0/minutiae"))["minutiae"] is None
    status, _, mesh = server.get("api/result/0/export/ply")  # made anew, from the arrays
    assert status == 200 and mesh.startswith(b"ply\n")


def changed(shown: Path, folder: Path, **changes: Callable[[np.ndarray], np.ndarray]) -> Path:
    """Copy a result and change arrays of its `height.npz`."""
    shutil.copytree(shown / "metric", folder)
    with np.load(folder / "height.npz") as file:
        arrays = dict(file)
    for name, change in changes.items():
        arrays[name] = change(arrays[name])
    np.savez(folder / "height.npz", **arrays)
    return folder


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("height_mm", lambda x: x + np.float32(2000.0), "beyond 1000 mm"),
        ("ridge_mm", lambda x: x + np.float32(1e30), "beyond 1000 mm"),
        ("input_from_upright", lambda x: x * [[1e5, 1, 1], [1, 1, 1], [1, 1, 1]], "not a rotation"),
    ],
)
def test_what_cannot_be_shown_is_refused(shown: Path, tmp_path: Path, name: str, change: Any, words: str) -> None:
    with pytest.raises(BadInput, match=words):
        read_surface(changed(shown, tmp_path / "result", **{name: change}))


def test_normals_that_are_none_are_not_exported(shown: Path, asking: Serve, tmp_path: Path) -> None:
    server = asking(changed(shown, tmp_path / "result", normals=lambda normals: normals * np.float32(1e38)))
    status, _, body = server.get("api/result/0/export/glb?step=1")
    assert status == 404 and b"not of unit length" in body


def test_an_answer_that_is_not_finite_is_refused() -> None:
    with pytest.raises(BadInput, match="NaN or infinite"):
        service.json_reply({"pitch_mm": float("nan")})


def test_a_picture_that_is_too_large_is_not_sent(shown: Path, asking: Serve, tmp_path: Path) -> None:
    folder = changed(shown, tmp_path / "result")
    os.truncate(folder / "preview.png", service._MAX_PICTURE_BYTES + 1)
    status, _, body = asking(folder).get("api/result/0/picture/preview.png")
    assert status == 404 and b"is too large" in body


def test_facts_tiles_and_figures(shown: Path, asking: Serve) -> None:
    server = asking(shown / "metric")
    meta = document(server.get("api/result/0"))
    assert meta["pitch_mm"] == pytest.approx(0.05)
    assert meta["print"]["ppi"] == pytest.approx(500, abs=0.1)
    assert len(meta["photos"]) == 7
    status, headers, first = server.get("api/result/0/first")
    assert status == 200 and int(headers["Content-Length"]) == len(first)
    for stride, tiles in meta["tiles"].items():
        for row, column in tiles:
            assert server.get(f"api/result/0/tile/{stride}/{row}/{column}")[0] == 200
    ray = urlencode({"ox": 0.3, "oy": 1.7, "oz": 60, "dx": 0, "dy": 0, "dz": -1})
    point = document(server.get(f"api/result/0/pick?{ray}"))["point_mm"]
    assert point[:2] == pytest.approx([0.3, 1.7], abs=1e-6)
    cut = document(server.get("api/result/0/section?x0=0.6&y0=3&x1=0.6&y1=8.4"))
    assert cut["figures"]["relief_um"] == pytest.approx(59.3, rel=0.06)
    assert len(cut["along_mm"]) == len(cut["height_mm"]) == len(cut["relief_um"])
    assert "no surface" in document(server.get("api/result/0/section?x0=20&y0=3&x1=30&y1=8.4"))["why_not"]


def test_photographs_come_as_they_were(shown: Path, asking: Serve) -> None:
    server = asking(shown / "metric")
    status, headers, data = server.get("api/result/0/photo/2?width=320")
    assert (status, headers["Content-Type"]) == (200, "image/jpeg")
    picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert picture.shape == (220, 320)
    linear = read_image(shown / "capture" / "white_2.png")[..., 0] / 255.0
    expected = 255 * np.where(linear < 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    small = cv2.resize(expected, (320, 220), interpolation=cv2.INTER_AREA)
    assert np.abs(picture - small).mean() < 4


def test_photographs_of_another_capture_are_not_shown(shown: Path, asking: Serve, tmp_path: Path) -> None:
    copy = tmp_path / "capture"
    copy.mkdir()
    for file in (shown / "capture").iterdir():
        (copy / file.name).write_bytes(file.read_bytes())
    (copy / "white_1.png").write_bytes((copy / "white_2.png").read_bytes())
    server = asking(shown / "metric", capture=copy)
    assert server.get("api/result/0/photo/0")[0] == 200
    status, _, words = server.get("api/result/0/photo/1")
    assert status == 404 and b"its hash is another" in words


def test_exports_are_read_back(shown: Path, asking: Serve, tmp_path: Path) -> None:
    server = asking(shown / "metric")
    whole = read_ply(shown / "metric" / "phalange.ply")

    def saved(kind: str, step: int) -> Path:
        status, headers, data = server.get(f"api/result/0/export/{kind}?step={step}")
        assert status == 200 and int(headers["Content-Length"]) == len(data)
        name = headers["Content-Disposition"].split('"')[1]
        assert name == ("metric" if step == 1 else f"metric-every-{step}") + f".{kind}"
        (tmp_path / name).write_bytes(data)
        return tmp_path / name

    assert saved("ply", 1).read_bytes() == (shown / "metric" / "phalange.ply").read_bytes()
    for step in (1, 2):
        glb, stl = read_glb(saved("glb", step)), read_stl(saved("stl", step))
        np.testing.assert_array_equal(stl, glb.vertices_mm[glb.faces])
        if step == 1:
            np.testing.assert_allclose(glb.vertices_mm, whole.vertices_mm, atol=2e-6)
            np.testing.assert_allclose(glb.normals, whole.normals, atol=2e-6)
            np.testing.assert_array_equal(glb.faces, whole.faces)
            np.testing.assert_allclose(glb.intensity / 255, whole.quality, atol=1e-6)
        else:
            ply = read_ply(saved("ply", step))
            np.testing.assert_array_equal(ply.vertices_mm, glb.vertices_mm)
            assert 0.24 < len(ply.vertices_mm) / len(whole.vertices_mm) < 0.26
            assert any("unit mm" in line for line in ply.comments)
            assert any(line.startswith("inputs_sha256") for line in ply.comments)
        assert "unit" in glb.extras and glb.extras["buffer_unit"] == "mm"


def test_a_folder_is_listed(shown: Path, asking: Serve) -> None:
    (shown / "loop").unlink(missing_ok=True)
    (shown / "loop").symlink_to(shown)
    server = asking(shown)
    listed = document(server.get("api/catalogue"))
    assert [one["name"] for one in listed["results"]] == ["ea", "metric"]
    assert listed["chosen"] == []
    status, headers, data = server.get("api/result/1/thumb")
    assert (status, headers["Content-Type"]) == (200, "image/jpeg")
    assert max(cv2.imdecode(np.frombuffer(data, np.uint8), 1).shape) <= 360


def test_names_do_not_turn_the_text_around_them(shown: Path, asking: Serve, tmp_path: Path) -> None:
    folder = tmp_path / "\N{RIGHT-TO-LEFT OVERRIDE}gnp" / "\N{HEBREW LETTER ALEF}\N{RIGHT-TO-LEFT MARK}"
    folder.mkdir(parents=True)
    shutil.copy(shown / "metric" / "height.npz", folder)
    (folder / "report.json").write_text(json.dumps({"preset": "\N{RIGHT-TO-LEFT ISOLATE}ae"}))
    server = asking(tmp_path)
    listed = document(server.get("api/catalogue"))["results"]
    assert [(one["name"], one["preset"]) for one in listed] == [("\ufffdgnp/\N{HEBREW LETTER ALEF}\ufffd", "\ufffdae")]
    assert document(asking(folder).get("api/catalogue"))["title"] == "\N{HEBREW LETTER ALEF}\ufffd"


def test_a_damaged_result_in_a_folder_says_so(shown: Path, asking: Serve, tmp_path: Path) -> None:
    (tmp_path / "bad").mkdir()
    (tmp_path / "bad" / "height.npz").write_bytes(b"PK\x03\x04 nothing")
    server = asking(tmp_path)
    status, _, words = server.get("api/result/0")
    assert status == 404 and b"damaged" in words


def test_two_results_are_compared(shown: Path, asking: Serve) -> None:
    server = asking(shown / "metric", shown / "ea")
    assert document(server.get("api/catalogue"))["chosen"] == ["0", "1"]
    pair = document(server.get("api/pair/0/1"))
    assert pair["alignment"]["how"] == "photographs"
    pytest.importorskip("nbis")
    assert all(first == second for first, second in pair["pairs"])  # the same print twice


def test_minutiae_lie_on_the_finger(shown: Path, asking: Serve) -> None:
    pytest.importorskip("nbis")
    server = asking(shown / "metric")
    middle = (document(server.get("api/result/0"))["print"]["columns"] - 1) / 2
    found = document(server.get("api/result/0/minutiae"))["minutiae"]
    placed = [one for one in found if one["place_mm"]]
    assert placed
    for one in placed:
        # the print's middle is the upright frame's; its left is the finger's right
        assert one["place_mm"][0] == pytest.approx(-(one["x_px"] - middle) * 25.4 / 500, abs=0.06)
        assert one["place_mm"][2] > -0.1


def test_head_tells_the_size_and_sends_nothing(shown: Path, asking: Serve) -> None:
    server = asking(shown / "metric")
    status, headers, body = server.get("api/result/0/export/ply", method="HEAD")
    assert status == 200 and body == b""
    assert int(headers["Content-Length"]) == (shown / "metric" / "phalange.ply").stat().st_size


def test_a_large_file_is_sent_in_pieces(shown: Path, asking: Serve, tmp_path: Path) -> None:
    """300 MB go through a reader that takes its time, and the server never holds them."""
    import tracemalloc

    folder = tmp_path / "result"
    folder.mkdir()
    (folder / "height.npz").write_bytes((shown / "metric" / "height.npz").read_bytes())
    with (folder / "phalange.ply").open("wb") as stream:
        stream.truncate(300_000_000)
    server = asking(folder)
    server.get("api/result/0")
    tracemalloc.start()
    with socket.create_connection(("127.0.0.1", server.server.server_port)) as connection:
        path = f"/{server.server.token}/api/result/0/export/ply"
        connection.sendall(f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{server.server.server_port}\r\n\r\n".encode())
        read = 0
        buffer = bytearray(1 << 20)
        while read < 100_000_000:
            read += connection.recv_into(buffer)
    assert tracemalloc.get_traced_memory()[1] < 60_000_000
    tracemalloc.stop()
    assert server.get("api/catalogue")[0] == 200  # the reader that went away did no harm


def sent(server: Asking, *pieces: bytes) -> bytes:
    """Send pieces as they are; return all that comes until the server closes the connection."""
    with socket.create_connection(("127.0.0.1", server.server.server_port), timeout=60) as connection:
        for piece in pieces:
            connection.sendall(piece)
        return b"".join(iter(lambda: connection.recv(65536), b""))


def request_of(server: Asking, *headers: str) -> bytes:
    lines = [f"GET /{server.server.token}/api/catalogue HTTP/1.1", f"Host: 127.0.0.1:{server.server.server_port}"]
    return "\r\n".join([*lines, *headers, "", ""]).encode()


@pytest.mark.parametrize(
    ("header", "status"),
    [
        ("Host: 127.0.0.1", 400),
        ("Host: evil.example", 400),
        ("Content-Length: 7", 400),
        ("Content-Length: 0\r\nContent-Length: 7", 400),
        ("Transfer-Encoding: chunked", 400),
        ("no colon", 400),
        ("Origin : http://evil.example", 400),
        ("X: " + 20_000 * "x", 431),
        ("Connection: close", 200),
    ],
    ids=lambda value: str(value)[:30],
)
def test_a_request_that_is_not_quite_one_is_refused_and_nothing_behind_it_read(
    shown: Path, asking: Serve, header: str, status: int
) -> None:
    server = asking(shown / "metric")
    came = sent(server, request_of(server, header) + request_of(server))
    assert came.startswith(f"HTTP/1.1 {status} ".encode())
    assert came.count(b"HTTP/1.1 ") == 1
    assert b"Content-Security-Policy" in came


def test_what_is_no_http_is_refused_in_plain_words(shown: Path, asking: Serve) -> None:
    server = asking(shown / "metric")
    came = sent(server, b"<script> is not a request\r\n\r\n")
    assert came.startswith(b"HTTP/1.1 400 ") and b"text/plain" in came and b"<script>" not in came


def test_two_requests_on_a_connection_are_answered(shown: Path, asking: Serve) -> None:
    server = asking(shown / "metric")
    together = request_of(server) + request_of(server, "Connection: close")
    for pieces in ((together,), (together[:50], together[50:]), tuple(bytes([byte]) for byte in together)):
        assert sent(server, *pieces).count(b"HTTP/1.1 200 OK") == 2


def test_a_request_that_never_ends_is_given_up(shown: Path, asking: Serve, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server_module, "_HEAD_S", 0.3)
    server = asking(shown / "metric")
    assert sent(server, b"GET / HTTP/1.1\r\nHost:") == b""
    stop = threading.Event()
    with socket.create_connection(("127.0.0.1", server.server.server_port), timeout=60) as connection:

        def drip() -> None:
            with contextlib.suppress(OSError):
                while not stop.wait(0.05):
                    connection.sendall(b"x")

        thread = threading.Thread(target=drip)
        thread.start()
        with contextlib.suppress(ConnectionError):
            assert connection.recv(100) == b""
        stop.set()
        thread.join()
    assert server.get("api/catalogue")[0] == 200


def test_connections_are_limited(shown: Path, asking: Serve, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server_module, "_MAX_CONNECTIONS", 3)
    server = asking(shown / "metric")
    before = threading.active_count()
    with contextlib.ExitStack() as stack:
        for _ in range(3):
            idle = stack.enter_context(socket.create_connection(("127.0.0.1", server.server.server_port), timeout=60))
            idle.sendall(request_of(server))
            assert idle.recv(12) == b"HTTP/1.1 200"
        for _ in range(20):
            assert sent(server).startswith(b"HTTP/1.1 503 ")
        assert threading.active_count() <= before + 3
        idle.close()
        end = time.monotonic() + 60
        while server.get("api/catalogue")[0] != 200:
            assert time.monotonic() < end


def test_surfaces_that_are_not_looked_at_are_let_go(
    shown: Path, asking: Serve, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Minutiae and pairs of five results are asked for; what is kept of them does not hold their surfaces."""
    for number in range(5):
        shutil.copytree(shown / "metric", tmp_path / str(number))
    monkeypatch.setattr(service, "_KEPT_BYTES", 0)

    def surfaces() -> int:
        gc.collect()
        return sum(type(thing) is ResultSurface for thing in gc.get_objects())

    before = surfaces()
    server = asking(tmp_path)
    for number in range(5):
        document(server.get(f"api/result/{number}/minutiae"))
        document(server.get(f"api/pair/{number}/{(number + 1) % 5}"))
    assert surfaces() == before + 2


def test_our_own_failure_says_nothing_of_the_inside(
    shown: Path, asking: Serve, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def fail(*_: object) -> None:
        raise RuntimeError("inside")

    server = asking(shown / "metric")
    monkeypatch.setattr(service, "_describe", fail)
    status, _, words = server.get("api/result/0")
    assert status == 500 and b"inside" not in words
    assert "inside" in caplog.text
    assert server.server.token not in caplog.text


def test_an_interrupt_is_not_lost_while_an_answer_begins(
    shown: Path, asking: Serve, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The thread that answers may have ended, and let the next one in, when the interrupt comes."""
    server = asking(shown / "metric").server

    def interrupted(self: Any, request: socket.socket, address: Any) -> None:
        self._free.release()
        raise KeyboardInterrupt

    monkeypatch.setattr(socketserver.ThreadingMixIn, "process_request", interrupted)
    ours, theirs = socket.socketpair()
    with ours, theirs, pytest.raises(KeyboardInterrupt):
        server.process_request(ours, ("127.0.0.1", 1))
