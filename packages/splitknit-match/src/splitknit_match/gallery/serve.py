"""A gallery over HTTP, by Starlette: enrol, identify, verify, quality, list and remove, one JSON
document a request.

Every act needs the token, has a bounded body, and leaves one line in the audit file: time, act,
whose finger it is said to be, what came out; nothing of the finger. The line of an enrolment or a
removal is there before it is final; if it then fails after all, a second line says so.
"""

from __future__ import annotations

import base64
import binascii
import datetime
import errno
import hmac
import json
import logging
import math
import os
import stat
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from splitknit import BadInput
from splitknit.errors import importing, printable, require
from splitknit.files import read_bytes
from splitknit.io.images import cores
from splitknit.io.provenance import known_json
from splitknit_match.gallery.file import MAX_NAME, Unavailable
from splitknit_match.gallery.gallery import Gallery
from splitknit_match.matching.inputs import Pixels
from splitknit_match.matching.match import make_template
from splitknit_match.prints.from_file import MAX_PPI, MIN_PPI, minutiae_of
from splitknit_match.records.minutiae_record import pack_minutiae
from splitknit_match.records.pictures import PrintFile
from splitknit_match.records.print_formats import decode_prints

_log = logging.getLogger(__name__)

_FINGER: dict[str, tuple[type, str]] = {
    "print": (
        str,
        "file of a print or record (PNG, WSQ, ISO 19794, ISO 39794, ANSI/NIST-ITL ...), base64",
    ),
    "template": (str, "template, base64, instead of `print`"),
    "resolution_ppi": (float, "resolution of a picture that does not state its own"),
    "ridges": (str, "dark or light, where it is known"),
}
ACTS: dict[str, tuple[str, dict[str, tuple[type, str]], tuple[str, ...]]] = {
    "enroll": (
        "Put a finger into the gallery",
        {
            "person": (str, "whose finger it is"),
            "finger": (str, "such as right_index"),
            "session": (str, "which one"),
            "duplicates": (str, "refuse, warn (default) or allow"),
            **_FINGER,
        },
        ("person", "finger"),
    ),
    "identify": (
        "Find a finger",
        {"top": (int, "candidates"), "fmr": (float, "false match rate"), **_FINGER},
        (),
    ),
    "verify": (
        "Check whose finger it is said to be",
        {"person": (str, "whose"), "fmr": (float, "false match rate"), **_FINGER},
        ("person",),
    ),
    "quality": ("How probably a print will match, and its template", _FINGER, ()),
    "list": ("List who is in the gallery", {"person": (str, "of this person only")}, ()),
    "remove": (
        "Remove a person, a finger or a session for good",
        {
            "person": (str, "whose fingers"),
            "finger": (str, "this one only"),
            "session": (str, "this one only"),
        },
        ("person",),
    ),
}
"""What may be asked for: by its name a sentence, the fields of the request, and those that must be
there."""


def openapi() -> dict[str, Any]:
    """Describe the service as an OpenAPI document."""
    kinds = {str: "string", int: "integer", float: "number"}
    answers = {
        "200": "what came out",
        "400": "a bad request, in one sentence",
        "401": "no token",
        "413": "too large",
        "503": "the gallery or the audit file cannot be used now, or the work took too long",
    }
    document = {"content": {"application/json": {"schema": {"type": "object"}}}}
    responses = {code: {"description": text, **document} for code, text in answers.items()}
    paths = {}
    for name, (words, fields, needed) in ACTS.items():
        known = {
            key: {"type": kinds[kind], "description": text} for key, (kind, text) in fields.items()
        }
        schema = {
            "type": "object",
            "properties": known,
            "required": list(needed),
            "additionalProperties": False,
        }
        body = {"required": True, "content": {"application/json": {"schema": schema}}}
        act = {"operationId": name, "summary": words, "requestBody": body, "responses": responses}
        paths[f"/{name}"] = {"post": act}
    healthy = {"operationId": "health", "summary": "Whether the gallery can be used; no token"}
    paths["/health"] = {"get": {**healthy, "responses": responses, "security": []}}
    security = {"securitySchemes": {"token": {"type": "http", "scheme": "bearer"}}}
    about = {"title": "splitknit", "version": "1"}
    return {
        "openapi": "3.1.0",
        "info": about,
        "paths": paths,
        "components": security,
        "security": [{"token": []}],
    }


_MAX_BODY = 10_000_000  # longest request: a print of 7 MB as base64
PATIENCE_S = 20.0
"""So long may a body take to arrive, and a connection wait without a request that is complete."""
WORK_S = 60.0  # so long may the work of a request take, with its waiting for a free core
_MIN_TOKEN = 16  # shortest token


