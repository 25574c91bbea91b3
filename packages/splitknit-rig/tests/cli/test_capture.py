"""``splitknit capture`` through the command line, on the twin and on a Raspberry Pi that is not
there."""

import json
import os
import shlex
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from enrolled import facts_of, refusal_of
from faulty_scene import Faults, FaultyScene
from splitknit.cli.main import main
from splitknit.errors import BadInput
from splitknit.io.capture import read_capture
from splitknit.io.rig import write_rig
from splitknit.nominal import default_rig
from splitknit_rig import capture_finger
from splitknit_simulator import twin_devices
from splitknit_simulator.twin import FingerScene

SMALL = ("--scale", "0.1", "--set", "pose.insertion_mm=[26.0, 26.0]")
PERSON = ("--seed", 3, "--subject", "S01", "--finger", "left_ring", "--session", 2)


def run(*words):
    return main(["capture", "--device", "twin", *map(str, words)])


def refused(capsys, *words, device="twin"):
    """Sentence with which a command is refused."""
    return refusal_of(capsys, f"capture --device {device}", *words)


def facts_with(capsys, *words):
    return facts_of(capsys, "capture --device twin", *words)


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    folder = tmp_path_factory.mktemp("capture") / "one"
    assert run("--out", folder, *SMALL, *PERSON) == 0
    return folder


@pytest.fixture
def faults(monkeypatch):
    """Let the twin's scenes have faults."""

    def spoil(**faults):
        class Spoilt(FingerScene):
            def __init__(self, *args, **options):
                super().__init__(*args, **options)
                self._faulty = FaultyScene(self._plain(), Faults(**faults))

            def _plain(self):
                scene = self

                class Plain:
                    camera, leds = scene.camera, scene.leds

                    @staticmethod
                    def light(lit):
                        return FingerScene.light(scene, lit)

                return Plain()

            def light(self, lit):
                return self._faulty.light(lit)

            def frame_begins(self, number):
                self._faulty.frame_begins(number)

        monkeypatch.setattr(twin_devices, "FingerScene", Spoilt)

    return spoil


def test_a_written_capture_has_its_truth_and_session(done):
    capture = read_capture(done)
    assert capture.subject == {"id": "S01", "finger": "left_ring", "session": 2}
    assert capture.shape == (220, 320)
    assert capture.captured_at is None  # a simulated capture is the same at any time
    for band in capture.bands.values():
        assert band.pixels.shape[0] == 7
        assert band.ambient is not None
        assert 0.001 < band.exposure[0] < 0.1
        assert len(set(band.exposure)) == 1
    assert capture.truth is not None
    with np.load(capture.truth) as truth:
        assert {"height_mm", "shape_mm", "mask", "normals"} <= set(truth.files)
    facts = json.loads((done / "session.json").read_text())
    assert facts["device"] == "twin"
    assert [shot["name"] for shot in facts["shots"]][:3] == ["white ambient", "white 0", "white 1"]
    assert facts["seconds"] < 7
    assert facts["settings"]["twin"]["scale"] == 0.1
    assert facts["verdict"] == []


@pytest.mark.slow
def test_facts_state_the_exposure_and_the_images(tmp_path, capsys):
    target = "--set", "capture.exposure.target=0.5"
    facts = facts_with(capsys, "--out", tmp_path / "c", *SMALL, *target)
    assert facts["exposure"]["white"]["level"] == pytest.approx(0.5, rel=0.1)
    assert facts["images"] == 14
    assert facts["subject"]["id"] == "anonymous"


@pytest.mark.parametrize("what", [(), ("nail",)])
def test_a_calibration_target_is_captured(what, tmp_path, capsys):
    words = "--out", tmp_path / "c", "--scale", 0.05, "--seed", 2
    facts = facts_with(capsys, "--target", *what, *words)
    assert facts["verdict"] == []
    (finding,) = facts["findings"]  # what stood there, and where
    assert finding["code"] == "simulated-target"
    capture = read_capture(tmp_path / "c")
    assert capture.material == "opaque"
    assert capture.subject == {}
    assert capture.truth is None
    means = capture.bands["white"].pixels.mean(axis=(1, 2, 3))
    assert (means > 2).all()


def test_an_unknown_target_is_refused(tmp_path, capsys):
    words = "--target", "teapot", "--out", tmp_path / "c"
    assert "no target 'teapot'; it has card" in refused(capsys, *words)


