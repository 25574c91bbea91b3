"""The service over HTTP: its acts, its refusals, its audit file, a client made from its OpenAPI
document."""

import base64
import contextlib
import json
import os
import random
import shutil
import socket
import ssl
import struct
import subprocess
import sys
import threading
import time

import pytest

from refusals import bad_input
from splitknit.io.prints import encode_print_png

pytest.importorskip("starlette")
httpx = pytest.importorskip("httpx")

from splitknit_match.gallery import serve  # noqa: E402
from splitknit_match.gallery.gallery import Gallery  # noqa: E402
from splitknit_match.gallery.serve import ACTS, make_app, openapi  # noqa: E402
from splitknit_match.gallery.verbs import server_of  # noqa: E402

from test_open_gallery import press  # noqa: E402  isort: skip

TOKEN = "a-token-of-many-letters"


def sent(image):
    return base64.b64encode(encode_print_png(image, 500.0)).decode()


@pytest.fixture
def running(tmp_path, monkeypatch):
    """The application on a port of this machine, called by a client of another library; and its
    server."""
    with Gallery(tmp_path / "people.skg") as gallery, socket.socket() as place:
        place.bind(("127.0.0.1", 0))
        monkeypatch.setattr("splitknit_match.gallery.serve._MAX_BODY", 2_000_000)
        app = make_app(gallery, TOKEN, tmp_path / "audit")
        server = server_of(app)
        thread = threading.Thread(target=server.run, kwargs={"sockets": [place]})
        thread.start()
        base = f"http://127.0.0.1:{place.getsockname()[1]}"
        with httpx.Client(
            base_url=base, headers={"Authorization": f"Bearer {TOKEN}"}, timeout=60
        ) as client:
            for _ in range(100):
                if server.started:
                    break
                time.sleep(0.05)
            yield client, server
        server.should_exit = True
        thread.join()


@pytest.fixture
def service(running):
    return running[0]


@pytest.mark.slow
def test_a_client_made_of_the_document_enrols_and_identifies(service, tmp_path):
    document = service.get("/openapi.json").json()
    assert document == openapi()

    class Client:
        """One method for each operation, with the fields that the document has."""

    def method(path, schema):
        def call(**fields):
            assert set(schema["required"]) <= set(fields) <= set(schema["properties"])
            return service.post(path, json=fields)

        return staticmethod(call)

    assert "security" in document["paths"].pop("/health")["get"]
    for path, operations in document["paths"].items():
        operation = operations["post"]
        schema = operation["requestBody"]["content"]["application/json"]["schema"]
        setattr(Client, operation["operationId"], method(path, schema))
    for name, seed in (("ann", 1), ("bob", 2)):
        enrolment = Client.enroll(person=name, finger="right_index", print=sent(press(seed)))
        assert enrolment.status_code == 200, enrolment.text
        assert enrolment.json()["enrolled"][0]["acquired"] and enrolment.json()["alike"] == []
    again = Client.enroll(
        person="eve", finger="left_thumb", print=sent(press(1, 5, 9.0)), duplicates="refuse"
    )
    assert again.status_code == 400 and "another person, 'ann'" in again.json()["error"]
    identification = Client.identify(print=sent(press(1, 9, 12.0)), top=1).json()
    assert (
        identification["candidates"][0]["person"] == "ann" and identification["decision"]["match"]
    )
    quality = Client.quality(print=sent(press(2, 4))).json()
    assert 0.9 < quality["chance"] < 1 and quality["acquired"]
    assert Client.verify(person="bob", template=quality["template"]).json()["decision"]["match"]
    assert not Client.verify(person="ann", template=quality["template"]).json()["decision"]["match"]
    listed = Client.list().json()["captures"]
    assert [capture["person"] for capture in listed] == ["ann", "bob"]
    assert "template" not in listed[0]
    assert Client.remove(person="bob").json() == {"removed": 1}
    assert Client.remove(person="bob").status_code == 400
    assert len(Client.list(person="ann").json()["captures"]) == 1
    lines = [json.loads(line) for line in (tmp_path / "audit").read_text().splitlines()][1:]
    assert [line["act"] for line in lines[7:]] == ["list", "remove", "remove", "list"]
    lines = lines[:7]
    assert [line["act"] for line in lines] == ["enroll"] * 3 + [
        "identify",
        "quality",
        "verify",
        "verify",
    ]
    assert (lines[3]["match"], lines[3]["found"], lines[2]["status"]) == (True, "ann", 400)
    assert set().union(*lines) <= {"time", "act", "status", "ms", "person", "match", "found"}
    assert (tmp_path / "audit").stat().st_mode & 0o077 == 0


