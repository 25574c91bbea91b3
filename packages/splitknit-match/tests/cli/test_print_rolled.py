"""``splitknit print --method rolled``: its files and facts, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest

import rolled_scene as scene
from enrolled import facts_of, refusal_of
from splitknit.findings import Finding
from splitknit.io.capture import write_capture
from splitknit_match.prints.verbs import _print_lines
from written_files import read_ply


@pytest.fixture(scope="module")
def drawn():
    return scene.capture(("right",))


@pytest.mark.slow
def test_a_rolled_print_its_mesh_and_its_facts(drawn, tmp_path, capsys, monkeypatch):
    capture, masks = drawn
    write_capture(capture, tmp_path / "capture")
    findings = (Finding("view-cut-off", "the left view is cut off."),)
    views = replace(scene.views_of(capture, masks), findings=findings)
    monkeypatch.setattr("splitknit_match.prints.rolled.find_mirror_views", lambda *_: views)
    monkeypatch.setattr("splitknit_match.rolled.finger.PITCH_MM", 0.07)  # quicker
    out = tmp_path / "out"
    facts = facts_of(capsys, f"print {tmp_path}/capture --method rolled --out {out}")
    assert facts["surface"] == "free"
    assert {"print.png", "rolled.ply", "report.json"} <= set(facts["files"])
    rolled = facts["rolled"]
    assert rolled["views"] == ["front", "right"]
    assert "view-cut-off" in [finding["code"] for finding in facts["findings"]]
    assert "Please note: the left view is cut off." in _print_lines(facts)
    assert 150 < rolled["coverage_deg"]["median"] < 200
    # the skin's true size: the width of the print is the length around the finger
    around = np.deg2rad(rolled["coverage_deg"]["median"]) * 0.5 * (scene.A + scene.B)
    assert facts["size"][1] * 25.4 / 500 == pytest.approx(around, rel=0.15)
    mesh = read_ply(out / "rolled.ply")
    assert len(mesh.vertices_mm) == rolled["mesh_points"]
    # the side of +x is there, that of -x is not, and the mesh turns its outside outwards
    assert mesh.vertices_mm[:, 0].max() > 7.5
    corners = mesh.vertices_mm[mesh.faces].astype(np.float64)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    outwards = (normal * (corners.mean(axis=1) * [1, 0, 1])).sum(axis=1) > 0
    assert outwards.mean() > 0.99


def test_a_capture_without_mirrors_is_refused(drawn, tmp_path, capsys):
    capture, _ = drawn
    bare = replace(capture, rig=replace(capture.rig, mirrors=()))
    write_capture(bare, tmp_path / "bare")
    out = tmp_path / "out"
    message = refusal_of(capsys, f"print {tmp_path}/bare --method rolled --out {out}")
    assert "no mirrors beside the finger" in message
    assert not out.exists()


def test_what_is_no_capture_and_surfaces_that_do_not_fit_are_refused(tmp_path, capsys):
    message = refusal_of(capsys, f"print {tmp_path} --method rolled --out {tmp_path}/out")
    assert "not a capture folder" in message
    message = refusal_of(
        capsys, f"print {tmp_path} --method rolled --surface plane --out", tmp_path / "out"
    )
    assert "cannot be printed on the plane" in message
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_the_twin_between_mirrors_is_rolled_by_itself(tmp_path, capsys):
    capture, out = tmp_path / "capture", tmp_path / "out"
    finger = ("--seed", 105, "--scale", 0.6, "--no-nir")
    mirrors = ("--mirrors", "left,right", "--set", "pose.roll_deg=[0,0]")
    facts_of(capsys, f"simulate --out {capture}", *finger, *mirrors)
    rolled = facts_of(capsys, f"print {capture} --method rolled --out {out}")["rolled"]
    assert rolled["coverage_deg"]["median"] > 160
    assert set(rolled["views"]) == {"front", "left", "right"}
