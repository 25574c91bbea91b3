"""Every kind of bad input through the command line: one sentence, code 2, nothing half-written."""

import codecs
import json
import os
import shutil
import tempfile
from pathlib import Path

import cv2
import numpy as np
import pytest

from enrolled import facts_of, words_of
from small_capture import copy_of, edit, repaint
from splitknit.cli.main import main
from splitknit.io.images import read_image, write_image


def of_capture(change):
    return lambda folder: edit(folder / "capture.json", change)


def of_rig(change):
    return lambda folder: edit(folder / "rig.json", change)


def of_image(name, change):
    return lambda folder: repaint(folder / name, change)


def of_all(change):
    def damage(folder):
        for file in sorted(folder.glob("*.png")):
            repaint(file, change)

    return damage


def resized(document, shape):
    document["camera"]["image_size"] = list(shape)


def too_close(folder):
    """The finger goes on to the left, to the right and below; only around its tip the background
    shows."""
    of_all(lambda pixels: pixels[:, 175:285])(folder)
    of_rig(lambda document: resized(document, (330, 110)))(folder)


def noise(level, spread):
    def damage(folder):
        rng = np.random.default_rng(0)
        of_all(lambda pixels: rng.integers(level, level + spread, pixels.shape).astype(np.uint8))(
            folder
        )

    return damage


def mask_of(shape, rows, columns):
    def damage(folder):
        mask = np.zeros((*shape, 1), dtype=np.uint8)
        mask[rows, columns] = 255
        write_image(folder / "given.png", mask)
        of_capture(lambda document: document.update(mask="given.png"))(folder)

    return damage


def exchanged(first, second):
    def damage(folder):
        both = (folder / first).read_bytes(), (folder / second).read_bytes()
        for name, data in zip((second, first), both, strict=True):
            (folder / name).write_bytes(data)

    return damage


def all_under_one_light(folder):
    first, rng = read_image(folder / "nir_0.png").astype(np.float64), np.random.default_rng(0)
    for k in range(7):
        noisy = np.clip(first + rng.normal(0, 1.5, first.shape), 0, 255).astype(np.uint8)
        repaint(folder / f"nir_{k}.png", lambda pixels, noisy=noisy: noisy)


def shrunk(pixels):
    """The finger of another: two thirds as wide."""
    small = cv2.resize(pixels, None, fx=0.66, fy=1.0, interpolation=cv2.INTER_AREA).reshape(
        len(pixels), -1, pixels.shape[2]
    )
    beside = (pixels.shape[1] - small.shape[1]) // 2
    return np.pad(
        small, ((0, 0), (beside, pixels.shape[1] - small.shape[1] - beside), (0, 0)), mode="edge"
    )


def cut_short(name, keep):
    def damage(folder):
        data = (folder / name).read_bytes()
        (folder / name).write_bytes(data[: int(keep * len(data))])

    return damage


def linked_out(folder):
    shutil.move(folder / "white_2.png", folder.parent / "white_2.png")
    (folder / "white_2.png").symlink_to(folder.parent / "white_2.png")


def truth_of_another(folder):
    np.savez(
        folder / "truth.npz",
        height_mm=np.ones((4, 5)),
        shape_mm=np.ones((4, 5)),
        mask=np.ones((4, 5)),
    )
    of_capture(lambda document: document.update(truth="truth.npz"))(folder)


def white(document):
    return document["bands"]["white"]


