"""Two measurements of one surface: a ridged cylinder in closed form, laid down in two poses."""

import json
import stat
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from refusals import bad_input
from splitknit.cli.main import main
from splitknit.io.provenance import provenance
from splitknit.io.results import write_arrays
from splitknit.reconstruction import Reconstruction
from splitknit_match.evaluation.pair import BANDS_MM, PROTOCOLS, compare_results

RADIUS_MM, PITCH = 8.0, 0.06
MAIN = "0 to 40"


def laid_down(
    roll=0.0,
    yaw=0.0,
    moved=(0.0, 0.0),
    *,
    um=30.0,
    whorl=1.0,
    stretched=0.0,
    near_mm=0.0,
    half_mm=5.6,
):
    """The cylinder with concentric ridges, rolled and turned (rad) and moved (mm)."""
    x, y = np.meshgrid(
        np.arange(-half_mm - 0.4, half_mm + 0.4, PITCH), np.arange(7.0, -7.0, -PITCH)
    )
    plane, above = (x, y), np.zeros(x.shape)
    for _ in range(4 if near_mm else 0):  # a perspective camera sees what lies deeper, further out
        x, y = (part * (1.0 - above / near_mm) for part in plane)
        above = np.sqrt(RADIUS_MM**2 - np.minimum((x - moved[0]) ** 2, 60.0)) - RADIUS_MM
    seen_at = x, y
    x, y = x - moved[0], y - moved[1]
    x, y = np.cos(yaw) * x + np.sin(yaw) * y, np.cos(yaw) * y - np.sin(yaw) * x
    relief = np.zeros(x.shape)
    for _ in range(8):  # the ridges' height moves the point at which a line of sight meets them
        angle = np.arcsin(np.clip(x / (RADIUS_MM + relief), -0.95, 0.95))
        s, v = RADIUS_MM * (angle - roll), y
        s = s + stretched * np.sin(v / 1.6)
        v = v + stretched * np.cos(s / 1.9)
        phase = (
            2
            * np.pi
            / 0.5
            * (np.hypot(s - whorl, v + 3.0 * whorl) + 0.3 * np.sin(0.7 * v + 0.4 * s))
        )
        relief = 1e-3 * um * np.cos(phase)
    mask = (np.abs(x) < half_mm) & (np.abs(y) < 6.6)
    seen = np.where(mask, 1.0, np.nan)
    height = ((RADIUS_MM + relief) * np.cos(angle) * seen).astype(np.float32)
    shape = (np.sqrt(RADIUS_MM**2 - np.minimum(x**2, 60.0)) * seen).astype(np.float32)
    normals = np.zeros((*mask.shape, 3), dtype=np.float32)
    return Reconstruction(
        height,
        height - shape,
        shape,
        mask,
        normals,
        seen.astype(np.float32),
        PITCH,
        np.eye(3),
        mask.shape,
        "truth",
        *((part * seen).astype(np.float32) for part in seen_at if near_mm),
    )


POSE = {"roll": 0.12, "yaw": 0.08, "moved": (0.6, -0.4)}


@pytest.mark.slow
def test_another_pose_is_found_to_the_micrometre_and_gains_are_reported():
    a, b = laid_down(), laid_down(**POSE, um=25.0)
    comparison = compare_results(a, b)
    assert np.rad2deg(np.arccos((np.trace(comparison.rotation) - 1) / 2)) == pytest.approx(
        8.26, abs=0.05
    )
    assert comparison.scale == pytest.approx(1.0, abs=0.02)
    ridges = comparison.figures["0.25 to 0.8 mm"][MAIN]
    assert ridges["gain"]["value"] == pytest.approx(1.2, abs=0.02)
    assert ridges["correlation"]["value"] > 0.995
    assert ridges["gain"]["low"] <= ridges["gain"]["value"] <= ridges["gain"]["high"]
    same = compare_results(a, laid_down(**POSE)).figures
    assert same["relief"][MAIN]["rms_um"]["value"] < 1.0
    assert same["above 8 mm"][MAIN]["rms_um"]["value"] < 1.0
    back = compare_results(b, a)
    np.testing.assert_allclose(back.rotation @ comparison.rotation, np.eye(3), atol=1e-3)
    assert back.figures["relief"][MAIN]["gain"]["value"] == pytest.approx(1 / 1.2, abs=0.02)


