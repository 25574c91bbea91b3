"""People without photographs: perfect reconstructions of small fingers in an enrolment's
folders."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

from perfect_results import write_perfect
from splitknit.cli.main import main
from splitknit.nominal import default_rig
from splitknit_simulator.finger.finger import FingerPose, draw_finger, finger_surface

FINGERS = (("S01", "left_thumb", 731), ("S01", "right_index", 732), ("S02", "right_index", 733))
POSES = (FingerPose(insertion_mm=25.0), FingerPose(insertion_mm=24.0, yaw_rad=0.12, roll_rad=0.08))


def people(folder: Path) -> Path:
    """Two people, three fingers, two sessions: result folders with a print each."""
    camera = default_rig(0.12).camera
    for person, finger, seed in FINGERS:
        drawn = draw_finger(seed, "right_loop")
        master = drawn.master()
        for session, pose in enumerate(POSES, start=1):
            seen = finger_surface(replace(drawn, printed=master), pose, camera)
            write_perfect(folder / person / f"session_{session}" / finger, seen, camera)
    return folder


def run(command: str, *arguments: object) -> int:
    """A command as it is typed, and words after it that may hold spaces."""
    return main([*command.split(), *map(str, arguments)])


def facts_of(capsys, command: str, *arguments: object) -> dict:
    """Facts of a verb that is done."""
    assert run(command, *arguments, "--json") == 0
    printed = capsys.readouterr()
    assert printed.err == ""
    return json.loads(printed.out)


def words_of(capsys, command: str, *arguments: object) -> str:
    """What a verb that is done says to people."""
    assert run(command, *arguments) == 0
    return capsys.readouterr().out


def refusal_of(capsys, command: str, *arguments: object) -> str:
    """The one sentence of a verb that refuses."""
    assert run(command, *arguments) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert len(printed.err.strip().splitlines()) == 1, printed.err
    return printed.err
