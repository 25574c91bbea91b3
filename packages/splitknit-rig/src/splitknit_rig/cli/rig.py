"""``splitknit rig``: the printed target, the study of dimensions, the LED board and the parts of a rig."""

from __future__ import annotations

import time
from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal

from splitknit import AnyPath, Help, Job, Natural, Outcome, Progress, Settings, Verb, path, refusing, require

if TYPE_CHECKING:
    from splitknit_rig.rig.circuit import CircuitSettings
    from splitknit_rig.rig.optimise import Study

_SHEET = "target.pdf"
_AXES = "rigs to compare: numbers with commas between them, every combination is tried"
_STUDY = "how they are compared"
_SHOWN = 10  # rigs of a sweep that are listed
_BUDGETS: dict[str, dict[str, Any]] = {
    "quick": {
        "heights_mm": (100.0, 140.0, 180.0),
        "radii_mm": (35.0, 52.5, 70.0),
        "powers_w": (1.0,),
        "resolutions": (8.0,),
        "fingers": 2,
    },
    "full": {
        "heights_mm": (100.0, 120.0, 140.0, 170.0, 200.0),
        "radii_mm": (35.0, 45.0, 52.5, 65.0, 80.0, 100.0),
        "powers_w": (0.1, 0.4, 1.0, 2.0),
        "resolutions": (10.0,),
        "fingers": 4,
    },
}
_SIDE_AXES = {"side": (0,), "side_radii_mm": (90.0,), "side_heights_mm": (30.0,)}
_Out = Annotated[AnyPath, Help("folder to write", "DIR")]
_Films = Annotated[Literal["servo", "hand", "neighbours"] | None, Help(
    "polarising films: an analyser that a servo or a hand turns, or crossed film on further white LEDs beside the "
    "first ones (default: as the rig file has it, else none)")]  # fmt: skip
_Side = Annotated[Natural, Help(
    "further white LEDs at the side, 90 mm from the axis and 30 mm over the finger plane: 7, or 2 to 6",
    "N")]  # fmt: skip


@dataclass(frozen=True, slots=True)
class PhantomJob(Job):
    """Write a finger with ridges of known height for a resin printer (STL).

    Returns
    -------
    dict
        The facts of ``phantom.json``, and ``out``.
    """

    _: KW_ONLY
    out: _Out

    def run(self, progress: Progress) -> dict[str, Any]:
        """Write it."""
        from splitknit_rig.rig.phantom import phantom_to_folder  # verbs import what they need

        return {"out": str(self.out), **phantom_to_folder(path(self.out))}


def _show_phantom(facts: dict[str, Any], job: PhantomJob) -> Outcome:
    size = " x ".join(f"{side:.1f}" for side in facts["size_mm"])
    return facts, [
        f"{path(job.out) / 'phantom.stl'}: {size} mm, {len(facts['fields'])} fields of ridges, {facts['triangles']} "
        f"triangles, closed; its heights as drawn are B of 'splitknit compare A {job.out} --out R'."
    ]


@dataclass(frozen=True, slots=True)
class TargetJob(Job):
    """Write checkerboards and the calibration disc as a PDF at true scale.

    Returns
    -------
    dict, list of str
        Sizes and counts, and the same in lines.
    """

    # fmt: off
    _: KW_ONLY
    out: Annotated[AnyPath, Help("folder to write, for target.pdf; or a PDF file", "DIR")]
    board: Annotated[str, Help("inner corners each way", "CxR")] = "9x6"
    square_mm: Annotated[float, Help("side of a square", "N")] = 3.0
    dot_mm: Annotated[float, Help("spacing of the disc's dots", "N")] = 10.0
    # fmt: on

    def run(self, progress: Progress) -> Outcome:
        """Draw and write it."""
        from splitknit import atomic_folder, check_file, check_target, write_file
        from splitknit_rig.calibration.targets import Board
        from splitknit_rig.rig.target import DOT_MM, PRODUCER, RULER_MM, TargetSettings, dots_mm, target_pdf

        out = path(self.out)
        as_file = out.suffix.lower() == ".pdf"
        sheet = out if as_file else out / _SHEET
        if as_file:
            check_file(sheet, "a sheet of targets", lambda data: data.startswith(b"%PDF") and PRODUCER in data)
        else:
            check_target(out, _SHEET, "an earlier sheet of targets")
        board = Board.named(self.board, self.square_mm)
        settings = TargetSettings(board.columns, board.rows, self.square_mm, self.dot_mm)
        data = target_pdf(settings)
        if as_file:
            write_file(out, data)
        else:
            with atomic_folder(out) as folder:
                (folder / _SHEET).write_bytes(data)
        across, down = settings.copies
        width, height = settings.board_mm
        facts = {
            "out": str(out),
            "board": {"inner_corners": [board.columns, board.rows], "square_mm": self.square_mm},
            "board_mm": [width, height],
            "copies": across * down,
            "disc": {"dots": len(dots_mm(settings)), "dot_mm": DOT_MM, "spacing_mm": settings.spacing_mm},
            "ruler_mm": RULER_MM,
        }
        lines = [
            f"{sheet}: {across * down} checkerboards of {width:g} x {height:g} mm (`board` {board.columns}x{board.rows}"
            f": inner corners, where four squares meet; {board.columns + 1} x {board.rows + 1} squares), and the disc "
            f"with {len(dots_mm(settings))} dots, on one sheet of A4.",
            f"Print it at 100 %; the ruler must measure {RULER_MM:g} mm.",
        ]
        return facts, lines