def test_what_is_wrong_is_one_sentence(service, tmp_path):
    good = {"person": "Ann", "finger": "right_index", "print": sent(press(1))}
    assert (
        service.post("/enroll", json=good, headers={"Authorization": "Bearer wrong"}).status_code
        == 401
    )
    assert service.post("/enroll", json=good, headers={"Authorization": ""}).status_code == 401
    assert service.post("/identify", content=b"x" * 2_100_000).status_code == 413
    for refusal, code in ((service.get("/identify"), 405), (service.post("/nothing"), 404)):
        assert refusal.status_code == code
        assert refusal.json()["error"].endswith("GET /openapi.json describes all.")
    bare = httpx.get(f"{service.base_url}/health")
    assert (bare.status_code, bare.json()) == (200, {"status": "ok"})
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
def test_broken_requests_do_not_end_it(service):
    rng = random.Random(4)
    good = json.dumps({"print": sent(press(2))[:4000]}).encode()
    for k in range(120):
        body = bytearray(good)
        for _ in range(1 + k % 5):
            body[rng.randrange(len(body))] = rng.randrange(256)
        answer = service.post(
            f"/{rng.choice(list(ACTS))}", content=bytes(body[: rng.randrange(len(body))])
        )
        assert answer.status_code == 400 and set(answer.json()) == {"error"}
    assert service.get("/openapi.json").status_code == 200


def test_faults_say_nothing(service, monkeypatch):
    def broken(*_):
        raise RuntimeError("secret")

    monkeypatch.setattr("splitknit_match.gallery.serve._done", broken)
    answer = service.post("/quality", json={"print": sent(press(1))})
    assert (answer.status_code, answer.json()) == (500, {"error": "internal error"})


@pytest.mark.slow
def test_slow_clients_are_let_go_and_no_host_is_believed(service, monkeypatch):
    for name in ("serve.PATIENCE_S", "verbs.SILENCE_S"):
        monkeypatch.setattr(f"splitknit_match.gallery.{name}", 0.5)
    place = service.base_url.host, service.base_url.port
    head = (
        f"POST /quality HTTP/1.1\r\nHost: a\r\nAuthorization: Bearer {TOKEN}\r\nContent-Length:"
        " 9\r\n\r\n{"
    )
    for begin, answer in (("POST /quality HTTP/1.1\r\n", b""), ("", b""), (head, b"HTTP/1.1 408")):
        with socket.create_connection(place, 10) as slow:
            slow.sendall(begin.encode())
            assert slow.recv(100)[:12] == answer
    assert service.post("/quality/").status_code == 404
    answer = service.post("/identify", content=b'{"fmr": %s, "print": ""}' % (b"9" * 400))
    assert (answer.status_code, answer.json()) == (400, {"error": "'fmr' must be a number."})


@pytest.mark.slow
def test_it_is_for_this_machine_and_wants_a_token(tmp_path):
    def refused(*words):
        run = [
            sys.executable,
            "-m",
            "splitknit",
            "serve",
            "--gallery",
            str(tmp_path / "g.skg"),
            *words,
        ]
        done = subprocess.run(run, capture_output=True, text=True, check=False, timeout=60)
        assert done.returncode == 2 and done.stderr.count("\n") == 1
        return done.stderr

    assert "is not this machine alone" in refused("--host", "0.0.0.0")
    assert "give the token" in refused()
    (tmp_path / "token").write_text("short\n")
    assert "16 ASCII characters" in refused("--token-file", str(tmp_path / "token"))
    with bad_input("16 ASCII characters"):
        make_app(Gallery(tmp_path / "g.skg"), "short")
    with bad_input(r"audit file .* cannot be written"):
        make_app(Gallery(tmp_path / "g.skg"), TOKEN, tmp_path / "none" / "audit")


