"""A session with polarising films: two series, an analyser that turns or LEDs of its own, and what
is checked."""

import io
import sys
from dataclasses import replace

import gpiozero
import numpy as np
import pytest
from gpiozero.pins.mock import MockFactory, MockPWMPin
from test_pi_session import CAMERA, rig_of_pi  # noqa: F401 - a fixture

from enrolled import refusal_of
from splitknit.cli.main import main
from splitknit.devices import Opened
from splitknit.errors import BadInput
from splitknit.io.capture import read_capture
from splitknit.io.rig import write_rig
from splitknit.nominal import default_rig
from splitknit_rig.capture.pi import PiAnalyser
from splitknit_rig.capture.pins import NIR_PINS, SECOND_PINS, WHITE_PINS, RigFilms, rig_films
from splitknit_rig.capture.session import SessionSettings, run_session
from splitknit_simulator.rigs import with_side_lights
from splitknit_simulator.twin import FingerScene
from twin_bench import twin_devices


class FilmScene:
    """A finger behind films: what is brighter than most of it is shine, which the crossed analyser
    stops."""

    def __init__(self, scene, *, turns=True, crossed_leds=()):
        self.scene, self.turns, self.crossed_leds = scene, turns, crossed_leds
        self.camera = scene.camera
        self.leds = (*scene.leds, *(scene.leds[k] for k, _ in enumerate(crossed_leds)))
        self.position, self.turned = "parallel", []

    def turn(self, position):
        self.turned.append(position)
        self.position = position if self.turns else "parallel"

    def light(self, lit):
        light = self.scene.light(
            [self.crossed_leds.index(k) if k in self.crossed_leds else k for k in lit]
        )
        matt = np.minimum(light, np.quantile(light, 0.97))
        crossed = self.position == "crossed" or any(k in self.crossed_leds for k in lit)
        return 0.5 * (matt if crossed else light + 2 * (light - matt))


def with_films(rig, **films):
    return replace(rig, provenance={**rig.provenance, "films": films})


def captured(scene, rig, settings=None):
    camera, lights, _ = twin_devices(scene)
    with lights, camera:
        return run_session(Opened("twin", camera, lights, rig, {}), settings, turn=scene.turn)


@pytest.mark.slow
def test_both_series_share_the_exposure_and_crossed_images_lack_the_specular_reflection(finger):
    scene = FilmScene(finger)
    session = captured(scene, with_films(finger.rig, kind="hand"))
    assert session.verdict == ()
    assert scene.turned == ["parallel", "crossed"]
    names = [f"white {k} crossed" for k in range(7)]
    assert [shot.name for shot in session.shots][8:16] == ["white crossed ambient", *names]
    parallel, crossed = (session.bands[band] for band in ("white", "white_crossed"))
    assert (parallel.polarisation, crossed.polarisation) == ("parallel", "crossed")
    assert parallel.leds == crossed.leds
    assert (parallel.exposure == crossed.exposure).all()
    assert crossed.ambient is not None
    assert session.crossed_over_parallel < 0.9


@pytest.mark.slow
def test_both_series_include_side_lights(finger):
    """From the last light of the parallel series on the left to the first of the crossed one on the
    right."""
    rig = with_side_lights(finger.rig, 7)
    scene = FilmScene(FingerScene(3, "whorl", replace(finger.settings, rig=rig)))
    session = captured(scene, with_films(rig, kind="hand"))
    assert session.verdict == ()
    assert {name: len(band.pixels) for name, band in session.bands.items()} == {
        "white": 14, "white_crossed": 14, "nir": 7}  # fmt: skip
    assert session.crossed_over_parallel < 0.9


@pytest.mark.slow
def test_neighbouring_leds_light_the_crossed_series_and_no_analyser_turns(finger):
    crossed = tuple(range(14, 21))
    scene = FilmScene(finger, crossed_leds=crossed)
    rig = with_films(replace(finger.rig, leds=scene.leds), kind="neighbours", crossed=list(crossed))
    session = captured(scene, rig)
    assert (session.verdict, scene.turned) == ((), [])
    assert session.bands["white_crossed"].leds == tuple((k,) for k in crossed)
    assert (session.bands["white"].exposure == session.bands["white_crossed"].exposure).all()


@pytest.mark.parametrize("turns", [False, True])
def test_an_analyser_that_does_not_turn_is_detected(finger, turns):
    scene = FilmScene(finger, turns=turns)
    session = captured(scene, with_films(finger.rig, kind="hand"))
    verdicts = [words for words in session.verdict if "where the finger shines" in words]
    assert (verdicts == []) == turns
    assert turns or "not 93 % or less: the analyser did not turn" in verdicts[0]


def test_motion_between_the_series_is_detected(finger):
    scene = FilmScene(finger)

    def moved(position, turn=scene.turn):
        turn(position)
        if position == "crossed":
            stay = scene.light
            scene.light = lambda lit: np.roll(stay(lit), 5, axis=1)

    scene.turn = moved
    session = captured(scene, with_films(finger.rig, kind="hand"))
    assert any("between white 6 and white 0 crossed" in words for words in session.verdict)