@dataclass(frozen=True, slots=True)
class OptimiseJob(Job):
    """Sweep the rig's dimensions on simulated fingers and find the best.

    Returns
    -------
    dict, list of str
        ``best``, ``as_good``, ``pareto``, ``counts`` and more of ``results.json``, and the same in lines.
    """

    # fmt: off
    _: KW_ONLY
    out: Annotated[AnyPath, Help("folder to write; a sweep left in it goes on", "DIR")]
    budget: Annotated[Literal["quick", "full"], Help("what is swept where no list is given")] = "quick"
    heights_mm: Annotated[str | None, Help("of camera and LEDs above the finger plane", "LIST", group=_AXES)] = None
    radii_mm: Annotated[str | None, Help("of the circle of LEDs", "LIST", group=_AXES)] = None
    powers_w: Annotated[str | None, Help("electrical power of one LED", "LIST", group=_AXES)] = None
    tilts_deg: Annotated[str | None, Help(
        "of the beams from the vertical to the axis, or 'centre' (the default)", "LIST", group=_AXES)] = None
    resolutions: Annotated[str | None, Help(
        "of the camera, pixels per mm on the finger, 3 to 75.7", "LIST", group=_AXES)] = None
    side: Annotated[str | None, Help("number of side lights", "LIST", group=_AXES)] = None
    side_radii_mm: Annotated[str | None, Help("of the side lights from the axis", "LIST", group=_AXES)] = None
    side_heights_mm: Annotated[str | None, Help("of the side lights", "LIST", group=_AXES)] = None
    fingers: Annotated[Natural | None, Help("simulated fingers a rig", "N", group=_STUDY)] = None
    method: Annotated[Literal["ea", "metric"], Help("of reconstruction", group=_STUDY)] = "ea"
    view: Annotated[Literal["perspective", "orthographic"], Help("of the camera", group=_STUDY)] = "perspective"
    objective: Annotated[Literal["rms", "ridges", "normals", "slopes"], Help(
        "error that is minimised: of the surface (rms, the default), of the ridges, of the normals; or of slopes from "
        "mirror reflections behind films, by their information instead of fingers", group=_STUDY)] = "rms"
    f_number: Annotated[float | None, Help("of the lens (default: 4)", "N", group=_STUDY)] = None
    half_angle_deg: Annotated[float | None, Help("of the LEDs' beams (default: 30)", "N", group=_STUDY)] = None
    led_drop_mm: Annotated[float | None, Help("LEDs below the lens (default: 0)", "N", group=_STUDY)] = None
    workers: Annotated[Natural, Help("processes", "N")] = 2
    # fmt: on

    def run(self, progress: Progress) -> Outcome:
        """Sweep, write, and report what came out."""
        from splitknit import json_text, plain_json, write_file
        from splitknit_rig.rig.candidates import grid
        from splitknit_rig.rig.optimise import OBJECTIVES, results_csv, summarise, sweep_rigs

        started, out = time.perf_counter(), path(self.out)
        axes = ("heights_mm", "radii_mm", "powers_w", "tilts_deg", "resolutions", *_SIDE_AXES)
        candidates, study = grid(*map(self._numbers, axes)), self._study()
        records = sweep_rigs(out, candidates, study, workers=self.workers, progress=progress)
        summary = summarise(records, OBJECTIVES[self.objective])
        compared = summary.pop("compared")
        best = next(one for one in records if one["candidate"]["name"] == summary["best"])
        found = {**best["candidate"], **best["mean"], **compared[summary["best"]]}
        facts = {**summary, "objective": self.objective, "best": found}
        document = {"format": "splitknit-rig-results", "version": 2, "study": plain_json(study), **facts}
        write_file(out / "results.csv", results_csv(records, compared, summary["pareto"]))
        document |= {"compared": compared, "records": records}
        write_file(out / "results.json", json_text(document).encode("ascii"))
        counts = summary["counts"]
        seconds = time.perf_counter() - started
        lines = [
            f"{len(records)} rigs in {seconds:.0f} s: {counts['done']} measured, {counts['refused']} refused by a "
            f"constraint, {counts['failed']} failed. Error {summary['figure']}, smallest first; x: on the Pareto front "
            "of error, power and size.",
            "  height  radius  power     beams  px/mm    error",
        ]
        done = {one["candidate"]["name"]: one["candidate"] for one in records if one["mean"] is not None}
        for name in sorted(done, key=lambda name: (compared[name]["value"], name))[:_SHOWN]:
            one, error = done[name], compared[name]["value"]
            tilt = "at centre" if one["tilt_deg"] is None else f"{one['tilt_deg']:g} deg"
            size = f"{one['height_mm']:3g} mm {one['radius_mm']:4g} mm {one['power_w']:4g} W {tilt:>9}"
            pareto = " x" if name in summary["pareto"] else ""
            side = "  {side} side lights, {side_radius_mm:g} / {side_height_mm:g} mm" if one.get("side") else ""
            lines.append(f"  {size} {one['px_per_mm']:6g} {error:8.3g}{pareto}{side.format(**one)}")
        if study.fingers > 1:
            lines.append(f"{len(summary['as_good'])} of {counts['done']} rigs are indistinguishable from the best.")
        lines += [f"{number} left out: {words}" for words, number in list(summary["reasons"].items())[:3]]
        lines.append(f"All figures: {out / 'results.csv'}; finger by finger: {out / 'results.json'}.")
        return {**facts, "out": str(out), "files": ["results.csv", "results.json"], "total_s": seconds}, lines

    def _study(self) -> Study:
        from splitknit_rig.rig.candidates import BuildSettings, PhotonSettings
        from splitknit_rig.rig.optimise import Study

        fingers = _BUDGETS[self.budget]["fingers"] if self.fingers is None else self.fingers
        build = BuildSettings(view=self.view, **self._given("half_angle_deg", "led_drop_mm"))
        photons = PhotonSettings(**self._given("f_number"))
        if self.objective == "slopes":
            require(self.fingers is None, "`objective` slopes draws no fingers; leave `fingers` out.")
            return Study("information", 1, build, photons)
        return Study(self.method, fingers, build, photons)

    def _given(self, *names: str) -> dict[str, Any]:
        return {name: getattr(self, name) for name in names if getattr(self, name) is not None}

    def _numbers(self, name: str) -> tuple[Any, ...]:
        """Numbers with commas between them; ``centre``, of beams, is None."""
        text = getattr(self, name)
        if text is None:
            return tuple(_BUDGETS[self.budget].get(name, _SIDE_AXES.get(name, (None,))))
        words = [word.strip() for word in text.split(",") if word.strip()]
        require(len(words) > 0, f"`{name}` is empty; list numbers with commas between them, as `{name}` 100,140.")
        values: list[float | None] = []
        for word in words:
            with refusing(f"`{name}` must list numbers with commas between them, but it holds '{word}'."):
                number = int if name == "side" else float
                values.append(None if name == "tilts_deg" and word == "centre" else number(word))
        return tuple(values)


