"""The thesis's construction: exact on shadows that are cast exactly, and the thesis's own table for
what it is."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from refusals import bad_input
from splitknit.errors import Refused
from splitknit.imaging.view import plane_points
from splitknit.model import Camera, Rig
from splitknit_rig.calibration import light_sources
from splitknit_rig.calibration.lights import (
    BANDS,
    COLUMNS,
    Circle,
    Tip,
    by_circle,
    read_tips,
    write_tips,
)
from splitknit_rig.calibration.lights_found import (
    Rules,
    check_nails,
    check_tips,
    copied_leds,
    judge,
    refusal,
)
from splitknit_rig.calibration.nail import Nail

THESIS = Path(__file__).resolve().parents[4] / "examples" / "thesis_tips.csv"
CAMERA = Camera(px_per_mm=75.7, image_size=(2200, 3200))
CIRCLE = Circle(50.0, 140.0)
TWO = ((-6, -4), (7, 5))


def cast(places, *, leds=7, height=20.0, circle=CIRCLE, camera=CAMERA):
    """Shadows by hand: the line from the LED over the nail's tip to the plane."""
    tips = []
    for k in range(leds):
        angle = 2 * np.pi * k / leds
        led = np.array([np.cos(angle), np.sin(angle)]) * circle.radius_mm + circle.centre_mm
        for number, place in enumerate(np.asarray(places, float), start=1):
            along = circle.height_mm / (circle.height_mm - height)
            end = led + (place - led) * along
            nail_px, tip_px = (
                (float(x * camera.px_per_mm + 1599.5), float(1099.5 - y * camera.px_per_mm))
                for x, y in (place, end)
            )
            tips.append(Tip("white", k, number, nail_px, tip_px))
    return tuple(tips)


def table(tips):
    return write_tips(tips).splitlines()


@pytest.fixture(scope="module")
def thesis():
    tips = read_tips(THESIS.read_text())
    centre = plane_points(CAMERA, [[1575, 1174]])[0]
    return tips, Circle(50.0, 140.0, (float(centre[0]), float(centre[1])))


def test_exact_shadows_give_exact_places():
    circle = Circle(50.0, 140.0, (1.5, -2.0))
    leds, height = by_circle(cast([(-6, -4), (7, 5), (0, 2)], circle=circle), CAMERA, circle)
    assert height == pytest.approx(20.0)
    for led in leds:
        angle = 2 * np.pi * led.led / 7
        assert led.position_mm == pytest.approx(
            [1.5 + 50 * np.cos(angle), -2 + 50 * np.sin(angle), 140], abs=1e-6
        )
        arm = np.array([50 * np.cos(angle), 50 * np.sin(angle), 140])
        assert led.direction == pytest.approx(arm / np.linalg.norm(arm), abs=1e-9)
        assert led.disagreement_deg == pytest.approx(0.0, abs=1e-6)


def test_the_table_of_the_thesis_has_the_figures_of_its_method(thesis):
    """The figures of its own method, to the digits in which they were worked out by others."""
    tips, circle = thesis
    assert len(tips) == 28
    leds, height = by_circle(tips, CAMERA, circle)
    apart = [each.disagreement_deg for each in leds]
    assert [round(each, 1) for each in apart[:7]] == [8.9, 1.1, 6.3, 0.8, 4.1, 6.9, 6.8]
    assert [round(each) for each in apart[8:11]] == [32, 19, 15]
    assert [apart[7], *apart[11:]] == pytest.approx([7.0, 2.5, 9.9, 9.0], abs=0.06)  # NIR 0: 6.947
    assert copied_leds(tips, CAMERA) == {("nir", k) for k in range(1, 7)}
    assert 19 < height < 20
    named = {(each.band, each.led): each for each in leds}
    verdicts = judge(named, copied_leds(tips, CAMERA), set(), 5.0)
    assert list(verdicts.values()) == [
        *("disagrees", "ok", "disagrees", "ok", "ok", "disagrees", "disagrees"),
        *("disagrees", *("copied",) * 6),
    ]
    sentence = refusal(verdicts, named, 5.0)
    assert sentence is not None
    for name in (
        "white 0 (8.9",
        "white 2",
        "white 5",
        "white 6",
        "NIR 0 (6.9",
        *(f"NIR {k}" for k in range(1, 7)),
    ):
        assert name in sentence
    assert "white 1" not in sentence and "`keep`" in sentence