def make_app(gallery: Gallery, token: str, audit: Path | None = None) -> Any:
    """Make the ASGI application.

    Raises BadInput if the token is short, the audit file cannot be written, or Starlette is not
    installed.
    """
    require(
        len(token) >= _MIN_TOKEN and token.isascii(),
        f"the token must have {_MIN_TOKEN} ASCII characters or more.",
    )
    _write_line(audit, {"act": "start"})
    with importing("serving needs Starlette and uvicorn: pip install 'splitknit-match[serve]'."):
        from anyio import CapacityLimiter, fail_after, move_on_after, to_thread
        from starlette.applications import Starlette
        from starlette.requests import ClientDisconnect, Request
        from starlette.responses import JSONResponse
        from starlette.routing import Route
    limiter = CapacityLimiter(cores())  # of comparisons at a time; the others wait
    expected = f"Bearer {token}".encode()

    async def body_of(request: Request) -> bytes:
        body = bytearray()
        with fail_after(PATIENCE_S):
            async for part in request.stream():
                body += part
                if len(body) > _MAX_BODY:
                    raise _AnswerError(413, f"the request has more than {_MAX_BODY} bytes")
        return bytes(body)

    async def answer(request: Request) -> JSONResponse:
        act = _Act(request.url.path[1:], audit)
        code, facts = 200, dict[str, Any]()
        try:
            if not hmac.compare_digest(request.headers.get("authorization", "").encode(), expected):
                raise _AnswerError(401, "give the token: Authorization: Bearer TOKEN")
            act.fields = _fields_of(act.name, await body_of(request))
            # what is left alone would be written later
            limit_s = WORK_S if act.name not in ("enroll", "remove") else math.inf
            with move_on_after(limit_s) as scope:
                facts = await to_thread.run_sync(
                    _done, act, gallery, abandon_on_cancel=True, limiter=limiter
                )
            if scope.cancelled_caught:
                raise _AnswerError(
                    503, f"the work took more than {WORK_S:g} s: try a smaller print, or later"
                )
        except _AnswerError as error:
            code, facts = error.code, {"error": str(error)}
        except BadInput as error:
            code, facts = (
                503 if isinstance(error, Unavailable) else 400,
                {"error": _shown(error, gallery)},
            )
        except TimeoutError:
            code, facts = 408, {"error": f"the request took more than {PATIENCE_S:g} s to arrive"}
        except ClientDisconnect:
            code = 499
        except Exception:
            _log.exception("internal error of %s", act.name)
            code, facts = 500, {"error": "internal error"}
        try:
            act.log(code, facts)
        except Unavailable as error:
            code, facts = 503, {"error": str(error)}
        return JSONResponse(facts, code)

    routes = [Route(f"/{name}", answer, methods=["POST"]) for name in ACTS]
    app = Starlette(
        routes=routes + _without_token(gallery),
        exception_handlers=dict.fromkeys((404, 405), _refused),
    )
    app.router.redirect_slashes = False  # it would redirect to the host that a client names
    return app


def _without_token(gallery: Gallery) -> list[Any]:
    """Routes that need none."""
    from anyio import to_thread
    from starlette.responses import JSONResponse
    from starlette.routing import Route

    async def health(_: Any) -> JSONResponse:
        facts = await to_thread.run_sync(_health_of, gallery)
        return JSONResponse(facts, 503 if "error" in facts else 200)

    async def described(_: Any) -> JSONResponse:
        return JSONResponse(openapi())

    return [Route("/openapi.json", described), Route("/health", health)]


async def _refused(_: Any, error: Any) -> Any:
    from starlette.responses import JSONResponse

    words = "there is no such address" if error.status_code == 404 else "use another method"
    facts = {"error": f"{words}; GET /openapi.json describes all."}
    return JSONResponse(facts, error.status_code, error.headers)


def _health_of(gallery: Gallery) -> dict[str, str]:
    try:
        if gallery.there:
            len(gallery)
    except BadInput as error:
        return {"error": _shown(error, gallery)}
    return {"status": "ok"}


class _AnswerError(Exception):
    """A request that is answered by another code than 400."""

    def __init__(self, code: int, words: str) -> None:
        super().__init__(words)
        self.code = code


class _Act:
    """One act of a client, which leaves a line."""

    def __init__(self, name: str, audit: Path | None) -> None:
        self.name, self.audit, self.fields, self.started = (
            name,
            audit,
            dict[str, Any](),
            time.perf_counter(),
        )
        self._logged = False

    def log(self, code: int, facts: Mapping[str, Any]) -> None:
        """Add the line, unless it is there (:meth:`written`); what was found is a name, never a
        score or a template.

        Raises Unavailable if it cannot be written.
        """
        if self._logged and code == 200:
            return
        person, ms = self.fields.get("person"), round(1000 * (time.perf_counter() - self.started))
        if person is not None and len(person) > MAX_NAME:
            person = f"{person[:MAX_NAME]}..."
        line = {"act": self.name, "status": code, "ms": ms, "person": person}
        if decision := facts.get("decision"):
            line["match"] = decision["match"]
            line["found"] = facts["candidates"][0]["person"] if decision["match"] else None
        _write_line(self.audit, line)

    def written(self) -> None:
        """Add the line while what was written is not yet final, so that no finger is enrolled
        or removed without it."""
        self.log(200, {})
        self._logged = True


