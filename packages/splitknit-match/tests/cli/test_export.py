"""``splitknit export`` and ``import``: prints and results as records, read by other programs, and
back."""

import json
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

import handmade
from enrolled import facts_of, refusal_of, words_of
from fmr_samples import transaction, type_14
from perfect_results import write_impressions
from spiral_prints import PLACES, spiral_print
from splitknit.io.prints import write_print_png
from splitknit.io.provenance import provenance
from splitknit.io.results import read_result, write_mesh
from splitknit.observation.stored import decode_table
from splitknit_match.prints.verbs import PrintFormat
from splitknit_match.records.minutiae_files import read_minutiae_record
from splitknit_match.records.pictures import PrintFile, read_print_png
from splitknit_match.records.print_formats import FORMATS, read_prints
from splitknit_simulator.finger.finger import FingerPose
from written_files import read_ply, read_stl

PICTURES = {"png": "png", "tiff": "tiff", "wsq": "wsq", "iso-19794-4": "fir", "iso-39794-4": "fim"}
MINUTIAE = {"iso-19794-2": "iso", "ansi-378": "fmr", "ansi-378-2009": "fmr"}


@pytest.fixture(scope="module")
def prints(tmp_path_factory):
    """Two presses of a finger and one of another, 500 ppi, and the first at 1000 ppi."""
    folder = tmp_path_factory.mktemp("prints")
    write_print_png(folder / "a.png", spiral_print())
    write_print_png(folder / "again.png", spiral_print((6, -9)))
    write_print_png(folder / "other.png", spiral_print(seed=2))
    write_print_png(folder / "fine.png", spiral_print(scale=2.0), 1000.0)
    return folder


def export(capsys, tmp_path, to, *sources, out="out", **options):
    flags = [word for name, value in options.items() for word in (f"--{name}", value)]
    return facts_of(capsys, "export", *sources, "--to", to, "--out", tmp_path / out, *flags)


def similarity_of(capsys, *fingers):
    return facts_of(capsys, "match", *fingers)["similarity"]


def enroll(capsys, gallery, source, person):
    owner = ("--person", person, "--finger", "right_index")
    facts_of(capsys, f"enroll {gallery} {source}", *owner)


@pytest.mark.parametrize("to", MINUTIAE)
def test_prints_become_records_in_one_command(prints, tmp_path, capsys, to):
    sources = prints / "a.png", prints / "fine.png"
    facts = export(capsys, tmp_path, to, *sources, finger="left_thumb")
    names = [file["file"] for file in facts["files"]]
    assert names == [f"a.{MINUTIAE[to]}", f"fine.{MINUTIAE[to]}"]
    for file in facts["files"]:
        (view,) = read_minutiae_record(tmp_path / "out" / file["file"])
        assert view.finger == "left_thumb"
        assert (view.size, view.resolution_ppcm) == ((500, 380), (197, 197))
        assert view.count == file["minutiae"]
        assert 40 < view.finger_quality == file["quality"] <= 100
        apart = np.hypot(view.x_px[:, None] - PLACES[:, 0], view.y_px[:, None] - PLACES[:, 1])
        assert (apart.min(axis=0) < 5).mean() > 0.95
    del facts["out"]
    assert json.loads((tmp_path / "out" / "export.json").read_text()) == facts


@pytest.mark.parametrize("to", PICTURES)
def test_an_exported_picture_is_read_back(prints, tmp_path, capsys, to):
    lossy = to == "wsq"
    if lossy:
        pytest.importorskip("_wsq")
    facts = export(capsys, tmp_path, to, prints / "a.png", prints / "fine.png")
    ppis = [500, 500 if lossy else 1000]
    for name, ppi, file in zip(("a", "fine"), ppis, facts["files"], strict=True):
        (picture,) = read_prints(tmp_path / "out" / f"{name}.{PICTURES[to]}")
        assert isinstance(picture, PrintFile)
        assert picture.resolution_ppi == pytest.approx(ppi, abs=0.02) == file["ppi"]
        original = spiral_print(scale=ppi / 500)
        assert picture.image.shape == original.shape
        difference = np.abs(picture.image.astype(int) - original)
        assert difference.mean() < (12 if lossy else 1e-9)