def test_directions_agree_with_the_thesis(thesis):
    """White 1 and 3, which agree, by hand: azimuths of both positions about the circle's centre."""
    tips, circle = thesis
    alone = [by_circle([t for t in tips if t.nail == nail], CAMERA, circle)[0] for nail in (1, 2)]
    for led, azimuths in ((1, (102.6, 99.3)), (3, (-75.7, -73.3))):
        arms = np.array([leds[led].position_mm for leds in alone]) - circle.foot_mm
        assert np.degrees(np.arctan2(arms[:, 1], arms[:, 0])) == pytest.approx(azimuths, abs=0.06)
        assert np.hypot(arms[:, 0], arms[:, 1]) == pytest.approx(50.0)


def test_copied_tips_are_found_at_any_scale():
    """A true tip is not taken for a copy, however small the image."""
    for scale in (1.0, 0.1):
        camera = Camera(px_per_mm=75.7 * scale, image_size=(2200, 3200))
        tips = list(cast([(-3, 0), (3, 0)], camera=camera))
        assert copied_leds(tips, camera) == set()
        x, y = tips[4].tip_px
        tips[5] = replace(tips[5], tip_px=(x + 17 * scale, y))
        assert copied_leds(tips, camera) == {("white", 2)}


def test_leds_of_one_position_are_unchecked():
    leds, _ = by_circle(cast([(5, 5)]), CAMERA, CIRCLE)
    assert leds[0].disagreement_deg is None
    named = {(each.band, each.led): each for each in leds}
    verdicts = judge(named, set(), set(), 5.0)
    assert set(verdicts.values()) == {"unchecked"}
    assert refusal(verdicts, named, 5.0) is None


def test_perspective_of_the_tip_of_the_nail_is_corrected():
    """The tip of a nail is seen further out; its height comes from the shadows, and the LEDs come
    out right."""
    focal = 140 * 75.7
    matrix = np.array([[focal, 0, 1599.5], [0, focal, 1099.5], [0, 0, 1.0]])
    camera = Camera(px_per_mm=75.7, image_size=(2200, 3200), model="perspective", matrix=matrix)
    tips = []
    for tip in cast(TWO):
        x, y = tip.nail_px
        out = 140 / (140 - 20)
        seen = 1599.5 + (x - 1599.5) * out, 1099.5 + (y - 1099.5) * out
        tips.append(replace(tip, nail_px=seen))
    leds, height = by_circle(tips, camera, CIRCLE)
    assert height == pytest.approx(20.0, abs=1e-3)
    assert leds[3].disagreement_deg == pytest.approx(0.0, abs=1e-3)


def test_a_written_table_is_read_back():
    tips = read_tips(THESIS.read_text())
    assert read_tips(write_tips(tips)) == tips
    assert [tip.band for tip in tips] == [BANDS[0]] * 14 + [BANDS[1]] * 14


