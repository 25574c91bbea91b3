"""Who may ask, and which files can be reached."""

from __future__ import annotations

from email.message import Message
from pathlib import Path

import pytest

from splitknit.errors import BadInput
from splitknit.viewer.catalogue import open_below, read_below
from splitknit.viewer.server import POLICY, _refusal, open_paths, start

TOKEN, PORT = "t0ken", 8123


def ask(path: str = "/t0ken/api/catalogue", method: str = "GET", **headers: str) -> int:
    message = Message()
    for name, value in {"host": f"127.0.0.1:{PORT}", **headers}.items():
        message[name.replace("_", "-")] = value
    found = _refusal(method, path, message, TOKEN, PORT)
    return 200 if found is None else found[0]


def test_the_page_itself_is_let_in() -> None:
    assert ask() == 200
    assert ask("/t0ken/") == 200
    assert ask(host=f"localhost:{PORT}") == 200
    assert ask(Origin=f"http://127.0.0.1:{PORT}", Sec_Fetch_Site="same-origin") == 200
    assert ask(method="HEAD") == 200


@pytest.mark.parametrize(
    "path",
    ["/", "/t0ken", "/T0KEN/", "/t0ke/api", "/t0kenx/api", "/api/catalogue", "//t0ken/", "/%740ken/", "t0ken/", ""],
)
def test_without_the_token_nothing_is_told(path: str) -> None:
    assert ask(path) == 403


@pytest.mark.parametrize(
    "host",
    ["evil.example", "evil.example:8123", "127.0.0.1", "127.0.0.1:80", "127.0.0.1:8123.evil.example", "[::1]:8123", ""],
)
def test_other_names_are_refused(host: str) -> None:
    assert ask(host=host) == 403


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://127.0.0.1:9", "https://127.0.0.1:8123", ""])
def test_other_origins_are_refused(origin: str) -> None:
    assert ask(Origin=origin) == 403


@pytest.mark.parametrize("name", ["Host", "Origin", "Sec-Fetch-Site", "Sec-Fetch-Dest"])
def test_a_header_that_decides_comes_once(name: str) -> None:
    message = Message()
    message["Host"] = f"127.0.0.1:{PORT}"
    message[name] = same = {"Host": message["Host"], "Origin": f"http://127.0.0.1:{PORT}"}.get(name, "same-origin")
    if name != "Host":
        message[name] = same
    found = _refusal("GET", "/t0ken/api/catalogue", message, TOKEN, PORT)
    assert found is not None and found[0] == 400


@pytest.mark.parametrize(
    "headers", [{"Content_Length": "1"}, {"Content_Length": "x"}, {"Transfer_Encoding": "chunked"}]
)
def test_reading_has_no_body(headers: dict[str, str]) -> None:
    assert ask(**headers) == 400
    assert ask(Content_Length="0") == 200


@pytest.mark.parametrize("site", ["cross-site", "same-site"])
def test_other_pages_may_lead_here_but_not_read(site: str) -> None:
    assert ask(Sec_Fetch_Site=site) == 403
    assert ask("/t0ken/", Sec_Fetch_Site=site, Sec_Fetch_Dest="document") == 200
    assert ask("/t0ken/", Sec_Fetch_Site=site, Sec_Fetch_Dest="iframe") == 403
    assert ask("/t0ken/", Sec_Fetch_Site=site, Sec_Fetch_Dest="script") == 403


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH", "OPTIONS"])
def test_nothing_can_be_written(method: str) -> None:
    assert ask(method=method) == 405


def test_tokens_are_random() -> None:
    with start(open_paths([]), 0) as one, start(open_paths([]), 0) as other:
        assert one.token != other.token
        assert len(one.token) >= 32


def test_the_policy_lets_nothing_in_from_elsewhere() -> None:
    assert "default-src 'none'" in POLICY
    assert "unsafe" not in POLICY
    assert "http" not in POLICY
    assert "*" not in POLICY


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "secret.txt").write_text("secret")
    root = tmp_path / "root"
    (root / "below").mkdir(parents=True)
    (root / "below" / "a.txt").write_text("a")
    (root / "link.txt").symlink_to(tmp_path / "secret.txt")
    (root / "inner.txt").symlink_to(root / "below" / "a.txt")
    (root / "up").symlink_to(tmp_path)
    return root


def test_plain_files_below_are_read(folder: Path) -> None:
    assert read_below(folder, "below/a.txt") == b"a"


@pytest.mark.parametrize(
    "name",
    [
        "../secret.txt", "below/../../secret.txt", "/etc/passwd", "link.txt", "inner.txt", "up/secret.txt", "below",
        "", ".", "below/", "below//a.txt", "..\\secret.txt", "a\0b", "missing.txt", "C:secret.txt", "./below/a.txt",
    ],
)  # fmt: skip
def test_nothing_else_is(folder: Path, name: str) -> None:
    with pytest.raises(BadInput):
        open_below(folder, name)


def test_files_that_are_too_large_are_not_read(folder: Path) -> None:
    (folder / "large").write_bytes(b"12345")
    with pytest.raises(BadInput, match="too large"):
        read_below(folder, "large", 4)