@pytest.mark.slow
def test_records_of_all_kinds_are_matched(prints, tmp_path, capsys):
    sources = [prints / f"{name}.png" for name in ("a", "again", "other")]
    for to, out in (("iso-19794-2", "iso"), ("ansi-378", "ansi"), ("iso-19794-4", "fir")):
        export(capsys, tmp_path, to, *sources, out=out)
    iso = tmp_path / "iso" / "a.iso"
    ansi = tmp_path / "ansi" / "again.fmr"
    fir = tmp_path / "fir" / "again.fir"
    match = facts_of(capsys, f"match {iso} {ansi}")
    assert match["method"] == "minutiae"
    assert match["similarity"] > 4
    assert (match["a"]["kind"], match["a"]["acquired"]) == ("minutiae", True)
    assert match["decision"]["match"]
    assert similarity_of(capsys, iso, tmp_path / "iso" / "other.iso") < 2
    assert similarity_of(capsys, iso, fir) > 3
    by_ridges = facts_of(capsys, f"match {prints}/a.png {fir} --method ridge")
    assert by_ridges["method"] == "ridge"
    assert "a.iso: 50 minutiae\n" in words_of(capsys, f"match {iso} {ansi}")
    refusal = refusal_of(capsys, f"match {iso} {ansi} --method ridge")
    assert "no ridges; compare by the method minutiae" in refusal
    facts_of(capsys, f"match {iso} --template {tmp_path}/a.skt")
    assert similarity_of(capsys, tmp_path / "a.skt", ansi) == similarity_of(capsys, iso, ansi)


@pytest.mark.slow
def test_a_gallery_of_minutiae(prints, tmp_path, capsys):
    export(capsys, tmp_path, "iso-19794-2", prints / "a.png", prints / "other.png", out="iso")
    gallery = tmp_path / "m.skg"
    enroll(capsys, gallery, tmp_path / "iso" / "a.iso", "Ann")
    enroll(capsys, gallery, tmp_path / "iso" / "other.iso", "Bob")
    for probe in (prints / "again.png", tmp_path / "iso" / "a.iso"):
        report = facts_of(capsys, f"identify {gallery} {probe}")
        assert (report["by"], report["decision"]["match"]) == ("minutiae", True)
        ann, bob = report["candidates"]
        assert (ann["person"], bob["person"]) == ("Ann", "Bob")
        assert ann["similarity"] > 3
        assert bob["similarity"] < 2
    assert "by minutiae" in words_of(capsys, f"identify {gallery} {prints}/again.png")
    enroll(capsys, gallery, prints / "again.png", "Ann")
    assert facts_of(capsys, f"gallery info {gallery}")["captures"] == 3
    plain = tmp_path / "plain"
    facts_of(capsys, f"gallery export {gallery} --out {plain}")
    assert facts_of(capsys, f"gallery import {tmp_path}/copy.skg {plain}")["new"] == 3
    out = tmp_path / "back"
    refusal = refusal_of(capsys, f"export {gallery} --to iso-19794-2 --out {out}")
    assert "a database, such as a gallery" in refusal


def test_ridges_and_minutiae_are_not_mixed(prints, tmp_path, capsys):
    export(capsys, tmp_path, "iso-19794-2", prints / "a.png", out="iso")
    record = tmp_path / "iso" / "a.iso"
    ridges = tmp_path / "r.skg"
    enroll(capsys, ridges, prints / "a.png", "A")
    owner = ("--person", "A", "--finger", "right_index")
    assert "a gallery of their own" in refusal_of(capsys, f"enroll {ridges} {record}", *owner)
    assert "keeps ridges" in refusal_of(capsys, f"identify {ridges} {record}")


@pytest.mark.slow
def test_export_and_print_of_a_result_agree(people_folder, tmp_path, capsys):
    result = people_folder / "S01" / "session_1" / "right_index"
    facts_of(capsys, f"print {result} --out {tmp_path}/print")
    export(capsys, tmp_path, "iso-19794-2", result, tmp_path / "print")
    record = (tmp_path / "print" / "minutiae.iso").read_bytes()
    assert (tmp_path / "out" / "right_index.iso").read_bytes() == record
    assert (tmp_path / "out" / "print.iso").read_bytes() == record
    export(capsys, tmp_path, "png", result, out="png")
    image = read_print_png(tmp_path / "png" / "right_index.png").image
    assert_array_equal(image, read_print_png(tmp_path / "print" / "print.png").image)


def test_prints_are_imported(prints, tmp_path, capsys):
    records = [type_14(spiral_print(), FGP=finger) for finger in (b"6", b"1")]
    two = tmp_path / "two.an2"
    two.write_bytes(transaction(*records))
    export(capsys, tmp_path, "ansi-378", prints / "a.png", out="ansi")
    record = tmp_path / "ansi" / "a.fmr"
    facts = facts_of(capsys, f"import {two} {record} --out {tmp_path}/in")
    assert [(file["file"], file["finger"]) for file in facts["files"]] == [
        ("two-1.png", "left_thumb"),
        ("two-2.png", "right_thumb"),
        ("a.iso", "unknown"),
    ]
    image = read_print_png(tmp_path / "in" / "two-1.png").image
    assert_array_equal(image, spiral_print())
    refusal = refusal_of(capsys, f"match {two} {prints}/a.png")
    assert "holds 2 prints; take them apart with 'splitknit import'" in refusal


