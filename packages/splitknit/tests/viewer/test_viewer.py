"""``splitknit view``: what the page gets, who may ask, how it starts and ends."""

from __future__ import annotations

import contextlib
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
from splitknit.io.results import read_result
from splitknit.viewer import server as server_module
from splitknit.viewer.server import POLICY, PageServer, opened_page, pages_of, start
from viewer_server import ask, started
from written_files import read_ply

Captured = pytest.CaptureFixture[str]


def test_the_page_gets_the_mesh_s_places(server: PageServer, shown: Path) -> None:
    status, headers, data = ask(server, f"/{server.token}/surface")
    assert (status, headers["Content-Type"]) == (200, "application/octet-stream")
    rows, columns = np.frombuffer(data, "<i4", 2)
    x, y, z, _ = np.frombuffer(data, "<f4", offset=8).reshape(4, rows, columns)
    mesh = read_ply(shown / "phalange.ply")
    np.testing.assert_allclose(np.stack([x, y, z], axis=-1)[np.isfinite(z)], mesh.vertices_mm, atol=2e-6)
    facts = json.loads(ask(server, f"/{server.token}/facts")[2])
    assert (facts["title"], facts["preset"], facts["unit"]) == ("metric", "metric", "mm")
    assert facts["warnings"] == ["No flexion crease is in view; the whole visible finger was kept."]


def test_a_large_surface_is_thinned(shown: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server_module, "_MOST_POINTS", 10_000)
    data = pages_of(read_result(shown), "metric")["surface"][1]
    heights = np.frombuffer(data, "<f4", offset=8).reshape(4, -1)[2]
    assert 4000 < np.isfinite(heights).sum() <= 10_500


def test_the_page_and_its_parts_are_let_in(server: PageServer) -> None:
    home = f"/{server.token}/"
    own = {"Origin": f"http://127.0.0.1:{server.server_port}", "Sec_Fetch_Site": "same-origin"}
    for path, headers in ((home, {}), (home, own), (home, {"Host": f"localhost:{server.server_port}"})):
        status, sent, body = ask(server, path, **headers)
        assert (status, sent["Content-Security-Policy"]) == (200, POLICY)
        assert b"<title>splitknit" in body
    for name in ("view.js", "style.css", "vendor/three/three.module.min.js", "vendor/three/OrbitControls.js"):
        assert ask(server, home + name, **own)[0] == 200
    assert ask(server, home, "HEAD")[2] == b""
    assert "unsafe" not in POLICY and "http" not in POLICY and "*" not in POLICY


@pytest.mark.parametrize("path", ["/", "/TOKEN", "/{}x/facts", "/facts", "/%7B{}/", "/{}"])
def test_without_the_token_nothing_is_told(server: PageServer, path: str) -> None:
    assert ask(server, path.format(server.token))[0] == 403


@pytest.mark.parametrize("path", ["../facts", "nothing", "vendor/three/LICENSE", "vendor/../facts", "%66acts"])
def test_there_is_nothing_else(server: PageServer, path: str) -> None:
    assert ask(server, f"/{server.token}/{path}")[0] == 404


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1", "127.0.0.1:80", "[::1]:8123", ""])
def test_other_names_are_refused(server: PageServer, host: str) -> None:
    assert ask(server, f"/{server.token}/", Host=host)[0] == 403


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://127.0.0.1:9", ""])
def test_other_origins_are_refused(server: PageServer, origin: str) -> None:
    assert ask(server, f"/{server.token}/facts", Origin=origin)[0] == 403


def test_other_pages_may_lead_here_but_not_read(server: PageServer) -> None:
    home = f"/{server.token}/"
    for site in ("cross-site", "same-site"):
        assert ask(server, f"{home}facts", Sec_Fetch_Site=site)[0] == 403
        assert ask(server, home, Sec_Fetch_Site=site, Sec_Fetch_Dest="document")[0] == 200
        assert ask(server, home, Sec_Fetch_Site=site, Sec_Fetch_Dest="iframe")[0] == 403


@pytest.mark.parametrize("line", ["Host: HOST", "Origin: http://HOST", "Sec-Fetch-Site: none"])
def test_a_header_that_decides_comes_once(server: PageServer, line: str) -> None:
    place = f"127.0.0.1:{server.server_port}"
    lines = [f"GET /{server.token}/ HTTP/1.1", "Host: HOST", line, line, "", ""]
    with socket.create_connection(("127.0.0.1", server.server_port), timeout=30) as connection:
        connection.sendall("\r\n".join(lines).replace("HOST", place).encode())
        assert connection.recv(100).startswith(b"HTTP/1.0 403")


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH", "OPTIONS"])
def test_nothing_can_be_written(server: PageServer, method: str) -> None:
    assert ask(server, f"/{server.token}/", method)[0] == 501


def test_tokens_are_random_and_only_the_loopback_address_listens() -> None:
    with start({}, 0) as one, start({}, 0) as other:
        assert one.token != other.token
        assert len(one.token) >= 32
        assert one.socket.getsockname()[0] == other.socket.getsockname()[0] == "127.0.0.1"


def test_connections_are_limited(server: PageServer) -> None:
    place = ("127.0.0.1", server.server_port)
    idle = [socket.create_connection(place, timeout=30) for _ in range(40)]
    try:
        closed = 0
        for one in idle:
            one.settimeout(0.2)
            with contextlib.suppress(TimeoutError):
                closed += one.recv(1) == b""
        assert closed == 8
    finally:
        for one in idle:
            one.close()


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_it_serves_until_it_is_stopped(shown: Path, how: signal.Signals) -> None:
    before = sorted(path for path in shown.rglob("*"))
    running, facts = started(shown)
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
        assert main(["view", str(shown), "--port", str(port), "--no-browser"]) == 2
    said = capsys.readouterr()
    assert (said.out, said.err.count("\n")) == ("", 1)
    assert f"port {port} cannot be used" in said.err and "--port" in said.err


@pytest.mark.parametrize("port", ["-1", "70000", "x", "٣"])
def test_a_port_that_is_none_is_refused(shown: Path, capsys: Captured, port: str) -> None:
    assert main(["view", str(shown), f"--port={port}"]) == 2
    assert "must be a port" in capsys.readouterr().err


@pytest.mark.parametrize("make", ["missing", "empty", "file", "damaged", "other"])
def test_what_is_no_result_is_refused_in_one_sentence(tmp_path: Path, capsys: Captured, make: str) -> None:
    place = tmp_path / "height.npz"
    if make == "damaged":
        place.write_bytes(b"PK\3\4")
    if make == "other":
        write_npz(place, {"height_mm": np.zeros((2, 2), np.float32)})
    if make == "file":
        (tmp_path / "missing").write_text("words")
    assert main(["view", str(tmp_path / ("missing" if make in ("missing", "file") else "")), "--no-browser"]) == 2
    said = capsys.readouterr()
    assert (said.out, said.err.count("\n")) == ("", 1)
    assert str(tmp_path) in said.err


def test_the_browser_gets_neither_the_token_nor_a_key(monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[str] = []
    key = "SPLITKNIT_GALLERY_KEY"
    monkeypatch.setenv(key, "secret")
    monkeypatch.setattr(webbrowser, "open", lambda url: opened.append(url) or key not in os.environ)
    with opened_page("http://127.0.0.1:1/token/") as done:
        assert done
        assert os.environ[key] == "secret"
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
