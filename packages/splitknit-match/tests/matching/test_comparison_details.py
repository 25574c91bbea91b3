"""Comparisons of two sides: what each method is handed, which rates hold, and what is reported."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import splitknit_match
from refusals import bad_input
from splitknit.errors import BadInput
from splitknit.findings import Finding, Severity
from splitknit.reconstruction import Surface
from splitknit_match.matching import inputs, methods, thesis
from splitknit_match.matching import match as match_module
from splitknit_match.matching.fusion import _FusedMatch
from splitknit_match.matching.inputs import Pixels, Side, held, is_of_minutiae, read_side
from splitknit_match.matching.results import MatchDecision, PlaneAlignment, Rated
from splitknit_match.matching.ridge import RidgeMatch
from splitknit_match.matching.score import own_rates_document
from splitknit_match.matching.template import Template, failed_template, pack
from splitknit_match.matching.thesis import FingerImages, ImageMatch, ThesisSettings
from splitknit_match.records.minutiae_record import KINDS, Minutiae, no_minutiae, pack_minutiae

RIDGES = RidgeMatch(0.5, 0.6, 150.0, 3.0, 1.0, -2.0, compared=True)
FUSED = _FusedMatch(7.0, 12.0, RIDGES, (0.5, 0.6, 12.0, math.nan))


def some_minutiae(count=12):
    x = np.arange(count, dtype=np.int32)
    kind = np.ones(count, np.uint8)
    return Minutiae(x, x, x * (np.pi / 16), kind, 50 * kind, (216, 196))


def side_of(kind, name="a.png", **changes):
    template = Template(
        np.zeros((110, 100), np.uint8), np.ones((110, 100), bool), 0.1, some_minutiae()
    )
    template = replace(template, kind=kind if kind in KINDS else "print")
    picture = np.zeros((9, 9), np.uint8) if kind in ("print", "photo") else None
    return replace(Side(Path(name), kind, None, template, picture), **changes)


SURFACE = Surface(*[np.zeros((2, 2))] * 4, 0.1, np.eye(3), (2, 2))  # type: ignore[arg-type]


@pytest.fixture
def rated(monkeypatch):
    """What rates were asked for; comparisons are replaced by fixed results."""
    asked = []

    def rate(*values):
        asked.append(values)
        decision = MatchDecision(True, 1e-4, 0.1)
        return Rated(fmr=1e-4, decision=decision, answer="match")

    monkeypatch.setattr(methods, "rate", rate)
    monkeypatch.setattr(methods, "fused_match", lambda a, b, quick: FUSED)
    monkeypatch.setattr(methods, "ridge_match", lambda a, b: RIDGES)
    monkeypatch.setattr(methods, "fused_photo", lambda *values, quick: (FUSED, 1.0, 0))
    monkeypatch.setattr(methods, "minutiae_match", lambda a, b: 41.0)
    return asked


def compared(method, a, b, **changes):
    options = {"fmr": 0.01, "own": None, "thesis": ThesisSettings()}
    return methods.compare_sides(method, a, b, **options | changes)


@pytest.mark.parametrize(
    ("method", "kinds", "scores"),
    [
        ("fusion", ("print", "print"), "fusion"),
        ("fusion", ("photo", "photo"), "fingerphotos alone"),
        ("fusion", ("photo", "print"), "fingerphotos and prints"),
        ("fusion", ("print", "photo"), "fingerphotos and prints"),
        ("fusion", ("scaled photo", "photo"), "fingerphotos alone"),
        ("fusion", ("surface", "print"), "contactless and prints"),
        ("fusion", ("contactless", "surface"), "contactless alone"),
        ("fusion", ("contactless", "photo"), "fusion of photographs with surfaces"),
        ("ridge", ("photo", "print"), "ridge on photographs"),
        ("ridge", ("print", "surface"), "ridge"),
    ],
)
def test_rates_are_of_what_was_compared(rated, method, kinds, scores):
    match = compared(method, side_of(kinds[0]), side_of(kinds[1], "b.png"))
    similarity = 7.0 if method == "fusion" else 0.5
    assert rated == [(similarity, scores, 150.0, 0.01, None)]
    assert (match.method, match.similarity, match.compared) == (method, similarity, True)
    assert (match.overlap_mm2, match.correlation) == (150.0, 0.6)
    assert match.alignment == PlaneAlignment(3.0, 1.0, -2.0)
    assert (match.a.path, match.b.path) == ("a.png", "b.png")
    assert (match.fmr, match.answer) == (1e-4, "match")
    if method == "fusion":
        assert (match.similarity_of_ridges, match.similarity_of_minutiae) == (0.5, 12.0)
        assert (match.a.minutiae, match.a.acquired, match.b.minutiae) == (12, True, 12)


def test_photographs_are_tried_at_several_scales(rated, monkeypatch):
    asked = []
    for scale, number, words in (
        (1.06, 0, "it fits best 6 % larger."),
        (0.88, 1, "it fits best 12 % smaller."),
        (1.009, 0, None),
        (0.98, 0, "it fits best 2 % smaller."),
    ):

        def tried(a, b, photos, quick, fit=(FUSED, scale, number)):
            asked.append((a.template, b.template, photos))
            return fit

        monkeypatch.setattr(methods, "fused_photo", tried)
        a, b = side_of("photo"), side_of("print", "b.png")
        match = compared("fusion", a, b)
        assert asked[-1] == (a.template, b.template, [True, False])
        if words is None:
            assert match.findings == ()
        else:
            (finding,) = match.findings
            assert finding.code == "fingerphoto-scale"
            assert finding.files == (("a.png", "b.png")[number],)
            assert str(finding).endswith(words)
    compared("fusion", side_of("scaled photo"), b)
    assert len(asked) == 4
    compared("fusion", b, b)
    assert len(asked) == 4


def test_the_fusion_takes_prints_with_minutiae(rated):
    bare = side_of("result")
    bare = replace(bare, template=replace(bare.template, minutiae=None))
    for pair in ((bare, side_of("print")), (side_of("print"), bare)):
        with bad_input() as caught:
            compared("fusion", *pair)
        assert str(caught.value) == (
            "a.png is a result without minutiae of a print; the method fusion compares prints:"
            " name one, or a template (.skt) that was made of one."
        )
    few = side_of("print")
    few = replace(few, template=replace(few.template, minutiae=no_minutiae()))
    assert compared("fusion", few, few).a.acquired  # ridges
    empty = replace(few, template=replace(failed_template(), minutiae=no_minutiae()))
    match = compared("fusion", few, empty)
    assert (match.b.acquired, match.answer) == (False, "not acquired")
    (finding,) = match.findings
    assert (finding.code, finding.files) == ("failure-to-acquire", ("a.png",))


def test_minutiae_are_counted_and_prints_judged(rated, monkeypatch):
    record = Side(Path("a.fmr"), "minutiae", minutiae=some_minutiae(13))
    second_record = replace(record, path=Path("b.fmr"))
    match = compared("minutiae", record, second_record)
    assert rated[-1] == (41.0, "minutiae_of_prints", None, 0.01, None)
    assert (match.method, match.similarity, match.compared) == ("minutiae", 41.0, True)
    assert (match.a.path, match.b.path) == ("a.fmr", "b.fmr")
    assert match.a.minutiae == 13
    assert (match.a.acquired, match.a.area_mm2) == (True, 0.0)
    taken = side_of("print", minutiae=some_minutiae(14))
    match = compared("minutiae", taken, record)
    assert match.a.minutiae == 14
    few = replace(record, minutiae=some_minutiae(9))
    match = compared("minutiae", record, few)
    assert (match.compared, match.answer) == (False, "not acquired")
    assert str(match.findings[0]).endswith(
        "a.fmr holds fewer than ten minutiae (failure to acquire)."
    )
    surface = side_of("surface", minutiae=some_minutiae(11))
    assert compared("minutiae", surface, surface).a.minutiae == 11
    assert rated[-1][1] not in methods.TABLES  # rates of two surfaces were not measured
    compared("minutiae", surface, record)
    assert rated[-1][1] == "minutiae_of_prints"
    monkeypatch.setattr(
        "splitknit.finger.ridges.surface_print",
        lambda surface, ppi: np.zeros((3, int(ppi)), np.uint8),
    )
    surface = side_of("surface", surface=SURFACE)
    assert methods._print_of(surface).shape == (3, 500)

    def refuse(*values):
        raise BadInput("no print.")

    monkeypatch.setattr("splitknit.finger.ridges.surface_print", refuse)
    with bad_input(r"a\.png.*no print"):
        methods._print_of(surface)


def test_images_of_surfaces_are_compared(rated, monkeypatch):
    images = iter([FingerImages({}, np.ones((2, 2), bool), 20.0), "b", "a", "b"])
    monkeypatch.setattr(methods, "surface_images", lambda surface: next(images))
    handed = []

    def matched(*values):
        handed.append(values)
        return ImageMatch(0.4, {"relief": 0.5}, 0.9, -30, {"relief": 0.2}, compared=True)

    monkeypatch.setattr(thesis, "thesis_match", matched)
    a, b = side_of("result", surface=SURFACE), side_of("result", "b", surface=SURFACE)
    settings = ThesisSettings(gate=0.3)
    match = compared("thesis", a, b, thesis=settings)
    assert handed[0][1:] == ("b", settings)
    assert rated[-1] == (0.4, "thesis", None, 0.01, None)
    assert (match.method, match.overlap, match.compared) == ("thesis", 0.9, True)
    assert (match.distances, match.dissimilarity) == ({"relief": 0.5}, {"relief": 0.2})
    assert match.alignment == PlaneAlignment(right_mm=-1.5)
    assert (match.a.path, match.b.path) == ("a.png", "b")
    for pair in ((a, side_of("print", "c.png")), (side_of("print", "c.png"), a)):
        images = iter("ab")
        with bad_input() as caught:
            compared("thesis", *pair)
        assert str(caught.value) == (
            "c.png is a print; the method thesis compares surfaces: name a capture or a result."
        )


def no_match(monkeypatch, answer="no match"):
    rated = Rated(fmr=0.2, decision=MatchDecision(False, 1e-4, 0.1), answer=answer)
    monkeypatch.setattr(methods, "rate", lambda *values: rated)


def test_a_mirrored_print_is_doubted(rated, monkeypatch):
    no_match(monkeypatch)
    asked = []
    monkeypatch.setattr(methods, "at_one_scale", lambda a, b: None)
    monkeypatch.setattr(methods, "_prints_match", lambda *v: asked.append(v) or True)
    a, b = side_of("print"), side_of("print", "b.png")
    a.template.valid[:, :30] = False
    match = compared("fusion", a, b)
    np.testing.assert_array_equal(asked[0][0].valid, a.template.valid[:, ::-1])
    assert asked[0][1:] == (b.template, 0.01, None)
    assert (match.answer, match.decision) == ("undecided", None)
    assert match.undecided == (
        "one seen in a mirror, both match: one of the pictures is mirrored; turn it round"
    )
    assert [finding.code for finding in match.findings] == ["mirrored-print"]
    assert match.findings[0].severity == Severity.DOUBT
    assert compared("ridge", a, b).answer == "no match"
    assert compared("fusion", side_of("photo"), b).answer == "no match"
    no_match(monkeypatch, "undecided")
    assert compared("fusion", a, b).findings == ()
    no_match(monkeypatch)
    monkeypatch.setattr(methods, "_prints_match", lambda *values: False)
    assert compared("fusion", a, b).answer == "no match"
    doubt = Finding("unequal-scales", "x.", Severity.DOUBT)
    monkeypatch.setattr(methods, "scale_doubt", lambda *values: asked.append(values) or doubt)
    match = compared("fusion", a, b)
    assert asked[-1] == (a.template, b.template, 0.01, None)
    assert (match.answer, match.undecided) == ("undecided", methods.reason(doubt))
    compared("fusion", a, b, own="own")
    assert asked[-1] == (a.template, b.template, 0.01, "own")


def test_findings_of_both_sides_are_kept_worst_first(rated):
    note = Finding("resampled", "it was resampled.")
    doubt = Finding("low-contrast", "its resolution is doubtful.", Severity.DOUBT)
    a = side_of("print", findings=(note,))
    b = side_of("print", "b.png", findings=(doubt,), quality=40.0)
    match = compared("fusion", a, b)
    assert set(match.findings) == {note, doubt}
    assert match.findings[0] == doubt
    assert (match.answer, match.b.quality) == ("match", 40.0)  # one resolution confirms the other
    assert methods.template_findings(b) == (doubt,)
    assert b.doubt == doubt
    assert a.doubt is None
    with bad_input("Nothing is kept of it; give the true resolution"):
        inputs.undoubted(b)
    assert inputs.undoubted(a) is a


def test_a_template_file_is_written_beside_its_inputs(tmp_path):
    target = tmp_path / "a.skt"
    side = side_of("print")
    written = methods.write_template_file(target, side)
    assert (written.file, written.bytes) == (str(target), target.stat().st_size)
    assert read_side(target, "metric").payload == side.payload == pack(side.template)
    assert methods.write_template_file(None, side) is None
    methods.check_template_file(None, target)
    methods.check_template_file(target, tmp_path / "b.skt", b"")
    with bad_input(r"a\.skt' is one of the inputs; name another file\."):
        methods.check_template_file(target, b"", tmp_path / "x" / ".." / "a.skt")
    target.write_bytes(b"")
    methods.check_template_file(target)  # a failure to acquire
    template_file = tmp_path / "a.txt"
    for content in (b"", b"x"):
        template_file.write_bytes(content)
        with bad_input("template"):
            methods.check_template_file(template_file)


@pytest.fixture
def reads(monkeypatch):
    """What was read: files named ``photo`` are photographs."""
    asked = []

    def read(finger, preset, progress, ppi=None, *, ridges=None, where=None):
        asked.append((finger, preset, ppi, where))
        progress("reading", 0.1)
        return side_of("print", str(finger))

    monkeypatch.setattr(inputs, "read_side", read)
    monkeypatch.setattr(inputs, "is_photo", lambda finger: "photo" in str(finger))
    return asked


@pytest.mark.parametrize("kept", [False, True])
@pytest.mark.parametrize(
    ("names", "resolutions", "chosen"),
    [
        (("print", "print2"), (400.0, 400.0), 0),
        (("photo", "print"), (400.0, None), 0),
        (("print", "photo"), (None, 400.0), 1),
        (("photo", "photo2"), (400.0, 400.0), 0),
    ],
)
def test_the_resolution_and_the_mask_are_of_the_photograph(  # noqa: PLR0917
    reads, rated, tmp_path, names, resolutions, chosen, kept
):
    stages = []
    files = [tmp_path / name for name in names]
    if kept:  # files are read at the same time
        for file in files:
            file.write_bytes(b"")
    match = splitknit_match.match(
        *files,
        "fusion",
        preset="snk",
        resolution_ppi=400.0,
        box="1,2,3,4",
        progress=lambda stage, fraction: stages.append((stage, fraction)),
    )
    assert [match.a.path, match.b.path] == [str(file) for file in files]
    by_file = {read[0]: read[1:] for read in reads}
    for file, resolution in zip(files, resolutions, strict=True):
        assert by_file[file][:2] == ("snk", resolution)
    assert by_file[files[1 - chosen]][2] is None
    assert by_file[files[chosen]][2].box == "1,2,3,4"
    assert stages == [("reading", 0.1), ("comparing", 0.9), ("done", 1.0)]
    assert match.template is None


def test_options_reach_the_comparison(rated, tmp_path):
    payload = side_of("print").payload
    for method, expected in (("auto", "fusion"), ("ridge", "ridge"), ("fusion", "fusion")):
        match = splitknit_match.match(payload, payload, method, fmr=0.02)
        assert match.method == expected
        assert rated[-1][3:] == (0.02, None)
    target = tmp_path / "a.skt"
    match = splitknit_match.match(payload, payload, template=target)
    assert match.template.bytes == target.stat().st_size
    for fmr in (0.0, 1.0):
        with bad_input(f"`fmr` must lie between 0 and 1, but it is {fmr}"):
            splitknit_match.match(payload, payload, fmr=fmr)
    with bad_input("is one of the inputs"):
        splitknit_match.match(target, payload, template=target)
    with bad_input("is one of the inputs"):
        splitknit_match.make_template(target, target)
    for verb in (
        splitknit_match.make_template,
        lambda *v, **how: splitknit_match.match(payload, *v, **how),
    ):
        with bad_input("thesis"):
            verb(payload, settings={"thesis.none": 1})
        assert verb(payload, settings={"thesis.gate": 0.5})
    own = tmp_path / "own.json"
    document = own_rates_document(np.arange(200.0), "of mine", "fusion", 40.0)
    own.write_text(json.dumps(document), encoding="utf-8")
    splitknit_match.match(payload, payload, decision=own)
    assert rated[-1][4].population == "of mine"
    with bad_input() as caught:
        splitknit_match.match(payload, payload, "ridge", decision=own)
    assert str(caught.value) == f"'{own}' is for the method fusion, but ridge compares these."


def test_a_template_is_made_and_written(reads, tmp_path):
    stages = []
    target = tmp_path / "a.skt"
    template = splitknit_match.make_template(
        "photo",
        target,
        "snk",
        resolution_ppi=400.0,
        box="1,2,3,4",
        progress=lambda stage, fraction: stages.append((stage, fraction)),
    )
    (read,) = reads
    assert read[:3] == (Path("photo"), "snk", 400.0)
    assert read[3].box == "1,2,3,4"
    assert stages == [("reading", 0.1), ("done", 1.0)]
    assert template.payload == target.read_bytes()
    assert template.template.bytes == target.stat().st_size
    assert template.a.path == "photo"
    match_module.match_or_make_template("photo", template=target, preset="lin")
    assert reads[-1][:2] == (Path("photo"), "lin")
    assert splitknit_match.make_template(np.zeros((9, 9), np.uint8), resolution_ppi=500).a
    assert isinstance(reads[-1][0], Pixels)


def test_fingers_come_as_paths_pixels_or_templates():
    assert held("a.png") == held(Path("a.png")) == Path("a.png")
    assert held(b"x") == b"x"
    image = np.zeros((8, 6), np.uint8)
    pixels = held(image[:, ::2], 500)
    assert (pixels.resolution_ppi, pixels.image.shape) == (500.0, (8, 3))
    assert pixels.image.flags.c_contiguous
    for ppi in (200, 5080):
        assert held(image, ppi).resolution_ppi == ppi
    assert held(image, 500).sha256 != held(image, 501).sha256 != held(image.T, 501).sha256


def test_records_of_minutiae_are_recognised(tmp_path):
    minutiae = pack_minutiae(some_minutiae())
    assert is_of_minutiae(minutiae)
    assert not is_of_minutiae(side_of("print").payload)
    assert not is_of_minutiae(tmp_path)
    path = tmp_path / "a"
    for content, expected in ((b"FMR\0 20", True), (b"FIR\0 20", False), (b"", False)):
        path.write_bytes(content)
        assert is_of_minutiae(path) == expected
    target = tmp_path / "a.skt"
    methods.write_template_file(target, Side(path, "template", minutiae=some_minutiae()))
    assert is_of_minutiae(target)
    assert read_side(target, "metric").minutiae.count == 12
    methods.write_template_file(target, side_of("print"))
    assert not is_of_minutiae(target)


def test_sides_are_of_what_was_named(tmp_path):
    missing = tmp_path / "a.png"
    with bad_input() as caught:
        read_side(missing, "metric")
    assert str(caught.value) == (
        f"there is no '{missing}'; name a capture folder, a result folder, a template (.skt), a"
        " print or a record of minutiae."
    )
    side = read_side(side_of("print").payload, "metric")
    assert (side.path, side.kind) == (Path("template"), "template")
    stages = []
    target = tmp_path / "A.SKT"
    methods.write_template_file(target, side)
    again = read_side(target, "metric", lambda stage, fraction: stages.append((stage, fraction)))
    assert (again.path, again.kind) == (target, "template")
    assert stages == [("reading A.SKT", 0.1)]
    where = inputs.PhotoFinger(None, "1,2,3,4")
    for finger, name in ((target, f"'{target}'"), (b"", "what is not a file")):
        with bad_input() as caught:
            read_side(finger, "metric", where=where)
        assert str(caught.value) == (
            f"`mask` and `box` choose the finger of a photograph in colour; {name} is none."
        )
    with bad_input(r"is neither a result \(height\.npz\), a capture"):
        read_side(tmp_path, "metric")