def test_a_print_is_printed_at_500_ppi(prints, tmp_path, capsys):
    facts = facts_of(capsys, f"print {prints}/fine.png --out {tmp_path}/out")
    assert (facts["method"], facts["size"], facts["ppi"]) == ("file", [500, 380], 500)
    assert facts["findings"] == []
    (view,) = read_minutiae_record(tmp_path / "out" / "minutiae.iso")
    assert abs(view.count - len(PLACES)) <= 4
    centres = [0.5, 2.5, 4.5]  # in pixels of 1000 ppi
    with np.load(tmp_path / "out" / "map.npz") as arrays:
        assert_allclose(arrays["columns"][7, :3], centres, atol=1e-3)
        assert_allclose(arrays["rows"][:3, 7], centres, atol=1e-3)
    options = ("--method", "relief", "--out", tmp_path / "no")
    assert "leave out --method" in refusal_of(capsys, "print", prints / "a.png", *options)


@pytest.mark.parametrize("to", ["png", "iso-19794-2"])
def test_an_export_does_not_depend_on_the_other_sources(prints, tmp_path, capsys, to):
    export(capsys, tmp_path, to, prints / "again.png", prints / "a.png", out="both")
    export(capsys, tmp_path, to, prints / "a.png", out="alone")
    name = f"a.{(PICTURES | MINUTIAE)[to]}"
    assert (tmp_path / "both" / name).read_bytes() == (tmp_path / "alone" / name).read_bytes()


def test_prints_without_ridges_are_failures_to_acquire(tmp_path, capsys):
    blank = tmp_path / "blank.png"
    write_print_png(blank, np.full((300, 300), 255, np.uint8))
    facts = export(capsys, tmp_path, "iso-19794-2", blank)
    assert facts["failures_to_acquire"] == ["blank.iso"]
    assert read_minutiae_record(tmp_path / "out" / "blank.iso")[0].count == 0
    words = words_of(capsys, f"export {blank} --to ansi-378 --out {tmp_path}/again")
    assert "failure to acquire" in words


