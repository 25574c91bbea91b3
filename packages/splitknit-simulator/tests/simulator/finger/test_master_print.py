"""Master prints: classes, periods, variety, determinism."""

import cv2
import numpy as np
import pytest

from refusals import bad_input
from splitknit_simulator.finger.master_print import (
    MasterPrintSettings,
    ink_print,
    master_of_print,
    master_print,
)
from splitknit_simulator.finger.ridges import PATTERNS, orientation_field

SMALL = MasterPrintSettings(half_width_mm=8.0, distal_mm=25.0, proximal_mm=2.0)
U = (np.arange(240) - 119.5) * 0.1
V = 28.0 - np.arange(300) * 0.1


@pytest.fixture(scope="module")
def prints():
    return [master_print("left_loop", seed, SMALL) for seed in range(4)]


def turn(angle, row, column, reach):
    """How often the direction turns by pi around a square path, counter-clockwise (rows point
    down)."""
    side = np.arange(-reach, reach)
    path = [(row + reach, column + k) for k in side] + [(row - k, column + reach) for k in side]
    path += [(row - reach, column - k) for k in side] + [(row + k, column - reach) for k in side]
    doubled = np.array([np.exp(2j * angle[r, c]) for r, c in path])
    return float(np.angle(np.roll(doubled, -1) / doubled).sum() / (2 * np.pi))


@pytest.mark.parametrize(
    ("pattern", "cores", "deltas"),
    [
        ("arch", 0, 0),
        ("tented_arch", 1, 1),
        ("left_loop", 1, 1),
        ("right_loop", 1, 1),
        ("whorl", 2, 2),
        ("twin_loop", 2, 2),
    ],
)
def test_the_class_determines_the_number_of_cores_and_deltas(pattern, cores, deltas):
    for seed in range(3):
        field = orientation_field(pattern, np.random.default_rng(seed), U, V)
        assert (len(field.cores_mm), len(field.deltas_mm)) == (cores, deltas)
        whole = turn(field.angle_rad, 150, 120, 110)
        assert round(whole) == cores - deltas
        for sign, points in ((1, field.cores_mm), (-1, field.deltas_mm)):
            for u, v in points:
                row, column = round((V[0] - v) / 0.1), round((u - U[0]) / 0.1)
                assert round(turn(field.angle_rad, row, column, 2)) == sign


def test_an_ink_print_is_mirrored_and_dark_on_ridges(prints):
    image = ink_print(prints[0], half_width_mm=7.5)
    step = 25.4 / 500
    rows, columns = np.mgrid[150:250, 100:180]
    u, v = 7.5 - (columns + 0.5) * step, 24.0 - (rows + 0.5) * step
    pitch = prints[0].u_mm[1] - prints[0].u_mm[0]
    i = np.rint((prints[0].v_mm[0] - v) / pitch).astype(int)
    j = np.rint((u - prints[0].u_mm[0]) / pitch).astype(int)
    assert np.corrcoef(image[rows, columns].ravel(), prints[0].ridge[i, j].ravel())[0, 1] < -0.8


@pytest.mark.slow
def test_the_mean_period_is_23_ridges_a_centimetre():
    periods = [
        master_print(
            "arch", seed, MasterPrintSettings(half_width_mm=2, distal_mm=3, proximal_mm=1)
        ).period_mm
        for seed in range(60)
    ]
    assert np.mean(periods) == pytest.approx(0.43, abs=0.012)
    assert 0.02 < np.std(periods) < 0.045


def test_ridges_keep_the_drawn_period(prints):
    for print_ in prints:
        pitch = print_.u_mm[1] - print_.u_mm[0]
        window = np.hanning(200)[:, None] * np.hanning(200)[None, :]
        part = print_.ridge[250:450, 100:300]
        power = np.abs(np.fft.fft2((part - part.mean()) * window)) ** 2
        f = np.hypot(np.fft.fftfreq(200, pitch)[:, None], np.fft.fftfreq(200, pitch)[None, :])
        ring = (f > 1.2) & (f < 3.8)
        mean = (power * f)[ring].sum() / power[ring].sum()
        assert 1 / mean == pytest.approx(print_.period_mm, rel=0.16)