@pytest.mark.slow
def test_without_its_line_an_act_is_not_done(service, tmp_path, monkeypatch):
    """A full disk: nothing is enrolled, and nothing is answered."""
    good = {"person": "Ann", "finger": "right_index", "print": sent(press(1))}
    before = (tmp_path / "audit").read_bytes()
    write = os.fdopen

    def full(*arguments, **options):
        stream = write(*arguments, **options)
        return Crowded(stream) if arguments[1] == "ab" else stream

    class Crowded(contextlib.AbstractContextManager):
        def __init__(self, stream):
            self.stream = stream

        def __getattr__(self, name):
            return getattr(self.stream, name)

        def write(self, data):
            return self.stream.write(data[:7])

        def __exit__(self, *_):
            self.stream.close()

    with monkeypatch.context() as change:
        change.setattr("splitknit.io.atomic.os.fdopen", full)
        answers = [
            service.post("/enroll", json=good),
            service.post("/quality", json={"print": good["print"]}),
        ]
    assert [answer.status_code for answer in answers] == [503, 503]
    assert {answer.json()["error"] for answer in answers} == {
        "the audit file 'audit' cannot be written (No space left on device), and without it nothing"
        " is done."
    }
    assert (tmp_path / "audit").read_bytes() == before
    assert not (tmp_path / "people.skg").exists()
    assert service.post("/quality", json={"print": good["print"]}).status_code == 200
    acts = [json.loads(line) for line in (tmp_path / "audit").read_text().splitlines()]
    assert [(act["act"], act.get("person")) for act in acts] == [("start", None), ("quality", None)]


@pytest.mark.slow
def test_a_gallery_that_is_gone_is_503_and_no_answer_names_a_folder(service, tmp_path):
    good = {"person": "Ann", "finger": "right_index", "print": sent(press(1))}
    probe = {"print": sent(press(1, 9, 12.0))}
    answers = [service.post("/identify", json=probe), service.post("/enroll", json=good)]
    answers += [
        service.post("/identify", json=probe),
        service.post("/verify", json={**probe, "person": "Bob"}),
    ]
    answers += [service.post("/enroll", json={**good, "print": sent(press(2)), "session": "1"})]
    (tmp_path / "people.skg").rename(tmp_path / "away")
    answers += [service.post("/identify", json=probe), service.post("/enroll", json=good)]
    assert not (tmp_path / "people.skg").exists()
    (tmp_path / "away").rename(tmp_path / "people.skg")
    answers += [service.post("/identify", json=probe)]
    assert [answer.status_code for answer in answers] == [400, 200, 200, 400, 400, 503, 503, 200]
    assert answers[2].json()["gallery"] == "people.skg" and answers[-1].json()["decision"]["match"]
    assert "people.skg' is gone" in answers[5].json()["error"]
    assert not [
        answer.text
        for answer in answers
        if str(tmp_path) in answer.text or str(tmp_path.resolve()) in answer.text
    ]


def test_no_answer_names_a_folder_given_as_relative(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "clinic").mkdir()
    with Gallery("clinic/people.skg") as gallery:
        (tmp_path / "clinic" / "people.skg").write_bytes(b"no gallery" * 1000)
        health = serve._health_of(gallery)
    assert "people.skg" in health["error"] and "clinic" not in health["error"]


def test_lines_of_the_audit_file_are_short(service, tmp_path):
    name = "\N{MUSICAL SYMBOL G CLEF}" * 100_000
    fields = {"finger": "right_index", "template": base64.b64encode(b"x").decode(), "person": name}
    answers = [service.post("/enroll", json=fields)]
    answers += [service.post("/verify", json={"person": name, "template": fields["template"]})]
    assert [answer.status_code for answer in answers] == [400, 400]
    lines = (tmp_path / "audit").read_bytes().splitlines()
    assert (
        len(lines) == 3
        and max(map(len, lines)) < 1500
        and max(len(answer.content) for answer in answers) < 500
    )


@contextlib.contextmanager
def served(folder, *words, tls=True, before=()):
    """The command as a process of its own; its port, and where it writes."""
    with socket.socket() as place:
        place.bind(("127.0.0.1", 0))
        port = place.getsockname()[1]
    command = [
        *before,
        sys.executable,
        "-m",
        "splitknit",
        "serve",
        "--gallery",
        str(folder / "people.skg"),
    ]
    command += ["--port", str(port), *words, *(certificate(folder) if tls else [])]
    environment = {**os.environ, "SPLITKNIT_SERVE_TOKEN": TOKEN}
    with (
        (folder / "said").open("wb") as log,
        subprocess.Popen(command, env=environment, stderr=log) as process,
    ):
        try:
            for _ in range(600):
                if b"Serving" in (folder / "said").read_bytes() or process.poll() is not None:
                    break
                time.sleep(0.1)
            yield process, port
        finally:
            process.kill()