@dataclass(frozen=True, slots=True)
class CircuitJob(Job):
    """Design the LED board: layout, Gerbers, schematic, parts, pin map, light on eye and skin.

    Returns
    -------
    dict, list of str
        The facts of ``circuit.json``, and the same in lines.
    """

    # fmt: off
    _: KW_ONLY
    out: _Out
    rig: Annotated[AnyPath | None, Help("rig file (default: the thesis's 14 LEDs)", "RIG")] = None
    films: _Films = None
    side: _Side = 0
    topology: Annotated[Literal["sink", "switch"] | None, Help(
        "sink: the current does not depend on supply and LED (the default); switch: the thesis's stage")] = None
    supply_v: Annotated[float | None, Help("voltage of the LEDs' supply (default: 9)")] = None
    settings: Settings = None
    # fmt: on

    def run(self, progress: Progress) -> Outcome:
        """Design the board and write it."""
        from splitknit import default_rig, flatten, override, read_rig
        from splitknit_rig.rig.circuit import CircuitSettings
        from splitknit_rig.rig.circuit_files import circuit_to_folder
        from splitknit_rig.rig.films import with_films, with_side_lights

        given = {"topology": self.topology, "supply_v": self.supply_v}
        # ``circuit.supply_v`` and ``supply_v`` are the same setting
        changes = {name.removeprefix("circuit."): value for name, value in flatten(self.settings or {}).items()}
        named = {name: value for name, value in given.items() if value is not None}
        settings = override(CircuitSettings(), {**named, **changes})
        rig = with_side_lights(with_films(read_rig(self.rig) if self.rig else default_rig(), self.films), self.side)
        facts = circuit_to_folder(path(self.out), rig, settings)
        return facts, _circuit_lines(facts, settings)


