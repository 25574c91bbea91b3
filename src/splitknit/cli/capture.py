"""The command line of ``splitknit capture``."""

from __future__ import annotations

import argparse
import select
import sys
from contextlib import AbstractContextManager, ExitStack, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

from splitknit.cli.verb import Outcome, Progress, add_overwrite, add_settings, natural, new_verb, refuse_given, scale

if TYPE_CHECKING:
    from splitknit.capture.enrolment import PlannedCapture
    from splitknit.capture.exposure import Focus, FocusWatch
    from splitknit.capture.folder import CaptureOptions, Opened
    from splitknit.model import Rig
    from splitknit.rig.devices import DeviceSettings

_BAR = 30


def add_capture(verbs: Any) -> None:
    """Add the verb."""
    verb = new_verb(verbs, "capture", "photograph a finger under all LEDs: with the rig, or with its twin", _run)
    verb.add_argument(
        "--device", choices=("pi", "twin"), required=True, help="pi: the Raspberry Pi's rig; twin: simulated"
    )
    verb.add_argument("--out", type=Path, metavar="DIR", help="capture folder to write")
    verb.add_argument("--rig", type=Path, metavar="FILE", help="rig file (default: the nominal rig)")
    verb.add_argument(
        "--target",
        nargs="?",
        const="card",
        metavar="WHAT",
        help="photograph a calibration target: no finger is looked for; the twin puts a card (default), disc, nail, "
        "board or sphere there",
    )
    verb.add_argument("--keep", action="store_true", help="write a capture even if it must be taken again")
    add_overwrite(verb)
    who = verb.add_argument_group("who (ids only, never names)")
    who.add_argument("--subject", metavar="ID", help="such as S01: letters, digits, - and _")
    who.add_argument("--finger", metavar="NAME", help="right_thumb ... right_little, left_thumb ...")
    who.add_argument("--session", type=natural, metavar="K", help="number of the session, from 1")
    many = verb.add_argument_group("many fingers")
    many.add_argument("--enrolment", type=Path, metavar="DIR", help="go on with the enrolment in DIR")
    many.add_argument("--subjects", type=natural, metavar="N", help="to be captured (default: 17)")
    many.add_argument("--sessions", type=natural, metavar="N", help="of every subject (default: 4)")
    many.add_argument("--fingers", metavar="LIST", help="all (default), or names with commas")
    many.add_argument("--next", type=natural, metavar="N", help="fingers to take now (default: all)")
    twin = verb.add_argument_group("twin")
    twin.add_argument("--seed", type=natural, help="which simulated finger (default: 0)")
    twin.add_argument("--pattern", help="loop, whorl, arch ... (default: drawn)")
    twin.add_argument("--scale", type=scale, help="size of the images, 1 = 3200 x 2200 (default: 0.5)")
    add_settings(verb)


def _run(options: argparse.Namespace) -> Outcome:
    """Capture one finger, or those that an enrolment waits for."""
    from splitknit.capture.folder import CaptureOptions  # so that --help is quick
    from splitknit.cli.options import read_changes
    from splitknit.io.rig import read_rig
    from splitknit.rig.devices import read_settings

    _check(options)
    rig = None if options.rig is None else read_rig(options.rig)
    changes = read_changes(options.settings, options.assignments)
    if options.target is not None:
        changes["capture.find_finger"] = False
    settings = read_settings(options.device, changes, rig, options.scale)
    how = CaptureOptions(
        settings.capture,
        settings.used(options.device),
        material="opaque" if options.target is not None else "skin",
        keep=options.keep,
        overwrite=options.overwrite,
        watch_focus=_FocusBar() if sys.stderr.isatty() and not options.json else None,
        turn=_turn if options.device == "pi" and sys.stdin.isatty() else None,
        ask=_ask if options.device == "pi" and sys.stdin.isatty() else None,
    )
    if options.enrolment is not None:
        return _run_enrolment(options, how, settings, rig)
    return _run_one(options, how, settings, rig)


def _check(options: argparse.Namespace) -> None:
    """Refuse options that do not go together."""
    from splitknit.capture.enrolment import FINGERS, check_subject_id
    from splitknit.errors import require

    require(
        (options.out is None) != (options.enrolment is None),
        "name where captures go: --out DIR for one finger, or --enrolment DIR for many, not both.",
    )
    if options.subject is not None:
        check_subject_id(options.subject)
    require(
        options.finger is None or options.finger in FINGERS,
        f"'{options.finger}' is no finger; fingers are {', '.join(FINGERS)}.",
    )
    require(options.session is None or options.session >= 1, "sessions are numbered from 1.")
    many = ("subjects", "sessions", "fingers", "next")
    refuse_given(options, () if options.enrolment is not None else many, "belongs to --enrolment DIR.")
    require(options.next is None or options.next >= 1, "--next must be at least 1.")
    require(
        options.device == "twin" or (options.seed is None and options.pattern is None),
        "--seed and --pattern belong to --device twin.",
    )
    require(
        options.enrolment is None or not (options.target is not None or options.overwrite or options.pattern),
        "--target, --overwrite and --pattern are for one capture; an enrolment draws fingers and replaces nothing.",
    )


