"""Sides of a comparison: prints, photographs and folders, with what finds their ridges replaced."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from refusals import bad_input
from splitknit.errors import BadInput
from splitknit.findings import Finding, Severity
from splitknit_match.matching import inputs
from splitknit_match.matching.inputs import Pixels, print_template, read_side
from splitknit_match.matching.template import failed_template
from splitknit_match.prints import fingerphoto, from_file, make, pressed
from splitknit_match.records.minutiae_record import FingerView, Minutiae, no_minutiae
from splitknit_match.records.pictures import PrintFile

PPI = 500.0


@dataclass
class Ridges:
    """What is used of pressed ridges."""

    lacks: str = ""
    several: bool = False
    image: np.ndarray | None = None


@dataclass
class Pressed:
    """What is used of a pressed print."""

    weight: np.ndarray


def waves(rows=300, columns=260):
    x = np.arange(columns) * 25.4 / PPI
    line = 127 + 90 * np.sin(2 * np.pi * x / 0.5)
    return np.broadcast_to(line, (rows, columns)).astype(np.uint8).copy()


def some_minutiae(count, size=(300, 260)):
    x = 60 + np.arange(count, dtype=np.int32) % 100
    y = 60 + np.arange(count, dtype=np.int32) // 100
    kind = np.ones(count, np.uint8)
    return Minutiae(x, y, np.zeros(count), kind, 50 * kind, size)


@pytest.fixture
def finder(monkeypatch):
    """Ridges, their weights and minutiae that are found; and what they were sought in."""
    weight = np.zeros((300, 260))
    weight[30:270, 20:240] = 0.5
    state = {
        "ridges": Ridges(), "weight": weight, "minutiae": some_minutiae(30), "sought": [],
    }  # fmt: skip

    def press(item, *, pressed):
        state["sought"].append((item.image.shape, item.resolution_ppi, pressed))
        return Pressed(state["weight"])

    monkeypatch.setattr(pressed, "pressed_ridges", lambda image: state["ridges"])
    monkeypatch.setattr(from_file, "pressed_print", press)
    monkeypatch.setattr(make, "enhance", lambda finger: "enhanced")
    monkeypatch.setattr(make, "minutiae_by_phase", lambda finger, enhanced: state["minutiae"])
    return state


def test_a_print_is_used_where_its_ridges_were_found(finder):
    template = print_template(waves())
    assert finder["sought"] == [((300, 260), PPI, finder["ridges"])]
    assert template.lacks == ""
    pixel = (25.4 / PPI) ** 2
    assert template.area_mm2 == pytest.approx(240 * 220 * pixel, rel=0.05)
    assert template.pitch_mm == 0.1
    assert template.minutiae.count == 30
    coarser = print_template(waves()[::2, ::2], 250.0)
    assert finder["sought"][-1][0] == (300, 260)
    assert coarser.minutiae.count == 30


@pytest.mark.parametrize(
    ("count", "rows", "lacks"),
    [
        (3, 240, True),  # 136 mm2: 2.04 to 136 minutiae
        (2, 240, False),
        (136, 240, True),
        (137, 240, False),
        (1, 170, True),  # 96 mm2: not judged
        (150, 170, True),
        (1, 178, False),  # 101 mm2
    ],
)
def test_a_print_has_as_many_minutiae_as_a_finger(finder, count, rows, lacks):
    finder["weight"][30 + rows :] = 0
    finder["minutiae"] = some_minutiae(count)
    template = print_template(waves())
    area_mm2 = rows * 220 * (25.4 / PPI) ** 2
    expected = f"no print of a finger: {count} lines end or fork on {area_mm2:.0f} mm²"
    assert template.lacks == ("" if lacks else expected)
    assert template.empty != lacks
    if not lacks:
        assert template.minutiae.count == 0
        assert template.minutiae.size == (300, 260)


def test_ten_square_millimetres_are_a_print(finder):
    finder["minutiae"] = no_minutiae((300, 260))
    for side, empty in ((58, True), (76, False)):
        finder["weight"][:] = 0
        finder["weight"][100 : 100 + side, 100 : 100 + side] = 1
        assert print_template(waves()).empty == empty


def test_pictures_without_ridges_are_failures_to_acquire(finder, monkeypatch):
    finder["ridges"] = Ridges("ridges of one width")
    template = print_template(waves())
    assert template.empty
    assert template.lacks == "ridges of one width"

    def nothing(image):
        raise BadInput("no ridges.")

    monkeypatch.setattr(pressed, "pressed_ridges", nothing)
    template = print_template(waves())
    assert (template.empty, template.lacks) == (True, "")
    assert template.minutiae.count == 0


def test_ridges_of_a_photograph_stand_for_its_picture(finder):
    pressed = Ridges(image=waves())
    blank = np.full((300, 260), 128, np.uint8)
    template = print_template(blank, pressed=pressed)
    assert finder["sought"][0][2] is pressed
    assert template.area_mm2 > 100
    assert template.minutiae.count == 30


@pytest.fixture
def prints_made(monkeypatch):
    """Pictures that templates were made of."""
    pictures = []

    def template(image, *, pressed=None, kind):
        pictures.append((image, pressed))
        return replace(failed_template(), kind=kind)

    monkeypatch.setattr(inputs, "print_template", template)
    return pictures


def test_a_photograph_is_a_side_with_its_quality(prints_made, monkeypatch, tmp_path):
    @dataclass
    class Source:
        flat: np.ndarray
        pressed: str
        findings: tuple[Finding, ...]
        quality: float

    note = Finding("resampled", "it was resampled.")
    source = Source(waves(), "ridges", (note,), 61.0)
    asked = []
    monkeypatch.setattr(fingerphoto, "fingerphoto", lambda path: "photo")
    monkeypatch.setattr(
        fingerphoto, "read_fingerphoto", lambda *values: asked.append(values) or source
    )
    path = tmp_path / "a.jpg"
    path.write_bytes(b"")
    where = inputs.PhotoFinger(None, "1,2,3,4")
    side = read_side(path, "metric", resolution_ppi=508.0, where=where)
    assert asked == [(path, pytest.approx(20.0), where, "photo")]
    assert prints_made == [(source.flat, "ridges")]
    assert (side.path, side.kind, side.quality, side.surface) == (path, "photo", 61.0, None)
    assert side.picture is source.flat
    assert (side.template.empty, side.template.kind) == (True, "scaled photo")
    assert side.findings == (note.of_file(path),)
    assert read_side(path, "metric").template.kind == "photo"
    assert asked[-1] == (path, None, None, "photo")
    assert inputs.is_photo(path)
    monkeypatch.setattr(fingerphoto, "fingerphoto", lambda path: None)
    assert not inputs.is_photo(path)
    for name in ("a.skt", "a.NPZ"):
        assert not inputs.is_photo(Path(name))
    assert not inputs.is_photo(b"")


def test_pixels_are_a_print_at_their_resolution(prints_made):
    side = read_side(Pixels(waves(300, 200), 1000.0), "metric")
    assert (side.path, side.kind) == (Path("array"), "print")
    assert prints_made[0][0].shape == side.picture.shape == (150, 100)


@pytest.mark.parametrize(
    ("report", "doubted"),
    [
        (None, True),
        ('{"method": "file"}', True),
        ('{"method": "metric"}', False),
        ('{"method": "metric", "findings": [{"code": "SCALE", "message": "x."}]}', True),
    ],
)
def test_the_resolution_of_a_folder_of_print_may_be_doubted(
    prints_made, monkeypatch, tmp_path, report, doubted
):
    from splitknit_match.prints import sources

    doubt = Finding("low-contrast", "it cannot be right.", Severity.DOUBT)
    note = Finding("resampled", "it was resampled.")
    picture = PrintFile(waves(), PPI, {})
    picture = replace(picture, findings=(note,))
    monkeypatch.setattr(from_file, "read_print_folder", lambda folder: (picture, "view"))
    monkeypatch.setattr(from_file, "resolution_doubt", lambda item: doubt)
    monkeypatch.setattr(from_file, "minutiae_of", lambda view: some_minutiae(5))
    for name in ("map.npz", "print.png"):
        (tmp_path / name).write_bytes(b"")
    if report is not None:
        text = report.replace("SCALE", sources.SCALE_OF_RIDGES)
        (tmp_path / "report.json").write_text(text, encoding="utf-8")
    side = read_side(tmp_path, "metric")
    assert (side.path, side.kind, side.minutiae.count) == (tmp_path, "print", 5)
    expected = (note, doubt) if doubted else (note,)
    assert side.findings == tuple(finding.of_file(tmp_path) for finding in expected)
    assert (side.doubt is not None) == doubted
    monkeypatch.setattr(from_file, "read_print_folder", lambda folder: (picture, None))
    monkeypatch.setattr(from_file, "resolution_doubt", lambda item: None)
    side = read_side(tmp_path, "metric")
    assert side.minutiae is None
    assert side.findings == (note.of_file(tmp_path),)


def test_results_in_memory_and_records_are_sides(monkeypatch, tmp_path):
    monkeypatch.setattr(inputs, "surface_template", lambda surface: failed_template())
    monkeypatch.setattr(inputs, "surface_of", lambda result: "surface")
    result = object.__new__(inputs.Reconstruction)
    capture = object.__new__(inputs.Capture)
    asked = []
    monkeypatch.setattr(inputs, "_reconstructed", lambda *v: asked.append(v) or result)
    for finger in (result, capture):
        side = read_side(finger, "snk", print)
        assert (side.path, side.kind) == (Path("reconstruction"), "result")
        assert side.surface == "surface"
    assert asked == [(capture, "snk", print)]
    view = object.__new__(FingerView)
    path = tmp_path / "a.fmr"
    path.write_bytes(b"")
    monkeypatch.setattr(fingerphoto, "fingerphoto", lambda path: None)
    monkeypatch.setattr(from_file, "read_one_finger", lambda path, ppi, ridges: view)
    monkeypatch.setattr(from_file, "minutiae_of", lambda view: some_minutiae(5))
    side = read_side(path, "snk")
    assert (side.path, side.kind, side.minutiae.count) == (path, "minutiae", 5)

    def refuse(*values):
        raise BadInput("it is damaged.")

    monkeypatch.setattr(from_file, "minutiae_of", refuse)
    with bad_input(r"a\.fmr.*it is damaged"):
        read_side(path, "snk")
    monkeypatch.setattr(inputs, "surface_template", refuse)
    with bad_input(r"reconstruction.*it is damaged"):
        read_side(result, "snk")
