"""Films before LEDs and camera, from simulated photographs of a card and a black ball, and their
use on captures."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from enrolled import facts_of, refusal_of
from refusals import bad_input
from small_capture import edit
from splitknit.capture import Band
from splitknit.io.capture import read_capture, write_capture
from splitknit.io.images import read_image, write_image
from splitknit.io.rig import read_rig, rig_from_json, rig_to_json, write_rig
from splitknit.model import Camera, Films
from splitknit.observation.films import contrast
from splitknit.observation.light import Light
from splitknit.observation.observe import observe
from splitknit_rig.calibration.polarisers import measure_ball
from splitknit_simulator.bench_photos import behind_films, drawn_films
from splitknit_simulator.calibration_set import solids
from splitknit_simulator.calibration_set.bench import BenchSettings
from splitknit_simulator.rigs import built_rig

SCALE = 0.2


def photographed(folder, seed, extinction):
    """Write the photographs of a rig's films, and return them."""
    rig = built_rig(seed, scale=SCALE)
    films, ball = drawn_films(rig, np.random.SeedSequence(seed), BenchSettings(), extinction)
    with pytest.MonkeyPatch.context() as patch:
        # samples across a pixel of the LEDs' images: less than 12, for time
        patch.setattr(solids, "RIM_SAMPLES", 4)
        seed = np.random.SeedSequence(seed + 1)
        assert list(behind_films(replace(rig, films=films), ball, seed, folder))
    return films


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    folder = tmp_path_factory.mktemp("films")
    yield folder / "polarisers", photographed(folder, 5, 5000.0)


def check(folder, films, tmp_path, capsys):
    """Films that the photographs give, compared with the true ones."""
    out = tmp_path / "rig.json"
    facts = facts_of(capsys, f"calibrate polarisers {folder}", "--out", out)
    measured = read_rig(out).films
    assert measured is not None and measured.leds == films.leds
    low, high = np.transpose(facts["leak_interval"])
    assert (low <= films.leak).all() and (films.leak <= high).all()
    assert_allclose(measured.brightness, films.brightness, rtol=0.005)
    assert_allclose(measured.shift_px, films.shift_px, atol=0.1)
    assert measured.scale == pytest.approx(films.scale, abs=1e-4)
    assert_allclose(measured.leak, films.leak, rtol=0.05, atol=1e-4)
    assert facts["findings"] == []
    assert max(facts["residual_rms_percent"]) < 1.0
    return measured


@pytest.mark.slow
def test_the_leak_brightness_and_shift_of_films_are_measured(bench, tmp_path, capsys):
    measured = check(*bench, tmp_path, capsys)
    rig = read_rig(tmp_path / "rig.json")
    assert rig_from_json(json.loads(json.dumps(rig_to_json(rig)))).films == measured
    assert rig.provenance["polarisers"]["inputs"]


@pytest.mark.slow
def test_the_highlight_of_neighbouring_leds_is_measured(bench):
    folder, films = bench
    ball = _dark(folder / "ball")
    usual = measure_ball(ball, films)
    crossed = ball.bands["white_crossed"]
    moved = replace(
        crossed,
        pixels=np.roll(crossed.pixels, (6, 4), (1, 2)),
        leds=tuple((k + 7,) for (k,) in crossed.leds),
    )
    light = measure_ball(replace(ball, bands={**ball.bands, "white_crossed": moved}), films)
    assert_allclose(light[..., 0], usual[..., 0], rtol=0.03, atol=2e-5 * usual[..., 0].max())


def _dark(folder):
    return read_capture(folder, may_be_dark=True)


def _swap(folder):
    def change(document):
        white, crossed = document["bands"]["white"], document["bands"]["white_crossed"]
        white["images"], crossed["images"] = crossed["images"], white["images"]

    edit(folder / "ball" / "capture.json", change)


def _clip(folder):
    file = folder / "ball" / "white_2.png"
    image = read_image(file)
    image[np.unravel_index(int(image[..., 1].argmax()), image.shape[:2])] = 65535
    write_image(file, image)


def _dull(folder):
    shutil.rmtree(folder / "ball")
    shutil.copytree(folder / "card", folder / "ball")


def _plain(folder):
    rng = np.random.default_rng(0)
    for path in (folder / "card").glob("white_*.png"):
        image = read_image(path)
        write_image(path, (40000 + rng.normal(0, 300, image.shape)).astype(np.uint16))


def _no_exposures(folder):
    def change(document):
        for entry in document["bands"]["white_crossed"]["images"]:
            entry["exposure_s"] *= 9

    edit(folder / "card" / "capture.json", change)


