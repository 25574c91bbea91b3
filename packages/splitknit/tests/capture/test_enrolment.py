"""Plans, what is finished, what is next."""

import json

import pytest

from refusals import bad_input
from splitknit.io.enrolment import (
    FINGERS,
    EnrolmentPlan,
    PlannedCapture,
    open_enrolment,
)


def finish(enrolment, place):
    folder = enrolment.path(place)
    folder.mkdir(parents=True)
    (folder / "capture.json").write_text("{}")


def test_the_default_plan_is_the_680_captures_of_the_thesis(tmp_path):
    enrolment = open_enrolment(tmp_path / "all")
    assert enrolment.plan.total == 680
    places = list(enrolment.places())
    assert len({place.folder for place in places}) == 680
    assert places[0].folder == "S01/session_1/right_thumb"
    assert places[-1].folder == "S17/session_4/left_little"
    seeds = {enrolment.seeds(place, 0)[0] for place in places}
    assert len(seeds) == 170  # a finger is the same in all its sessions
    assert {enrolment.seeds(place, 0)[1] for place in places} == {0, 1, 2, 3}
    assert enrolment.seeds(places[5], 0) == enrolment.seeds(places[5], 0)
    assert seeds.isdisjoint({enrolment.seeds(place, 1)[0] for place in places})


def test_finished_captures_are_skipped_and_the_others_stay_in_order(tmp_path):
    enrolment = open_enrolment(
        tmp_path / "e", subjects=2, sessions=2, fingers=("right_index", "left_thumb")
    )
    first = [place.folder for place in enrolment.waiting()]
    assert first[:4] == [
        "S01/session_1/right_index",
        "S01/session_1/left_thumb",
        "S02/session_1/right_index",
        "S02/session_1/left_thumb",
    ]
    finish(enrolment, PlannedCapture("S01", 1, "left_thumb"))
    again = open_enrolment(tmp_path / "e")
    assert again.plan == enrolment.plan
    assert [place.folder for place in again.waiting()] == [first[0], *first[2:]]
    assert [p.folder for p in again.waiting(subject="S02", session=2)] == first[6:]
    assert [p.folder for p in again.waiting(finger="left_thumb", session=1)] == [
        "S02/session_1/left_thumb"
    ]


def test_a_plan_may_grow_but_not_shrink(tmp_path):
    folder = tmp_path / "e"
    open_enrolment(folder, subjects=2, sessions=2, fingers=FINGERS[:2])
    assert open_enrolment(folder, subjects=3).plan == EnrolmentPlan(
        subjects=3, sessions=2, fingers=FINGERS[:2]
    )
    assert open_enrolment(folder, fingers=FINGERS).plan == EnrolmentPlan(
        subjects=3, sessions=2, fingers=FINGERS
    )
    for less in ({"subjects": 2}, {"sessions": 1}, {"fingers": FINGERS[:3]}):
        with bad_input(r"3 subjects, 2 sessions and 10 fingers.*not shrink"):
            open_enrolment(folder, **less)
    assert open_enrolment(folder).plan.subjects == 3


def test_folders_that_are_no_enrolment_are_refused(tmp_path):
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "thesis.doc").write_text("x")
    with bad_input(r"holds other files and no enrolment\.json"):
        open_enrolment(tmp_path / "other")
    (tmp_path / "file").write_text("x")
    with bad_input("is a file"):
        open_enrolment(tmp_path / "file")


@pytest.mark.parametrize(
    "text", ["", "[]", "{", '{"format": "x"}', '{"format": "splitknit-enrolment", "version": 2}']
)
def test_a_damaged_plan_is_refused(tmp_path, text):
    open_enrolment(tmp_path / "e", subjects=2)
    (tmp_path / "e" / "enrolment.json").write_text(text)
    with bad_input(r"enrolment\.json' cannot be read.*no capture is lost"):
        open_enrolment(tmp_path / "e")


@pytest.mark.parametrize(
    "change", [{"subjects": "2"}, {"subjects": True}, {"fingers": [1]}, {"fingers": ["toe"]}]
)
def test_a_plan_of_wrong_values_is_refused(tmp_path, change):
    open_enrolment(tmp_path / "e", subjects=2)
    file = tmp_path / "e" / "enrolment.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | change))
    with bad_input("cannot be read"):
        open_enrolment(tmp_path / "e")


@pytest.mark.parametrize(
    "wrong",
    [
        {"subjects": 0},
        {"sessions": 0},
        {"subjects": 10_000},
        {"fingers": ()},
        {"fingers": ("right_toe",)},
        {"fingers": ("right_index", "right_index")},
    ],
)
def test_impossible_plans_are_refused_and_nothing_is_written(tmp_path, wrong):
    with bad_input():
        open_enrolment(tmp_path / "e", **wrong)
    assert not (tmp_path / "e").exists()


@pytest.mark.parametrize("name", ["S18", "s01", "Anna"])
def test_unknown_subjects_sessions_and_fingers_are_refused(tmp_path, name):
    enrolment = open_enrolment(tmp_path / "e")
    with bad_input("S01, S02"):
        enrolment.waiting(subject=name)
    with bad_input("1, 2, 3, 4"):
        enrolment.waiting(session=5)
    with bad_input("right_thumb"):
        enrolment.waiting(finger="thumb")
