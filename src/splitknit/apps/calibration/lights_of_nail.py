"""What ``splitknit calibrate lights`` does with a table of nail and shadow tips, and with photographs of the nail."""

from __future__ import annotations

import argparse
import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from splitknit.apps.calibration.calibrated_lights import LightSettings, calibrate_lights, lines_of, rig_of
from splitknit.apps.calibration.lights_inputs import RigInputs, write_lights
from splitknit.apps.verb import Outcome, Refused
from splitknit.calibration.light_table import Tip, read_tips
from splitknit.calibration.lights import Circle
from splitknit.errors import BadInput, read_bytes
from splitknit.io import plain_json, provenance

Report = Callable[[str, float], None]


@dataclass(frozen=True, slots=True, eq=False)
class Task:
    """What the command line asks for."""

    options: argparse.Namespace
    inputs: RigInputs
    circle: Circle
    settings: LightSettings


def lights_of_table(task: Task, progress: Report) -> Outcome:
    """Calibrate from a typed table."""
    options = task.options
    data = read_bytes(options.table, 16_000_000)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise BadInput(f"{options.table} is not a text file; export the table as CSV in UTF-8.") from error
    tips = read_tips(text, str(options.table))
    progress("fitting", 0.5)
    hashes = {options.table.name: hashlib.sha256(data).hexdigest()}
    return finish(task, tips, hashes, str(options.table))


def finish(task: Task, tips: Sequence[Tip], hashes: Mapping[str, str], name: str) -> Outcome:
    """Find the LEDs, refuse or write."""
    options, inputs, circle, settings = task.options, task.inputs, task.circle, task.settings
    found = calibrate_lights(
        tips,
        inputs.camera,
        circle,
        name=name,
        method=options.method,
        settings=settings,
        keep=options.keep,
        calibrated=inputs.base is not None,
    )
    facts = {**found.facts, "circle": {"radius_mm": circle.radius_mm, "height_mm": circle.height_mm}}
    if found.sentence is not None:
        refused = plain_json({**facts, "written": False, "out": None})
        assert isinstance(refused, dict)
        raise Refused(f"{name}: {found.sentence}", dict(refused))
    origin = provenance({"method": found.method, "circle": circle, "lights": settings}, hashes)
    words = [
        {name: one[name] for name in ("band", "led", "verdict", "disagreement_deg", "interval_deg", "interval_mm")}
        for one in found.facts["leds"]
    ]
    rig = rig_of(found.chosen, inputs.camera, inputs.base, plain_json_map({"leds": words, "provenance": origin}))
    return write_lights(rig, options.out, facts, lines_of(facts))


def plain_json_map(value: Mapping[str, object]) -> dict[str, object]:
    """Return `value` as plain JSON."""
    result = plain_json(value)
    assert isinstance(result, dict)
    return dict(result)
