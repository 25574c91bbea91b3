"""The service over HTTP: its acts, its refusals, its audit file, a client made from its OpenAPI document."""

from __future__ import annotations

import base64
import contextlib
import json
import os
import random
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit.io.prints import encode_print_png

pytest.importorskip("starlette")
httpx = pytest.importorskip("httpx")

from splitknit_match.cli.serve import impatient  # noqa: E402
from splitknit_match.gallery import serve  # noqa: E402
from splitknit_match.gallery.serve import ACTS, make_app, openapi  # noqa: E402
from splitknit_match.gallery.warm import OpenGallery  # noqa: E402

from test_open_gallery import press  # noqa: E402  isort: skip

TOKEN = "a-token-of-many-letters"


def sent(image: np.ndarray) -> str:
    return base64.b64encode(encode_print_png(image, 500.0)).decode()


@pytest.fixture
def service(tmp_path: Path):
    """The application on a port of this machine, called by a client of another library."""
    import uvicorn

    with OpenGallery.open(tmp_path / "people.skg") as gallery, socket.socket() as place:
        place.bind(("127.0.0.1", 0))
        app = make_app(gallery, TOKEN, tmp_path / "audit", max_body=2_000_000)
        server = uvicorn.Server(uvicorn.Config(app, log_level="critical", http=impatient()))
        thread = threading.Thread(target=server.run, kwargs={"sockets": [place]})
        thread.start()
        base = f"http://127.0.0.1:{place.getsockname()[1]}"
        with httpx.Client(base_url=base, headers={"Authorization": f"Bearer {TOKEN}"}, timeout=60) as client:
            for _ in range(100):
                if server.started:
                    break
                time.sleep(0.05)
            yield client
        server.should_exit = True
        thread.join()


def test_a_client_made_of_the_document_enrols_and_identifies(service, tmp_path: Path) -> None:
    document = service.get("/openapi.json").json()
    assert document == openapi()

    class Client:
        """One method for each operation, with the fields that the document has."""

    def method(path: str, schema: dict):
        def call(**fields):
            assert set(schema["required"]) <= set(fields) <= set(schema["properties"])
            return service.post(path, json=fields)

        return staticmethod(call)

    for path, operations in document["paths"].items():
        operation = operations["post"]
        schema = operation["requestBody"]["content"]["application/json"]["schema"]
        setattr(Client, operation["operationId"], method(path, schema))
    for name, seed in (("ann", 1), ("bob", 2)):
        made = Client.enroll(person=name, finger="right_index", print=sent(press(seed)))
        assert made.status_code == 200, made.text
        assert made.json()["enrolled"][0]["acquired"] and made.json()["alike"] == []
    again = Client.enroll(person="eve", finger="left_thumb", print=sent(press(1, 5, 9.0)), duplicates="refuse")
    assert again.status_code == 400 and "another person, 'ann'" in again.json()["error"]
    found = Client.identify(print=sent(press(1, 9, 12.0)), top=1).json()
    assert found["candidates"][0]["person"] == "ann" and found["decision"]["match"]
    quality = Client.quality(print=sent(press(2, 4))).json()
    assert 0 < quality["quality"] <= 100 and quality["acquired"]
    assert Client.verify(person="bob", template=quality["template"]).json()["decision"]["match"]
    assert not Client.verify(person="ann", template=quality["template"]).json()["decision"]["match"]
    lines = [json.loads(line) for line in (tmp_path / "audit").read_text().splitlines()][1:]
    assert [line["act"] for line in lines] == ["enroll"] * 3 + ["identify", "quality", "verify", "verify"]
    assert (lines[3]["match"], lines[3]["found"], lines[2]["status"]) == (True, "ann", 400)
    assert set().union(*lines) <= {"time", "act", "status", "ms", "person", "match", "found"}
    assert (tmp_path / "audit").stat().st_mode & 0o077 == 0


def test_what_is_wrong_is_one_sentence(service, tmp_path: Path) -> None:
    good = {"person": "Ann", "finger": "right_index", "print": sent(press(1))}
    assert service.post("/enroll", json=good, headers={"Authorization": "Bearer wrong"}).status_code == 401
    assert service.post("/enroll", json=good, headers={"Authorization": ""}).status_code == 401
    assert service.post("/identify", content=b"x" * 2_100_000).status_code == 413
    assert service.get("/identify").status_code == 405
    assert service.post("/nothing", json={}).status_code == 404
    for body, words in (
        (b"{", "not a JSON document"),
        (b"[" * 100_000, "not a JSON document"),
        (b"\xff\xfe", "not a JSON document"),
        (b"[]", "must be a JSON object"),
        (b'{"print": 3, "person": "A", "finger": "right_index"}', "must be a text"),
        (b'{"finger": "right_index", "print": ""}', "'person' is missing"),
        (json.dumps({**good, "other": 1}).encode(), "not a field of enroll"),
        (json.dumps({**good, "template": "AA=="}).encode(), "either 'print' or 'template'"),
        (json.dumps({**good, "print": "*"}).encode(), "must be base64"),
        (json.dumps({**good, "print": "AAAA"}).encode(), "of another kind"),
        (json.dumps({**good, "finger": "nose"}).encode(), "is not a finger"),
        (json.dumps({**good, "person": ""}).encode(), "person"),
        (json.dumps({**good, "resolution_ppi": 1e300}).encode(), "from 200 to 5080"),
    ):
        answer = service.post("/enroll", content=body)
        assert answer.status_code == 400, (body[:60], answer.text)
        assert words in answer.json()["error"], answer.text
    assert not (tmp_path / "people.skg").exists()


