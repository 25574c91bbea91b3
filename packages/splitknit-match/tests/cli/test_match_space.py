"""``splitknit match`` by features in space: results and captures, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from splitknit.cli.main import main
from splitknit.io.npz import write_npz

METHODS = ("minutiae3d", "surface-code", "tetrahedra")


def facts_of(capsys: pytest.CaptureFixture[str], method: str, *arguments: object) -> dict:
    assert main(["match", *map(str, arguments), "--method", method, "--json"]) == 0
    printed = capsys.readouterr()
    assert printed.err == ""
    return json.loads(printed.out)


@pytest.mark.parametrize("method", METHODS)
def test_one_finger_is_told_from_another(impressions: Path, method: str, capsys) -> None:
    same = facts_of(capsys, method, impressions / "a", impressions / "again")
    other = facts_of(capsys, method, impressions / "a", impressions / "other")
    assert same["compared"]
    assert other["compared"]
    assert same["similarity"] > other["similarity"] + {"surface-code": 0.08}.get(method, 0.3)
    assert same["decision"]["match"] and not other["decision"]["match"]
    assert same["fmr_basis"]["population"] == "true surfaces of 80 simulated fingers"
    assert same["a"]["acquired"]
    if method == "surface-code":
        assert same["a"]["code_mm2"] > 100
    else:
        assert same["agreeing"] <= min(same["a"]["minutiae"], same["b"]["minutiae"])
    assert main(["match", str(impressions / "a"), str(impressions / "again"), "--method", method, "--raw"]) == 0
    words = capsys.readouterr().out
    assert words.startswith("Match, decided at a false match rate of 1 in 3,100 ")
    assert f"\nScore {same['similarity']:.4f} (fraction of" in words


@pytest.mark.parametrize("method", METHODS)
def test_prints_and_templates_have_no_surface(impressions: Path, method: str, tmp_path: Path, capsys) -> None:
    assert main(["match", str(impressions / "a"), "--template", str(tmp_path / "a.skt")]) == 0
    capsys.readouterr()
    for flat, kind in ((impressions / "a" / "print.png", "print"), (tmp_path / "a.skt", "template")):
        assert main(["match", str(impressions / "a"), str(flat), "--method", method]) == 2
        printed = capsys.readouterr()
        assert printed.out == ""
        assert f"is a {kind}; the method {method} compares surfaces: name a capture or a result." in printed.err


def test_too_little_skin(impressions: Path, tmp_path: Path, capsys) -> None:
    """A scrap of a finger is a failure to acquire, and said to be one."""
    with np.load(impressions / "a" / "height.npz") as arrays:
        scrap = dict(arrays)
    mask = np.zeros_like(scrap["mask"])
    row, column = (int(np.median(axis)) for axis in np.nonzero(scrap["mask"]))
    mask[row - 40 : row + 40, column - 40 : column + 40] = True
    for name in ("height_mm", "ridge_mm", "shape_mm"):
        scrap[name] = np.where(mask, scrap[name], np.nan).astype(np.float32)
    scrap |= {"mask": mask, "normals": scrap["normals"] * mask[..., None]}
    (tmp_path / "scrap").mkdir()
    write_npz(tmp_path / "scrap" / "height.npz", scrap)
    for method in METHODS:
        found = facts_of(capsys, method, impressions / "a", tmp_path / "scrap")
        assert (found["compared"], found["similarity"], found["b"]["acquired"]) == (False, 0.0, False)
        assert main(["match", str(impressions / "a"), str(tmp_path / "scrap"), "--method", method]) == 0
        words = capsys.readouterr().out
        assert "not compared: failure to acquire" in words
        assert "scrap holds" in words


def test_settings_can_be_changed(impressions: Path, capsys) -> None:
    strict = facts_of(
        capsys, "minutiae3d", impressions / "a", impressions / "again", "--set", "minutiae3d.agreement.plane_mm=0.1"
    )
    assert strict["similarity"] < facts_of(capsys, "minutiae3d", impressions / "a", impressions / "again")["similarity"]
    wrong = ["match", str(impressions / "a"), str(impressions / "again"), "--set", "surface_code.coding=morse"]
    assert main([*wrong, "--method", "surface-code"]) == 2
    assert "one of 'gray', 'binary'" in capsys.readouterr().err
