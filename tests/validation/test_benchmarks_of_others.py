"""The loaders of public benchmarks on miniature folders of the same layout."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.io import savemat

from script_folder import VALIDATION, Script, scripts_of
from splitknit_simulator.finger.finger import draw_finger

SIDE, RADIUS = 96, 40.0


@pytest.fixture
def run() -> Iterator[Script]:
    with scripts_of(VALIDATION / "benchmarks") as named:
        yield named("run")


def ball() -> tuple[np.ndarray, np.ndarray]:
    """Normals and mask of a ball that fills most of the picture."""
    i, j = np.mgrid[0:SIDE, 0:SIDE]
    x, y = (j - (SIDE - 1) / 2) / RADIUS, ((SIDE - 1) / 2 - i) / RADIUS
    mask = x * x + y * y < 0.9
    z = np.sqrt(np.where(mask, 1 - x * x - y * y, 1))
    return np.where(mask[..., None], np.dstack([x, y, z]), 0.0), mask


def write_images(
    folder: Path, names: list[str], shading: np.ndarray, strengths: np.ndarray
) -> None:
    for name, picture, strength in zip(names, shading, strengths, strict=True):
        # OpenCV writes blue first
        colours = np.clip(picture[..., None] * strength[::-1] * 20_000, 0, 65_535)
        cv2.imwrite(str(folder / name), colours.astype(np.uint16))


def test_diligent(tmp_path: Path, run: Script, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "ballPNG"
    folder.mkdir()
    normals, mask = ball()
    rng = np.random.default_rng(0)
    lights = np.column_stack([rng.uniform(-0.5, 0.5, (12, 2)), np.ones(12)])
    lights /= np.linalg.norm(lights, axis=1, keepdims=True)
    strengths = rng.uniform(0.5, 1.5, (12, 3))
    names = [f"{k + 1:03d}.png" for k in range(12)]
    write_images(folder, names, np.clip(normals @ lights.T, 0, None).transpose(2, 0, 1), strengths)
    (folder / "filenames.txt").write_text("\n".join(names))
    np.savetxt(folder / "light_directions.txt", lights)
    np.savetxt(folder / "light_intensities.txt", strengths)
    cv2.imwrite(str(folder / "mask.png"), mask.astype(np.uint8) * 255)
    savemat(folder / "Normal_gt.mat", {"Normal_gt": normals})
    assert run.main(["diligent", str(tmp_path), "--json", str(tmp_path / "rows.json")]) == 0
    rows = json.loads((tmp_path / "rows.json").read_text())
    assert [row["preset"] for row in rows] == ["metric", "ea"]
    assert rows[0]["object"] == "ballPNG" and rows[0]["lights"] == 12
    assert rows[0]["measured_deg"] < 0.5
    (folder / "light_intensities.txt").write_text("1 1 1\n")
    assert run.main(["diligent", str(folder)]) == 2
    assert "differ in length" in capsys.readouterr().err


def test_luces(tmp_path: Path, run: Script) -> None:
    folder = tmp_path / "Bowl"
    folder.mkdir()
    focal, distance, radius = 400.0, 100.0, 11.0
    i, j = np.mgrid[0:SIDE, 0:SIDE]
    rays = np.dstack([(j - 47.5) / focal, (i - 47.5) / focal, np.ones((SIDE, SIDE))])
    middle = np.array([0.0, 0.0, distance])
    a, b, c = (rays**2).sum(-1), rays @ middle, middle @ middle - radius**2
    inside = b * b - a * c
    depth = (b - np.sqrt(np.maximum(inside, 0))) / a
    points = rays * depth[..., None]
    normals = (points - middle) / radius
    mask = (inside > 0) & (normals[..., 2] < -0.4)
    rng = np.random.default_rng(1)
    angle = np.linspace(0, 2 * np.pi, 10, endpoint=False)
    positions = np.column_stack([40 * np.cos(angle), 40 * np.sin(angle), rng.uniform(-5, 5, 10)])
    strengths = rng.uniform(0.7, 1.3, (10, 3))
    shading = []
    for position in positions:
        to_light = position - points
        away = np.linalg.norm(to_light, axis=-1)
        lobe = np.clip(to_light[..., 2] / -away, 0, None)  # the axis looks along z
        shading.append(
            np.where(
                mask,
                1e4 * lobe * np.clip((normals * to_light).sum(-1) / away, 0, None) / away**2,
                0,
            )
        )
    write_images(folder, [f"{k + 1:02d}.png" for k in range(10)], np.array(shading), strengths)
    head = "N_img nrows ncols f x0 y0 mean_distance\n"
    rows = [f"10 {SIDE} {SIDE} {focal} 47.5 47.5 {distance - radius}\n"]
    for position, strength in zip(positions, strengths, strict=True):
        rows.append(
            " ".join(f"{value:.5f}" for value in (*position, 0, 0, 1, *strength, 1, 0)) + "\n"
        )
    (folder / "led_params.txt").write_text(head + "".join(rows))
    cv2.imwrite(str(folder / "mask.png"), mask.astype(np.uint8) * 255)
    ours = np.where(mask[..., None], normals * [1, -1, -1], 0)
    cv2.imwrite(str(folder / "normals.png"), ((ours[..., ::-1] + 1) / 2 * 65_535).astype(np.uint16))
    np.savez(folder / "zgt.npz", zgt=np.where(mask, depth, 0))
    scene = next(run.scenes("luces", tmp_path))
    assert scene.error_deg(scene.normals) < 0.01
    row = scene.row("metric")
    assert row["measured_deg"] < 1.5
    assert row["height_mm"] < 0.2


@pytest.mark.slow
def test_surfaces_against_prints(
    tmp_path: Path, run: Script, capsys: pytest.CaptureFixture[str]
) -> None:
    """Surfaces of 508 ppi and 13 x 15 mm, as tomographs give them, and contact prints of three
    simulated fingers."""
    down, right = 0.05 * np.mgrid[0:300, 0:260]
    (tmp_path / "prints").mkdir()
    with scripts_of(VALIDATION / "scanners") as named:
        result_of_points = named("cloud").result_of_points
    with scripts_of(VALIDATION / "match") as named:
        press = named("pressed_prints").press
        for finger in range(3):
            master = draw_finger(900 + finger).master()
            step = float(master.u_mm[1] - master.u_mm[0])
            place = (right - 6.5 - master.u_mm[0]) / step, (master.v_mm[0] - 23 + down) / step
            ridges = cv2.remap(
                master.ridge.astype(np.float32), *np.float32(place), cv2.INTER_LINEAR
            )
            points = np.dstack([right, -down, 0.05 * ridges - 0.01 * (right - 6.5) ** 2])
            cloud = points.reshape(-1, 3).astype(np.float32)
            result_of_points(cloud, 0.05).save(tmp_path / "surfaces" / f"{finger}_1")
            cv2.imwrite(str(tmp_path / "prints" / f"{finger}-1.png"), press(master, 1))
    capsys.readouterr()
    sets = [
        str(tmp_path / "surfaces"),
        "--pattern",
        "{finger}_{sample}",
        "--against",
        str(tmp_path / "prints"),
    ]
    assert (
        run.main(
            [
                "prints",
                *sets,
                "--against-pattern",
                "{finger}-{sample}.png",
                "--resolution-ppi",
                "500",
            ]
        )
        == 0
    )
    facts = json.loads(capsys.readouterr().out)
    assert (facts["genuine"], facts["impostors"], facts["failures"]) == (3, 6, [])
    assert (facts["eer_percent"][0], facts["impostors_accepted"]) == (0, 0)


def test_a_pull_strains_the_skin_between_what_sticks_and_the_rim() -> None:
    x, y = np.meshgrid(np.linspace(-8, 8, 316), np.linspace(-9, 9, 355))
    with scripts_of(VALIDATION / "match") as named:
        presses = named("pressed_prints")
        edge = np.hypot(x / 8, y / 9)
        shift = presses.pulled(x + 1j * y, edge, presses.PULLED, np.random.default_rng(3))
    assert np.abs(shift[edge < presses.STICKS[0]]).max() == 0
    assert 0.3 < np.abs(shift[edge > 0.9]).max() < 4
    strains = [np.abs(part).max() for part in np.gradient(shift, presses.PITCH_MM)]
    assert 0.05 < max(strains) <= presses.MAX_STRAIN + 1e-9
