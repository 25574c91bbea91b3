"""``splitknit simulate``: one finger, a population of them, or what calibrates a simulated rig."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, replace
from typing import Annotated, Any, Literal

from splitknit.cli.verb import Outcome, Verb
from splitknit.errors import require
from splitknit.verbs import AnyPath, Help, Job, Natural, Overwrite, Progress, Scale, Settings, path, refuse_given

_WORKERS = 2
_OF_POPULATIONS = ("subjects", "fingers", "sessions", "workers", "prints")
_OF_CAPTURES = ("pattern", "rig", "print_file", "rolled", "motion", "condition", "mirrors", "nir")
_OF_FINGERS = (*_OF_CAPTURES, "impression")


@dataclass(frozen=True, slots=True)
class SimulateJob(Job):
    """Photograph a simulated finger, a population of them, or what calibrates a simulated rig."""

    # fmt: off
    what: Annotated[Literal["finger", "population"], Help(
        "one capture (finger, the default), or many people's fingers in several sessions", positional=True)] = "finger"
    _: KW_ONLY
    out: Annotated[AnyPath, Help("capture folder to write", "DIR")]
    overwrite: Overwrite = False
    seed: Annotated[Natural, Help("which finger, or which population")] = 0
    bench: Annotated[bool, Help(
        "not a finger, but all that calibrates the rig that person SEED built: board, disc, nail, white card")] = False
    rig: Annotated[AnyPath | None, Help("rig file that photographs the finger", "RIG")] = None
    pattern: Annotated[str | None, Help(
        "loop, whorl, arch or another master print the twin knows (default: drawn)")] = None
    print_file: Annotated[AnyPath | None, Help(
        "a real print of 500 pixels an inch, ridges dark, tip up: the finger that left it, instead of a drawn one",
        "FILE", option="--print")] = None
    rolled: Annotated[bool, Help(
        "the print was rolled from nail to nail, down to the first crease: its outline sizes the finger")] = False
    scale: Annotated[Scale | None, Help("size of the images, 1 = 3200 x 2200 pixels (default: the twin's)")] = None
    motion: Annotated[float | None, Help(
        "the finger moves by MM during the capture, as a hand does that is held still (0.5 is much)", "MM")] = None
    lights: Annotated[Literal["white", "coloured", "coloured9"], Help(
        "LEDs of the visible band: seven white ones (the default), or six or nine coloured ones, of which a red, a "
        "green and a blue one share an exposure")] = "white"
    condition: Annotated[Literal["none", "wet", "dry", "dusty", "scarred", "glossy"] | None, Help(
        "what is the matter with the finger's skin (default: none)")] = None
    severity: Annotated[float | None, Help("of the condition: 0 (nothing) to 1 (default: 1)", "S")] = None
    mirrors: Annotated[str | None, Help(
        "mirrors beside the finger, seen in the same picture: left, right, tip, or several with commas between",
        "NAMES")] = None
    nir: Annotated[bool, Help("a rig with mirrors does without NIR LEDs")] = True
    impression: Annotated[Natural, Help("which capture of the finger: pose and noise change (default: 0)")] = 0
    settings: Settings = None
    subjects: Annotated[Natural | None, Help("people (default: 17)", "N", group="population")] = None
    fingers: Annotated[str | None, Help(
        "all (default), or names with commas, such as right_index", "LIST", group="population")] = None
    sessions: Annotated[Natural | None, Help("captures a finger (default: 4)", "N", group="population")] = None
    prints: Annotated[AnyPath | None, Help(
        "real prints of 500 pixels an inch, FINGER_IMPRESSION.png, tip up, ridges dark: the ridges of a third of the "
        "fingers, one print for each; with mirror images where they are too few", "FOLDER", group="population")] = None
    workers: Annotated[Natural | None, Help(f"processes (default: {_WORKERS})", "N", group="population")] = None
    # fmt: on

    def run(self, progress: Progress) -> Outcome:
        """Simulate what is asked for."""
        if self.what == "population":
            return self._population(progress)
        refuse_given(self, _OF_POPULATIONS, "is for 'splitknit simulate population'.")
        if self.bench:
            refuse_given(self, _OF_FINGERS, "does not go with `bench`, which has no finger.")
        changes = self._changes()
        if not self.bench:
            return self._finger(changes, progress)
        together = "`bench` and `lights` do not go together: what is calibrated has white LEDs."
        require(self.lights == "white", together)
        return self._bench(changes, progress)

    def _changes(self) -> dict[str, Any]:
        """The settings that the options stand for; those of `settings` itself give way to all but mirrors."""
        changes: dict[str, Any] = dict(self.settings or {})
        if self.motion is not None:
            changes["motion.amplitude_mm"] = self.motion
        require(
            self.severity is None or self.condition not in (None, "none"),
            "`severity` sets how bad a `condition` is; name one.",
        )
        if self.condition is not None:
            changes["condition.kind"] = self.condition
        if self.severity is not None:
            changes["condition.severity"] = self.severity
        if self.mirrors is not None:
            changes.setdefault("mirrors.names", tuple(part.strip() for part in self.mirrors.split(",")))
        if not self.nir:
            require(
                self.mirrors is not None or self.rig is not None,
                "`nir` needs `mirrors`: without mirrors the shape of the finger comes from its NIR images.",
            )
            changes.setdefault("mirrors.nir", False)
        return changes

    def _finger(self, changes: Mapping[str, Any], progress: Progress) -> Outcome:
        from splitknit_simulator.twin import simulate_to_folder  # verbs import what they need

        facts = simulate_to_folder(
            path(self.out),
            seed=self.seed,
            pattern=self.pattern,
            scale=self.scale,
            rig=path(self.rig),
            lights=self.lights,
            impression=self.impression,
            print_file=path(self.print_file),
            rolled=self.rolled,
            changes=changes,
            overwrite=self.overwrite,
            progress=progress,
        )
        rows, columns = facts["image_size"]
        return facts, [
            f"Simulated capture of a {facts['pattern']} written to {self.out}: "
            f"{facts['images']} images of {columns} x {rows} pixels, with truth.",
            f"Next: splitknit reconstruct {self.out} --out RESULT"
            + (" --preset lin" if self.lights != "white" else ""),
        ]

    def _bench(self, changes: Mapping[str, Any], progress: Progress) -> Outcome:
        from splitknit.settings import override
        from splitknit_simulator.bench_photos import BenchPhotos, bench_to_folder

        out, photos = path(self.out), override(BenchPhotos(), changes)
        facts = bench_to_folder(
            out, seed=self.seed, scale=self.scale or 0.5, photos=photos, overwrite=self.overwrite, progress=progress
        )
        lines = [
            f"The bench of rig {facts['seed']} written to {out}: {facts['boards']} photographs of a board of "
            f"{facts['board']} inner corners and {facts['square_mm']:g} mm, the nail in {facts['nails']} places, a "
            "card.",
            f"Next: splitknit calibrate camera {out}/board --board {facts['board']} --plane {out}/plane.png "
            f"--rig {out}/rig_drawn.json --out rig.json",
        ]
        return facts, lines

    def _population(self, progress: Progress) -> Outcome:
        from splitknit.io.enrolment import FINGERS
        from splitknit.settings import override
        from splitknit_simulator.population.folder import simulate_population
        from splitknit_simulator.population.sessions import PopulationSettings

        refuse_given(self, (*_OF_FINGERS, "severity", "bench", "overwrite"), "does not go with a population.")
        settings = override(PopulationSettings(seed=self.seed), self.settings or {})
        settings = settings if self.scale is None else replace(settings, scale=self.scale)
        fingers = None
        if self.fingers is not None:
            fingers = FINGERS if self.fingers == "all" else tuple(self.fingers.split(","))
        facts = simulate_population(
            path(self.out),
            settings,
            subjects=self.subjects,
            sessions=self.sessions,
            fingers=fingers,
            prints=path(self.prints),
            workers=_WORKERS if self.workers is None else self.workers,
            progress=progress,
        )
        each = facts["seconds_per_capture"]
        speed = f", {each:.1f} s each" if each is not None else ""
        people = f"{facts['subjects']} subjects, {len(facts['fingers'])} fingers, {facts['sessions']} sessions"
        return facts, [
            f"{facts['simulated']} captures simulated now{speed}, {facts['found']} were there; {facts['total']} in "
            f"{self.out}: {people}.",
            *_prints_words(facts),
            f"{facts['table']} lists them with what was drawn.",
        ]


def _prints_words(facts: Mapping[str, Any]) -> list[str]:
    if not facts["prints"]:
        return []
    fingers = facts["subjects"] * len(facts["fingers"])
    mirrored = f", {facts['prints_mirrored']} of them mirrored" if facts["prints_mirrored"] else ""
    return [f"{facts['prints']} of {fingers} fingers have the ridges of a real print{mirrored}."]


SIMULATE = Verb(SimulateJob)
