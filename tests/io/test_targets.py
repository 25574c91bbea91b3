import json

import numpy as np
import pytest

from refusals import bad_input
from splitknit.cli.main import main
from splitknit.io.atomic import atomic_folder
from splitknit.io.images import write_image
from splitknit.io.rig import write_rig
from splitknit.io.targets import check_file, check_target
from splitknit.nominal import default_rig
from splitknit_rig.calibration.written import check_picture, check_rig_file

WRITERS = (
    ["print", "RESULT"],
    ["evaluate", "--scores", "scores.csv"],
    ["gallery", "export", "gallery.skg"],
    ["simulate"],
    ["simulate", "--bench"],
    ["demo"],
    ["reconstruct", "CAPTURE"],
)


@pytest.fixture
def taken(tmp_path):
    """A folder that splitknit wrote: photographs of a finger, as ``splitknit capture`` leaves
    them."""
    with atomic_folder(tmp_path / "finger") as folder:
        for name in ("capture.json", "session.json", "report.json", "white_0.png"):
            (folder / name).write_text("{}")
    return tmp_path / "finger"


@pytest.mark.parametrize("words", WRITERS, ids=lambda words: " ".join(words[:2]))
def test_no_verb_replaces_photographs(words, taken, capsys):
    assert main([*words, "--out", str(taken)]) == 2
    error = capsys.readouterr().err
    assert "is not empty and is not an earlier" in error and error.count("\n") == 1
    assert (taken / "white_0.png").is_file()


def test_the_same_kind_may_be_replaced(tmp_path):
    check_target(tmp_path / "new", "map.npz", "an earlier print")
    check_target(tmp_path, "map.npz", "an earlier print")
    (tmp_path / "map.npz").touch()
    check_target(tmp_path, "map.npz", "an earlier print")
    (tmp_path / "map.npz").unlink()
    (tmp_path / "other").touch()
    with bad_input("is not an earlier print; name another folder"):
        check_target(tmp_path, "map.npz", "an earlier print")


@pytest.mark.parametrize("text", ["", "{", "[]", "{}", json.dumps({"format": "another"})])
def test_a_report_of_another_kind_is_distinguished(text, tmp_path):
    report = tmp_path / "report.json"
    report.write_text(json.dumps({"format": "ours"}))
    check_target(tmp_path, "report.json", "an earlier one", form="ours")
    report.write_text(text)
    with bad_input("is not an earlier one"):
        check_target(tmp_path, "report.json", "an earlier one", form="ours")


def test_what_is_read_is_kept(tmp_path):
    source = tmp_path / "a" / "b"
    source.mkdir(parents=True)
    for out in (source, source.parent, source / ".." / "b"):
        with bad_input("holds the input itself"):
            check_target(out, "x", "an earlier one", keep=source)
    check_target(source / "out", "x", "an earlier one", keep=source)


CAMERA = [
    "--px-per-cm",
    "200",
    "--image-size",
    "300,200",
    "--led-height-cm",
    "14",
    "--led-radius-cm",
    "5",
    "--nail-height-mm",
    "20",
]
FILE_WRITERS = (
    ["match", "A", "--template"],
    ["rig", "target", "--out"],
    ["calibrate", "camera", "PHOTOS", "--out"],
    ["calibrate", "radiometry", "CARD", "--out"],
    ["calibrate", "lights", *CAMERA, "--images", "PHOTOS", "--out"],
    ["calibrate", "lights", *CAMERA, "--images", "PHOTOS", "--show"],
    ["calibrate", "lights", *CAMERA, "--images", "PHOTOS", "--tips-out"],
)


@pytest.mark.parametrize("words", FILE_WRITERS, ids=lambda words: " ".join((*words[:2], words[-1])))
@pytest.mark.parametrize("content", [b"%PDF-1.7 a letter", b"{}", b"\xff\xd8\xff a photograph"])
def test_no_option_replaces_a_file_of_another_kind(words, content, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    suffix = ".png" if words[-1] == "--show" else ".pdf" if "target" in words else ""
    out = tmp_path / f"mine{suffix}"
    out.write_bytes(content)
    assert main([*words, str(out)]) == 2
    error = capsys.readouterr().err
    assert "exists and is not a" in error and error.count("\n") == 1
    assert out.read_bytes() == content and list(tmp_path.iterdir()) == [out]


def test_an_earlier_file_of_the_same_kind_is_replaced(tmp_path, capsys):
    sheet, rig = tmp_path / "sheet.pdf", tmp_path / "rig.json"
    for _ in range(2):
        assert main(f"rig target --out {sheet}".split()) == 0
        check_rig_file(rig)
        write_rig(default_rig(), rig)
    check_file(tmp_path / "new", "a template", lambda data: False)
    (tmp_path / "empty").touch()
    with bad_input("exists and is not a template"):
        check_file(tmp_path / "empty", "a template", lambda data: False)
    (tmp_path / "link").symlink_to("nowhere")
    for path in (tmp_path, tmp_path / "link"):
        with bad_input(r"is a folder|exists and is not a template"):
            check_file(path, "a template", lambda data: True)


def test_a_picture_is_not_written_over_a_photograph(tmp_path):
    write_image(tmp_path / "white_0.png", np.ones((4, 4), np.uint8))
    check_picture(tmp_path / "white_0.png")
    check_picture(tmp_path / "new.png", tmp_path)
    with bad_input("is one of the photographs"):
        check_picture(tmp_path / "white_0.png", tmp_path)