def test_a_rig_file_determines_image_size_and_leds(tmp_path):
    rig = default_rig(0.08, seed=4)
    write_rig(rig, tmp_path / "rig.json")
    assert run("--out", tmp_path / "c", "--rig", tmp_path / "rig.json") == 0
    capture = read_capture(tmp_path / "c")
    assert capture.shape == rig.camera.image_size
    assert [led.intensity for led in capture.rig.leds] == [led.intensity for led in rig.leds]


@pytest.mark.slow
def test_a_finger_that_moved_is_written_only_with_keep(tmp_path, capsys, faults):
    faults(moves_mm={6: (0.5, 0.0)})
    verdict = "the finger moved by 0.5 mm between white 3 and white 4: hold still and capture again"
    assert verdict in refused(capsys, "--out", tmp_path / "c", *SMALL)
    assert list(tmp_path.iterdir()) == []
    assert run("--out", tmp_path / "c", *SMALL, "--keep", "--json") == 2
    out, err = capsys.readouterr()
    assert "kept in" in err
    assert json.loads((tmp_path / "c" / "session.json").read_text())["verdict"] != []
    read_capture(tmp_path / "c")
    assert json.loads(out)["verdict"] == [verdict]


def test_a_dead_led_is_named(tmp_path, capsys, faults):
    faults(dead=frozenset({9}))
    message = refused(capsys, "--out", tmp_path / "c", *SMALL)
    assert "nir 2 did not light; check its wiring" in message
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_foreign_files_and_earlier_captures_are_not_overwritten(done, tmp_path, capsys):
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "diary.txt").write_text("x")
    assert "mine" in refused(capsys, "--out", mine, *SMALL)
    assert "not an earlier capture" in refused(capsys, "--out", mine, *SMALL, "--overwrite")
    assert (mine / "diary.txt").read_text() == "x"
    before = (done / "white_0.tiff").read_bytes()
    assert "exists and is not empty" in refused(capsys, "--out", done, *SMALL)
    assert (done / "white_0.tiff").read_bytes() == before
    assert run("--out", tmp_path / "a", "--scale", 0.05) == 0
    assert run("--out", tmp_path / "a", "--scale", 0.05, "--overwrite", "--seed", 2) == 0


def test_png_files_hold_the_same_pixels(done, tmp_path):
    """By name: a rig's files are TIFF files unless PNG is asked for."""
    assert run("--out", tmp_path / "png", *SMALL, *PERSON, "--set", "capture.images=png") == 0
    ours, theirs = read_capture(done), read_capture(tmp_path / "png")
    assert {Path(name).suffix for name in ours.bands["white"].files} == {".tiff"}
    assert {Path(name).suffix for name in theirs.bands["white"].files} == {".png"}
    for name, band in ours.bands.items():
        np.testing.assert_array_equal(band.pixels, theirs.bands[name].pixels)


