"""``splitknit capture``: photograph one finger, or the next fingers of an enrolment."""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping
from contextlib import AbstractContextManager, ExitStack, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from splitknit.arguments import (
    AnyPath,
    Natural,
    Progress,
    Report,
    Scale,
    Settings,
    checked,
    refuse_given,
    silent,
)
from splitknit.errors import require
from splitknit.settings import Limits, flatten

if TYPE_CHECKING:
    from splitknit.devices import Opened
    from splitknit.io.enrolment import PlannedCapture
    from splitknit_rig.capture.openers import Opener

    Target = str | None
else:
    Target = Annotated[
        tuple[str, ...] | None,
        Parameter(consume_multiple=(0, 1), converter=lambda _, tokens: tokens[0].value),
    ]
_WHO = Parameter(group="Who (ids only, never names)")
_MANY = Parameter(group="Many fingers")
_TWIN = Parameter(group="Twin")


@checked
def capture(
    *,
    device: Literal["pi", "twin"],
    out: AnyPath | None = None,
    rig: AnyPath | None = None,
    target: Target = None,
    led: str | None = None,
    preview: bool = False,
    seconds: Annotated[float | None, Limits(0, 600, above=True)] = None,
    keep: bool = False,
    overwrite: bool = False,
    subject: Annotated[str | None, _WHO] = None,
    finger: Annotated[str | None, _WHO] = None,
    session: Annotated[Natural | None, _WHO] = None,
    enrolment: Annotated[AnyPath | None, _MANY] = None,
    subjects: Annotated[Natural | None, _MANY] = None,
    sessions: Annotated[Natural | None, _MANY] = None,
    fingers: Annotated[str | None, _MANY] = None,
    next: Annotated[Natural | None, _MANY] = None,
    seed: Annotated[Natural | None, _TWIN] = None,
    pattern: Annotated[str | None, _TWIN] = None,
    scale: Annotated[Scale | None, _TWIN] = None,
    settings: Settings = None,
    progress: Progress = silent,
) -> Report:
    """Photograph a finger under all LEDs: with the rig, or with its twin.

    Parameters
    ----------
    device
        pi: the Raspberry Pi's rig; twin: simulated.
    out
        Capture folder to write.
    rig
        Rig file (default: the nominal rig).
    target
        Photograph a calibration target: no finger is looked for; the twin puts a card (default),
        nail, board, sphere, ball or phantom there.
    led
        Only light this LED, such as 'white 3', and photograph nothing.
    preview
        Photograph and state the sharpness again and again while the lens is turned; under `led`
        (default: the first). `out`: a picture (.png) that is kept up to date.
    seconds
        For how long (default: 5; `preview` 600).
    keep
        Write a capture even if it must be taken again.
    overwrite
        Replace an earlier capture in `out`.
    subject
        Such as S01: letters, digits, - and _.
    finger
        right_thumb ... right_little, left_thumb ...
    session
        Number of the session, from 1.
    enrolment
        Go on with the enrolment in this folder.
    subjects
        To be captured (default: 17).
    sessions
        Of every subject (default: 4).
    fingers
        All (default), or names with commas.
    next
        Fingers to take now (default: all).
    seed
        Which simulated finger (default: 0).
    pattern
        loop, whorl, arch ... (default: drawn).
    scale
        Size of the images, 1 = 3200 x 2200 (default: 0.5).

    Returns
    -------
    Report
        The facts of ``session.json`` and ``out``; of an enrolment what was captured and skipped,
        and what is next.

    Raises
    ------
    BadInput
        Naming what is at fault; ``Refused``, with the session's facts, where the finger must be
        captured again.

    Examples
    --------
    >>> capture(device="twin", out="capture", seed=1).facts["images"]  # doctest: +SKIP
    14
    """
    from splitknit.io.enrolment import fingers_named, open_enrolment
    from splitknit.io.targets import check_capture
    from splitknit.settings import override
    from splitknit_rig.capture.folder import CaptureOptions, capture_enrolment, capture_to_folder
    from splitknit_rig.capture.openers import opener_of
    from splitknit_rig.capture.session import SessionSettings

    changes = flatten(settings or {})
    if preview or led is not None:
        refuse_given(
            f"does not go with `{'preview' if preview else 'led'}`.",
            enrolment=enrolment,
            **({} if preview else {"out": out, "target": target}),
        )
        opener = opener_of(device, changes, rig, scale, target=target or "card")
        if preview:
            return _previewed(opener, led, seconds or 600.0, out)
        return _lit(opener, led, seconds or 5.0)
    refuse_given("belongs to `led` or `preview`.", seconds=seconds)
    places = (
        "name where captures go: `out` DIR for one finger, or `enrolment` DIR for many, not both."
    )
    require((out is None) != (enrolment is None), places)
    _check_who(subject, finger, session)
    if enrolment is None:
        many = {"subjects": subjects, "sessions": sessions, "fingers": fingers, "next": next}
        refuse_given("belongs to `enrolment` DIR.", **many)
    require(next is None or next >= 1, "`next` must be at least 1.")
    drawn = seed is not None or pattern is not None
    require(device == "twin" or not drawn, "`seed` and `pattern` belong to `device` twin.")
    alone = (
        "`target`, `overwrite` and `pattern` are for one capture; an enrolment draws fingers and"
        " replaces nothing."
    )
    require(enrolment is None or not (target is not None or overwrite or pattern), alone)

    if target is not None:
        target = target or "card"  # of an option without a value
        changes["capture.find_finger"] = False
    session_changes = {
        name: value for name, value in changes.items() if name.startswith("capture.")
    }
    device_changes = {name: value for name, value in changes.items() if name not in session_changes}
    asks = device == "pi" and sys.stdin.isatty()
    how = CaptureOptions(
        override(
            SessionSettings(images="tiff"),
            {name.removeprefix("capture."): value for name, value in session_changes.items()},
        ),
        material="opaque" if target is not None else "skin",
        keep=keep,
        overwrite=overwrite,
        turn=_turn if asks else None,
        ask=_ask if asks else None,
    )
    opener = opener_of(device, device_changes, rig, scale, pattern=pattern, target=target)
    if out is not None:
        who: dict[str, Any] = {"id": subject or "anonymous", "session": session or 1}
        if target is not None:
            who = {}
        elif finger is not None or device == "twin":
            who["finger"] = finger or "simulated"
        check_capture(Path(out), overwrite=overwrite)  # before any device is opened
        progress("opening the devices", 0.0)
        with opener(seed or 0, (session or 1) - 1) as devices:
            facts = capture_to_folder(devices, Path(out), how, subject=who, progress=progress)
        return Report(facts, tuple(_lines(facts, Path(out), of_finger=target is None)))

    assert enrolment is not None
    opened = open_enrolment(
        Path(enrolment), subjects=subjects, sessions=sessions, fingers=fingers_named(fingers)
    )
    waiting = opened.waiting(subject=subject, session=session, finger=finger)[:next]
    with ExitStack() as stack:
        kept = stack.enter_context(opener(0, 0)) if device == "pi" and waiting else None

        def open_devices(place: PlannedCapture) -> AbstractContextManager[Opened]:
            return (
                nullcontext(kept) if kept is not None else opener(*opened.seeds(place, seed or 0))
            )

        facts = capture_enrolment(opened, waiting, open_devices, how, progress)
    done = f"{facts['finished']} of {facts['total']} are finished in {enrolment}."
    return Report(
        facts,
        (
            f"{len(facts['captured'])} fingers captured now; {done}",
            *(f"Skipped: {name}" for name in facts["skipped"]),
            *(f"Please note: {finding['message']}" for finding in facts["findings"]),
            "All fingers are captured." if facts["next"] is None else f"Next: {facts['next']}",
        ),
    )