def test_a_target_needs_no_specular_reflection(finger):
    scene = FilmScene(finger, turns=False)
    session = captured(
        scene, with_films(finger.rig, kind="servo"), SessionSettings(find_finger=False)
    )
    assert session.verdict == ()
    assert "white_crossed" in session.bands


def test_an_analyser_that_nothing_turns_is_refused(finger):
    camera, lights, _ = twin_devices(finger)
    with lights, camera, pytest.raises(BadInput, match="nothing turns it here"):
        run_session(Opened("twin", camera, lights, with_films(finger.rig, kind="servo"), {}))


def test_films_on_the_twin_are_refused(tmp_path, capsys):
    write_rig(with_films(default_rig(), kind="servo"), tmp_path / "rig.json")
    words = "--rig", tmp_path / "rig.json", "--out", tmp_path / "c"
    # before anything is simulated
    refusal = refusal_of(capsys, "capture --device twin", *words)
    assert "the twin's camera and LEDs have not" in refusal


@pytest.mark.parametrize(
    ("films", "words"),
    [
        ({"kind": "glued"}, 'kind "servo", "hand" or "neighbours"'),
        ([], 'kind "servo", "hand" or "neighbours"'),
        ({"kind": "servo", "servo": 17}, "no LED has, not 17"),
        ({"kind": "servo", "pulses_ms": [1.0, 1.0]}, "two different numbers of 0.3 to 3"),
        ({"kind": "neighbours", "crossed": [7, 8, 9]}, "half of its 7 white LEDs"),
    ],
)
def test_impossible_films_are_refused(films, words):
    rig = default_rig()
    with pytest.raises(BadInput, match=words):
        rig_films(replace(rig, provenance={"films": films}))
    assert rig_films(rig) is None


def test_pins_of_films_are_not_those_of_leds():
    assert set(SECOND_PINS).isdisjoint(WHITE_PINS + NIR_PINS + (4,))


def test_the_servo_gets_pulses_only_while_it_turns():
    gpiozero.Device.pin_factory = MockFactory(pin_class=MockPWMPin)
    try:
        rig = with_films(default_rig(), kind="servo", servo=5, pulses_ms=[2.0, 1.0])
        slept = []
        analyser = PiAnalyser(
            rig_films(rig), gpiozero.Servo, lambda seconds: slept.append(pin.state)
        )
        pin = gpiozero.Device.pin_factory.pin(5)
        with analyser:
            assert pin.state == 0
            analyser("parallel")
            analyser("crossed")
            assert pin.state == 0
        assert slept == pytest.approx([0.1, 0.05])  # fractions of 20 ms
        assert rig_films(with_films(default_rig(), kind="hand")) == RigFilms(
            "hand", tuple(range(7))
        )
    finally:
        gpiozero.Device.pin_factory.reset()
        gpiozero.Device.pin_factory = None


class Hand(io.StringIO):
    """Somebody at the terminal who turns the analyser when asked, or goes away."""

    def __init__(self, scene, answers):
        super().__init__()
        self.scene, self.answers = scene, list(answers)

    def isatty(self):
        return True

    def readline(self):
        answer = self.answers.pop(0)
        if answer is KeyboardInterrupt:
            raise KeyboardInterrupt
        if answer:
            self.scene.turn(answer)
        return answer and "\n"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("answers", "code"),
    [(["parallel", "crossed"], 0), (["parallel", ""], 2), (["parallel", KeyboardInterrupt], 130)],
)
def test_an_analyser_turned_by_hand_is_requested_on_the_terminal(
    rig_of_pi,  # noqa: F811
    finger,
    tmp_path,
    capsys,
    *,
    monkeypatch,
    answers,
    code,
):
    """A capture that ends between the series leaves nothing."""
    words, _ = rig_of_pi
    scene = FilmScene(finger)
    monkeypatch.setattr(sys.modules["picamera2"].Picamera2, "scene", scene)
    write_rig(with_films(default_rig(0.1, 0), kind="hand"), tmp_path / "rig.json")
    monkeypatch.setattr(sys, "stdin", Hand(scene, answers))
    monkeypatch.setattr(sys.stdin, "fileno", lambda: 0)
    assert main([*words, "--out", str(tmp_path / "c")]) == code
    printed = capsys.readouterr()
    assert "Turn the analyser to crossed, then press Enter" in printed.err
    assert {file.name for file in tmp_path.iterdir()} == (
        {"rig.json"} if code else {"c", "rig.json"}
    )
    if code == 0:
        capture = read_capture(tmp_path / "c")
        assert capture.bands["white_crossed"].polarisation == "crossed"
        assert "where the finger shines, the crossed images have" in printed.out
    elif code == 2:
        assert "nobody answered on the terminal" in printed.err
