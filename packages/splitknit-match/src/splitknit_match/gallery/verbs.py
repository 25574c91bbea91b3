"""Verbs of a gallery: ``splitknit identify``, ``gallery list|info|remove|export|import``,
``serve``."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import sys
from collections.abc import Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal
from weakref import WeakSet

from cyclopts import Parameter

from splitknit.arguments import (
    AnyPath,
    Natural,
    Preset,
    Progress,
    Report,
    ResolutionPpi,
    Ridges,
    checked,
    count,
    silent,
)
from splitknit.errors import BadInput, importing, printable, require
from splitknit.findings import Finding, worst_first
from splitknit.settings import Limits
from splitknit_match.matching.match import Finger

if TYPE_CHECKING:
    from splitknit_match.gallery.file import Key
    from splitknit_match.gallery.gallery import Gallery
    from splitknit_match.gallery.identify import Identification

    GivenKey = Key | AnyPath
else:
    GivenKey = AnyPath
    Identification = Any

KeyFile = Annotated[
    AnyPath | None,
    Parameter(
        help=(
            "Key of an encrypted gallery: a passphrase, or 64 hexadecimal digits (or the variable "
            "SPLITKNIT_GALLERY_KEY)."
        ),
    ),
]
LOCAL = ("127.0.0.1", "::1", "localhost")
CONNECTIONS = 64
"""Connections at a time. Source: judgement, far more than cores."""
SILENCE_S = 4.0
"""So long may a TLS handshake take, and then a connection do nothing: no request begun, no answer
fetched. Source: judgement, above four round trips by satellite, and lost packets sent again."""


@checked
def identify(
    gallery: AnyPath,
    probe: Finger,
    key: GivenKey | None = None,
    *,
    top: Natural = 10,
    person: str | None = None,
    finger: str | None = None,
    fmr: float | None = None,
    merge: Literal["person", "finger", "none"] = "person",
    resolution_ppi: float | None = None,
    ridges: Ridges = None,
    preset: Preset = "metric",
    scheduler: str | None = None,
    progress: Progress = silent,
) -> Identification:
    """Find a finger in a gallery, or check whose it is said to be.

    A gallery that keeps minutiae is searched by minutiae, one that keeps ridges by ridges.

    Parameters
    ----------
    gallery : path
        File of the gallery.
    probe : path, array (H, W) uint8, bytes of a template, Reconstruction or Capture
    key : Key or path, optional
        Key, or file with the key, of an encrypted gallery.
    top, person, finger, fmr, merge, preset : optional
        See :func:`identify_in_gallery`.
    resolution_ppi : float, optional
        Pixels per inch of a print that is an array, or whose file does not state it.
    ridges : {"dark", "light"}, optional
        As of :func:`match`.
    scheduler : str, optional
        Address of a Dask scheduler, whose workers hold and search the gallery; they must see it
        under the same name, and an encrypted one's key in their environment.
    progress : called with the name of a stage and the fraction done, optional

    Returns
    -------
    Identification
        ``candidates``, best first, and ``decision``; that nobody is found is not an error.

    Raises
    ------
    BadInput
        If a file cannot be used, the gallery's templates were made otherwise, the claimed person or
        finger is not in it, the rate was not measured, or the scheduler cannot be reached or must
        not be used.

    Examples
    --------
    >>> import splitknit_match
    >>> answer = splitknit_match.identify("people.skg", "captures/unknown", top=3)  # doctest: +SKIP
    >>> answer.candidates  # doctest: +SKIP
    """
    with _opened(gallery, key, scheduler) as opened:
        return opened.identify(
            probe,
            top=top,
            person=person,
            finger=finger,
            fmr=fmr,
            merge=merge,
            resolution_ppi=resolution_ppi,
            ridges=ridges,
            preset=preset,
            progress=progress,
        )


@checked
def identify_in_gallery(
    gallery: AnyPath,
    probe: AnyPath,
    *,
    key_file: KeyFile = None,
    top: Natural = 10,
    person: str | None = None,
    finger: str | None = None,
    fmr: float | None = None,
    merge: Literal["person", "finger", "none"] = "person",
    raw: bool = False,
    resolution_ppi: ResolutionPpi = None,
    ridges: Ridges = None,
    preset: Preset = "metric",
    scheduler: str | None = None,
    progress: Progress = silent,
) -> Identification | Report:
    """Find a finger in a gallery, or check whose it is said to be.

    Parameters
    ----------
    gallery
        File of the gallery.
    probe
        Capture folder, result folder, template (.skt), print, record of minutiae, or photograph of
        a finger in colour.
    top
        Candidates that are reported.
    person
        Verification: whose finger it is said to be.
    finger
        Which finger it is; others are left out.
    fmr
        False match rate of one comparison at which is decided (default: 1e-4, or the smallest that
        was measured for such prints).
    merge
        One candidate for each person (default), each finger, or each enrolled capture (none).
    raw
        Print the method's own scores too (--json always has them).
    preset
        How captures are reconstructed.
    scheduler
        Dask scheduler tls://HOST:PORT whose workers search.

    Returns
    -------
    Identification, or Report with its scores (`raw`)

    Raises
    ------
    BadInput
        As :func:`identify`.

    Examples
    --------
    >>> answer = identify_in_gallery("people.skg", "captures/unknown", top=3)  # doctest: +SKIP
    >>> answer.facts["answer"]  # doctest: +SKIP
    'match'
    """
    from splitknit_match.gallery.file import readable_gallery
    from splitknit_match.gallery.identify import identification_lines

    identification = identify(
        gallery,
        probe,
        key_file,
        top=top,
        person=person,
        finger=finger,
        fmr=fmr,
        merge=merge,
        resolution_ppi=resolution_ppi,
        ridges=ridges,
        preset=preset,
        scheduler=scheduler,
        progress=progress,
    )
    findings = (*identification.findings, *readable_gallery(gallery, key_file))
    identification = replace(identification, findings=worst_first(findings))
    if not raw:
        return identification
    return Report(identification.facts, tuple(identification_lines(identification, scores=True)))


def _opened(gallery: AnyPath, key_file: GivenKey | None, scheduler: str | None = None) -> Gallery:
    from splitknit_match.gallery.gallery import Gallery

    return Gallery(gallery, key_file, scheduler)


def _reported(
    gallery: AnyPath,
    key_file: AnyPath | None,
    facts: dict[str, Any],
    lines: Sequence[str],
    findings: Sequence[Finding] = (),
) -> Report:
    """What a verb did with a gallery, `findings`, and one where others can read it."""
    from splitknit_match.gallery.file import readable_gallery

    ordered = worst_first([*findings, *readable_gallery(gallery, key_file)])
    notes = [f"Please note: {finding}" for finding in ordered]
    return Report({**facts, "findings": [finding.facts for finding in ordered]}, (*lines, *notes))


def gallery_list(
    gallery: AnyPath, *, key_file: KeyFile = None, person: str | None = None
) -> Report:
    """List whose fingers are in it.

    Parameters
    ----------
    gallery
        File of the gallery.
    person
        Of this person only.

    Returns
    -------
    Report

    Raises
    ------
    BadInput
        If the gallery cannot be read, or holds nothing of the person.

    Examples
    --------
    >>> gallery_list("people.skg").facts["captures"]  # doctest: +SKIP
    """
    from splitknit_match.gallery.file import check_person, session_order

    name = None if person is None else check_person(person)
    entries = _opened(gallery, key_file).entries(name)
    require(name is None or entries, f"'{gallery}' holds nothing of person '{name}'.")
    entries.sort(key=lambda entry: (entry.person, entry.finger, session_order(entry.session)))
    lines = [f"{'person':24} {'finger':13} {'session':8} {'from':9} skin"]
    captures = []
    for entry in entries:
        acquired = entry.template_bytes > 0
        skin = (
            f"{entry.area_mm2:.0f} mm²"
            if acquired
            else f"failure to acquire ({entry.failure or 'unknown'})"
        )
        lines.append(f"{entry.person:24} {entry.finger:13} {entry.session:8} {entry.kind:9} {skin}")
        captures.append(
            {**asdict(entry), "acquired": acquired, "enrolled_at": entry.enrolled_at or None}
        )
    return _reported(gallery, key_file, {"gallery": str(gallery), "captures": captures}, lines)


def gallery_info(gallery: AnyPath, *, key_file: KeyFile = None) -> Report:
    """Show numbers and sizes.

    Parameters
    ----------
    gallery
        File of the gallery.

    Returns
    -------
    Report

    Raises
    ------
    BadInput
        If the gallery cannot be read.

    Examples
    --------
    >>> gallery_info("people.skg").facts["people"]  # doctest: +SKIP
    17
    """
    from splitknit_match.gallery.file import VERSION
    from splitknit_match.gallery.gallery import content_of
    from splitknit_match.matching.template import VERSION as TEMPLATE_VERSION

    with _opened(gallery, key_file) as opened:
        facts = asdict(content_of(opened, created=False))
        template_bytes = sum(entry.template_bytes for entry in opened)
    del facts["created"]
    file_bytes = Path(gallery).stat().st_size
    facts |= {"version": VERSION, "template_version": TEMPLATE_VERSION}
    facts |= {"template_bytes": template_bytes, "file_bytes": file_bytes}
    locked = "encrypted" if facts["encrypted"] else "not encrypted"
    people = count(facts["people"], "person", "people")
    templates = f"{template_bytes / 1e6:.2f} MB of templates (version {TEMPLATE_VERSION})"
    return _reported(
        gallery,
        key_file,
        facts,
        (
            f"{gallery}: a gallery of version {VERSION}, {locked}.",
            (
                f"{count(facts['captures'], 'capture')} of {count(facts['fingers'], 'finger')} of"
                f" {people}."
            ),
            f"{templates}, {file_bytes / 1e6:.2f} MB in all.",
            f"{facts['failures']} of them are failures to acquire.",
        ),
    )


def gallery_remove(
    gallery: AnyPath,
    *,
    key_file: KeyFile = None,
    person: str,
    finger: str | None = None,
    session: str | None = None,
) -> Report:
    """Remove a person or a finger, so that nothing of it remains in the file.

    Parameters
    ----------
    gallery
        File of the gallery.
    person
        Whose fingers.
    finger
        This one only.
    session
        This one only.

    Returns
    -------
    Report

    Raises
    ------
    BadInput
        If there is nothing of it, or the gallery cannot be written.

    Examples
    --------
    >>> gallery_remove("people.skg", person="Ann").facts["removed"]  # doctest: +SKIP
    4
    """
    with _opened(gallery, key_file) as opened:
        removed = opened.remove(person, finger, session)
        left = len(opened)
    facts = {"gallery": str(gallery), "removed": removed, "captures": left}
    line = f"Removed {count(removed, 'capture')} from {gallery}; {left} are left."
    if not removed:
        line = f"{gallery} holds no such capture, and what was removed earlier is erased now."
    return _reported(gallery, key_file, facts, (line,))


def gallery_export(
    gallery: AnyPath, *, key_file: KeyFile = None, out: AnyPath, person: str | None = None
) -> Report:
    """Write all of it, not encrypted, into a folder of templates and a table.

    Parameters
    ----------
    gallery
        File of the gallery.
    out
        Folder to write.
    person
        All that is kept of this person.

    Returns
    -------
    Report

    Raises
    ------
    BadInput
        If the gallery cannot be read, or `out` holds anything but an earlier export.

    Examples
    --------
    >>> gallery_export("people.skg", out="exported").facts["captures"]  # doctest: +SKIP
    68
    """
    from splitknit_match.gallery.folder import export_gallery

    facts = export_gallery(_opened(gallery, key_file), Path(out), person=person)
    line = f"Wrote {count(facts['captures'], 'template')} and gallery.csv to {facts['out']}."
    words = "they are personal data, and they are not encrypted there."
    return _reported(gallery, key_file, facts, (line,), (Finding("not-encrypted", words),))


def gallery_import(
    gallery: AnyPath, folder: AnyPath, *, key_file: KeyFile = None, replace: bool = False
) -> Report:
    """Put an exported folder into a gallery, which is made where there is none.

    Parameters
    ----------
    gallery
        File of the gallery.
    folder
        What 'splitknit gallery export' wrote.
    replace
        Let captures take the place of others.

    Returns
    -------
    Report

    Raises
    ------
    BadInput
        If the folder is no export, or a capture of the same names is there already; the gallery is
        then as before.

    Examples
    --------
    >>> gallery_import("people.skg", "exported").facts["new"]  # doctest: +SKIP
    68
    """
    from splitknit_match.gallery.folder import import_gallery

    facts = import_gallery(_opened(gallery, key_file), Path(folder), replaces=replace)
    known = facts["found"] - facts["new"]
    came = f"{facts['new']} captures came in, {known} were there already"
    return _reported(gallery, key_file, facts, (f"{came}; {facts['captures']} are in it now.",))


@checked
def serve(
    *,
    gallery: AnyPath,
    key_file: KeyFile = None,
    token_file: AnyPath | None = None,
    host: str = LOCAL[0],
    port: Annotated[int, Limits(1, 65535)] = 8321,
    certificate: AnyPath | None = None,
    certificate_key: AnyPath | None = None,
    audit: AnyPath | None = None,
) -> None:
    """Serve a gallery over HTTP: enrol, identify, verify, quality.

    Parameters
    ----------
    gallery
        File of the gallery, made with the first finger.
    token_file
        Token that clients must send (or the variable SPLITKNIT_SERVE_TOKEN).
    host
        Address to listen at; others than this machine's need `certificate`.
    port
        Port.
    certificate
        TLS: certificate chain (PEM).
    certificate_key
        TLS: its private key (PEM).
    audit
        File that gets a line for each act, without biometric data.

    Raises
    ------
    BadInput
        If a file cannot be used, or nothing can listen there.

    Examples
    --------
    >>> serve(gallery="people.skg", token_file="token")  # doctest: +SKIP
    """
    from splitknit_match.gallery.file import readable, readable_gallery
    from splitknit_match.gallery.serve import make_app, read_token

    require(
        (certificate is None) == (certificate_key is None),
        "`certificate` and `certificate_key` go together.",
    )
    cure = "give `certificate` and `certificate_key` for TLS, or a proxy's."
    require(host in LOCAL or certificate is not None, f"'{host}' is not this machine alone; {cure}")
    token = read_token(None if token_file is None else Path(token_file))
    scheme = "http" if certificate is None else "https"
    with _opened(gallery, key_file) as opened:
        if opened.there:
            opened.people()
        app = make_app(opened, token, None if audit is None else Path(audit))
        server = server_of(app, certificate, certificate_key)
        findings = readable_gallery(gallery, key_file)
        for what, file in (("token", token_file), ("key", certificate_key)):
            findings += () if file is None else readable(Path(file), what)
        for finding in findings:
            print(printable(f"Please note: {finding}"), file=sys.stderr, flush=True)
        with _listening(host, port) as door, contextlib.suppress(KeyboardInterrupt):
            words = f"Serving {gallery} at {scheme}://{host}:{port}; Ctrl-C ends it."
            print(printable(words), file=sys.stderr, flush=True)
            server.run(sockets=[door])


class _Door(socket.socket):
    """Listens; what comes while :data:`CONNECTIONS` are open is closed at once."""

    def __init__(self, listening: socket.socket) -> None:
        super().__init__(fileno=listening.detach())
        self._inside = WeakSet[socket.socket]()

    def accept(self) -> tuple[socket.socket, Any]:
        """As of any socket; ConnectionAbortedError, which asyncio expects, where there are too
        many."""
        connection, address = super().accept()
        if sum(known.fileno() >= 0 for known in self._inside) >= CONNECTIONS:
            connection.close()
            raise ConnectionAbortedError
        self._inside.add(connection)
        return connection, address


def _listening(host: str, port: int) -> socket.socket:
    """A socket that listens there. Raises BadInput if it cannot."""
    try:
        family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        return _Door(socket.create_server(address[:2], family=family))
    except (OSError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise BadInput(
            f"cannot listen at port {port} of '{host}' ({reason}); give another `port` or `host`."
        ) from error


def server_of(
    app: Any, certificate: AnyPath | None = None, certificate_key: AnyPath | None = None
) -> Any:
    """A server of an ASGI application, over TLS with a certificate chain and its private key.
    Raises BadInput if these do not fit.

    Connections on which nothing happens for 4 to 8 s are ended.
    """
    with importing("serving needs uvicorn: pip install 'splitknit-match[serve]'."):
        import uvicorn
        from uvicorn.protocols.http.h11_impl import H11Protocol

    class Impatient(H11Protocol):
        def connection_made(self, transport: Any) -> None:
            super().connection_made(transport)
            self.loop.call_later(SILENCE_S, self._look, (None, 0))

        def shutdown(self) -> None:
            cycle: Any = self.cycle
            # it has not come as a whole
            if cycle is not None and cycle.more_body and not cycle.response_complete:
                self.transport.abort()
            else:
                super().shutdown()

        def _look(self, last: tuple[Any, int]) -> None:
            if self not in self.connections:  # it has ended
                return
            cycle: Any = self.cycle
            now = (cycle, self.transport.get_write_buffer_size())
            # no work, but for an answer that the client does not fetch
            waits = cycle is None or cycle.response_complete or self.flow.write_paused
            if waits and now == last:
                self.transport.abort()  # to close it would wait for the client
            self.loop.call_later(SILENCE_S, self._look, now)

    class Server(uvicorn.Server):
        async def startup(self, sockets: list[socket.socket] | None = None) -> None:
            """Listen, as uvicorn does, which has no setting for the time of a handshake."""
            loop: Any = asyncio.get_running_loop()
            if certificate is not None:
                loop.create_server = partial(loop.create_server, ssl_handshake_timeout=SILENCE_S)
            await super().startup(sockets)

    config = uvicorn.Config(
        app,
        loop="asyncio",  # which accepts by the door
        log_level="error",
        access_log=False,
        server_header=False,
        limit_concurrency=2 * CONNECTIONS,  # of requests: some outlive their connections
        http=Impatient,
        timeout_keep_alive=5,
        timeout_graceful_shutdown=10,
        h11_max_incomplete_event_size=65_536,
        ssl_certfile=certificate,
        ssl_keyfile=certificate_key,
        ssl_keyfile_password="none",  # else OpenSSL asks at the terminal
    )
    try:
        config.load()
    except (OSError, ValueError) as error:  # OpenSSL's are OSErrors
        reason = f"'{certificate}' and '{certificate_key}' cannot be used for TLS ({error})"
        raise BadInput(
            f"{reason}; name PEM files that belong together, of a key without a passphrase."
        ) from error
    return Server(config)
