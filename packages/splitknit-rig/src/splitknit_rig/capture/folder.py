"""A capture session on the devices, and a capture folder if its verdict is good. ``session.json``
in it holds exposure, focus, the checks of every shot, times and settings.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from splitknit import BadInput, write_capture
from splitknit.devices import Opened, Turn
from splitknit.errors import Refused
from splitknit.io.atomic import atomic_folder
from splitknit.io.enrolment import Enrolment, PlannedCapture
from splitknit.io.provenance import json_text, provenance
from splitknit.io.targets import check_capture
from splitknit.model import Progress
from splitknit_rig.capture.session import Session, SessionSettings, run_session

MARKER = "session.json"
Ask = Callable[[PlannedCapture, str | None], str]
"""Asks for a finger, with the reason if it is asked for again; answers ``go``, ``skip`` or
``stop``."""


@dataclass(frozen=True, slots=True)
class CaptureOptions:
    """Options for taking and keeping captures."""

    settings: SessionSettings
    material: str = "skin"
    keep: bool = False  # write a capture although it must be taken again
    overwrite: bool = False  # replace an earlier capture
    # has the analyser turned by hand, where the devices do not turn it; None: nobody is there
    turn: Turn | None = None
    # enrolment: asks for each finger, and again after a verdict; None: stops at the first verdict
    ask: Ask | None = None


def capture_to_folder(
    devices: Opened,
    out: Path,
    options: CaptureOptions,
    *,
    subject: Mapping[str, Any],
    progress: Progress,
) -> dict[str, Any]:
    """Capture a finger into the folder `out`; return the facts of ``session.json`` and more. Raises
    BadInput with the verdict if the finger must be captured again; nothing is then written, except
    with `options.keep`.
    """
    check_capture(out, overwrite=options.overwrite)
    with atomic_folder(out, overwrite=options.overwrite) as target:
        session = run_session(
            devices,
            options.settings,
            turn=devices.turn or options.turn,
            progress=lambda stage, fraction: progress(stage, 0.8 * fraction),
        )
        verdict = "; ".join(session.verdict)
        facts = {**_facts(devices, session, options), "subject": dict(subject)}
        if verdict and not options.keep:
            raise Refused(f"{verdict}.", facts)
        progress("writing", 0.8)
        capture = replace(
            session.capture(devices.rig, material=options.material), subject=dict(subject)
        )
        if devices.name == "pi":
            capture = replace(capture, captured_at=datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"))
        images = options.settings.images
        write_capture(capture, target, devices.truth, overwrite=True, images=images)
        (target / MARKER).write_text(json_text(facts), encoding="utf-8")
    if verdict:
        raise Refused(f"{verdict} (kept in '{out}' because of `keep`).", {**facts, "out": str(out)})
    progress("done", 1.0)
    return {**facts, "out": str(out)}


def _facts(devices: Opened, session: Session, options: CaptureOptions) -> dict[str, Any]:
    used = {"device": devices.name, "capture": options.settings, **devices.settings}
    return {
        "format": "splitknit-session",
        **provenance(used),
        "device": devices.name,
        "image_size": list(devices.rig.camera.image_size),
        "bands": {name: len(band.leds) for name, band in session.bands.items()},
        "images": sum(shot.led is not None for shot in session.shots),
        "exposure": {
            band: {
                "exposure_s": e.exposure_s,
                "gain": e.gain,
                "brightest_led": e.brightest,
                "level": e.level,
            }
            for band, e in session.exposures.items()
        },
        "focus": asdict(session.focus),
        **(
            {}
            if session.crossed_over_parallel is None
            else {"crossed_over_parallel": session.crossed_over_parallel}
        ),
        "shots": [asdict(shot) for shot in session.shots],
        "frames_taken": session.frames_taken,
        "seconds": session.seconds,
        "seconds_per_frame": session.seconds / (len(session.shots) - 1),
        "verdict": list(session.verdict),
        "findings": [finding.facts for finding in devices.findings],
    }


def capture_enrolment(
    enrolment: Enrolment,
    places: list[PlannedCapture],
    open_devices: Callable[[PlannedCapture], AbstractContextManager[Opened]],
    options: CaptureOptions,
    progress: Progress,
) -> dict[str, Any]:
    """Capture the next fingers `places` of an enrolment, opening the devices for each; return what
    was captured and skipped, how many are finished, and what is next. BadInput names finger and
    verdict; finished fingers are kept.
    """
    captured: list[str] = []
    skipped: list[str] = []
    findings: list[dict[str, Any]] = []
    for k, place in enumerate(places):

        def report(stage: str, fraction: float, k: int = k, place: PlannedCapture = place) -> None:
            progress(f"{place.subject} {place.finger}", (k + fraction) / len(places))

        answer, facts = _one_finger(enrolment, place, open_devices, options, report)
        if answer == "stop":
            break
        if facts is None:
            skipped.append(place.folder)
        else:
            captured.append(place.folder)
            findings += [each for each in facts["findings"] if each not in findings]
    waiting = enrolment.waiting()
    return {
        "enrolment": str(enrolment.folder),
        "captured": captured,
        "skipped": skipped,
        "finished": enrolment.plan.total - len(waiting),
        "total": enrolment.plan.total,
        "next": waiting[0].folder if waiting else None,
        "findings": findings,
    }


def _one_finger(
    enrolment: Enrolment,
    place: PlannedCapture,
    open_devices: Callable[[PlannedCapture], AbstractContextManager[Opened]],
    options: CaptureOptions,
    progress: Progress,
) -> tuple[str, dict[str, Any] | None]:
    """Answer and facts of one finger, which is asked for until it is good, skipped or stopped."""
    ask, why = options.ask, None
    while True:
        answer = "go" if ask is None else ask(place, why)
        if answer != "go":
            return answer, None
        subject = {"id": place.subject, "finger": place.finger, "session": place.session}
        try:
            with open_devices(place) as devices:
                facts = capture_to_folder(
                    devices, enrolment.path(place), options, subject=subject, progress=progress
                )
            return "go", facts
        except BadInput as error:
            if ask is None:
                message = f"{place.words}: {error}"
                raise (
                    Refused(message, error.facts)
                    if isinstance(error, Refused)
                    else BadInput(message)
                ) from error
            why = str(error)