# name: (what is done to a good capture, words that the sentence must hold)
KINDS = {
    "missing image": (
        lambda folder: (folder / "white_3.png").unlink(),
        ("white_3.png", "does not exist"),
    ),
    "truncated image": (cut_short("nir_2.png", 0.6), ("nir_2.png",)),
    "all black": (
        of_image("white_4.png", np.zeros_like),
        ("white_4.png", "black", "LED 4", "capture it again"),
    ),
    "saturated": (
        of_image("white_5.png", lambda pixels: np.where(pixels > 30, 255, pixels).astype(np.uint8)),
        ("white_5.png", "overexposed", "shorter exposure"),
    ),
    "one of another size": (
        of_image("nir_1.png", lambda pixels: pixels[:-1]),
        ("nir_1.png", "329", "330"),
    ),
    "rig for another camera": (
        of_rig(lambda document: resized(document, (440, 640))),
        ("rig", "640", "480"),
    ),
    "broken capture.json": (cut_short("capture.json", 0.5), ("capture.json", "not valid JSON")),
    "path above the folder": (
        of_capture(lambda document: white(document)["images"].__setitem__(0, "../white_0.png")),
        ("capture.json", "../white_0.png"),
    ),
    "link out of the folder": (linked_out, ("white_2.png",)),
    "three borders": (too_close, ("capture", "touches 3 borders", "mask")),
    "no finger": (noise(20, 30), ("capture", "no finger", "mask")),
    "mask too small": (
        mask_of((330, 480), np.s_[200:202], np.s_[240:242]),
        ("capture", "mask", "small"),
    ),
    "values that wrapped round": (
        of_all(lambda pixels: pixels * np.uint8(10)),
        ("capture", "do not fit the lights"),
    ),
    "NIR exchanged": (
        exchanged("nir_0.png", "nir_3.png"),
        ("nir_0.png and nir_3.png", "deg (median)", "--keep"),
    ),
    "white exchanged": (
        exchanged("white_0.png", "white_1.png"),
        ("white_0.png and white_1.png", "--keep"),
    ),
    "NIR turned": (
        of_image("nir_2.png", lambda pixels: pixels[::-1, ::-1]),
        ("nir_2.png does not", "--keep"),
    ),
    "white noise": (
        of_image(
            "white_2.png",
            lambda p: np.random.default_rng(0).integers(10, 200, p.shape).astype(np.uint8),
        ),
        ("white_2.png does not", "--keep"),
    ),
    "images flipped": (of_all(lambda pixels: pixels[:, ::-1]), ("x pointing left", "--keep")),
    "one light": (
        all_under_one_light,
        ("nir_0.png to nir_6.png are all under one light", "--keep"),
    ),
    "NIR of another finger": (
        lambda folder: [repaint(folder / f"nir_{k}.png", shrunk) for k in range(7)],
        ("rim", "of one finger", "--keep"),
    ),
    "a copy": (
        lambda folder: shutil.copyfile(folder / "white_3.png", folder / "white_4.png"),
        ("same pixels", "white_3.png", "white_4.png"),
    ),
    "lights in micrometres": (
        of_rig(
            lambda d: [
                led.update(position_mm=[1e3 * v for v in led["position_mm"]]) for led in d["leds"]
            ]
        ),
        ("position_mm", "possible"),
    ),
    "truth of another capture": (truth_of_another, ("capture", "truth")),
}


def refused(capsys, words, *arguments):
    """`reconstruct` refuses in one sentence that holds the words."""
    assert main(["reconstruct", *map(str, arguments)]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("splitknit: error: ")
    sentence = printed.err.removeprefix("splitknit: error: ").removesuffix("\n")
    assert "\n" not in sentence
    assert sentence.endswith((".", "?"))
    assert ". " not in sentence.replace("e.g. ", ""), "more than one sentence"
    assert "? " not in sentence
    assert "Traceback" not in sentence
    assert "Error" not in sentence
    for word in words:
        assert word in sentence, sentence


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_bad_captures_are_refused_in_one_sentence(kind, twin_folder, tmp_path, capsys):
    damage, words = KINDS[kind]
    folder = copy_of(twin_folder, tmp_path / "capture")
    damage(folder)
    before = sorted(path.name for path in tmp_path.rglob("*"))
    more = ["--json"] if len(kind) % 2 else []  # the sentence is the same with and without
    # quicker: refused after the reconstruction
    more += ["--preset", "ea"] if kind.startswith("truth") else []
    refused(capsys, words, folder, "--out", tmp_path / "deep" / "result", *more)
    assert sorted(path.name for path in tmp_path.rglob("*")) == before


@pytest.mark.slow
def test_a_spoilt_surface_is_stated_first_and_refused_by_strict(twin_folder, tmp_path, capsys):
    folder = copy_of(twin_folder, tmp_path / "capture")
    KINDS["white exchanged"][0](folder)
    words = folder, "--out", tmp_path / "out", "--preset", "ea", "--keep"
    printed = words_of(capsys, "reconstruct", *words)
    assert printed.startswith(
        "The surface is spoilt: the photographs seem to be under other lights"
    )
    findings = json.loads((tmp_path / "out" / "report.json").read_text())["findings"]
    assert [each["code"] for each in findings if each["severity"] != "note"] == ["light-order"]
    shutil.rmtree(tmp_path / "out")
    refused(capsys, ("under other lights", "--strict"), *words, "--strict")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("factor", "preset", "words"),
    [
        pytest.param(2.0, "metric", "all lengths are 0.5", marks=pytest.mark.slow),
        (0.5, "ea", "the finger's width is 3"),
    ],
)
def test_a_wrong_scale_is_stated_first_and_refused_by_strict(
    factor, preset, words, tmp_path, capsys
):
    folder, out = tmp_path / "capture", tmp_path / "out"
    assert main(f"simulate --out {folder} --seed 3 --scale 0.12".split()) == 0
    capsys.readouterr()
    of_rig(lambda rig: rig["camera"].update(px_per_mm=factor * rig["camera"]["px_per_mm"]))(folder)
    command = folder, "--out", out, "--preset", preset
    first = words_of(capsys, "reconstruct", *command).splitlines()[0]
    assert first.startswith("The surface may be wrong: ") and words in first
    shutil.rmtree(out)
    refused(capsys, (words, "--strict"), *command, "--strict")


