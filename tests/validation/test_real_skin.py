"""Predicting a light that was left out, small."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from script_folder import VALIDATION, Script
from splitknit import preset_settings, read_capture, reconstruct, write_capture
from splitknit.capture import Band, Capture
from splitknit.model import Camera, Led, Rig
from splitknit.skin.grid import Grid
from splitknit_simulator import simulate_capture

TABLES = VALIDATION / "real_skin" / "tables"


FOLDER = VALIDATION / "real_skin"


def matt_bump() -> Capture:
    """A matt bump under distant lights, grey."""
    y, x = np.mgrid[-80:81, -60:61] / 10.0
    height = 4.0 * np.exp(-(x**2 + y**2) / 18.0)
    normals = np.dstack([height * x / 9.0, height * y / 9.0, np.ones_like(x)])
    normals[..., 1] *= -1  # y is up
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    azimuth = np.arange(7) * 2 * np.pi / 7
    towards = np.stack([0.35 * np.cos(azimuth), 0.35 * np.sin(azimuth), np.full(7, 0.94)], axis=1)
    images = np.clip(40000 * np.einsum("hwi,li->lhw", normals, towards), 0, 65535).astype(np.uint16)
    band = Band("white", images[..., None], tuple((k,) for k in range(7)), np.ones(7), np.zeros(7))
    rig = Rig(
        Camera(10.0, x.shape), tuple(Led("white", direction=tuple(map(float, v))) for v in towards)
    )
    return Capture(rig, {"white": band}, material="opaque", mask=x**2 + y**2 < 30)


def test_an_image_is_left_out(script: Script) -> None:
    rest = script("predict").without(matt_bump(), "white", 2).bands["white"]
    assert rest.leds == ((0,), (1,), (3,), (4,), (5,), (6,))
    assert rest.pixels.shape[0] == rest.exposure.size == rest.black_level.size == 6


def test_a_matt_surface_is_predicted(script: Script) -> None:
    row = script("predict").left_out(matt_bump(), "white", 2, preset_settings("metric"))
    (ways,) = row["channels"].values()
    assert ways["model"]["rms"] < 0.01
    assert ways["lambertian"]["rms"] < 0.005
    assert ways["neighbours"]["rms"] > ways["model"]["rms"]


def test_figures_of_known_predictions(script: Script) -> None:
    figures = script("predict").figures
    rng = np.random.default_rng(1)
    grid = Grid(
        np.ones((120, 100), np.bool_),
        np.arange(100) * 0.05,
        np.arange(120) * 0.05,
        0.05,
        (False,) * 4,
    )
    seen = (1 + 0.05 * rng.standard_normal((6, 120, 100))).astype(np.float32)
    slant = np.full(grid.shape, 10.0, np.float32)
    perfect = figures(2 * seen, seen, 1, grid, slant)
    assert perfect["rms"] < 1e-6
    assert [perfect[name] for name in ("ridges", "change", "gain")] == pytest.approx(
        [1, 1, 1], abs=1e-4
    )
    assert "rms_20_40" not in perfect
    opposite = seen.copy()
    opposite[1] = 2 * seen[np.arange(6) != 1].mean(axis=0) - seen[1]
    assert figures(opposite, seen, 1, grid, slant)["gain"] == pytest.approx(-1, abs=0.05)


@pytest.mark.slow
def test_a_simulated_finger(
    script: Script, twin_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "results.json"
    command = f"{twin_folder} --surface {twin_folder} --set metric.rounds=1 --out {out}".split()
    assert script("run").main(command) == 0
    rows = json.loads(out.read_text())["capture"]
    assert [(row["band"], row["image"]) for row in rows] == [
        ("white", 0),
        ("white", 2),
        ("white", 4),
    ]
    assert all(row["gloss"] == 0 for row in rows)
    assert all(0 < row["channels"]["green"]["model"]["rms"] < 0.2 for row in rows)
    assert len(capsys.readouterr().out.splitlines()) == 4
    settings = script("run").chosen_settings(["metric.rounds=1"])
    row = script("predict").left_out(read_capture(twin_folder), "nir", 3, settings)
    assert row["channels"]["nir"]["model"]["rms"] < 0.2


def drifted(capture: Capture, truth: dict[str, Any]) -> Capture:
    """White images of light that is refracted as it enters: moved away from their LED (Wang and
    Jacques 1995)."""
    band, per_mm = capture.bands["white"], capture.rig.camera.px_per_mm
    towards = capture.rig.select(band.leds).light_vectors()
    towards /= 1.42 * np.linalg.norm(towards, axis=1, keepdims=True)  # sine of the refracted angle
    mean_path_mm = 1 / (
        truth["optics_scattering_per_mm"] + 0.35 * truth["optics_absorption_per_mm"]
    )
    moved = band.pixels.copy()
    size = moved.shape[2], moved.shape[1]
    for image, (x, y, _) in zip(moved, towards, strict=True):
        for c in range(3):
            shift = np.array(
                [[1, 0, -x * mean_path_mm[c] * per_mm], [0, 1, y * mean_path_mm[c] * per_mm]]
            )
            channel = np.ascontiguousarray(image[..., c])
            image[..., c] = cv2.warpAffine(
                channel, shift, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
            )
    return replace(capture, bands={**capture.bands, "white": replace(band, pixels=moved)})


@pytest.mark.slow
def test_refracted_light_shades_ridges_less_behind_crossed_polarisers(script: Script) -> None:
    capture, truth = simulate_capture(3, "whorl", {"scale": 0.2, "skin": {"glare": [0.0, 0.0]}})
    settings = script("run").chosen_settings(["metric.rounds=1"])
    surface = reconstruct(capture, settings=settings)
    gains = [
        script("predict").left_out(photographed, "white", 2, settings, surface)["channels"][
            "green"
        ]["model"]["gain"]
        for photographed in (capture, drifted(capture, truth))
    ]
    assert gains[0] > 0.5
    assert gains[1] < 0.5 * gains[0]


def test_bad_input_takes_one_sentence(
    script: Script, twin_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    few = matt_bump()
    for image in (6, 5, 4):
        few = script("predict").without(few, "white", image)
    write_capture(replace(few, mask=None), tmp_path / "few")
    for command, expected in (
        ([str(tmp_path / "none")], "none"),
        ([str(tmp_path / "few")], "has 4 images; leaving one out needs 5"),
        ([str(twin_folder), "--set", "metric.rounds"], "--set needs STAGE.FIELD=VALUE"),
        ([str(twin_folder), "--set", "metric.nothing=1"], "nothing"),
    ):
        assert script("run").main(command) == 2
        error = capsys.readouterr().err
        assert expected in error
        assert error.count("\n") == 1


def stored(name: str) -> list[list[str]]:
    with (TABLES / name).open(newline="", encoding="utf-8") as file:
        return list(csv.reader(file))


def test_the_stored_table_is_that_of_the_results(script: Script) -> None:
    results = json.loads((VALIDATION / "real_skin" / "results.json").read_text())
    assert script("run").table(results) == stored("predictions.csv")
