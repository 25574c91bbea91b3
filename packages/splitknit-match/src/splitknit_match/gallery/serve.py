"""A gallery over HTTP, by Starlette: enrol, identify, verify and quality, one JSON document a request.

Every act needs the token, has a bounded body, and leaves one line in the audit file: time, act, whose finger it is said
to be, what came out; nothing of the finger. The line of an enrolment is there before the finger is; if it then cannot
be kept after all, a second line says so.
"""

from __future__ import annotations

import base64
import binascii
import contextlib
import datetime
import hmac
import json
import math
import os
import sys
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from splitknit import BadInput
from splitknit.errors import importing, printable, read_bytes, require
from splitknit.io.atomic import append_line
from splitknit.io.images import cores
from splitknit.io.prints import PrintFile
from splitknit.io.provenance import known_json
from splitknit_match.gallery.file import MAX_NAME, Unavailable
from splitknit_match.gallery.gallery import Gallery
from splitknit_match.matching.inputs import Pixels
from splitknit_match.matching.match_job import make_template
from splitknit_match.matching.minutiae_record import PPI, pack_minutiae
from splitknit_match.prints.from_file import minutiae_of, pressed_print
from splitknit_match.prints.make import enhance, measured
from splitknit_match.records.print_formats import decode_prints

MAX_BODY = 10_000_000
"""Bytes of a request, at most: a print of 7 MB as base64."""
PATIENCE_S = 20.0
"""So long may a body take to arrive, and a connection wait without a request that is complete."""
WORK_S = 60.0
"""So long may the work of a request take, with its waiting for a free core."""
MIN_TOKEN = 16
_FINGER: dict[str, tuple[type, str]] = {
    "print": (str, "file of a print or record (PNG, WSQ, ISO 19794, ISO 39794, ANSI/NIST-ITL ...), base64"),
    "template": (str, "template, base64, instead of `print`"),
    "resolution_ppi": (float, "resolution of a picture that does not state its own"),
}
ACTS: dict[str, tuple[str, dict[str, tuple[type, str]], tuple[str, ...]]] = {
    "enroll": (
        "Put a finger into the gallery",
        {"person": (str, "whose finger it is"), "finger": (str, "such as right_index"), "session": (str, "which one"),
         "duplicates": (str, "refuse, warn (default) or allow"), **_FINGER},
        ("person", "finger"),
    ),
    "identify": ("Find a finger", {"top": (int, "candidates"), "fmr": (float, "false match rate"), **_FINGER}, ()),
    "verify": ("Check whose finger it is said to be",
               {"person": (str, "whose"), "fmr": (float, "false match rate"), **_FINGER}, ("person",)),
    "quality": ("How good a print is, and its template", _FINGER, ()),
}  # fmt: skip
"""What may be asked for: by its name a sentence, the fields of the request, and those that must be there."""


def openapi(acts: Mapping[str, Any] = ACTS) -> dict[str, Any]:
    """Describe the service as an OpenAPI document."""
    kinds = {str: "string", int: "integer", float: "number"}
    answers = {
        "200": "what came out",
        "400": "a bad request, in one sentence",
        "401": "no token",
        "413": "too large",
        "503": "the gallery or the audit file cannot be used now, or the work took too long",
    }
    json_of = {"content": {"application/json": {"schema": {"type": "object"}}}}
    paths = {}
    for name, (words, fields, needed) in acts.items():
        known = {key: {"type": kinds[kind], "description": text} for key, (kind, text) in fields.items()}
        schema = {"type": "object", "properties": known, "required": list(needed), "additionalProperties": False}
        paths[f"/{name}"] = {
            "post": {
                "operationId": name,
                "summary": words,
                "requestBody": {"required": True, "content": {"application/json": {"schema": schema}}},
                "responses": {code: {"description": text, **json_of} for code, text in answers.items()},
            }
        }
    security = {"securitySchemes": {"token": {"type": "http", "scheme": "bearer"}}}
    about = {"title": "splitknit", "version": "1"}
    return {"openapi": "3.1.0", "info": about, "paths": paths, "components": security, "security": [{"token": []}]}