@pytest.mark.slow
def test_jpeg_is_detected_in_the_pixels(twin_folder, tmp_path, capsys):
    """Also where somebody saved it as PNG afterwards; the ridges' heights are less certain then."""
    for quality in (0, 75, 95):
        folder = copy_of(twin_folder, tmp_path / f"capture_{quality}")

        def through_jpeg(image, quality=quality):
            data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
            return np.asarray(cv2.imdecode(data, cv2.IMREAD_UNCHANGED)).reshape(image.shape)

        for file in folder.glob("[wn]*_*.png") if quality else ():
            repaint(file, through_jpeg)
        out = tmp_path / f"result_{quality}"
        printed = words_of(capsys, f"reconstruct {folder} --out {out}")
        assert ("saved as JPEG" in printed) == (quality > 0)
        with np.load(out / "height.npz") as saved:
            mask = saved["mask"]
            over = saved["uncertainty_um"][mask] / np.abs(1000.0 * saved["ridge_mm"][mask])
        assert (float(np.nanmin(over)) > 0.299) == (quality > 0)


@pytest.mark.slow
@pytest.mark.parametrize("preset", ["metric", "ea"])
def test_a_mask_helps_where_the_finger_touches_three_borders(preset, twin_folder, tmp_path, capsys):
    folder = copy_of(twin_folder, tmp_path / "capture")
    too_close(folder)
    mask_of((330, 110), np.s_[120:], np.s_[:])(folder)
    out = tmp_path / "result"
    facts = facts_of(capsys, f"reconstruct {folder} --out {out} --preset {preset}")
    assert facts["facts"]["mask"] == "given"
    with np.load(out / "height.npz") as arrays:
        assert arrays["mask"].sum() == 210 * 110
        assert np.array_equal(np.isfinite(arrays["height_mm"]), arrays["mask"])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--set", "nowhere.field=1"], ("nowhere.field", "there is no setting")),
        (["--set", "knit.mehtod=addition"], ("did you mean 'knit.method'",)),
        (
            ["--set", "metric.rounds=0x" + "f" * 5000],
            ("metric.rounds must be", "thousands of digits"),
        ),
        (["--set", "mask"], ("--set", "stage.field=value")),
        (["--settings", "nowhere.json"], ("nowhere.json", "does not exist")),
    ],
)
def test_wrong_settings_are_refused_before_the_work(arguments, words, tmp_path, capsys):
    """Even before the capture is looked for."""
    refused(capsys, words, tmp_path / "none", "--out", tmp_path / "out", *arguments)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_of_others_is_not_overwritten(twin_folder, tmp_path, capsys):
    letters = tmp_path / "letters"
    letters.mkdir()
    (letters / "dear.txt").write_text("x")
    refused(capsys, ("letters", "another folder"), twin_folder, "--out", letters)
    refused(capsys, ("dear.txt",), twin_folder, "--out", letters / "dear.txt")
    assert [path.name for path in tmp_path.rglob("*")] == ["letters", "dear.txt"]


@pytest.mark.parametrize("name", ["nowhere", "notes.txt", "a\0b"])
def test_a_path_that_is_no_capture_is_refused(name, tmp_path, capsys):
    (tmp_path / "notes.txt").write_text("x")
    refused(capsys, (), tmp_path / name, "--out", tmp_path / "out")
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


@pytest.fixture
def nobody(tmp_path):
    """Root gives up its rights for a while; others have none to give up."""
    own = [tmp_path, *tmp_path.parents]
    for parent in own[: own.index(Path(tempfile.gettempdir()))]:
        parent.chmod(0o777)
    if os.geteuid() != 0:
        yield
        return
    codecs.lookup("utf-8-sig")  # nobody may not be allowed to read Python's own folder
    import splitknit.folders

    assert splitknit.folders
    os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(0)


@pytest.fixture
def closed(request, twin_folder, tmp_path):
    """A capture of which one file, or the folder itself, may not be read."""
    folder = copy_of(twin_folder, tmp_path / "capture")
    mode = (folder / request.param).stat().st_mode
    (folder / request.param).chmod(0)
    yield folder
    (folder / request.param).chmod(mode)


@pytest.mark.parametrize("closed", [".", "white_3.png", "rig.json"], indirect=True)
def test_files_without_permission_are_refused(closed, tmp_path, nobody, capsys):
    refused(capsys, ("capture", "ermission denied"), closed, "--out", tmp_path / "out")
    assert [path.name for path in tmp_path.iterdir()] == ["capture"]
