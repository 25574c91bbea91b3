"""People whose fingers are similar, sessions that differ, and captures that follow from their place
alone."""

import hashlib
from dataclasses import replace

import numpy as np
import pytest

from refusals import bad_input
from splitknit.nominal import default_rig
from splitknit_simulator.population.people import (
    ARCHES,
    DIGITS,
    FINGERS,
    RADIAL,
    TENTED,
    TWIN,
    WHORLS,
    draw_person,
)
from splitknit_simulator.population.sessions import (
    DEFORMATION_MM,
    LARGE,
    SWELLING_SD,
    PopulationSettings,
    SessionRanges,
    draw_impression,
    population_capture,
)

COUNT = 500
SIDES = ("right", "left")
SMALL = PopulationSettings(scale=0.08)


@pytest.fixture(scope="module")
def people():
    return [draw_person(5, number) for number in range(1, COUNT + 1)]


@pytest.fixture(scope="module")
def impressions(people):
    camera = default_rig(0.1).camera
    return [
        [
            draw_impression(p.fingers[name], SessionRanges(), camera, (5, p.number, 2))
            for name in ("right_index", "left_ring")
        ]
        for p in people
    ]


def _shapes(people, name, field):
    return np.array([getattr(p.fingers[name].finger.shape, field) for p in people])


def _correlation(a, b):
    return float(np.corrcoef(a, b)[0, 1])


def test_a_person_depends_on_seed_and_number_alone(people):
    assert draw_person(5, 7) == people[6]
    assert draw_person(6, 7) != people[6]
    seeds = {own.finger.seed for p in people for own in p.fingers.values()}
    assert len(seeds) == 10 * COUNT


def test_classes_have_the_frequencies_of_their_digit(people):
    for name in FINGERS:
        side, digit = name.split("_")
        k = DIGITS.index(digit)
        arch, whorl = ARCHES[side][k], WHORLS[side][k]
        radial, ulnar = sorted(("left_loop", "right_loop"), reverse=side == "left")
        fractions = {
            "arch": arch * (1 - TENTED),
            "tented_arch": arch * TENTED,
            radial: (1 - arch - whorl) * RADIAL[k],
            ulnar: (1 - arch - whorl) * (1 - RADIAL[k]),
            "whorl": whorl * (1 - TWIN),
            "twin_loop": whorl * TWIN,
        }
        drawn = [p.fingers[name].finger.pattern for p in people]
        for pattern, fraction in fractions.items():
            spread = np.sqrt(fraction * (1 - fraction) / COUNT)
            assert abs(drawn.count(pattern) / COUNT - fraction) < 4 * spread + 1e-9, (name, pattern)


def test_pattern_classes_of_a_person_correlate(people):
    whorls = np.array(
        [
            [
                p.fingers[f].finger.pattern in ("whorl", "twin_loop")
                for f in ("right_ring", "left_thumb")
            ]
            for p in people
        ]
    )
    assert _correlation(whorls[:, 0], whorls[:, 1]) > 0.1


def test_the_shapes_of_both_hands_are_mirror_images(people):

    def correlation(field):
        return _correlation(*(_shapes(people, f"{side}_middle", field) for side in SIDES))

    for field in ("sideways_mm", "skew"):
        assert correlation(field) < -0.75
    for field, least in (
        ("width_mm", 0.9),
        ("length_mm", 0.85),
        ("pad_bulge", 0.75),
        ("tip_drop_mm", 0.7),
    ):
        assert correlation(field) > least
    tilts = np.array(
        [[p.fingers[f"{side}_index"].finger.skin.creases[0].tilt for side in SIDES] for p in people]
    )
    assert _correlation(tilts[:, 0], tilts[:, 1]) < -0.75


def test_impressions_stay_in_their_ranges(impressions):

    def drawn(name):
        """Of two fingers of every person."""
        return np.array([[getattr(finger, name) for finger in both] for both in impressions])

    low, high = DEFORMATION_MM
    values = drawn("deformation_mm")
    assert low <= values.min() < low + 0.1 * (high - low)
    assert high - 0.1 * (high - low) < values.max() <= high
    swelling = drawn("swelling")
    assert 0.02 < np.abs(swelling).max() <= 2 * SWELLING_SD
    assert _correlation(*swelling.T) > 0.65
    assert _correlation(drawn("moisture")[:, 0], drawn("roughness")[:, 0]) < -0.99
    partial, insertion = drawn("partial"), drawn("insertion_mm")
    assert 0.06 < partial.mean() < 0.14
    assert insertion[partial].max() <= 22.0
    assert insertion[~partial].min() >= 26.0
    assert 5.5 < drawn("roll_deg").std() < 7.5


@pytest.mark.slow
def test_a_capture_depends_on_person_finger_and_session_alone():
    def digest(photographed):
        parts = [band.pixels.tobytes() for band in photographed.capture.bands.values()]
        parts += [
            key.encode() + np.ascontiguousarray(photographed.truth[key]).tobytes()
            for key in sorted(photographed.truth)
        ]
        return hashlib.sha256(b"".join(parts)).hexdigest()

    person = SMALL.person(2)
    master = person.fingers["left_little"].finger.master()
    first = population_capture(SMALL, person, "left_little", 2)
    population_capture(SMALL, person, "left_little", 1, master=master)
    threads = replace(SMALL, render=replace(SMALL.render, workers=2))
    assert digest(
        population_capture(threads, SMALL.person(2), "left_little", 2, master=master)
    ) == digest(first)
    assert first.capture.subject == {"id": "S02", "finger": "left_little", "session": 2}
    films = replace(SMALL, films=replace(SMALL.films, kind="analyser"))
    polarised = population_capture(films, person, "left_little", 2, master=master).capture
    assert "white_crossed" in polarised.bands
    assert polarised.bands["white_crossed"].pixels.mean() < polarised.bands["white"].pixels.mean()
    assert first.facts["sex"] == person.sex
    assert first.truth["impression_roll_deg"] == pytest.approx(
        np.rad2deg(first.truth["landmark_roll_rad"])
    )
    assert first.truth["master_minutiae_mm"].shape == (first.facts["minutiae"], 3)
    assert not set(LARGE) & first.truth.keys()
    told = np.array([led.intensity for led in first.capture.rig.leds])
    assert 0.001 < np.abs(first.truth["led_intensity"] / told - 1).max() < 0.02
    assert [led.intensity for led in SMALL.rig().leds] == list(told)


def test_unknown_fingers_people_and_ranges_are_refused():
    with bad_input("'left_toe' is not a finger"):
        population_capture(SMALL, SMALL.person(1), "left_toe", 1)
    with bad_input("numbered from 1"):
        draw_person(0, 0)
    with bad_input(r"sessions\.roll_sd_deg must be from 0 to 12"):
        SessionRanges(roll_sd_deg=30.0)
    with bad_input(r"population\.truth"):
        PopulationSettings(truth="none")