@pytest.mark.parametrize(
    ("command", "refusal"),
    [
        ("export bare.png --to wsq", "does not state its resolution"),
        ("export a.png bare.png --to iso-19794-2", "--resolution-ppi 500"),
        ("export a.iso --to wsq", "holds minutiae and no picture"),
        ("export NOWHERE --to wsq", "there is no 'NOWHERE'"),
        ("export . --to wsq", "is not a capture"),
        ("export text.txt --to wsq", "of another kind"),
        ("export a.png --to wsq --finger toe", "'toe' is not a finger"),
        ("export a.png --to wsq --impression ink", "'ink' is not an impression type"),
        ("export a.png --to stl", "has no surface to export; name a result"),
        ("export a.png --to ansi-378 --owner 0", "must be from 1 to 65535"),
        ("import .", "photographs of a folder are imported by --images"),
        ("import", "name photographs"),
        ("import a.png --images .", "one after the other"),
        ("import a.png --lights a.png", "goes with --images"),
        ("print a.iso", "no picture to print"),
        ("print bare.png", "--resolution-ppi 500"),
    ],
)
def test_bad_input_is_one_sentence_and_writes_nothing(  # noqa: PLR0917
    prints, tmp_path, capsys, monkeypatch, command, refusal
):
    export(capsys, tmp_path, "iso-19794-2", prints / "a.png", out="iso")
    (tmp_path / "iso" / "a.iso").rename(tmp_path / "a.iso")
    (tmp_path / "a.png").write_bytes((prints / "a.png").read_bytes())
    Image.fromarray(spiral_print()).save(tmp_path / "bare.png")
    (tmp_path / "text.txt").write_text("hello")
    monkeypatch.chdir(tmp_path)
    assert refusal in refusal_of(capsys, *command.split(), "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_every_format_that_is_written_is_tested():
    written = {name for name, form in FORMATS.items() if form.encode is not None}
    assert written == set(PICTURES) | set(MINUTIAE)
    assert set(get_args(PrintFormat)) == {*written, "stl", "obj", "glb", "lp"}


@pytest.mark.slow
def test_an_exported_mesh_equals_the_phalange(tmp_path, capsys):
    trimesh = pytest.importorskip("trimesh")
    results = write_impressions(tmp_path, 0.06, 721, FingerPose())
    write_mesh(tmp_path / "a.ply", read_result(results / "a"), provenance({}, {}))
    ply = read_ply(tmp_path / "a.ply")
    for to in ("stl", "obj"):
        (file,) = export(capsys, tmp_path, to, results / "a", out=to)["files"]
        assert (file["file"], file["kind"], file["unit"]) == (f"a.{to}", "result", "mm")
        assert (file["vertices"], file["faces"]) == (len(ply.vertices_mm), len(ply.faces))
        assert (tmp_path / to / f"a.{to}").stat().st_mode & 0o777 == 0o600
    stl = tmp_path / "stl" / "a.stl"
    assert stl.read_bytes().startswith(b"splitknit, unit mm")
    assert_array_equal(read_stl(stl), ply.vertices_mm[ply.faces])
    obj = tmp_path / "obj" / "a.obj"
    text = obj.read_text()
    assert text.startswith("# unit mm, splitknit")
    normals = [line.split()[1:] for line in text.splitlines() if line.startswith("vn ")]
    assert_allclose(np.array(normals, dtype=float), ply.normals, atol=1e-6)
    mesh = trimesh.load(obj, process=False, maintain_order=True, force="mesh")
    assert_allclose(mesh.vertices, ply.vertices_mm, atol=1e-5)
    assert_array_equal(mesh.faces, ply.faces)
    light = decode_table(np.dtype(np.uint8), "srgb")[mesh.visual.vertex_colors[:, 0]]
    assert_allclose(light, ply.quality, atol=6e-3)


def test_an_object_becomes_a_solid_and_a_model(tmp_path: Path, capsys) -> None:
    trimesh = pytest.importorskip("trimesh")
    coin = tmp_path / "coin"
    result, _ = handmade.finger(px_per_mm=5.0, size=(110, 160))
    result.save(coin)
    export(capsys, tmp_path, "stl", coin, base=1.5)
    assert trimesh.load(tmp_path / "out" / "coin.stl").is_watertight
    (model,) = export(capsys, tmp_path, "glb", coin, out="glb")["files"]
    mesh = trimesh.load(tmp_path / "glb" / "coin.glb", force="mesh", process=False)
    assert len(mesh.vertices) == model["vertices"]
    refusal = refusal_of(capsys, f"export {coin} --out {tmp_path}/none --to obj --base 2")
    assert "is of --to" in refusal


def test_records_state_quality_and_owner(prints, tmp_path, capsys):
    facts = export(capsys, tmp_path, "iso-39794-4", prints / "a.png", owner="0x0123")
    assert facts["files"][0]["quality"] > 40
    export(capsys, tmp_path, "ansi-378", prints / "a.png", out="ansi", owner="0x0123")
    assert (tmp_path / "ansi" / "a.fmr").read_bytes()[10:12] == b"\x01\x23"


def test_a_record_is_described_with_what_it_holds(prints, tmp_path, capsys):
    export(capsys, tmp_path, "iso-19794-2", prints / "a.png", out="iso")
    record = tmp_path / "iso" / "a.iso"
    facts = facts_of(capsys, f"records what {record}")
    assert facts["what"] == "ISO/IEC 19794-2:2005"
    assert facts["holds"][0]["minutiae"] == 50
    export(capsys, tmp_path, "iso-39794-4", prints / "a.png", out="fim")
    words = words_of(capsys, f"records what {tmp_path}/fim/a.fim")
    assert "ISO/IEC 39794-4" in words
    assert "380 x 500 pixels, 500 ppi" in words
    (tmp_path / "cut.iso").write_bytes(record.read_bytes()[:100])
    assert "truncated" in facts_of(capsys, f"records what {tmp_path}/cut.iso")["damage"]
    both = facts_of(capsys, f"records what {record} {tmp_path}/cut.iso")["files"]
    assert both[0] == facts
    assert "damage" in both[1]


def test_files_that_are_no_records_are_described(prints, tmp_path, capsys):
    facts_of(capsys, f"match {prints}/a.png --template {tmp_path}/a.skt")
    (tmp_path / "x").write_bytes(b"GIF89a")
    for name, what in (("a.skt", "template of splitknit"), ("x", "of an unknown kind")):
        facts = facts_of(capsys, f"records what {tmp_path}/{name}")
        assert what in facts["what"]
        assert facts["holds"] == []
    assert "does not exist" in refusal_of(capsys, f"records what {tmp_path}/none")
