"""Xie's case: EA with two-layer skin, and nothing else."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from splitknit.cli.main import main
from splitknit.errors import BadInput
from splitknit.model import Capture, Reconstruction
from splitknit.pipeline import reconstruct
from splitknit.presets import PRESETS
from splitknit.settings import flatten
from splitknit.steps import Memory


@pytest.fixture(scope="module")
def xie(twin_capture: Capture, twin_memory: Memory) -> Reconstruction:
    return reconstruct(twin_capture, "xie", memory=twin_memory)


def test_it_differs_from_ea_by_the_reflectance_alone() -> None:
    ea, xie = (flatten(asdict(PRESETS[name])) for name in ("ea", "xie"))
    changed = {name: (ea[name], xie[name]) for name in ea if ea[name] != xie[name]}
    assert changed == {
        "normals.method": ("lambertian", "hanrahan_krueger"),
        "normals.hanrahan_krueger.weights": ("robust", "equal"),
    }


@pytest.mark.slow
def test_surface_follows_from_the_layers(twin_capture: Capture, twin_memory: Memory, xie: Reconstruction) -> None:
    plain = reconstruct(twin_capture, "ea", memory=twin_memory)
    np.testing.assert_array_equal(xie.mask, plain.mask)
    between = np.sum(xie.normals * plain.normals, axis=-1)[xie.mask]
    turned = np.degrees(np.arccos(np.clip(between, -1, 1)))
    assert 0.1 < turned.mean() < 5
    assert np.isfinite(xie.height_mm[xie.mask]).all()
    # a surface that passes less light from the side makes sloping skin darker: it is taken for less steep
    tilt, flat = (np.degrees(np.arccos(result.normals[..., 2][xie.mask])) for result in (xie, plain))
    steep = flat > 30
    assert tilt[steep].mean() < flat[steep].mean()


@pytest.mark.slow
def test_settings_reach_the_fit(twin_capture: Capture, twin_memory: Memory, xie: Reconstruction) -> None:
    change = {"normals.hanrahan_krueger.layers.refractive_index": 1.37}
    other = reconstruct(twin_capture, "xie", change, memory=twin_memory)
    assert not np.array_equal(other.height_mm, xie.height_mm, equal_nan=True)
    with pytest.raises(BadInput, match="refractive_index"):
        reconstruct(twin_capture, "xie", {"normals.hanrahan_krueger.layers.refractive_index": 1.0})


def test_bad_settings_are_one_sentence(twin_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["reconstruct", str(twin_folder), "--out", str(tmp_path / "out"), "--preset", "xie"]
    assert main([*command, "--set", "normals.hanrahan_krueger.base_reflectance=7"]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert len(said.err.strip().splitlines()) == 1
    assert "hanrahan_krueger.base_reflectance must be from 0.01 to 1" in said.err
    assert not (tmp_path / "out").exists()