def _check_who(subject: str | None, finger: str | None, session: int | None) -> None:
    from splitknit.io.enrolment import FINGERS

    require(
        subject is None or re.fullmatch(r"[A-Za-z0-9_-]{1,32}", subject) is not None,
        f"'{subject}' cannot be a subject's id: use up to 32 letters, digits, - and _ (such as"
        " S01), never a name.",
    )
    require(
        finger is None or finger in FINGERS,
        f"'{finger}' is not a finger; fingers are {', '.join(FINGERS)}.",
    )
    require(session is None or session >= 1, "sessions are numbered from 1.")


def _led_of(devices: Opened, name: str | None) -> int:
    """Number of a named LED, or of the first."""
    from splitknit_rig.capture.pins import led_names

    names = led_names(devices.rig)
    require(name in (None, *names), f"the rig has no LED '{name}'; it has {', '.join(names)}.")
    return 0 if name is None else names.index(name)


def _lit(opener: Opener, name: str | None, seconds: float) -> Report:
    """Light one LED for a time."""
    with opener(0, 0) as devices:
        devices.lights.shine(_led_of(devices, name), seconds)
    return Report({"led": name, "seconds": seconds}, (f"{name} was lit for {seconds:g} s.",))


def _previewed(opener: Opener, name: str | None, seconds: float, out: AnyPath | None) -> Report:
    """Report the sharpness under one LED for a time."""
    from splitknit_rig.calibration.written import check_picture
    from splitknit_rig.capture.preview import look_again

    def show(sharpness: float, best: float) -> None:
        sys.stderr.write(f"\rsharpness {sharpness:.2f} %, best {best:.2f} % ")
        sys.stderr.flush()

    picture = None if out is None else Path(out)
    check_picture(picture)
    with opener(0, 0) as devices:
        led = _led_of(devices, name)
        count, best = look_again(devices, led, seconds, picture, show)
    facts = {"looks": count, "best_sharpness": best}
    return Report(facts, (f"{count} pictures, best sharpness {best:.2f} %.",))