@pytest.mark.slow
def test_minutiae_sit_on_broken_ridges_at_the_density_of_people():
    densities = []
    for seed, pattern in enumerate(PATTERNS):
        print_ = master_print(pattern, seed, SMALL)
        inside = (
            (np.abs(print_.minutiae[:, 0]) < 7)
            & (print_.minutiae[:, 1] > 3)
            & (print_.minutiae[:, 1] < 24)
        )
        densities.append(inside.sum() / (14 * 21))
    assert 0.13 < np.mean(densities) < 0.32


def test_a_dislocation_is_found_with_its_direction():
    from splitknit_simulator.finger.ridges import phase_singularities

    rows, columns = np.mgrid[0:200, 0:200].astype(float)
    phase = 2 * np.pi * columns / 10 + np.arctan2(100.5 - rows, columns - 100.5)
    wave = (
        np.cos(phase) * np.exp(-(((rows - 100) / 60) ** 2) - ((columns - 100) / 60) ** 2)
    ).astype(np.float32)
    singular = phase_singularities(wave, np.full((200, 200), np.pi / 2))
    near = singular[np.hypot(singular[:, 0] - 100.5, singular[:, 1] - 100.5) < 60]
    assert len(near) == 1
    assert np.hypot(near[0, 0] - 100.5, near[0, 1] - 100.5) < 3
    # The phase grows along the columns; a turn of +2 pi counter-clockwise leaves more ridges below
    # (rows down).
    above = np.ptp(np.unwrap(phase[20]))
    below = np.ptp(np.unwrap(phase[180]))
    assert np.sign(np.sin(near[0, 2])) == (1 if above > below else -1)


def test_pores_sit_on_ridges(prints):
    for print_ in prints:
        assert print_.ridge[print_.pores > 0.5].mean() > 0.85
        area = np.ptp(print_.u_mm) * np.ptp(print_.v_mm)
        count, _ = cv2.connectedComponents((print_.pores > 0.3).astype(np.uint8))
        assert 2.9 < count / area < 4.4  # 1 / (0.43 mm x 0.65 mm) = 3.6, thinned


def test_the_same_seed_gives_the_same_bytes_for_any_threads():
    before = cv2.getNumThreads()
    try:
        cv2.setNumThreads(1)
        first = master_print("whorl", 5, SMALL)
    finally:
        cv2.setNumThreads(before)
    second = master_print("whorl", 5, SMALL)
    assert first.ridge.tobytes() == second.ridge.tobytes()
    assert first.pores.tobytes() == second.pores.tobytes()
    assert first.minutiae.tobytes() == second.minutiae.tobytes()
    assert master_print("whorl", 6, SMALL).ridge.tobytes() != first.ridge.tobytes()


def test_unknown_patterns_and_coarse_pitches_are_refused():
    with bad_input("choose one of"):
        master_print("spiral", 0)
    with bad_input("pitch_mm"):
        MasterPrintSettings(pitch_mm=0.1)


def test_a_print_gives_back_the_ridges_of_its_finger(prints):
    """Ink on paper and back: mirrored twice, at the print's scale, its middle 13.5 mm above the
    first crease."""
    first = prints[0]
    restored = master_of_print(ink_print(first), settings=SMALL)
    pad = (
        (slice(None), np.abs(restored.u_mm) < 4.0),
        (np.abs(restored.v_mm - 13.5) < 6.0, slice(None)),
    )
    printed, recovered = (m.ridge[pad[1]][pad[0]] for m in (first, restored))
    best = max(
        np.corrcoef(
            np.roll(recovered, (r, c), (0, 1))[8:-8, 8:-8].ravel(), printed[8:-8, 8:-8].ravel()
        )[0, 1]
        for r in range(-6, 7, 2)
        for c in range(-6, 7, 2)
    )
    assert best > 0.85
    # beyond the print the skin is smooth
    assert restored.ridge[np.abs(restored.v_mm - 1.0) < 1.0].std() < 1e-6
    assert restored.pattern == "print" and not restored.cores_mm and len(restored.minutiae) == 0


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (np.zeros((40, 30, 3), np.uint8), "grey"),
        (np.full((300, 300), 255, np.uint8), "no ridges"),
        (np.full((2000, 300), 255, np.uint8), "too large"),
    ],
)
def test_images_that_are_no_print_are_refused(image, message):
    with bad_input(message):
        master_of_print(image)
