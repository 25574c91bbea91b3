"""The ablation runs on a tiny finger, takes from the light what it says, and its page is filled."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from script_folder import Script, scripts_of
from splitknit.imaging.band import linear_channels, linear_stack
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.twin import simulate_capture

FOLDER = Path(__file__).resolve().parents[2] / "validation" / "separation"


@pytest.fixture(scope="module")
def script() -> Iterator[Script]:
    """Import a script of validation/separation by its name."""
    with scripts_of(FOLDER) as named:
        yield named


@pytest.fixture(scope="module")
def bench(script: Script) -> Any:
    rows = script("ablation_rows")
    return rows.Bench(1000, rows.Options(scale=0.15))


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
    direct, matt, rest = (fractions[n][:, mask] for n in ("direct", "direct without glare", "all but glare"))
    assert np.all((matt >= 0) & (matt <= direct) & (direct <= 1))
    np.testing.assert_allclose(direct - matt, 1 - rest, atol=1e-5)
    assert 0.1 < direct.mean() < 0.6
    # the fraction of the glare, times the photograph, is the glare of the photograph
    light = linear_stack(twin.capture.bands["white"], "linear", "grey")[:, mask]
    glare = twin.truth["glare_white"].astype(np.float32)[:, mask]
    assert np.sum((1 - rest) * light) == pytest.approx(glare.sum(), rel=0.03)
    assert np.corrcoef(((1 - rest) * light).ravel(), glare.ravel())[0, 1] > 0.99


def test_changed_captures(script: Script, twin: Any) -> None:
    light = script("ablation_light")
    capture, names = twin.capture, ("red", "green", "blue")
    glare = twin.truth["glare_white"].astype(np.float32)
    without = light.without_glare(capture, "white", glare)
    wanted = linear_channels(capture.bands["white"], "linear", names) - glare
    np.testing.assert_allclose(linear_channels(without.bands["white"], "linear", names), wanted, atol=2e-5)
    assert without.bands["nir"] is capture.bands["nir"]
    grey = light.in_grey(capture).bands["white"]
    assert grey.pixels.shape[-1] == 1
    wanted = linear_stack(capture.bands["white"], "linear", "grey")
    np.testing.assert_allclose(linear_stack(grey, "linear", "grey"), wanted, atol=2e-5)


def test_the_twin_takes_the_networks_place(script: Script, bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    rows = script("ablation_rows").ROWS
    plain = bench.reconstructed(rows["snk_plain_all"])
    ones = np.ones((7, *bench.twin.capture.shape), dtype=np.float32)
    fractions = {"direct": ones, "all but glare": ones * np.linspace(0.2, 1, 7, dtype=np.float32)[:, None, None]}
    monkeypatch.setitem(bench.__dict__, "_fractions", fractions)
    same, other = (bench.reconstructed(rows[name]) for name in ("snk_plain_direct", "snk_plain_matt"))
    np.testing.assert_array_equal(same.height_mm, plain.height_mm)
    np.testing.assert_array_equal(same.mask, plain.mask)
    assert not np.allclose(other.ridge_mm[other.mask], plain.ridge_mm[plain.mask], rtol=0.1, atol=0)


def test_share_that_the_network_finds_in_colours(script: Script, bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def finding(enhanced: Any, images: Any, network: str) -> Any:
        assert network == "direct" and np.all(enhanced == 1)
        inside = images[:, :, bench.finger.wider[bench.finger.window]]
        assert np.all(images >= 0) and np.all(images[:, :, ~bench.finger.wider[bench.finger.window]] == 0)
        # red, green and blue of each light in their order
        white = linear_channels(bench.twin.capture.bands["white"], "linear", ("red", "green", "blue"))
        wanted = np.maximum(white[:, :, bench.finger.wider], 0).swapaxes(0, 1)
        np.testing.assert_array_equal(inside, wanted)
        return np.linspace(0.2, 1, 7, dtype=np.float32)[:, None, None] * enhanced

    rows = script("ablation_rows")
    with monkeypatch.context() as patch:
        patch.setattr(rows, "direct_of_enhanced", finding)
        fraction = type(bench)._coloured.func(bench)
    np.testing.assert_allclose(fraction[:, 0, 0], 1)
    monkeypatch.setitem(bench.__dict__, "_coloured", fraction)
    monkeypatch.setitem(bench.__dict__, "_fractions", {"all but glare": fraction})
    by_network, by_truth = (bench.reconstructed(rows.ROWS[f"snk_plain_{name}"]) for name in ("colours", "matt"))
    np.testing.assert_array_equal(by_network.height_mm, by_truth.height_mm)


def test_glare_that_the_network_draws(script: Script, bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    rows = script("ablation_rows")
    height, width = bench.twin.capture.shape
    window = (slice(10, 75), slice(20, 90))
    turns = iter((1.0, 2.0))

    def drawing(*_: object) -> SimpleNamespace:
        return SimpleNamespace(glare=np.full((7, 32, 35), next(turns), dtype=np.float32))

    def in_two_turns(*_: object) -> str:
        for _ in range(2):
            rows.metric.relief_of_output(None, None, None, None)
        return "surface"

    with monkeypatch.context() as patch:
        patch.setattr(rows.metric, "relief_of_output", drawing)
        patch.setattr(rows, "glare_of", lambda found, *_: found.glare)
        patch.setattr(rows, "reconstruct", in_two_turns)
        patch.setattr(bench, "finger", replace(bench.finger, window=window))
        surface, glare = type(bench)._by_network.func(bench)
        assert rows.metric.relief_of_output is drawing
    assert surface == "surface"
    # that of the last turn, two pixels a side for one, and the row that is left over
    expected = np.zeros((7, height, width), dtype=np.float32)
    expected[:, *window] = 2.0
    np.testing.assert_array_equal(glare, expected)

    with monkeypatch.context() as patch:
        patch.setattr(rows, "reconstruct", lambda *_: None)
        assert "cannot read" in bench.figures("near_network")["refused"]


def run(out: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-W", "error", str(FOLDER / "ablation.py"), "--scale", "0.15", "--workers", "1"]
    command += ["--out", str(out / "ablation.json"), "--scratch", str(out / "scratch"), *arguments]
    return subprocess.run(
        command, capture_output=True, text=True, check=False, env={**os.environ, "PYTHONWARNINGS": "error"}
    )


@pytest.mark.slow
def test_one_tiny_finger(tmp_path: Path) -> None:
    command = ("--fingers", "1", "--rows", "ea-split", "snk_plain_all")
    done = run(tmp_path, *command)
    assert done.returncode == 0 and done.stderr == "", done.stderr
    results = json.loads((tmp_path / "ablation.json").read_text())
    assert list(results["rows"]) == ["ea-split", "snk_plain_all"] and results["seeds"] == [1000]
    (pair,) = results["pairs"]
    (finger,) = results["fingers"]
    for key, figure in pair["figures"].items():
        assert figure["interval"] is None
        one, other = (finger["rows"][name][key] for name in ("snk_plain_all", "ea-split"))
        assert figure["mean"] == pytest.approx(one - other, abs=2e-4 * abs(one))
    # a second run takes the finger from the disk
    (single,) = (tmp_path / "scratch").glob("*/01000.json")
    stamp = single.stat().st_mtime_ns
    assert run(tmp_path, *command).returncode == 0
    assert single.stat().st_mtime_ns == stamp
    assert json.loads((tmp_path / "ablation.json").read_text()) == results


def test_rows_of_a_changed_network_are_measured_again(
    script: Script, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []

    class Counting:
        def __init__(self, *_: object) -> None:
            pass

        def figures(self, name: str) -> dict[str, float]:
            asked.append(name)
            return {"ridge_gain": float(len(asked))}

    rows, ablation = script("ablation_rows"), script("ablation")
    monkeypatch.setattr(rows, "Bench", Counting)
    monkeypatch.setattr(ablation, "_one_thread", lambda: None)
    for sha, wanted in (("a", ["ea-split", "metric"]), ("a", []), ("b", ["metric"])):
        asked.clear()
        found = ablation._measure_all([7], {"ea-split": {}, "metric": {"relief": sha}}, rows.Options(), tmp_path, 1)
        assert asked == wanted
    assert found == [{"ea-split": {"ridge_gain": 1.0}, "metric": {"ridge_gain": 1.0}}]


def test_unknown_row_is_refused(tmp_path: Path) -> None:
    done = run(tmp_path, "--rows", "mood")
    assert done.returncode == 2 and "mood" in done.stderr and not list(tmp_path.iterdir())


def test_statistics(script: Script) -> None:
    ablation = script("ablation")
    figure = ablation.statistics([1.0, 2.0, 4.0, 5.0])
    # 3 +- t(0.975, 3 degrees of freedom) times 1.8257 / 2
    assert figure["mean"] == 3.0
    assert figure["interval"] == pytest.approx([3.0 - 3.1824 * 0.91287, 3.0 + 3.1824 * 0.91287], abs=1e-3)

    keys = script("ablation_rows").FIGURES
    fingers = [
        {"ea-split": dict.fromkeys(keys, 0.5 + 0.1 * k), "snk_plain_all": dict.fromkeys(keys, 0.7 + 0.1 * k)}
        for k in range(3)
    ]
    fingers.append({"ea-split": dict.fromkeys(keys, 0.1), "snk_plain_all": {"refused": "no finger"}})
    results = ablation.summarised(fingers, ["ea-split", "snk_plain_all"])
    assert results["rows"]["snk_plain_all"]["refused"] == 1
    assert results["rows"]["ea-split"]["figures"]["ridge_gain"]["mean"] == pytest.approx(0.475)
    (pair,) = results["pairs"]
    assert pair["fingers"] == 3
    difference = pair["figures"]["normals_mean_deg"]
    assert difference["mean"] == pytest.approx(0.2)
    assert difference["interval"] == pytest.approx([0.2, 0.2])


def test_rows_are_what_they_are_called(script: Script, bench: Any) -> None:
    rows = script("ablation_rows")
    for _, first, second in rows.PAIRS:
        assert first in rows.ROWS and second in rows.ROWS
    for name, preset in (("snk_clahe_network", "snk"), ("ea-split", "ea-split"), ("metric", "metric")):
        assert bench._settings(rows.ROWS[name]) == rows.preset_settings(preset)


def test_the_page_shows_the_figures(script: Script) -> None:
    assert script("ablation_report").main(["--check"]) == 0, "run validation/separation/ablation_report.py"
    results = json.loads((FOLDER / "ablation.json").read_text())
    rows = script("ablation_rows")
    assert list(results["rows"]) == [name for name in rows.ROWS if name not in rows.CONTRAST_ROWS]


def test_contrast_is_shown_with_intervals_over_fingers(script: Script) -> None:
    report = script("ablation_report")
    fingers = [
        {"rows": {"a": dict.fromkeys(report.COLUMNS, 0.5 + 0.1 * k), "b": dict.fromkeys(report.COLUMNS, 0.1 * k)}}
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


def test_page_is_filled(script: Script, tmp_path: Path) -> None:
    report = script("ablation_report")
    figures = {key: {"mean": 0.5, "interval": [0.4, 0.6]} for key in report.COLUMNS}
    results = {
        "seeds": [1000, 1001],
        "scale": 0.5,
        "check_mm": 0.42,
        "rows": {"ea-split": {"group": "one", "words": "all light", "refused": 1, "figures": figures}},
        "pairs": [{"words": "a against b", "row": "a", "against": "b", "figures": figures}],
    }
    text = report.section(results)
    assert "| `ea-split` (1 refused) | 0.500 [0.400, 0.600] | 0.50 [0.40, 0.60] | 0.5 [0.4, 0.6] |" in text
    assert report.rows_csv(results).splitlines()[1].startswith("ea-split,one,all light,1,0.500,0.400,0.600,0.50,")
    assert report.pairs_csv(results).splitlines()[1].startswith("a against b,a,b,+0.500,+0.400,+0.600,")
    # an interval ends where the figure does, a difference's does not
    figures = {key: {"mean": 0.9, "interval": [0.7, 1.1]} for key in report.COLUMNS}
    assert "| x | 0.900 [0.700, 1.000] | 0.90 [0.70, 1.10] |" in report._line("x", figures)
    pairs = {"pairs": [{"words": "x", "row": "a", "against": "b", "figures": figures}]}
    assert "x,a,b,+0.900,+0.700,+1.100," in report.pairs_csv(pairs)
    page = report.filled("# Page\n", "old")
    assert page == "# Page\n\n## Ablation\n\n<!-- ablation -->\nold\n<!-- /ablation -->\n"
    assert report.filled(page + "more\n", "new") == page.replace("old", "new") + "more\n"
    with pytest.raises(ValueError, match="no <!-- /ablation -->"):
        report.filled("<!-- ablation -->\n", "x")
    file, target = tmp_path / "ablation.json", tmp_path / "page.md"
    file.write_text(json.dumps(results))
    target.write_text("# Page\n")
    command = ["--results", str(file), "--page", str(target)]
    assert report.main([*command, "--check"]) == 1
    assert report.main(command) == 0
    assert report.main([*command, "--check"]) == 0