def _circuit_lines(facts: dict[str, Any], settings: CircuitSettings) -> list[str]:
    boards = "LED board" if all("board" not in led for led in facts["leds"]) else "Two LED boards"
    lines = [f"{boards} of {len(facts['leds'])} stages ({settings.topology}, {settings.supply_v:g} V):"]
    for band, stage in facts["stages"].items():
        low, middle, high = stage["current_ma"]
        values = ", ".join(f"{role} {r['ohm']:g} ohm {r['rating_w']:g} W" for role, r in stage["resistors"].items())
        lines.append(f"  {band:5s} {middle:.0f} mA ({low:.0f} to {high:.0f} over all tolerances): {values}")
    lines.append(f"  fuse {facts['fuse_ma']} mA, for one LED at a time")
    board = facts["board"]
    if "misfit" in board:
        laid_out = f"  the LED board is left out: {board['misfit']}; lay out your own with the values of circuit.json"
    else:
        laid_out = "  laid out on {:g} x {:g} mm with two layers; not yet made".format(*board["size_mm"])
    light = "Light on eye and skin, all LEDs on, against the exempt group of IEC 62471 (calculated, no certificate):"
    lines += [laid_out, light]
    for hazard in facts["safety"]:
        lines.append(
            f"  {hazard['leds']:5s} {hazard['hazard']:26s} {hazard['value']:9.4g} of {hazard['limit']:.4g} "
            f"{hazard['unit']}, margin {hazard['margin']:.3g} ({hazard['margin_with_a_shorted_transistor']:.3g} with a "
            "shorted transistor"
            + (f", {hazard['margin_without_films']:.3g} without films)" if "films" in facts else ")")
        )
    lines.append(f"Written to {facts['out']}: {', '.join(facts['files'])}; rig.json holds the pin map.")
    return lines


@dataclass(frozen=True, slots=True)
class CadJob(Job):
    """Draw the parts of a rig for a 3D printer: STL, STEP, pictures, checks.

    Returns
    -------
    dict
        The facts of ``parts.json``, and ``out``.
    """

    # fmt: off
    _: KW_ONLY
    out: _Out
    rig: Annotated[AnyPath | None, Help("rig file (default: the thesis's rig, 14 cm, 14 LEDs)", "FILE")] = None
    films: _Films = None
    side: _Side = 0
    below: Annotated[bool, Help("put the assembly together with the camera below the finger")] = False
    pictures: Annotated[bool, Help("leave the pictures out")] = True
    settings: Settings = None
    # fmt: on

    def run(self, progress: Progress) -> dict[str, Any]:
        """Draw, check and write the parts."""
        from splitknit_rig.rig.cad import cad_to_folder

        how: dict[str, Any] = {name: getattr(self, name) for name in ("below", "films", "side", "pictures")}
        rig = path(self.rig)
        return cad_to_folder(path(self.out), rig_file=rig, changes=self.settings, progress=progress, **how)


def _show_parts(facts: dict[str, Any], job: CadJob) -> Outcome:
    parts, dimensions = facts["parts"], facts["dimensions"]
    needed = sum(part["mass_g"] * part["quantity"] for part in parts.values() if part["needed"])
    tilts = sorted({led["tilt_deg"] for led in dimensions["leds"]})
    tilt = f"{tilts[0]:.1f} deg" if tilts[-1] - tilts[0] < 0.1 else f"{tilts[0]:.1f} to {tilts[-1]:.1f} deg"
    lines = [
        f"{len(parts)} parts drawn, all closed; the rig stands {dimensions['total_height_mm']:.0f} mm high, its "
        f"{len(dimensions['leds'])} LED holes are tilted by {tilt}, the nail is {dimensions['nail']['height_mm']:g} mm "
        f"high.",
        f"What the rig needs weighs {needed:.0f} g in solid PLA, less with infill.",
    ]
    for name, part in parts.items():
        size = " x ".join(f"{value:.0f}" for value in part["size_mm"])
        checks = part["checks"]
        lines.append(
            f"  {name:22s} {size} mm, {part['mass_g']:.0f} g, thinnest wall {checks['wall']['smallest_mm']:.1f} mm, "
            f"longest bridge {checks['overhang']['bridge_mm']:.1f} mm"
        )
        lines += [f"    {finding}" for finding in part["findings"]]
    pictures = "pictures/, " if facts["pictures"] else ""
    return facts, [*lines, f"Written to {job.out}: stl/, step/, assembly.step, {pictures}parts.json."]


PHANTOM, CAD = Verb(PhantomJob, _show_phantom), Verb(CadJob, _show_parts)
TARGET, OPTIMISE, CIRCUIT = map(Verb, (TargetJob, OptimiseJob, CircuitJob))