@pytest.mark.slow
def test_broken_requests_do_not_end_it(service) -> None:
    rng = random.Random(4)
    good = json.dumps({"print": sent(press(2))[:4000]}).encode()
    for k in range(120):
        body = bytearray(good)
        for _ in range(1 + k % 5):
            body[rng.randrange(len(body))] = rng.randrange(256)
        answer = service.post(f"/{rng.choice(list(ACTS))}", content=bytes(body[: rng.randrange(len(body))]))
        assert answer.status_code == 400 and set(answer.json()) == {"error"}
    assert service.get("/openapi.json").status_code == 200


def test_faults_say_nothing(service, monkeypatch) -> None:
    def broken(*_):
        raise RuntimeError("secret")

    monkeypatch.setattr("splitknit_match.gallery.serve._done", broken)
    answer = service.post("/quality", json={"print": sent(press(1))})
    assert (answer.status_code, answer.json()) == (500, {"error": "internal error"})


def test_slow_clients_are_let_go_and_no_host_is_believed(service, monkeypatch) -> None:
    monkeypatch.setattr(serve, "PATIENCE_S", 0.5)
    place = service.base_url.host, service.base_url.port
    head = f"POST /quality HTTP/1.1\r\nHost: a\r\nAuthorization: Bearer {TOKEN}\r\nContent-Length: 9\r\n\r\n{{"
    for begin, answer in (("POST /quality HTTP/1.1\r\n", b""), ("", b""), (head, b"HTTP/1.1 408")):
        with socket.create_connection(place, 10) as slow:
            slow.sendall(begin.encode())
            assert slow.recv(100)[:12] == answer
    assert service.post("/quality/").status_code == 404
    said = service.post("/identify", content=b'{"fmr": %s, "print": ""}' % (b"9" * 400))
    assert (said.status_code, said.json()) == (400, {"error": "'fmr' must be a number."})


def test_it_is_for_this_machine_and_wants_a_token(tmp_path: Path) -> None:
    def refused(*words: str) -> str:
        run = [sys.executable, "-m", "splitknit", "serve", "--gallery", str(tmp_path / "g.skg"), *words]
        done = subprocess.run(run, capture_output=True, text=True, check=False, timeout=60)
        assert done.returncode == 2 and done.stderr.count("\n") == 1
        return done.stderr

    assert "is not this machine alone" in refused("--host", "0.0.0.0")
    assert "give the token" in refused()
    (tmp_path / "token").write_text("short\n")
    assert "16 ASCII characters" in refused("--token-file", str(tmp_path / "token"))
    with pytest.raises(BadInput, match="16 ASCII characters"):
        make_app(OpenGallery(tmp_path / "g.skg"), "short")
    with pytest.raises(BadInput, match=r"audit file .* cannot be written"):
        make_app(OpenGallery(tmp_path / "g.skg"), TOKEN, tmp_path / "none" / "audit")


def test_without_its_line_an_act_is_not_done(service, tmp_path: Path, monkeypatch) -> None:
    """A full disk: the act that met it is said to be in doubt, no other is begun, and its line comes with the room."""
    good = {"person": "Ann", "finger": "right_index", "print": sent(press(1))}
    before = (tmp_path / "audit").read_bytes()
    write = os.fdopen

    def full(*arguments, **options):
        stream = write(*arguments, **options)
        return Crowded(stream) if arguments[1] == "ab" else stream

    class Crowded(contextlib.AbstractContextManager):
        def __init__(self, stream) -> None:
            self.stream = stream

        def __getattr__(self, name: str):
            return getattr(self.stream, name)

        def write(self, data: bytes) -> int:
            return self.stream.write(data[:7])

        def __exit__(self, *_) -> None:
            self.stream.close()

    with monkeypatch.context() as change:
        change.setattr("splitknit.io.atomic.os.fdopen", full)
        first = service.post("/enroll", json=good)
        second = service.post("/enroll", json={**good, "person": "Bob"})
    assert [one.status_code for one in (first, second)] == [503, 503]
    assert "may have been done" in first.json()["error"] and "nothing is done" in second.json()["error"]
    assert (tmp_path / "audit").read_bytes() == before
    assert service.post("/quality", json={"print": good["print"]}).status_code == 200
    acts = [json.loads(line) for line in (tmp_path / "audit").read_text().splitlines()]
    assert [(act["act"], act.get("person")) for act in acts] == [("start", None), ("enroll", "Ann"), ("quality", None)]


@pytest.mark.parametrize("reader", [False, True])
def test_a_pipe_in_place_of_a_log_holds_nobody(tmp_path: Path, reader: bool) -> None:
    os.mkfifo(tmp_path / "audit")
    held = os.open(tmp_path / "audit", os.O_RDONLY | os.O_NONBLOCK) if reader else None
    with pytest.raises(BadInput, match=r"audit file .* cannot be written"):
        make_app(OpenGallery(tmp_path / "g.skg"), TOKEN, tmp_path / "audit")
    if held is not None:
        os.close(held)


def test_work_that_takes_too_long_is_answered(service, monkeypatch: pytest.MonkeyPatch) -> None:
    ended = threading.Event()
    monkeypatch.setattr(serve, "WORK_S", 0.05)
    monkeypatch.setattr(serve, "_done", lambda *_: ended.wait(30))
    answer = service.post("/quality", json={"print": "AAAA"})
    ended.set()
    assert answer.status_code == 503
    assert "took more than" in answer.json()["error"]
