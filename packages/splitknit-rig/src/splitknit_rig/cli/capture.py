"""``splitknit capture``: photograph one finger, or those that an enrolment waits for."""

from __future__ import annotations

import select
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import KW_ONLY, dataclass
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, Literal

from splitknit.cli.verb import Outcome, Verb, wants_json
from splitknit.errors import require
from splitknit.settings import flatten
from splitknit.verbs import AnyPath, Help, Job, Natural, Overwrite, Progress, Scale, Settings, path, refuse_given

if TYPE_CHECKING:
    from splitknit.devices import Opened
    from splitknit.io.enrolment import PlannedCapture
    from splitknit_rig.capture.exposure import Focus, FocusWatch
    from splitknit_rig.capture.folder import CaptureOptions

Opener = Callable[[int, int], AbstractContextManager["Opened"]]
"""Opens the devices, by the twin's seed and impression."""
_BAR = 30
_WHO, _MANY = "who (ids only, never names)", "many fingers"


@dataclass(frozen=True, slots=True)
class CaptureJob(Job):
    """Photograph a finger under all LEDs: with the rig, or with its twin.

    Returns
    -------
    dict
        The facts of ``session.json`` and ``out``; of an enrolment what was captured and skipped, and what is next.

    Raises
    ------
    BadInput
        Naming what is at fault; ``Refused``, with the session's facts, where the finger must be captured again.
    """

    # fmt: off
    _: KW_ONLY
    device: Annotated[Literal["pi", "twin"], Help("pi: the Raspberry Pi's rig; twin: simulated")]
    out: Annotated[AnyPath | None, Help("capture folder to write", "DIR")] = None
    rig: Annotated[AnyPath | None, Help("rig file (default: the nominal rig)", "FILE")] = None
    target: Annotated[str | None, Help(
        "photograph a calibration target: no finger is looked for; the twin puts a card (default), nail, board "
        "or sphere there", "WHAT", alone="card")] = None
    keep: Annotated[bool, Help("write a capture even if it must be taken again")] = False
    overwrite: Overwrite = False
    subject: Annotated[str | None, Help("such as S01: letters, digits, - and _", "ID", group=_WHO)] = None
    finger: Annotated[str | None, Help("right_thumb ... right_little, left_thumb ...", "NAME", group=_WHO)] = None
    session: Annotated[Natural | None, Help("number of the session, from 1", "K", group=_WHO)] = None
    enrolment: Annotated[AnyPath | None, Help("go on with the enrolment in DIR", "DIR", group=_MANY)] = None
    subjects: Annotated[Natural | None, Help("to be captured (default: 17)", "N", group=_MANY)] = None
    sessions: Annotated[Natural | None, Help("of every subject (default: 4)", "N", group=_MANY)] = None
    fingers: Annotated[str | None, Help("all (default), or names with commas", "LIST", group=_MANY)] = None
    next: Annotated[Natural | None, Help("fingers to take now (default: all)", "N", group=_MANY)] = None
    seed: Annotated[Natural | None, Help("which simulated finger (default: 0)", group="twin")] = None
    pattern: Annotated[str | None, Help("loop, whorl, arch ... (default: drawn)", group="twin")] = None
    scale: Annotated[Scale | None, Help("size of the images, 1 = 3200 x 2200 (default: 0.5)", group="twin")] = None
    settings: Settings = None
    # fmt: on

    def run(self, progress: Progress) -> dict[str, Any]:
        """Capture one finger, or those that an enrolment waits for."""
        from splitknit.settings import override
        from splitknit_rig.capture.folder import CaptureOptions  # so that --help is quick
        from splitknit_rig.capture.session import SessionSettings

        self._check()
        changes = flatten(self.settings or {})
        if self.target is not None:
            changes["capture.find_finger"] = False
        own = {name: value for name, value in changes.items() if name.startswith("capture.")}
        others = {name: value for name, value in changes.items() if name not in own}
        asks = self.device == "pi" and sys.stdin.isatty()
        how = CaptureOptions(
            override(SessionSettings(), {name.removeprefix("capture."): value for name, value in own.items()}),
            material="opaque" if self.target is not None else "skin",
            keep=self.keep,
            overwrite=self.overwrite,
            watch_focus=_FocusBar() if sys.stderr.isatty() and not wants_json() else None,
            turn=_turn if asks else None,
            ask=_ask if asks else None,
        )
        opener = self._pi(others) if self.device == "pi" else self._twin(others)
        return (self._one if self.enrolment is None else self._enrolled)(how, opener, progress)

    def _pi(self, changes: dict[str, Any]) -> Opener:
        """What opens the Raspberry Pi's devices."""
        from splitknit import read_rig
        from splitknit.settings import override
        from splitknit_rig.capture.pi import PiCameraSettings, opened_pi

        strays = [name for name in changes if not name.startswith("pi.")]
        require(
            not strays and self.scale is None,
            f"'{strays[0] if strays else 'scale'}' is a setting of the twin; with `device` pi leave it out, or use "
            "names that begin with capture. or pi.",
        )
        rig = None if self.rig is None else read_rig(self.rig)
        settings = override(PiCameraSettings(), {name.removeprefix("pi."): value for name, value in changes.items()})
        return lambda seed, impression: opened_pi(rig, settings)

    def _twin(self, changes: dict[str, Any]) -> Opener:
        """What opens the twin's devices, which the simulator's member brings."""
        from splitknit import read_rig
        from splitknit.registry import DEVICES, SIMULATOR, extension

        rig = None if self.rig is None else read_rig(self.rig)
        twin = extension(DEVICES, "twin", "the rig's twin", SIMULATOR)(changes, rig, self.scale)
        return partial(twin.opened, pattern=self.pattern, target=self.target)

    def _check(self) -> None:
        from splitknit.io.enrolment import FINGERS, check_subject_id

        require(
            (self.out is None) != (self.enrolment is None),
            "name where captures go: `out` DIR for one finger, or `enrolment` DIR for many, not both.",
        )
        if self.subject is not None:
            check_subject_id(self.subject)
        words = f"'{self.finger}' is not a finger; fingers are {', '.join(FINGERS)}."
        require(self.finger is None or self.finger in FINGERS, words)
        require(self.session is None or self.session >= 1, "sessions are numbered from 1.")
        if self.enrolment is None:
            refuse_given(self, ("subjects", "sessions", "fingers", "next"), "belongs to `enrolment` DIR.")
        require(self.next is None or self.next >= 1, "`next` must be at least 1.")
        drawn = self.seed is not None or self.pattern is not None
        require(self.device == "twin" or not drawn, "`seed` and `pattern` belong to `device` twin.")
        require(
            self.enrolment is None or not (self.target is not None or self.overwrite or self.pattern),
            "`target`, `overwrite` and `pattern` are for one capture; an enrolment draws fingers and replaces nothing.",
        )

    def _one(self, how: CaptureOptions, opener: Opener, progress: Progress) -> dict[str, Any]:
        from splitknit.io.targets import check_capture
        from splitknit_rig.capture.folder import capture_to_folder

        assert self.out is not None
        out = path(self.out)
        check_capture(out, overwrite=self.overwrite)  # before any device is opened
        session = self.session or 1
        subject: dict[str, Any] = {"id": self.subject or "anonymous", "session": session}
        if self.target is not None:
            subject = {}
        elif self.finger is not None or self.device == "twin":
            subject["finger"] = self.finger or "simulated"
        progress("opening the devices", 0.0)
        with opener(self.seed or 0, session - 1) as devices:
            return capture_to_folder(devices, out, how, subject=subject, progress=progress)

    def _enrolled(self, how: CaptureOptions, opener: Opener, progress: Progress) -> dict[str, Any]:
        from splitknit.io.enrolment import FINGERS, open_enrolment
        from splitknit_rig.capture.folder import capture_enrolment

        assert self.enrolment is not None
        fingers = None
        if self.fingers is not None:
            fingers = FINGERS if self.fingers == "all" else tuple(self.fingers.split(","))
        folder = path(self.enrolment)
        enrolment = open_enrolment(folder, subjects=self.subjects, sessions=self.sessions, fingers=fingers)
        places = enrolment.waiting(subject=self.subject, session=self.session, finger=self.finger)[: self.next]
        with ExitStack() as stack:
            kept = stack.enter_context(opener(0, 0)) if self.device == "pi" and places else None

            def open_devices(place: PlannedCapture) -> AbstractContextManager[Opened]:
                return nullcontext(kept) if kept is not None else opener(*enrolment.seeds(place, self.seed or 0))

            return capture_enrolment(enrolment, places, open_devices, how, progress)