@pytest.mark.parametrize("fit", ["rigid", "elastic"])
def test_a_surface_differs_from_itself_by_nothing(fit):
    comparison = compare_results(laid_down(), laid_down(), fit=fit)
    assert comparison.figures["relief"][MAIN]["rms_um"]["value"] < 0.1
    assert "same measurement, to the last digit" in str(comparison.findings[0])


def test_a_perspective_camera_sees_the_same_surface():
    """Its pixels lie up to 0.1 mm beside those of parallel rays (ridges in between follow the
    smooth body's depth)."""
    figures = compare_results(laid_down(), laid_down(near_mm=60.0)).figures
    assert figures["0.25 to 0.8 mm"][MAIN]["rms_um"]["value"] < 1.0
    assert figures["above 8 mm"][MAIN]["rms_um"]["value"] < 2.0


@pytest.mark.slow
def test_what_lies_steeper_than_60_deg_is_not_compared():
    true = laid_down(half_mm=7.5)
    x = np.arange(-7.9, 7.9, PITCH)
    beyond = np.maximum(np.rad2deg(np.arcsin(np.clip(np.abs(x) / RADIUS_MM, 0, 0.95))) - 61.0, 0.0)
    wrong = replace(true, height_mm=true.height_mm + np.float32(0.05) * beyond.astype(np.float32))
    relief = compare_results(wrong, true).figures["relief"][MAIN]
    assert relief["rms_um"]["value"] < 0.5


@pytest.mark.slow
def test_skin_that_has_shifted_is_followed_by_the_elastic_fit():
    a, b = laid_down(), laid_down(**POSE, stretched=0.03)
    stiff, soft = compare_results(a, b), compare_results(a, b, fit="elastic")
    rms = [
        comparison.figures["relief"]["0 to 20"]["rms_um"]["value"] for comparison in (stiff, soft)
    ]
    assert 3 * rms[1] < rms[0]
    assert rms[1] < 1.0
    assert [finding.code for finding in stiff.findings] == ["shifted-skin"]
    assert "above 8 mm" not in soft.figures


def test_other_ridges_and_unknown_scales_are_refused():
    with bad_input("not the same"):
        compare_results(laid_down(), laid_down(whorl=-1.5))
    with bad_input("scale"):
        compare_results(laid_down(), replace(laid_down(), scale_known=False))


@pytest.mark.slow
def test_the_verb_writes_a_private_report_and_states_the_protocols_error(tmp_path, capsys):
    for name, result in {"a": laid_down(), "b": laid_down(**POSE)}.items():
        write_arrays(tmp_path / f"{name}.npz", result, provenance())
    a, b, out = str(tmp_path / "a.npz"), str(tmp_path / "b.npz"), tmp_path / "r"
    assert (
        main(
            ["compare", a, b, "--out", str(out), "--protocol", "powder-5", "--repeat", b, "--json"]
        )
        == 0
    )
    facts = json.loads(capsys.readouterr().out)
    assert (
        facts["own_error"]["powder-5, simulated"]["relief"]["rms_um"] == PROTOCOLS["powder-5"][0][0]
    )
    assert facts["own_error"]["B, repeated"]["relief"]["rms_um"] < 0.1
    for name in facts["files"]:
        assert stat.S_IMODE((out / name).stat().st_mode) == 0o600
    page = (out / "report.html").read_text()
    assert "A - B" in page
    surfaces = json.loads(page.split('id="surfaces">')[1].split("</script>")[0])
    assert [surface["title"] for surface in surfaces] == ["A", "B"]
    frames = [
        [surface[key] for key in ("rows", "columns", "left", "top", "pitch")]
        for surface in surfaces
    ]
    assert frames[0] == frames[1]
    assert main(["compare", a, str(tmp_path / "nothing"), "--out", str(out)]) == 2
    assert (out / "report.json").is_file()
    assert capsys.readouterr().err.count("\n") == 1


def test_the_stated_errors_are_those_of_the_study():
    study = json.loads((Path(__file__).parents[2] / "validation/pair/results.json").read_text())
    names = {"gel": "gel", "cast": "cast, elastic"} | {
        f"powder-{um}": f"powder {um} um" for um in (5, 10, 20)
    }
    for protocol, bands in PROTOCOLS.items():
        for band, (rms, gain) in zip(BANDS_MM, bands, strict=False):
            rows = [pair["truth"][names[protocol]]["bands"][band][MAIN] for pair in study.values()]
            assert rms == pytest.approx(
                np.sqrt(np.mean([row["rms_um"] ** 2 for row in rows])), abs=0.05
            )
            assert gain == pytest.approx(np.mean([row["gain"] for row in rows]), abs=0.005)