def test_spaces_blank_lines_comments_and_further_columns_are_ignored():
    head = ", ".join([*(name.upper() for name in COLUMNS), "remark"])
    tips = read_tips(
        f"\ufeff# typed\n{head}\n\n WHITE , 3, 1, 10, 20.5, 30, 4e1, blurred\n,,,,,,,\n"
    )
    assert tips == (Tip("white", 3, 1, (10.0, 20.5), (30.0, 40.0)),)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda lines: lines[:1], "no rows"),
        (lambda lines: [], "is empty"),
        (lambda lines: [lines[0].replace("tip_y_px", "y"), *lines[1:]], "lacks tip_y_px"),
        (lambda lines: [lines[0], lines[1].replace("white", "red")], "white or nir"),
        (lambda lines: [lines[0], lines[1].replace("white,0", "white,7")], "led must be 0 to 6"),
        (
            lambda lines: [lines[0], lines[1].replace("white,0,1", "white,0,one")],
            "nail must be a whole number",
        ),
        (lambda lines: [lines[0], lines[1].rsplit(",", 1)[0] + ",?"], "tip_y_px must be a number"),
        (lambda lines: [lines[0], lines[1].rsplit(",", 1)[0]], "6 fields"),
        (lambda lines: [lines[0], "a" * 200_000], "not a table in CSV"),
        (lambda lines: [*lines, lines[5]], "row 15 is for white 2, nail 1, as an earlier row is"),
    ],
)
def test_a_table_that_cannot_be_read_is_refused(change, words):
    lines = change(table(cast(TWO)))
    with bad_input(words):
        read_tips("\n".join(lines))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda tips: [tip for tip in tips if tip.led != 3], "no row for white 3"),
        (
            lambda tips: [tip for tip in tips if (tip.led, tip.nail) != (3, 2)],
            "white 3 at nail 1 only",
        ),
        (
            lambda tips: [replace(tips[0], tip_px=(3300.0, 5.0)), *tips[1:]],
            "white 0, nail 1: .* outside the image",
        ),
        (lambda tips: [replace(tips[0], nail_px=(5.0, 2300.0)), *tips[1:]], "outside the image"),
    ],
)
def test_an_incomplete_table_is_refused(change, words):
    tips = list(cast(TWO))
    check_tips(tips, CAMERA.image_size)
    with bad_input(words):
        check_tips(change(tips), CAMERA.image_size)


def test_a_missing_shadow_and_a_nail_outside_the_circle_are_refused():
    tips = list(cast(TWO))
    at_nail = [*tips[:3], replace(tips[3], tip_px=tips[3].nail_px), *tips[4:]]
    with bad_input("white 1, nail 2: there is no shadow"):
        by_circle(at_nail, CAMERA, CIRCLE)
    with bad_input(r"white 0, nail 1: .*circle"):
        by_circle(tips, CAMERA, Circle(5.0, 140.0))


def test_a_nail_number_must_be_one_place():
    tips = list(cast(TWO))
    check_nails(tips, CAMERA)
    x, y = tips[4].nail_px
    with bad_input(r"nail 1 .* one position"):
        check_nails([*tips[:4], replace(tips[4], nail_px=(x + 300, y)), *tips[5:]], CAMERA)
    with bad_input(r"nails 1 and 2 .* one"):
        check_nails(cast([(-6, -4), (-6, -3.9)]), CAMERA)


def test_a_shadow_that_leaves_the_picture_gets_a_finding(monkeypatch):
    """Of LEDs that are kept, the worst finding first, and of LEDs that are refused."""
    tips, lost = [*cast([(-6, -4), (7, 5), (0, 2)])], ["white 0 at nail 3"]
    first = tips[0]
    tips[0] = replace(first, tip_px=(first.tip_px[0] + 400, first.tip_px[1] - 400))
    monkeypatch.setattr(light_sources, "tips_of_photos", lambda *_, **__: (tips, {}, lost))

    def lights(*, keep):
        rules = Rules(Nail(), "circle", keep=keep)
        files = {"encoding": None, "show": None, "tips_out": None}
        return light_sources.lights_of_nail(
            Path("nail"), Rig(CAMERA, ()), CIRCLE, rules, None, **files
        )

    kept = lights(keep=True)
    codes = ["kept-leds", "one-band", "shadow-out-of-view"]
    assert [finding.code for finding in kept.findings] == codes
    assert "Please note: the shadow leaves the picture for white 0 at nail 3." in str(kept)
    with pytest.raises(Refused) as refused:
        lights(keep=False)
    assert [finding["code"] for finding in refused.value.facts["findings"]] == codes[1:]
    assert refused.value.facts["shadows_out_of_the_picture"] == lost