@pytest.mark.parametrize(
    ("words", "printed"),
    [
        ("", "--out DIR for one finger, or --enrolment DIR for many"),
        ("--out a --enrolment b", "not both"),
        ("--out a --subject 'Anna Meier'", "never a name"),
        ("--out a --session 0", "numbered from 1"),
        ("--out a --subjects 3", "--subjects belongs to --enrolment"),
        ("--enrolment e --next 0", "--next"),
        ("--enrolment e --fingers right_index,toe", "Expected right_thumb or right_index"),
        ("--enrolment e --overwrite", "replaces nothing"),
        ("--out a --set capture.exposure.target=3", "exposure.target"),
        ("--out a --set skin.nonsense=3", "nonsense"),
        ("--out a --rig missing.json", "missing.json"),
    ],
)
def test_options_that_cannot_be_used_are_refused(words, printed, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert printed in refused(capsys, *shlex.split(words))
    assert list(tmp_path.iterdir()) == []


def test_a_rig_of_another_camera_or_with_too_few_leds_is_refused(tmp_path, capsys):
    rig, words = default_rig(0.05), ("--out", tmp_path / "c", "--rig", tmp_path / "rig.json")
    write_rig(rig, tmp_path / "rig.json")
    printed = refused(capsys, *words, "--scale", 0.1)
    assert "another camera: its images have 110 x 160" in printed
    write_rig(replace(rig, leds=rig.leds[:2] + rig.leds[7:]), tmp_path / "rig.json")
    assert "2 white LEDs" in refused(capsys, *words)


class TestEnrolment:
    PLAN = ("--subjects", 2, "--sessions", 2, "--fingers", "right_index,left_thumb")

    @pytest.mark.slow
    def test_an_enrolment_continues_until_all_fingers_are_captured(
        self, tmp_path, capsys, faults, monkeypatch
    ):
        folder = tmp_path / "e"
        words = "--enrolment", folder, "--scale", 0.05
        facts = facts_with(capsys, *words, *self.PLAN, "--next", 3)
        assert (facts["finished"], facts["total"]) == (3, 8)
        assert facts["next"] == "S02/session_1/left_thumb"
        kept = folder / "S01" / "session_1" / "right_index"
        stamp = (kept / "white_0.tiff").stat().st_mtime_ns

        with monkeypatch.context():
            faults(dead=frozenset({0}))
            printed = refused(capsys, *words)
            assert "S02, session 1, left thumb" in printed
            assert "white 0 did not light" in printed
        monkeypatch.undo()
        assert len(list(folder.rglob("capture.json"))) == 3

        session = facts_with(capsys, *words, "--subject", "S02", "--session", 2)
        assert session["captured"] == ["S02/session_2/right_index", "S02/session_2/left_thumb"]
        assert run(*words) == 0
        assert "All fingers are captured." in capsys.readouterr().out
        assert (kept / "white_0.tiff").stat().st_mtime_ns == stamp
        assert len(list(folder.glob("S*/session_*/*/capture.json"))) == 8
        capture = read_capture(folder / "S02" / "session_2" / "left_thumb")
        assert capture.subject == {"id": "S02", "finger": "left_thumb", "session": 2}
        assert facts_with(capsys, *words)["captured"] == []

        skin, height = {}, {}
        for file in folder.rglob("truth.npz"):
            subject, session, finger = file.relative_to(folder).parts[:3]
            with np.load(file) as truth:
                skin[subject, session, finger] = float(truth["skin_melanin"])
                height[subject, session, finger] = np.nan_to_num(truth["height_mm"]).tobytes()
        assert len(set(skin.values())) == 4  # of every finger, the same in both sessions
        assert skin["S01", "session_1", "left_thumb"] == skin["S01", "session_2", "left_thumb"]
        assert len(set(height.values())) == 8  # laid down anew every time

    def test_a_folder_of_something_else_is_refused(self, done, capsys):
        assert "is not an enrolment" in refused(capsys, "--enrolment", done)


class TestPi:
    """On a computer that is not a Raspberry Pi."""

    @pytest.mark.parametrize(
        ("picamera2", "words"),
        [
            (None, "picamera2"),
            (
                SimpleNamespace(Picamera2=SimpleNamespace(global_camera_info=list)),
                "no camera was found",
            ),
        ],
    )
    def test_missing_hardware_is_refused_and_no_led_lit(
        self, picamera2, words, tmp_path, capsys, monkeypatch
    ):
        from gpiozero import Device
        from gpiozero.pins.mock import MockFactory

        monkeypatch.setitem(sys.modules, "picamera2", picamera2)
        monkeypatch.setattr(Device, "pin_factory", MockFactory())
        assert words in refused(capsys, "--out", tmp_path / "c", device="pi")
        assert not any(pin.state for pin in Device.pin_factory.pins.values())
        assert list(tmp_path.iterdir()) == []

    @pytest.mark.parametrize(
        "words", ["--scale 0.5", "--seed 3", "--pattern loop", "--set skin.melanin=0.1"]
    )
    def test_settings_of_the_twin_are_refused(self, words, tmp_path, capsys):
        assert "twin" in refused(capsys, "--out", tmp_path / "c", *words.split(), device="pi")


@pytest.mark.slow
def test_sigterm_leaves_nothing_half_written(tmp_path):
    out = tmp_path / "c"
    code = "import sys; from splitknit.cli.main import main; sys.exit(main())"
    words = f"capture --device twin --out {out} --scale 0.3".split()
    process = subprocess.Popen([sys.executable, "-c", code, *words], stderr=subprocess.PIPE)
    deadline = time.monotonic() + 60
    while not list(tmp_path.iterdir()) and time.monotonic() < deadline:
        time.sleep(0.02)
    time.sleep(0.3)  # in the middle of the session
    os.kill(process.pid, signal.SIGTERM)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert b"interrupted" in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("text", ["", "Ann Lee", "../x", "S01/x", "Ä", "x" * 33, "a.b", "S01\n"])
def test_a_subject_id_that_could_name_a_person_or_a_path_is_refused(text):
    with pytest.raises(BadInput, match="never a name"):
        capture_finger._check_who(text, None, None)
    capture_finger._check_who("S-01_b", None, None)