def _show(facts: dict[str, Any], job: CaptureJob) -> Outcome:
    notes = [f"Please note: {note}." for note in facts["notes"]]
    if job.enrolment is not None:
        return facts, [
            f"{len(facts['captured'])} fingers captured now; {facts['finished']} of {facts['total']} are finished in "
            f"{job.enrolment}.",
            *(f"Skipped: {name}" for name in facts["skipped"]),
            *notes,
            "All fingers are captured." if facts["next"] is None else f"Next: {facts['next']}",
        ]
    rows, columns = facts["image_size"]
    lines = [
        f"{facts['images']} images of {columns} x {rows} pixels, with ambient frames, in {facts['seconds']:.1f} s "
        f"({facts['seconds_per_frame']:.2f} s a frame), written to {job.out}.",
        *_exposure_lines(facts),
        *notes,
    ]
    if job.target is None:
        lines.append(f"Next: splitknit reconstruct {job.out} --out RESULT")
    return facts, lines


CAPTURE = Verb(CaptureJob, _show)


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


def _ask(place: PlannedCapture, why: str | None) -> str:
    if why is not None:
        print(f"\nNot yet: {why}", file=sys.stderr)
    print(f"\n{place.words}: lay it down and press Enter (s: skip it, q: stop) ", end="", file=sys.stderr, flush=True)
    answer = sys.stdin.readline()
    if answer == "" or answer.strip().lower().startswith("q"):
        return "stop"
    return "skip" if answer.strip().lower().startswith("s") else "go"


def _turn(position: str) -> None:
    print(f"\nTurn the analyser to {position}, then press Enter: ", end="", file=sys.stderr, flush=True)
    require(sys.stdin.readline() != "", "the analyser was not turned: nobody answered on the terminal.")


class _FocusBar:
    """Shows focus live on the terminal; Enter ends it."""

    def __call__(self, focus: Focus, watch: FocusWatch) -> bool:
        full = round(_BAR * min(focus.sharpness / watch.best, 1.0)) if watch.best > 0 else 0
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
