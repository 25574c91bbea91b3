"""A finger that moved is brought onto one shot before it is reconstructed; a still one is left
alone, bit by bit."""

import json

import numpy as np
import pytest

from refusals import bad_input
from splitknit import reconstruct
from splitknit.cli.main import main
from splitknit.finger.steady import find_steady_finger
from splitknit.io.capture import write_capture
from splitknit.observation.observe import observe
from splitknit.presets import preset_settings
from splitknit.settings import override
from splitknit_simulator.accuracy import compare
from splitknit_simulator.finger.motion import HandMotion
from splitknit_simulator.rigs import coloured_rig
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.twin import simulate_capture

SCALE = 0.12
OFF = {"motion.correct": "off"}


@pytest.fixture(scope="module")
def still():
    return simulate_capture(11, "whorl", TwinSettings(scale=SCALE))


@pytest.fixture(scope="module")
def moved():
    return simulate_capture(
        11, "whorl", TwinSettings(scale=SCALE, motion=HandMotion(amplitude_mm=0.5))
    )


@pytest.fixture(scope="module")
def undone(moved):
    return reconstruct(moved[0], "ea")


@pytest.fixture(scope="module")
def unmoved(still):
    return reconstruct(still[0], "ea")


def steadied(capture, **changes):
    settings = override(
        preset_settings("ea"), {f"motion.{name}": value for name, value in changes.items()}
    )
    light = observe(capture)
    steady, finger = find_steady_finger(light, settings)
    return light, steady, finger


def correlation(result, truth):
    return compare(result, truth).figures["ridge_correlation"]


@pytest.mark.slow
def test_correction_restores_the_ridge_correlation(still, moved, unmoved, undone):
    lost = correlation(unmoved, still[1]) - correlation(undone, moved[1])
    assert lost < 0.05
    assert (
        correlation(reconstruct(moved[0], "ea", OFF), moved[1])
        < correlation(undone, moved[1]) - 0.15
    )


@pytest.mark.slow
def test_facts_state_the_measured_motion(moved, undone):
    _, truth = moved
    told = {name: undone.facts[f"motion_{name}"] for name in ("white", "nir")}
    assert undone.facts["motion"]["reference"] == "white 3"
    assert told["white"]["turn_deg"][3] == 0.0
    for name, first in (("white", 0), ("nir", 7)):
        assert len(told[name]["shift_mm"]) == 7
        flow = np.nanmean(truth["motion_flow_px"][first : first + 7], axis=(2, 3)) * float(
            truth["pitch_mm"]
        )
        # the finger's middle is not that of all skin in view, which turns
        np.testing.assert_allclose(told[name]["shift_mm"], flow * [1, -1], atol=0.06)
    assert max(told["white"]["unexplained_after"]) < 0.5 * max(told["white"]["unexplained_before"])
    assert "moved by" in undone.warnings[0]
    json.dumps(told)


@pytest.mark.slow
def test_a_still_finger_is_unchanged(still, unmoved):
    capture, _ = still
    light, same, finger = steadied(capture)
    assert same is light
    assert "motion" not in finger.facts
    results = unmoved, reconstruct(capture, "ea", OFF)
    for name in ("height_mm", "ridge_mm", "normals", "albedo", "mask"):
        np.testing.assert_array_equal(*(getattr(result, name) for result in results))


@pytest.mark.slow
def test_correct_off_changes_nothing_and_on_always_registers(still, moved):
    light, same, _ = steadied(moved[0], correct="off")
    assert same is light
    light, registered, finger = steadied(still[0], correct="on")
    assert registered is not light
    assert max(finger.facts["motion_white"]["moved_mm"]) < 0.02


@pytest.mark.slow
def test_too_much_motion_is_refused(moved, tmp_path, capsys):
    capture, truth = moved
    with bad_input(r"moved by 0\.\d\d mm .* at most 0\.05 mm can be undone"):
        steadied(capture, most_mm=0.05)
    write_capture(capture, tmp_path / "capture", truth)
    out = tmp_path / "result"
    command = f"reconstruct {tmp_path}/capture --out {out} --preset ea".split()
    assert main([*command, "--set", "motion.most_mm=0.05"]) == 2
    assert "at most 0.05 mm can be undone" in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.slow
def test_photographs_of_coloured_leds_are_registered():
    motion = HandMotion(amplitude_mm=0.8)
    capture, truth = simulate_capture(
        4, "left_loop", TwinSettings(rig=coloured_rig(0.15, 0), motion=motion)
    )
    *_, finger = steadied(capture, correct="on")
    told = finger.facts["motion_white"]
    count = len(capture.bands["white"].pixels)
    assert len(told["moved_mm"]) == count == 2
    flow = np.nanmean(truth["motion_flow_px"][:count], axis=(2, 3)) * capture.rig.camera.pitch_mm
    assert np.hypot(*flow[0]) > 0.15
    np.testing.assert_allclose(told["shift_mm"], flow * [1, -1], atol=0.06)
