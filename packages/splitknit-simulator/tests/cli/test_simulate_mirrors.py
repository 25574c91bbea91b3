"""``splitknit simulate --mirrors``: options in, a capture folder out."""

import numpy as np
import pytest

from enrolled import facts_of, refusal_of, words_of
from splitknit.io.capture import read_capture


@pytest.mark.slow
def test_a_stored_mirror_rig_photographs_the_finger_again_with_another_roll(tmp_path, capsys):
    common = "--seed", "6", "--set", "mirrors.truth_pitch_mm=0.5"
    first = "--mirrors", "right", "--no-nir", "--scale", "0.08", "--out", tmp_path / "first"
    assert facts_of(capsys, "simulate", *common, *first)["images"] == 7
    capture = read_capture(tmp_path / "first")
    assert set(capture.bands) == {"white"}
    assert [mirror.name for mirror in capture.rig.mirrors] == ["right"]
    rolled = "--set", "pose.roll_deg=[20, 20]", "--set", "pose.insertion_mm=[28, 30]"
    again = "--rig", tmp_path / "first" / "rig.json", "--impression", "1", *rolled
    words_of(capsys, "simulate", *common, *again, "--out", tmp_path / "second")
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
    ("options", "words"),
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
def test_options_that_exclude_mirrors_are_refused(options, words, tmp_path, capsys):
    out = tmp_path / "out"
    assert words in refusal_of(capsys, "simulate", *options, "--out", out, "--scale", "0.08")
    assert not out.exists()
