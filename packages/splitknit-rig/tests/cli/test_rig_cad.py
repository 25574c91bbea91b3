"""``splitknit rig cad``: whole folders or one sentence."""

from __future__ import annotations

import hashlib
import importlib.util
import json
import sys
from dataclasses import replace
from xml.etree import ElementTree

import pytest

from splitknit.cli.main import main
from splitknit.io.rig import write_rig
from splitknit.model import default_rig
from written_files import read_stl

needs_cad = pytest.mark.skipif(
    importlib.util.find_spec("build123d") is None, reason="build123d (extra 'rig') is not installed"
)


def refused(capsys, *arguments):
    assert main(["rig", "cad", *arguments]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    return err


def test_without_build123d_one_sentence_says_what_to_install(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "build123d", None)
    error = refused(capsys, "--out", str(tmp_path / "parts"))
    assert "make install EXTRAS=cad" in error
    assert not (tmp_path / "parts").exists()


def test_impossible_rigs_and_settings_are_refused_before_anything_is_drawn(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "build123d", None)
    rig = default_rig()
    far = tuple(
        replace(led, position_mm=(2.5 * led.position_mm[0], 2.5 * led.position_mm[1], 140.0)) for led in rig.leds
    )
    write_rig(replace(rig, leds=far), tmp_path / "wide.json")
    out = str(tmp_path / "parts")
    error = refused(capsys, "--out", out, "--rig", str(tmp_path / "wide.json"))
    assert "wide.json: the LEDs stand up to 131.2 mm" in error
    assert "there is no setting 'finger.reech_mm'; did you mean" in refused(
        capsys, "--out", out, "--set", "finger.reech_mm=3"
    )
    assert "thinner than the minimum" in refused(capsys, "--out", out, "--set", "joint.wall_mm=0.8")
    assert "nowhere.json" in refused(capsys, "--out", out, "--rig", str(tmp_path / "nowhere.json"))
    assert not (tmp_path / "parts").exists()


def hashes(folder):
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


@needs_cad
@pytest.mark.slow
@pytest.mark.filterwarnings("default::DeprecationWarning")
def test_the_folder_is_complete_and_the_same_every_time(tmp_path, capsys):
    from splitknit_rig.rig.part_reports import _check_soundness

    rig = default_rig()
    six = replace(rig, leds=rig.leds[:6])
    write_rig(six, tmp_path / "rig.json")
    common = ["--rig", str(tmp_path / "rig.json"), "--json", "--set", "calibration.dot_mm=2.0"]
    assert main(["rig", "cad", "--out", str(tmp_path / "a"), *common]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert main(["rig", "cad", "--out", str(tmp_path / "b"), *common]) == 0
    capsys.readouterr()
    assert hashes(tmp_path / "a") == hashes(tmp_path / "b")
    written = json.loads((tmp_path / "a" / "parts.json").read_text())
    assert written == {key: value for key, value in facts.items() if key != "out"}
    assert len(written["dimensions"]["leds"]) == 6
    assert written["settings"]["calibration"]["dot_mm"] == 2.0
    assert list(written["inputs"]) == ["rig.json"]
    for name, part in written["parts"].items():
        assert part["checks"]["watertight"]["ok"]
        assert (tmp_path / "a" / "step" / f"{name}.step").stat().st_size > 1000
        _, faults, volume_mm3 = _check_soundness(read_stl(tmp_path / "a" / "stl" / f"{name}.stl"))
        assert faults == 0
        assert volume_mm3 / 1000 == pytest.approx(part["volume_cm3"], abs=1e-3)
        failed = [check for check, verdict in part["checks"].items() if not verdict["ok"]]
        assert bool(part["findings"]) or not failed
    assert {f"{name}.svg" for name in written["parts"]} | {"exploded.svg", "section.svg"} == set(written["pictures"])
    for name in written["pictures"]:
        drawing = ElementTree.parse(tmp_path / "a" / "pictures" / name).getroot()
        edges = [one for one in drawing.iter() if one.tag.endswith(("path", "line"))]
        assert len(edges) >= 8
        width, height = (float(drawing.get(side).removesuffix("mm")) for side in ("width", "height"))
        size = written["parts"].get(name.removesuffix(".svg"), {}).get("size_mm")
        if size:  # two views beside each other, at true scale
            assert width < 2 * (size[0] + size[1]) + 30 and height < sum(size) + 20
        else:
            assert height > written["dimensions"]["total_height_mm"] * 0.8


@needs_cad
@pytest.mark.slow
@pytest.mark.filterwarnings("default::DeprecationWarning")
def test_below_turns_the_rig_over(tmp_path, capsys):
    import build123d

    out = tmp_path / "below"
    assert main(["rig", "cad", "--out", str(out), "--below", "--no-pictures"]) == 0
    said = capsys.readouterr().out
    assert "11 parts drawn" in said
    assert "pictures" not in said
    written = json.loads((out / "parts.json").read_text())
    assert written["camera"] == "below"
    assert written["assembly"][0] == "window_base"
    assert not (out / "pictures").exists()
    whole = build123d.import_step(out / "assembly.step")
    assert {child.label for child in whole.children} == set(written["assembly"])
    lowest = whole.bounding_box().min.Z
    assert lowest == pytest.approx(-written["dimensions"]["heights_over_finger_plane_mm"]["top"], abs=0.01)
