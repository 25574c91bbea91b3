"""The ablation runs on a tiny finger, takes from the light what it says, and its page is filled."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from script_folder import Script
from splitknit.observation.observe import observe
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.twin import simulate_capture

FOLDER = Path(__file__).resolve().parents[2] / "validation" / "separation"


@pytest.fixture(scope="module")
def bench(script: Script) -> Any:
    return script("ablation_rows").Bench(1000, 0.15)


@pytest.fixture
def twin(bench: Any) -> Any:
    return bench.twin


@pytest.mark.slow
def test_the_finger_is_that_of_the_accuracy(twin: Any) -> None:
    capture, _ = simulate_capture(1000, None, TwinSettings(scale=0.15))
    for name, band in capture.bands.items():
        np.testing.assert_array_equal(twin.capture.bands[name].pixels, band.pixels)


def test_true_parts_of_the_light(script: Script, twin: Any) -> None:
    fractions = script("ablation_light").true_shares(twin, 0.42)
    mask = twin.truth["mask"]
    direct, matt, rest = (
        fractions[n][:, mask] for n in ("direct", "direct without glare", "all but glare")
    )
    assert np.all((matt >= 0) & (matt <= direct) & (direct <= 1))
    np.testing.assert_allclose(direct - matt, 1 - rest, atol=1e-5)
    assert 0.1 < direct.mean() < 0.6
    # the fraction of the glare, times the photograph, is the glare of the photograph
    light = observe(twin.capture).white.grey[:, mask]
    glare = twin.truth["glare_white"].astype(np.float32)[:, mask]
    assert np.sum((1 - rest) * light) == pytest.approx(glare.sum(), rel=0.03)
    assert np.corrcoef(((1 - rest) * light).ravel(), glare.ravel())[0, 1] > 0.99


def test_changed_captures(script: Script, twin: Any) -> None:
    light = script("ablation_light")
    capture = twin.capture
    glare = twin.truth["glare_white"].astype(np.float32)
    without = light.without_glare(capture, "white", glare)
    wanted = observe(capture).white.stack - glare
    np.testing.assert_allclose(observe(without).white.stack, wanted, atol=2e-5)
    assert without.bands["nir"] is capture.bands["nir"]
    grey = observe(light.in_grey(capture)).white
    assert not grey.has_colour
    wanted = observe(capture).white.grey
    np.testing.assert_allclose(grey.grey, wanted, atol=2e-5)


def test_the_twin_takes_the_networks_place(
    script: Script, bench: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = script("ablation_rows").ROWS
    plain = bench.reconstructed(rows["snk_plain_all"])
    ones = np.ones((7, *bench.twin.capture.shape), dtype=np.float32)
    fractions = {
        "direct": ones,
        "all but glare": ones * np.linspace(0.2, 1, 7, dtype=np.float32)[:, None, None],
    }
    monkeypatch.setitem(bench.__dict__, "_fractions", fractions)
    direct, matt = (
        bench.reconstructed(rows[name]) for name in ("snk_plain_direct", "snk_plain_matt")
    )
    np.testing.assert_array_equal(direct.height_mm, plain.height_mm)
    np.testing.assert_array_equal(direct.mask, plain.mask)
    assert not np.allclose(matt.ridge_mm[matt.mask], plain.ridge_mm[plain.mask], rtol=0.1, atol=0)


@pytest.mark.slow
def test_one_tiny_finger(script: Script, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ablation, rows = script("ablation"), script("ablation_rows")
    names = ["ea-split", "snk_plain_all"]
    (finger,) = ablation.measure_all([1000], names, 0.15, tmp_path, 1)
    (pair,) = ablation.summarised([finger], names)["pairs"]
    for key, figure in pair["figures"].items():
        assert figure["interval"] is None
        assert figure["mean"] == pytest.approx(
            finger["snk_plain_all"][key] - finger["ea-split"][key]
        )
    monkeypatch.setattr(rows, "Bench", lambda *_: pytest.fail("measured again"))
    assert ablation.measure_one(1000, names, 0.15, tmp_path) == finger


def test_statistics(script: Script) -> None:
    ablation = script("ablation")
    figure = ablation.statistics([1.0, 2.0, 4.0, 5.0])
    # 3 +- t(0.975, 3 degrees of freedom) times 1.8257 / 2
    assert figure["mean"] == 3.0
    assert figure["interval"] == pytest.approx(
        [3.0 - 3.1824 * 0.91287, 3.0 + 3.1824 * 0.91287], abs=1e-3
    )

    keys = script("ablation_rows").FIGURES
    fingers = [
        {
            "ea-split": dict.fromkeys(keys, 0.5 + 0.1 * k),
            "snk_plain_all": dict.fromkeys(keys, 0.7 + 0.1 * k),
        }
        for k in range(3)
    ]
    fingers.append(
        {"ea-split": dict.fromkeys(keys, 0.1), "snk_plain_all": {"refused": "no finger"}}
    )
    results = ablation.summarised(fingers, ["ea-split", "snk_plain_all"])
    assert results["rows"]["snk_plain_all"]["refused"] == 1
    assert results["rows"]["ea-split"]["figures"]["ridge_gain"]["mean"] == pytest.approx(0.475)
    (pair,) = results["pairs"]
    assert pair["fingers"] == 3
    difference = pair["figures"]["normals_mean_deg"]
    assert difference["mean"] == pytest.approx(0.2)
    assert difference["interval"] == pytest.approx([0.2, 0.2])


def test_the_page_shows_the_figures(script: Script) -> None:
    assert script("ablation_report").main(["--check"]) == 0, (
        "run validation/separation/ablation_report.py"
    )
    results = json.loads((FOLDER / "ablation.json").read_text())
    rows = script("ablation_rows")
    assert set(rows.ROWS) - set(rows.CONTRAST_ROWS) <= set(results["rows"])
    assert {name for _, *pair in rows.PAIRS for name in pair} <= set(rows.ROWS)


def test_contrast_is_shown_with_intervals_over_fingers(script: Script) -> None:
    report = script("ablation_report")
    fingers = [
        {
            "rows": {
                "a": dict.fromkeys(report.COLUMNS, 0.5 + 0.1 * k),
                "b": dict.fromkeys(report.COLUMNS, 0.1 * k),
            }
        }
        for k in range(3)
    ]
    rows = {"a": {"words": "one"}, "b": {"words": "other"}}
    pairs = [{"words": "one instead of the other", "row": "a", "against": "b"}]
    results = {"seeds": [1, 2, 3], "scale": 0.5, "rows": rows, "pairs": pairs, "fingers": fingers}
    text = report.contrast_section(results, ["one", "other", "*one instead of the other*"])
    # of three fingers the mean of a draw is that of the lowest or of the highest in one of 27
    assert "| one | 0.600 [0.500, 0.700] |" in text and "| other | 0.100 [0.000, 0.200] |" in text
    assert "| *one instead of the other* | +0.500 [+0.500, +0.500] |" in text
    assert "\none,0.600,0.500,0.700," in report.contrast_csv(results)
    assert "\none instead of the other,+0.500,+0.500,+0.500," in report.contrast_csv(results)


def test_the_error_after_the_best_factor_is_that_of_amplified_ridges(script: Script) -> None:
    rng = np.random.default_rng(1)
    true = rng.standard_normal(4000)
    estimated = 0.2 * true + 0.1 * rng.standard_normal(4000)
    errors = []
    for factor in (1.0, 1.7):
        ridges = factor * estimated
        row = {
            "ridge_gain": float(ridges @ true / (true @ true)),
            "ridge_correlation": float(ridges @ true / np.sqrt((ridges @ ridges) * (true @ true))),
            "ridge_rms_um": float(np.sqrt(np.mean((ridges - true) ** 2))),
        }
        errors.append(script("ablation_report").best_factor_um(row))
    best = (estimated @ true) / (estimated @ estimated) * estimated
    assert errors == pytest.approx([float(np.sqrt(np.mean((best - true) ** 2)))] * 2)