def certificate(folder):
    """Options for TLS with a certificate that is valid for a day."""
    if shutil.which("openssl") is None:
        pytest.skip("no openssl to make a certificate")
    chain, key = folder / "chain.pem", folder / "key.pem"
    kind = [
        "-newkey",
        "ec",
        "-pkeyopt",
        "ec_paramgen_curve:prime256v1",
        "-nodes",
        "-days",
        "1",
        "-subj",
        "/CN=x",
    ]
    command = ["openssl", "req", "-x509", *kind, "-keyout", str(key), "-out", str(chain)]
    subprocess.run(command, check=True, capture_output=True, timeout=60)
    key.chmod(0o600)
    return ["--certificate", str(chain), "--certificate-key", str(key)]


def connected(port, tls):
    plain = socket.create_connection(("127.0.0.1", port), 10)
    if not tls:
        return plain
    context = ssl.create_default_context()
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    return context.wrap_socket(plain)


@pytest.mark.slow
@pytest.mark.parametrize("tls", [True, False])
def test_clients_that_are_silent_do_not_hold_the_end(tmp_path, tls):
    with served(tmp_path, tls=tls) as (process, port), contextlib.ExitStack() as stack:
        for _ in range(20):
            stack.enter_context(socket.create_connection(("127.0.0.1", port), 10))
        with connected(port, tls) as client:
            client.sendall(b"GET /openapi.json HTTP/1.1\r\nHost: a\r\n\r\n")
            assert client.recv(15) == b"HTTP/1.1 200 OK"
        half = stack.enter_context(connected(port, tls))
        head = (
            f"POST /quality HTTP/1.1\r\nHost: a\r\nAuthorization: Bearer {TOKEN}\r\nContent-Length:"
            " 90000\r\n\r\n"
        )
        half.sendall(head.encode() + b"{" * 70_000)
        time.sleep(0.3)
        process.terminate()
        assert process.wait(20) in (0, -15)
    log = (tmp_path / "said").read_text()
    assert len(log) < 1000 and "Traceback" not in log


def test_who_fetches_no_answer_is_let_go(running, monkeypatch):
    monkeypatch.setattr("splitknit_match.gallery.verbs.SILENCE_S", 0.2)
    client, server = running
    asked = b"GET /openapi.json HTTP/1.1\r\nHost: a\r\n\r\n" * 4000
    with socket.socket() as deaf:
        deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
        deaf.settimeout(1)
        deaf.connect((client.base_url.host, client.base_url.port))
        with contextlib.suppress(OSError):  # it reads no further, or has closed
            deaf.sendall(asked)
        for _ in range(100):
            if not server.server_state.connections:
                break
            time.sleep(0.1)
        assert not server.server_state.connections
    assert client.get("/health").status_code == 200


@pytest.mark.slow
@pytest.mark.parametrize("tls", [True, False])
def test_silent_connections_do_not_hold_the_door(tmp_path, tls):
    """64 of 1100 come in, and are let go before a client's patience ends."""
    with served(tmp_path, tls=tls) as (_, port), contextlib.ExitStack() as stack:
        silent = [
            stack.enter_context(socket.create_connection(("127.0.0.1", port), 10))
            for _ in range(64)
        ]
        for _ in range(1036):
            late = socket.create_connection(("127.0.0.1", port), 10)
            with late, contextlib.suppress(ConnectionResetError):
                assert late.recv(1) == b""
        for connection in silent:
            assert connection.recv(1) == b""
        with connected(port, tls) as client:
            client.sendall(b"GET /health HTTP/1.1\r\nHost: a\r\n\r\n")
            assert client.recv(15) == b"HTTP/1.1 200 OK"
    assert (tmp_path / "said").read_text().count("\n") == 1


@pytest.mark.slow
def test_clients_killed_while_they_wait_do_not_hold_the_end(tmp_path):
    body = json.dumps({"print": sent(press(1))}).encode()
    head = (
        f"POST /quality HTTP/1.1\r\nHost: a\r\nAuthorization: Bearer {TOKEN}\r\nContent-Length:"
        f" {len(body)}\r\n\r\n"
    )
    with served(tmp_path) as (process, port):
        for _ in range(4):
            client = connected(port, True)
            client.sendall(head.encode() + body)
            # as of one that is killed
            client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            client.close()
        process.terminate()
        assert process.wait(20) in (0, -15)
    assert "Traceback" not in (tmp_path / "said").read_text()


