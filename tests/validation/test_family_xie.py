"""Xie's case: the painter of its skin agrees with the fit's model, figures come out, and its tables are filled."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from script_folder import Script, scripts_of
from splitknit.photometric.hanrahan_krueger_fit import SkinLayers, reflected

FOLDER = Path(__file__).resolve().parents[2] / "validation" / "family"


@pytest.fixture(scope="module")
def script() -> Iterator[Script]:
    """Import a script of validation/family by its name."""
    with scripts_of(FOLDER) as named:
        yield named


def test_two_writings_of_one_model_agree(script: Script) -> None:
    painter = script("xie_skin")
    rng = np.random.default_rng(2)
    slope = rng.uniform(-1, 1, (30, 40, 2))
    normals = np.dstack([slope, np.ones((30, 40))])
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    lights = np.array([[0.3, 0.1, 1.0], [-0.5, 0.4, 0.7], [0.9, 0.0, 0.2]])
    skin = painter.Skin(depth=0.6, fraction=0.7)
    fraction, depth = painter.layers(skin, (30, 40), 10.0, rng)
    assert abs(np.log(depth).std() - skin.depth_spread) < 0.01
    images = painter.paint(normals, lights, skin, fraction, depth)
    strength = np.linalg.norm(lights, axis=1, keepdims=True)
    flat = normals.reshape(-1, 3)
    own = reflected(
        lights / strength @ flat.T, flat[:, 2], lights[:, 2:] / strength, np.full(len(flat), skin.base),
        fraction.ravel(), depth.ravel(), np.pi / skin.index**2, SkinLayers(refractive_index=skin.index),
    )  # fmt: skip
    np.testing.assert_allclose((strength * own.value).reshape(images.shape), images, atol=2e-4)
    assert (images == 0).any() and images.max() > 0.3


def test_fit_of_its_own_skin_reaches_what_the_noise_allows(script: Script) -> None:
    rows = script("xie_itself").on_itself(1000, 0.06)
    assert len(rows) == 6
    for row in rows:
        assert row["layers_deg"] < 0.6 * row["lambertian_deg"]
        assert row["converged"] > 0.99
        if row["noise"] > 0:
            assert 0.7 < row["layers_rms_deg"] / row["allowed_rms_deg"] < 1.3


@pytest.mark.slow
def test_figures_of_a_finger(script: Script) -> None:
    xie, ways = script("xie"), script("xie_ways")
    scene = xie.scenes(*xie.photographed(5000, 0.2, "no glare"), ("green",))["green"]
    assert scene.stack.shape == (7, *scene.mask.shape)
    known = ways.ways()
    perfect = ways.figures(scene, np.where(scene.mask[..., None], scene.truth["normals"], 0).astype(np.float32))
    assert perfect["normals_deg"] < 0.1
    assert perfect["ridge_correlation"] > 0.75  # three shapelets pass no more of the band
    found = {name: ways.figures(scene, known[name](scene)[0]) for name in known}
    assert all(2 < each["normals_deg"] < 40 for each in found.values())
    assert len({each["normals_deg"] for each in found.values()}) == len(found)
    assert found["lambertian near"]["normals_deg"] < found["lambertian"]["normals_deg"]
    assert len(ways.trials()) == 23


def test_photographs_are_left_out_where_they_are_absent(
    script: Script, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("SPLITKNIT_DATA", str(tmp_path))
    assert script("xie_photographs").on_photographs() is None


def test_fingers_of_the_trials_are_not_reported(script: Script, capsys: pytest.CaptureFixture[str]) -> None:
    assert script("xie").main(["--first-trial-seed", "1005"]) == 2
    assert "others than those reported" in capsys.readouterr().err


def test_intervals_are_of_the_mean_difference(script: Script) -> None:
    report = script("xie_report")
    values = np.random.default_rng(0).normal(1.0, 2.0, 40)
    mean, low, high = report.interval(values)
    assert mean == pytest.approx(values.mean())
    expected = 1.96 * values.std() / np.sqrt(40)
    assert high - mean == pytest.approx(expected, rel=0.15)
    assert mean - low == pytest.approx(expected, rel=0.15)


def test_the_tables_show_the_results(script: Script) -> None:
    assert script("xie_report").main(["--check"]) == 0, "run validation/family/xie_report.py"


def test_results_are_of_the_fingers_they_name() -> None:
    results = json.loads((FOLDER / "xie.json").read_text(encoding="ascii"))
    seeds = [finger["seed"] for finger in results["fingers"]]
    assert len(set(seeds)) == len(seeds) >= 8
    assert not set(seeds) & {trial["seed"] for trial in results["trials"]}


@pytest.mark.slow
def test_everything_runs_on_tiny_fingers(script: Script, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    xie, report = script("xie"), script("xie_report")
    monkeypatch.setattr(xie, "OUT", tmp_path / "scratch")
    assert xie.main(["--smoke", "--out", str(tmp_path / "xie.json")]) == 0
    results = json.loads((tmp_path / "xie.json").read_text(encoding="ascii"))
    for table in report.TABLES.values():
        rows = table(results)
        assert results["photographs"] is None or len(rows) > 1
        assert len({len(row) for row in rows}) <= 1