def _run_one(options: argparse.Namespace, how: CaptureOptions, settings: DeviceSettings, rig: Rig | None) -> Outcome:
    from splitknit.capture.folder import capture_to_folder
    from splitknit.io.targets import check_capture
    from splitknit.rig.devices import opened_pi, opened_twin

    check_capture(options.out, overwrite=options.overwrite)  # before any device is opened
    session = options.session or 1
    subject: dict[str, Any] = {"id": options.subject or "anonymous", "session": session}
    if options.target is not None:
        subject = {}
    elif options.finger is not None or options.device == "twin":
        subject["finger"] = options.finger or "simulated"
    with ExitStack() as stack:
        progress = stack.enter_context(Progress(options))
        progress.update("opening the devices", 0.0)
        devices = stack.enter_context(
            opened_pi(rig, settings)
            if options.device == "pi"
            else opened_twin(settings, options.seed or 0, session - 1, pattern=options.pattern, target=options.target)
        )
        facts = capture_to_folder(devices, options.out, how, subject=subject, progress=progress.update)
    rows, columns = facts["image_size"]
    lines = [
        f"{facts['images']} images of {columns} x {rows} pixels, with ambient frames, in {facts['seconds']:.1f} s "
        f"({facts['seconds_per_frame']:.2f} s a frame), written to {options.out}.",
        *_exposure_lines(facts),
        *(f"Please note: {note}." for note in facts["notes"]),
    ]
    if options.target is None:
        lines.append(f"Next: splitknit reconstruct {options.out} --out RESULT")
    return facts, lines


def _exposure_lines(facts: dict[str, Any]) -> list[str]:
    lines = [
        f"  {band}: {1e3 * one['exposure_s']:.1f} ms at gain {one['gain']:.1f}, LED {one['brightest_led']}, the "
        f"brightest, at {100 * one['level']:.0f} % of full scale"
        for band, one in facts["exposure"].items()
        if band != "white_crossed"  # as white
    ]
    if "crossed_over_parallel" in facts:
        part = 100 * facts["crossed_over_parallel"]
        lines.append(f"  where the finger shines, the crossed images have {part:.0f} % of the parallel ones' light")
    return [*lines, f"  sharpness {facts['focus']['sharpness']:.2f} %"]


def _run_enrolment(
    options: argparse.Namespace, how: CaptureOptions, settings: DeviceSettings, rig: Rig | None
) -> Outcome:
    from splitknit.capture.enrolment import FINGERS, open_enrolment
    from splitknit.capture.folder import capture_enrolment
    from splitknit.rig.devices import opened_pi, opened_twin

    fingers = None
    if options.fingers is not None:
        fingers = FINGERS if options.fingers == "all" else tuple(options.fingers.split(","))
    enrolment = open_enrolment(options.enrolment, subjects=options.subjects, sessions=options.sessions, fingers=fingers)
    waiting = enrolment.waiting(subject=options.subject, session=options.session, finger=options.finger)
    places = waiting[: options.next]
    with ExitStack() as stack:
        progress = stack.enter_context(Progress(options))
        if options.device == "pi" and places:
            devices = stack.enter_context(opened_pi(rig, settings))

        def open_devices(place: PlannedCapture) -> AbstractContextManager[Opened]:
            if options.device == "pi":
                return nullcontext(devices)
            seed, impression = enrolment.seeds(place, options.seed or 0)
            return opened_twin(settings, seed, impression)

        facts = capture_enrolment(enrolment, places, open_devices, how, progress.update)
    lines = [
        f"{len(facts['captured'])} fingers captured now; {facts['finished']} of {facts['total']} are finished in "
        f"{options.enrolment}.",
        *(f"Skipped: {name}" for name in facts["skipped"]),
        *(f"Please note: {note}." for note in facts["notes"]),
        "All fingers are captured." if facts["next"] is None else f"Next: {facts['next']}",
    ]
    return facts, lines


def _ask(place: PlannedCapture, why: str | None) -> str:
    """Ask for a finger on the terminal."""
    if why is not None:
        print(f"\nNot yet: {why}", file=sys.stderr)
    print(f"\n{place.words}: lay it down and press Enter (s: skip it, q: stop) ", end="", file=sys.stderr, flush=True)
    answer = sys.stdin.readline()
    if answer == "" or answer.strip().lower().startswith("q"):
        return "stop"
    return "skip" if answer.strip().lower().startswith("s") else "go"


def _turn(position: str) -> None:
    """Have the analyser turned by hand."""
    from splitknit.errors import require

    print(f"\nTurn the analyser to {position}, then press Enter: ", end="", file=sys.stderr, flush=True)
    require(sys.stdin.readline() != "", "the analyser was not turned: nobody answered on the terminal.")


class _FocusBar:
    """Shows focus live on the terminal; Enter ends it."""

    def __call__(self, focus: Focus, watch: FocusWatch) -> bool:
        fraction = min(focus.sharpness / watch.best, 1.0) if watch.best > 0 else 0.0
        full = round(_BAR * fraction)
        bar = "#" * full + "." * (_BAR - full)
        text = f"focus |{bar}| {focus.sharpness:5.2f} %, best {watch.best:5.2f} (Enter: go on)"
        sys.stderr.write(f"\r{text}")
        sys.stderr.flush()
        done = sys.stdin.isatty() and bool(select.select([sys.stdin], [], [], 0)[0])
        if done:
            sys.stdin.readline()
        if done or watch.ended:
            sys.stderr.write(f"\r{' ' * len(text)}\r")
        return done