def make_app(gallery: Gallery, token: str, audit: Path | None = None, max_body: int = MAX_BODY) -> Any:  # noqa: PLR0915
    """Make the ASGI application.

    Raises BadInput if the token is short, the audit file cannot be written, or Starlette is not installed.
    """
    sound = len(token) >= MIN_TOKEN and token.isascii()
    require(sound, f"the token must have {MIN_TOKEN} ASCII characters or more.")
    log = _Audit(audit)
    require(log.put_down(_line({"act": "start"}, {})), f"the audit file '{audit}' cannot be written; name another one.")
    with importing("serving needs Starlette and uvicorn: pip install 'splitknit-match[serve]'."):
        from anyio import CapacityLimiter, fail_after, move_on_after, to_thread
        from starlette.applications import Starlette
        from starlette.requests import ClientDisconnect, Request
        from starlette.responses import JSONResponse
        from starlette.routing import Route
    limiter = CapacityLimiter(cores())  # of comparisons at a time; the others wait
    expected = f"Bearer {token}".encode()

    async def body_of(request: Request) -> bytes | None:
        """The body, or None where it is too large."""
        body = bytearray()
        with fail_after(PATIENCE_S):
            async for part in request.stream():
                body += part
                if len(body) > max_body:
                    return None
        return bytes(body)

    def answer_of(name: str) -> Callable[[Request], Any]:
        async def answer(request: Request) -> JSONResponse:
            act = _Act(log, name)
            said: dict[str, Any] = {}
            if not log.put_down():
                return JSONResponse({"error": "the audit file cannot be written, so nothing is done"}, 503)
            try:
                if not hmac.compare_digest(request.headers.get("authorization", "").encode(), expected):
                    code, said = 401, {"error": "give the token: Authorization: Bearer TOKEN"}
                elif (body := await body_of(request)) is None:
                    code, said = 413, {"error": f"the request has more than {max_body} bytes"}
                else:
                    asked = act.asked = _asked(name, body)
                    code, said = 503, {"error": f"the work took more than {WORK_S:g} s: try a smaller print, or later"}
                    longest = WORK_S if name != "enroll" else math.inf  # what is left alone would be written later
                    with move_on_after(longest):
                        said = await to_thread.run_sync(
                            _done, name, asked, gallery, act.enrolled, abandon_on_cancel=True, limiter=limiter
                        )
                        code = 200
            except BadInput as error:
                code, said = 503 if isinstance(error, Unavailable) else 400, {"error": _shown(error, gallery)}
            except TimeoutError:
                code, said = 408, {"error": f"the request took more than {PATIENCE_S:g} s to arrive"}
            except ClientDisconnect:
                code = 499
            except Exception:
                code, said = 500, {"error": "internal error"}
            if not act.put_down(code, said):
                code, said = 503, {"error": "the audit file cannot be written; what was asked may have been done"}
            return JSONResponse(said, code)

        return answer

    async def described(_: Request) -> JSONResponse:
        return JSONResponse(openapi())

    routes = [Route(f"/{name}", answer_of(name), methods=["POST"]) for name in ACTS]
    app = Starlette(routes=[*routes, Route("/openapi.json", described)])
    app.router.redirect_slashes = False  # it would redirect to the host that a client names
    return app


def _asked(name: str, body: bytes) -> dict[str, Any]:
    """Fields of a request, each of its kind. Raises BadInput."""
    _, fields, needed = ACTS[name]
    try:
        given = json.loads(body)
    except (ValueError, RecursionError) as error:
        raise BadInput("the request is not a JSON document.") from error
    if not isinstance(given, dict):
        raise BadInput("the request must be a JSON object.")
    for key, value in given.items():
        require(key in fields, f"'{key[:40]}' is not a field of {name}; it has {', '.join(fields)}.")
        kind = fields[key][0]
        sound = isinstance(value, int | float if kind is float else kind) and not isinstance(value, bool)
        sound = sound and (kind is not float or abs(value) <= sys.float_info.max)
        require(sound, f"'{key}' must be a {'number' if kind is not str else 'text'}.")
    for key in needed:
        require(key in given, f"'{key}' is missing: {fields[key][1]}.")
    require(("print" in given) != ("template" in given), "give either 'print' or 'template'.")
    return given


def _finger_of(given: Mapping[str, Any]) -> Pixels | bytes:
    """The finger of a request: a print of known resolution, or a template."""
    try:
        data = base64.b64decode(given.get("print", given.get("template")), validate=True)
    except (binascii.Error, ValueError) as error:
        raise BadInput("'print' and 'template' must be base64.") from error
    if "template" in given:
        require(len(data) > 0, "the template is empty: a failure to acquire.")
        return data
    held = decode_prints(data, "the print")
    require(len(held) == 1, f"the print holds {len(held)} fingers; send them one by one.")
    if not isinstance(held[0], PrintFile):
        return pack_minutiae(minutiae_of(held[0]))
    ppi = given.get("resolution_ppi", held[0].resolution_ppi)
    require(ppi is not None and 200 <= ppi <= 5080, "give 'resolution_ppi', from 200 to 5080: the print states none.")
    return Pixels(held[0].image, float(ppi))