def _alone(folder):
    def change(document):
        del document["bands"]["white_crossed"], document["bands"]["white"]["polarisation"]

    edit(folder / "card" / "capture.json", change)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (_swap, "exchange white and white_crossed"),
        (_clip, "the highlight is clipped"),
        (_dull, "no highlight stands out"),
        (_plain, "no common details"),
        (_no_exposures, "times as bright in the crossed image"),
        (_alone, "holds no crossed series"),
    ],
)
def test_photographs_that_do_not_show_the_films_are_refused(bench, spoil, words, tmp_path, capsys):
    own = Path(shutil.copytree(bench[0], tmp_path / "own"))
    spoil(own)
    out = "--out", tmp_path / "rig.json"
    assert words in refusal_of(capsys, f"calibrate polarisers {own}", *out)
    assert not (tmp_path / "rig.json").exists()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"leds": [0, 0]}, "different LEDs of the rig"),
        ({"leak": [0.7]}, "films.leak"),
        ({"leak": [-0.1]}, r"films.leak\[0\]: Expected float >= 0"),
        ({"brightness": [[1.0, 1.0]]}, "Expected array of length >= 3"),
        ({"brightness": [[1.0, 1.0, 0.0]]}, r"brightness\[0\]\[2\]: Expected float >= 0.01"),
        ({"scale": 2.0}, "films.scale"),
        ({"shift_px": [1.0]}, "films.shift_px"),
    ],
)
def test_rig_files_with_wrong_films_are_refused(change, words):
    rig = replace(built_rig(1, scale=0.05), films=Films((0,), (0.01,), ((1.0, 1.0, 1.0),)))
    document = rig_to_json(rig)
    assert rig_from_json(document).films == rig.films
    document["films"] |= change
    with bad_input(words):
        rig_from_json(document)


@pytest.mark.slow
def test_measured_films_align_the_crossed_series(bench, tmp_path):
    folder, films = bench
    capture = _dark(folder / "card")
    measured = observe(replace(capture, rig=replace(capture.rig, films=films)))
    assert measured.facts == {"films": "measured"}

    def apart(of):
        p, c = (of.bands[name].stack for name in ("white", "white_crossed"))
        inner = np.s_[..., 20:-20, 20:-20]
        return float(np.abs(c - p)[inner].mean() / p[inner].mean())

    assert apart(observe(capture)) > 0.05
    assert apart(measured) < 0.01
    # light that no film has dimmed
    white, alone = measured.without_films().white.grey, measured.white.grey
    assert abs(float(white.mean() / alone.mean()) - 1.0) < 0.002
    write_capture(capture, tmp_path / "c")
    others = replace(films, leds=(*films.leds[1:], 12))
    write_rig(replace(capture.rig, films=others), tmp_path / "c" / "rig.json")
    with bad_input("LED 0 lights a polarised image"):
        observe(_dark(tmp_path / "c"))


@pytest.mark.slow
def test_films_without_calibration_are_taken_as_ideal(bench):
    capture = _dark(bench[0] / "card")
    same = observe(capture)
    assert same.bands["white_crossed"].gains is None
    assert same.facts == {"films": "taken as ideal"}
    assert (contrast(None, same.white) == 1.0).all()
    alone = replace(capture, bands={"white": capture.bands["white"]})
    assert observe(alone).facts == {}


def test_light_that_clips_behind_a_darker_film_clips_in_the_mean():
    pixels = np.full((3, 4, 4, 3), 200, dtype=np.uint8)
    full = pixels.copy()
    full[0] = 255
    parts = {"leds": ((0,), (1,), (2,)), "exposure": np.ones(3), "black_level": np.zeros(3)}
    rig = replace(built_rig(1, scale=0.05), camera=Camera(10.0, (4, 4)))
    for crossed, clips in ((pixels, False), (full, True)):
        behind = Light(Band("white_crossed", crossed, **parts), rig, "linear")
        white = Light(Band("white", pixels, **parts), rig, "linear")
        mean = replace(white, crossed=behind.divided_by(np.full((3, 3), 0.75)))
        assert (mean.stack[0, 0] >= 0.985).all() == clips


@pytest.mark.slow
def test_the_contrast_agrees_with_that_of_the_highlights(bench):
    folder, films = bench
    capture = _dark(folder / "ball")
    lit = observe(replace(capture, rig=replace(capture.rig, films=films)))
    p, c = (lit.bands[name].grey for name in ("white", "white_crossed"))
    for k, expected in enumerate(contrast(films, lit.white)):
        row, column = np.unravel_index(int(p[k].argmax()), p[k].shape)
        spot = np.s_[row - 8 : row + 9, column - 8 : column + 9]
        a, b = float(p[k][spot].sum()), float(c[k][spot].sum())
        assert (a - b) / (a + b) == pytest.approx(expected, abs=0.01)