def _lines(facts: Mapping[str, Any], out: Path, *, of_finger: bool) -> list[str]:
    rows, columns = facts["image_size"]
    each = f"{facts['seconds']:.1f} s ({facts['seconds_per_frame']:.2f} s a frame)"
    lines = [
        (
            f"{facts['images']} images of {columns} x {rows} pixels, with ambient frames, in"
            f" {each}, written to {out}."
        ),
    ]
    for band, exposure in facts["exposure"].items():
        if band != "white_crossed":  # as white
            lines.append(
                f"  {band}: {1e3 * exposure['exposure_s']:.1f} ms at gain {exposure['gain']:.1f},"
                f" LED {exposure['brightest_led']}, the brightest, at {100 * exposure['level']:.0f}"
                " % of full scale"
            )
    if "crossed_over_parallel" in facts:
        part = 100 * facts["crossed_over_parallel"]
        lines.append(
            f"  where the finger shines, the crossed images have {part:.0f} % of the parallel ones'"
            " light"
        )
    lines.append(f"  sharpness {facts['focus']['sharpness']:.2f} %")
    lines += [f"Please note: {finding['message']}" for finding in facts["findings"]]
    if of_finger:
        lines.append(f"Next: splitknit reconstruct {out} --out RESULT")
    return lines


def _ask(place: PlannedCapture, why: str | None) -> str:
    if why is not None:
        print(f"\nNot yet: {why}", file=sys.stderr)
    print(
        f"\n{place.words}: lay it down and press Enter (s: skip it, q: stop) ",
        end="",
        file=sys.stderr,
        flush=True,
    )
    answer = sys.stdin.readline()
    if answer == "" or answer.strip().lower().startswith("q"):
        return "stop"
    return "skip" if answer.strip().lower().startswith("s") else "go"


def _turn(position: str) -> None:
    print(
        f"\nTurn the analyser to {position}, then press Enter: ",
        end="",
        file=sys.stderr,
        flush=True,
    )
    require(
        sys.stdin.readline() != "", "the analyser was not turned: nobody answered on the terminal."
    )