def _shown(error: BadInput, gallery: Gallery) -> str:
    """A sentence without the folders of this machine."""
    text = str(error)
    for folder in (gallery.path.resolve().parent, gallery.path.parent):
        if len(folder.parts) > 1:
            text = text.replace(printable(str(folder)), "...")
    return text


def _done(
    name: str, given: Mapping[str, Any], gallery: Gallery, enrolled: Callable[[], None] = lambda: None
) -> dict[str, Any]:
    finger: Any = _finger_of(given)
    if name == "enroll":
        options = {key: given[key] for key in ("session", "duplicates") if key in given}
        made = gallery.enroll(finger, given["person"], given["finger"], put_down=enrolled, **options)
        return {"enrolled": known_json(made.enrolled), "alike": known_json(made.alike)}
    if name == "quality":
        found = make_template(finger)
        payload = found.payload or b""
        score = None
        if isinstance(finger, Pixels) and found.a.acquired:
            printed = pressed_print(PrintFile(finger.image, finger.resolution_ppi, {}))
            score = round(measured(printed, enhance(printed, PPI), PPI).score)
        template = base64.b64encode(payload).decode("ascii")
        return {"acquired": found.a.acquired, "area_mm2": found.a.area_mm2, "quality": score, "template": template}
    options = {key: given[key] for key in ("top", "fmr", "person") if key in given}
    return dict(known_json(gallery.identify(finger, **options))) | {"gallery": gallery.path.name}


class _Audit:
    """The audit file, and the lines for which the disk had no room."""

    def __init__(self, file: Path | None) -> None:
        self.file, self.unwritten = file, list[dict[str, Any]]()
        self._lock = threading.Lock()

    def put_down(self, *lines: dict[str, Any], keep: bool = True) -> bool:
        """Add lines, those that were not written first; whether that could be done. `keep`: else they wait for room."""
        if self.file is None:
            return True
        with self._lock:
            self.unwritten += lines
            with contextlib.suppress(OSError):
                while self.unwritten:
                    append_line(self.file, self.unwritten[0], begin=True)
                    del self.unwritten[0]
            done = not self.unwritten
            if not done and not keep:
                del self.unwritten[-len(lines) :]
        return done


class _Act:
    """One act of a client, which leaves its line."""

    def __init__(self, log: _Audit, name: str) -> None:
        self.log, self.name, self.asked, self.started = log, name, dict[str, Any](), time.perf_counter()
        self._enrolled = False

    def put_down(self, code: int, said: Mapping[str, Any], *, keep: bool = True) -> bool:
        """Add the line, unless :meth:`enrolled` did and nothing went wrong since; whether it is there."""
        if self._enrolled and code == 200:
            return True
        person, ms = self.asked.get("person"), round(1000 * (time.perf_counter() - self.started))
        if person is not None and len(person) > MAX_NAME:
            person = f"{person[:MAX_NAME]}..."
        return self.log.put_down(_line({"act": self.name, "status": code, "ms": ms, "person": person}, said), keep=keep)

    def enrolled(self) -> None:
        """Add the line while what was written is not yet final, so that no finger is enrolled without it."""
        done = self.put_down(200, {}, keep=False)
        require(done, "the audit file cannot be written, so nothing is enrolled.", Unavailable)
        self._enrolled = True


def _line(line: dict[str, Any], said: Mapping[str, Any]) -> dict[str, Any]:
    """A line of the audit file; what was found is a name, never a score, a picture or a template."""
    line = {"time": datetime.datetime.now(datetime.UTC).isoformat(timespec="milliseconds"), **line}
    decision = said.get("decision")
    if decision is not None:
        line["match"] = decision["match"]
        line["found"] = said["candidates"][0]["person"] if decision["match"] else None
    return line


def read_token(file: Path | None, variable: str = "SPLITKNIT_SERVE_TOKEN") -> str:
    """Token from a file, else from the environment. Raises BadInput if there is none."""
    if file is None:
        text = os.environ.get(variable)
        require(bool(text), f"give the token that clients must send: `token_file` FILE, or the variable {variable}.")
        return str(text)
    return read_bytes(file, 10_000).decode("utf-8", "replace").strip()