@pytest.mark.slow
def test_what_it_cannot_serve_with_is_one_sentence(tmp_path):
    """A certificate that does not fit, a key that is locked, a port that is taken; notes of an
    open token and an open gallery."""
    options, token = certificate(tmp_path), tmp_path / "token"
    (tmp_path / "locked.pem").write_bytes(
        b"-----BEGIN ENCRYPTED PRIVATE KEY-----\n"
        + base64.b64encode(bytes(99))
        + b"\n-----END ENCRYPTED PRIVATE KEY-----\n"
    )
    token.write_text(TOKEN)
    token.chmod(0o644)
    for words in (
        [*options[:3], str(tmp_path / "locked.pem")],
        [*options[:3], str(token)],
        ["--certificate", "none", *options[2:]],
    ):
        with served(tmp_path, *words, tls=False) as (process, _):
            assert process.wait(20) == 2
        log = (tmp_path / "said").read_text()
        assert log.count("\n") == 1 and "name PEM files" in log, log
    (tmp_path / "people.skg").touch()
    (tmp_path / "people.skg").chmod(0o644)
    with served(tmp_path, "--token-file", str(token), tls=False) as (first, port):
        said = (tmp_path / "said").read_text()
        assert "note: the token" in said and "note: the gallery" in said
        (tmp_path / "second").mkdir()
        with served(tmp_path / "second", "--port", str(port), tls=False) as (second, _):
            assert second.wait(20) == 2
        log = (tmp_path / "second" / "said").read_text()
        assert log.count("\n") == 1 and "cannot listen at port" in log and "Serving" not in log
        first.terminate()
        assert first.wait(20) in (0, -15)


@pytest.mark.slow
def test_a_full_disk_is_no_fault_of_the_client(tmp_path):
    mounted = (
        "unshare",
        "-rm",
        "sh",
        "-c",
        f'mount -t tmpfs -o size=80k none {tmp_path / "small"} && exec "$@"',
        "sh",
    )
    (tmp_path / "small").mkdir()
    try:
        subprocess.run([*mounted, "true"], check=True, capture_output=True, timeout=20)
    except (OSError, subprocess.SubprocessError):
        pytest.skip("no small disk can be mounted here")
    gallery = (
        "--gallery",
        str(tmp_path / "small" / "people.skg"),
        "--audit",
        str(tmp_path / "audit"),
    )
    with (
        served(tmp_path, *gallery, tls=False, before=mounted) as (_, port),
        httpx.Client() as client,
    ):
        client.base_url, client.headers["Authorization"] = (
            f"http://127.0.0.1:{port}",
            f"Bearer {TOKEN}",
        )
        answers = []
        for seed in range(1, 20):
            fields = {"person": str(seed), "finger": "right_index", "print": sent(press(seed))}
            answers.append(client.post("/enroll", json=fields, timeout=60))
            if answers[-1].status_code != 200:
                break
        assert answers[-1].status_code == 503 and "is full" in answers[-1].json()["error"], answers[
            -1
        ].text
        assert str(tmp_path) not in answers[-1].text
        identification = client.post(
            "/identify", json={"print": sent(press(1, 9, 12.0))}, timeout=60
        )
        assert (
            identification.status_code == 200
            and identification.json()["searched"]["captures"] == len(answers) - 1
        )
    acts = [json.loads(line) for line in (tmp_path / "audit").read_text().splitlines()][1:-1]
    assert [act["status"] for act in acts if act["person"] == str(len(answers))][-1] == 503


@pytest.mark.parametrize("reader", [False, True])
def test_a_pipe_in_place_of_a_log_holds_nobody(tmp_path, reader):
    os.mkfifo(tmp_path / "audit")
    held = os.open(tmp_path / "audit", os.O_RDONLY | os.O_NONBLOCK) if reader else None
    with bad_input(r"audit file .* cannot be written"):
        make_app(Gallery(tmp_path / "g.skg"), TOKEN, tmp_path / "audit")
    if held is not None:
        os.close(held)


def test_work_that_takes_too_long_is_answered(service, monkeypatch):
    ended = threading.Event()
    monkeypatch.setattr(serve, "WORK_S", 0.05)
    monkeypatch.setattr(serve, "_done", lambda *_: ended.wait(30))
    answer = service.post("/quality", json={"print": "AAAA"})
    ended.set()
    assert answer.status_code == 503
    assert "took more than" in answer.json()["error"]
