"""Recall and linkability of shards: the measure itself, and a tiny store from end to end."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from script_folder import Script, scripts_of
from splitknit_match.batch.chunks import SUFFIX, write_chunk
from splitknit_match.batch.features import BANDS, QUALITY, _feature_schema
from splitknit_match.matching.template import Template, pack

pytest.importorskip("pyarrow")

FOLDER = Path(__file__).resolve().parents[2] / "validation" / "match"


@pytest.fixture(scope="module")
def script() -> Iterator[Script]:
    """Import a script of validation/match by its name."""
    with scripts_of(FOLDER) as named:
        yield named


def test_linkability_of_known_distributions(script: Script) -> None:
    """Against the integral, for normal scores one deviation apart; 0 where they are the same, 1 where they part."""
    d_sys, rng = script("shards").d_sys, np.random.default_rng(0)
    one, two = rng.normal(0, 1, 200_000), rng.normal(0, 1, 200_000)
    assert d_sys(one, two) < 0.01
    assert d_sys(one, two + 100) == pytest.approx(1.0)
    s = np.linspace(-8, 9, 20_001)
    p, q = np.exp(-((s - 1) ** 2) / 2), np.exp(-(s**2) / 2)
    expected = (p * np.clip(2 * p / (p + q) - 1, 0, None)).sum() / p.sum()
    assert d_sys(one + 1, two) == pytest.approx(expected, abs=0.01)


def test_intervals_are_by_finger(script: Script) -> None:
    by_finger = script("shards").by_finger
    owners = ["a"] * 50 + ["b"] * 50 + ["c"] * 50
    value, low, high = by_finger(np.ones(150, bool), owners)
    assert (value, high) == (1.0, 1.0)
    assert low < 0.45  # three fingers, not 150 probes
    value, low, high = by_finger(np.array([True] * 100 + [False] * 50), owners)
    assert (round(value, 2), low) == (0.67, 0.0)


@pytest.fixture
def store(tmp_path: Path) -> Path:
    """Six fingers in two sessions: waves that differ by finger, with noise that differs by session."""
    columns: dict[str, list[object]] = {name: [] for name in _feature_schema().names}
    down, right = np.mgrid[0:200, 0:160] * 0.1
    for number in range(12):
        finger, session = divmod(number, 2)
        turn = 0.4 * finger + 0.06 * (right if finger % 2 else down)
        wave = np.cos(2 * np.pi * (np.cos(turn) * right + np.sin(turn) * down) / (0.42 + 0.02 * finger))
        wave += np.random.default_rng(number).normal(0, 0.2, wave.shape)
        level = np.digitize(wave, (-0.7, 0, 0.7)).astype(np.uint8)
        row = dict.fromkeys(f"{name}_{band}" for band in BANDS for name in QUALITY)
        row |= {"capture": f"S0{finger + 1}/session_{session + 1}/x", "subject": f"S0{finger + 1}", "finger": "x"}
        row |= {"session": str(session + 1), "acquired": True, "failure": "", "area_mm2": 70.0, "warnings": []}
        row |= {"input_sha256": "0" * 64, "template": pack(Template(level, np.ones(level.shape, bool), 0.1))}
        row |= {"print": None, "images": None}
        for name, value in row.items():
            columns[name].append(value)
    folder = tmp_path / "store"
    write_chunk(
        folder / "features" / "metric" / f"00000-waves{SUFFIX}", columns, _feature_schema(), {"kind": "features"}
    )
    return folder


@pytest.mark.slow
def test_recall_and_keys_from_end_to_end(script: Script, store: Path, tmp_path: Path, monkeypatch) -> None:
    shards, out = script("shards"), tmp_path / "shards.json"
    noise = np.random.default_rng(0).normal(0, 26, (400, 192)).round().clip(-127, 127).astype(np.int8)
    monkeypatch.setattr(shards, "bases", lambda *unused: noise)
    common = ["--work", str(tmp_path / "work"), "--store", str(store), "--first", "1", "--out", str(out)]
    shards.main(["recall", *common, "--fingers", "3000"])
    shards.main(["keys", *common, "--fingers", "3000", "--pairs", "40"])
    found = json.loads(out.read_text())
    at = found["recall"]["sizes"]["3000"]
    assert at["within"]["500"][0] == 1.0
    assert at["missed"] == []
    links = found["keys"]["d_sys"]["other capture"]
    assert links["one key, numbers"] > 0.9
    assert links["two keys, numbers"] < 0.35  # 240 scores: chance alone gives about a fifth
