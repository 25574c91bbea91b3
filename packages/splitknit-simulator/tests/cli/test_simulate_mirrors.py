"""``splitknit simulate --mirrors``: options in, a capture folder out."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from splitknit.cli.main import main
from splitknit.io.capture import read_capture


@pytest.mark.slow
def test_a_mirror_capture_is_written_read_and_taken_again_with_another_roll(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    common = [
        "simulate",
        "--mirrors",
        "right",
        "--no-nir",
        "--scale",
        "0.08",
        "--seed",
        "6",
        "--json",
    ]
    common += ["--set", "mirrors.truth_pitch_mm=0.5"]
    assert main([*common, "--out", str(tmp_path / "first")]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["images"] == 7
    capture = read_capture(tmp_path / "first")
    assert set(capture.bands) == {"white"}
    assert [mirror.name for mirror in capture.rig.mirrors] == ["right"]
    rig = tmp_path / "first" / "rig.json"
    again = ["simulate", "--rig", str(rig), "--seed", "6", "--set", "mirrors.truth_pitch_mm=0.5"]
    rolled = [
        "--impression",
        "1",
        "--set",
        "pose.roll_deg=[20, 20]",
        "--set",
        "pose.insertion_mm=[28, 30]",
    ]
    assert main([*again, *rolled, "--out", str(tmp_path / "second")]) == 0
    truths = [np.load(tmp_path / name / "truth.npz") for name in ("first", "second")]
    np.testing.assert_array_equal(
        truths[0]["mirror_right_normal"], truths[1]["mirror_right_normal"]
    )
    assert float(truths[1]["landmark_roll_rad"]) == pytest.approx(np.deg2rad(20.0))
    assert (
        truths[0]["view_right_mask"].any()
        and not truths[0]["view_right_mask"][truths[0]["mask"]].any()
    )
    second = read_capture(tmp_path / "second")
    assert second.subject["session"] == 2
    assert second.rig.mirrors == capture.rig.mirrors


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--mirrors", "right,up"], "left, right and tip"),
        (["--mirrors", ""], "left, right and tip"),
        (["population", "--mirrors", "right"], "--mirrors does not go with a population"),
        (["--no-nir"], "--no-nir needs --mirrors"),
        (["--mirrors", "right", "--bench"], "--mirrors does not go with --bench"),
        (["--impression", "2", "--bench"], "--impression does not go with --bench"),
        (["--mirrors", "right", "--motion", "0.2"], "leave out mirrors, or condition, motion"),
        (["--mirrors", "right", "--condition", "wet"], "leave out mirrors, or condition"),
    ],
)
def test_what_cannot_be_is_refused_in_one_sentence(
    options: list[str], says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert main(["simulate", *options, "--out", str(out), "--scale", "0.08"]) == 2
    message = capsys.readouterr().err
    assert says in message and message.count("\n") == 1
    assert not out.exists()