def _append_line(path: Path, line: Mapping[str, Any]) -> None:
    """Add a line of JSON to a log, made where there is none, whole or not at all: a regular file,
    no link. Raises OSError.
    """
    flags = os.O_CREAT | os.O_WRONLY | os.O_APPEND | os.O_NOFOLLOW | os.O_NONBLOCK
    with os.fdopen(os.open(path, flags, 0o600), "ab", buffering=0) as stream:
        mode = os.fstat(stream.fileno()).st_mode
        data = json.dumps(line).encode("ascii") + b"\n"
        if not stat.S_ISREG(mode):  # a pipe that nobody empties would hold the program
            raise OSError(errno.EINVAL, "it is not a file")
        if (written := stream.write(data)) < len(data):
            stream.truncate(stream.tell() - written)
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def _write_line(audit: Path | None, line: dict[str, Any]) -> None:
    now = datetime.datetime.now(datetime.UTC).isoformat(timespec="milliseconds")
    try:
        if audit is not None:
            _append_line(audit, {"time": now, **line})
    except OSError as error:
        raise Unavailable(
            f"the audit file '{audit.name if audit else ''}' cannot be written ({error.strerror}),"
            " and without it nothing is done."
        ) from error


def _fields_of(name: str, body: bytes) -> dict[str, Any]:
    """Fields of a request, each of its kind. Raises BadInput."""
    _, known, needed = ACTS[name]
    try:
        fields = json.loads(body)
    except (ValueError, RecursionError) as error:
        raise BadInput("the request is not a JSON document.") from error
    if not isinstance(fields, dict):
        raise BadInput("the request must be a JSON object.")
    for key, value in fields.items():
        require(key in known, f"'{key[:40]}' is not a field of {name}; it has {', '.join(known)}.")
        kind = known[key][0]
        sound = isinstance(value, int | float if kind is float else kind) and not isinstance(
            value, bool
        )
        require(
            sound and (kind is not float or abs(value) <= sys.float_info.max),
            f"'{key}' must be a {'number' if kind is not str else 'text'}.",
        )
    for key in needed:
        require(key in fields, f"'{key}' is missing: {known[key][1]}.")
    single = ("print" in fields) != ("template" in fields)
    require(single or "print" not in known, "give either 'print' or 'template'.")
    return fields


def _finger_of(fields: Mapping[str, Any]) -> Pixels | bytes:
    """The finger of a request: a print of known resolution, or a template."""
    try:
        data = base64.b64decode(fields.get("print", fields.get("template")), validate=True)
    except (binascii.Error, ValueError) as error:
        raise BadInput("'print' and 'template' must be base64.") from error
    if "template" in fields:
        require(data, "the template is empty: a failure to acquire.")
        return data
    prints = decode_prints(data, "the print")
    require(len(prints) == 1, f"the print holds {len(prints)} fingers; send them one by one.")
    if not isinstance(prints[0], PrintFile):
        return pack_minutiae(minutiae_of(prints[0]))
    ppi = fields.get("resolution_ppi", prints[0].resolution_ppi)
    require(
        ppi is not None and MIN_PPI <= ppi <= MAX_PPI,
        f"give 'resolution_ppi', from {MIN_PPI:g} to {MAX_PPI:g}: the print states none.",
    )
    ridges = fields.get("ridges")
    require(ridges in (None, "dark", "light"), "'ridges' must be dark or light.")
    return Pixels(prints[0].image, float(ppi), ridges, prints[0].impression)


def _shown(error: BadInput, gallery: Gallery) -> str:
    """A sentence without the folders of this machine."""
    text = str(error)
    for file in (gallery.path.resolve(), gallery.path):
        text = text.replace(printable(str(file)), printable(file.name))
        if len(file.parts) > 2:
            text = text.replace(printable(str(file.parent)), "...")
    return text


def _done(act: _Act, gallery: Gallery) -> dict[str, Any]:
    """What is answered."""
    fields = dict(act.fields)
    if act.name == "list":
        return {"captures": known_json(gallery.entries(**fields))}
    if act.name == "remove":
        return {"removed": gallery.remove(**fields, last=act.written)}
    finger: Any = _finger_of(fields)
    for name in _FINGER:
        fields.pop(name, None)
    if act.name == "enroll":
        person, which = fields.pop("person"), fields.pop("finger")
        enrolment = gallery.enroll(finger, person, which, put_down=act.written, **fields)
        made = "enrolled", "alike", "findings"
        return {name: known_json(getattr(enrolment, name)) for name in made}
    if act.name == "quality":
        result = make_template(finger)
        facts = {name: getattr(result.a, name) for name in ("acquired", "area_mm2", "chance")}
        return {**facts, "template": base64.b64encode(result.payload).decode("ascii")}
    return dict(known_json(gallery.identify(finger, **fields))) | {"gallery": gallery.path.name}


def read_token(file: Path | None) -> str:
    """Token from a file, else from the environment. Raises BadInput if there is none."""
    if file is None:
        text = os.environ.get("SPLITKNIT_SERVE_TOKEN")
        require(
            text,
            "give the token that clients must send: `token_file` FILE, or the variable"
            " SPLITKNIT_SERVE_TOKEN.",
        )
        return str(text)
    return read_bytes(file, 10_000).decode("utf-8", "replace").strip()
