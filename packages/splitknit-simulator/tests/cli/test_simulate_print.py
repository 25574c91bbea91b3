"""``splitknit simulate --print``."""

from dataclasses import replace

import numpy as np
import pytest

from enrolled import refusal_of
from splitknit.cli.main import main
from splitknit.io.images import write_image
from splitknit.io.npz import read_npz
from splitknit_simulator.finger.finger import draw_finger
from splitknit_simulator.finger.master_print import ink_print, master_print
from splitknit_simulator.finger.shape import shape_of_rolled_print


def simulated(out, *options):
    """Truth of the finger of seed 3, photographed."""
    assert main(["simulate", "--seed", "3", *map(str, options), "--out", str(out)]) == 0
    return read_npz(out / "truth.npz")


@pytest.mark.slow
def test_a_print_gives_the_finger_its_ridges(tmp_path):
    """Its ridges end where the print does, and are not those of the seed."""
    write_image(tmp_path / "print.png", ink_print(master_print("whorl", 5)))
    drawn = simulated(tmp_path / "drawn", "--scale", "0.15")
    own = simulated(tmp_path / "own", "--scale", "0.15", "--print", tmp_path / "print.png")
    assert str(own["landmark_pattern"]) == "print"
    both = own["mask"] & drawn["mask"]
    np.testing.assert_allclose(own["shape_mm"][both], drawn["shape_mm"][both], atol=1e-5)
    relief = [np.where(both, truth["height_mm"] - truth["shape_mm"], 0.0) for truth in (drawn, own)]
    rows, columns = np.flatnonzero(both.any(axis=1)), np.flatnonzero(both.any(axis=0))
    top, centre = rows[0], int(columns.mean())
    middle = np.s_[top + 40 : top + 100, centre - 30 : centre + 30]
    assert relief[1][middle].std() > 0.5 * relief[0][middle].std()
    assert abs(np.corrcoef(relief[0][middle].ravel(), relief[1][middle].ravel())[0, 1]) < 0.5


def test_a_row_of_a_rolled_print_is_as_long_as_the_half_section():
    shape = replace(draw_finger(4).shape, squareness=0.0)
    half, high, pitch = 7.5, 7.5 * shape.thickness_mm / shape.width_mm, 0.05
    angle = np.linspace(-np.pi / 2, np.pi / 2, 20_001)
    arc = float(np.trapezoid(np.hypot(half * np.cos(angle), high * np.sin(angle)), angle))
    rows = np.arange(0.0, 24.0, pitch)  # a round tip of 7 mm, then a cylinder
    row_mm = arc * np.sqrt(1.0 - np.clip(1.0 - rows / 7.0, 0.0, 1.0) ** 2)
    columns = np.arange(-14.0, 14.0, pitch)
    fitted = shape_of_rolled_print(2.0 * np.abs(columns)[None, :] < row_mm[:, None], pitch, shape)
    assert fitted.width_mm == pytest.approx(2.0 * half, abs=0.1)
    assert fitted.thickness_mm == pytest.approx(2.0 * high, abs=0.1)
    # the skin of the tip falls towards the nail
    assert 4.0 <= fitted.tip_length_mm < 7.0 and fitted.length_mm < 24.0
    assert (fitted.squareness, fitted.taper) == (0.0, shape.taper)


@pytest.mark.slow
def test_the_outline_of_a_rolled_print_gives_the_finger_its_size(tmp_path):
    image = ink_print(master_print("whorl", 5), half_width_mm=11.5)  # 23 mm from nail to nail
    write_image(tmp_path / "rolled.png", image)
    options = "--scale", "0.1", "--print", tmp_path / "rolled.png"
    drawn = simulated(tmp_path / "drawn", *options)
    own = simulated(tmp_path / "own", *options, "--rolled")
    width = [
        float(truth["mask"].sum(axis=1).max()) * float(truth["pitch_mm"]) for truth in (drawn, own)
    ]
    assert width[1] == pytest.approx(draw_width(image), abs=1.0)
    assert abs(width[0] - width[1]) > 0.3


def draw_width(image):
    """Of the finger of seed 3 that left a print of this outline."""
    ink = (image < 128).any(axis=0)
    return shape_of_rolled_print(
        np.ones((300, int(ink.sum())), dtype=bool), 25.4 / 500, draw_finger(3).shape
    ).width_mm


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--pattern", "whorl"], "leave out the pattern"),
        (["--bench"], "--print does not go with --bench"),
        (["population"], "--print does not go with a population"),
        ([], "no ridges"),
    ],
)
def test_options_that_exclude_a_print_are_refused(tmp_path, capsys, options, words):
    write_image(tmp_path / "white.png", np.full((300, 300), 255, dtype=np.uint8))
    arguments = *options, "--out", tmp_path / "none", "--print", tmp_path / "white.png"
    assert words in refusal_of(capsys, "simulate", *arguments)
    assert not (tmp_path / "none").exists()


def test_rolled_needs_a_print_as_wide_as_a_finger(tmp_path, capsys):
    rolled = "simulate", "--rolled", "--out", tmp_path / "none"
    assert "--print" in refusal_of(capsys, *rolled)
    write_image(tmp_path / "narrow.png", ink_print(master_print("whorl", 5), half_width_mm=5.0))
    assert "rolled print" in refusal_of(capsys, *rolled, "--print", tmp_path / "narrow.png")
    assert not (tmp_path / "none").exists()
