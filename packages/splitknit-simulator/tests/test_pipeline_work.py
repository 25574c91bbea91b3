"""What a reconstruction by `metric` computes, loads and keeps: counted, for seconds depend on the machine."""

from __future__ import annotations

import subprocess
import sys
import weakref
from collections import Counter
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import splitknit
from splitknit.finger.locate import FingerSettings, find_finger
from splitknit.imaging import band as light
from splitknit.io import pictures
from splitknit.io.capture import write_capture
from splitknit.methods import metric
from splitknit.model import Capture
from splitknit.networks import unet
from splitknit.report.photos import LONGEST_PX, small_images
from splitknit.report.result import write_results
from splitknit.skin import learned, shape
from splitknit.skin.grid import Grid
from splitknit.skin.images import skin_images
from splitknit.steps import Memory
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.twin import simulate_capture


@pytest.fixture(scope="module")
def capture() -> Capture:
    """A small finger whose pixels the networks can read, halved."""
    return simulate_capture(3, None, TwinSettings(scale=0.17))[0]


@pytest.fixture
def counts(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """Calls, pixels and transforms of what is run while the test lasts."""
    found: Counter[str] = Counter()
    infer, compare, features = unet._infer, shape.residual_of, learned.features
    forward, inverse = Grid.forward, Grid.inverse

    def inferring(network: unet.Network, image: np.ndarray) -> np.ndarray:
        found[f"pixels of the {network.card.name} network"] += image[0, 0].size
        return infer(network, image)

    def comparing(*arguments: object) -> shape.Residual:
        found["comparisons"] += 1
        return compare(*arguments)

    def describing(*arguments: object) -> learned.Features:
        found["features"] += 1
        made = features(*arguments)
        found["pixels"] = made.fields[0].size
        return made

    def there(grid: Grid, field: np.ndarray, extend: bool = False) -> np.ndarray:
        found["transforms"] += field[..., 0, 0].size
        return forward(grid, field, extend)

    def back(grid: Grid, spectrum: np.ndarray) -> np.ndarray:
        found["transforms"] += spectrum[..., 0, 0].size
        return inverse(grid, spectrum)

    monkeypatch.setattr(unet, "_infer", inferring)
    monkeypatch.setattr(shape, "residual_of", comparing)
    monkeypatch.setattr(metric, "features", describing)
    monkeypatch.setattr(Grid, "forward", there)
    monkeypatch.setattr(Grid, "inverse", back)
    return found


@pytest.mark.slow
def test_no_more_is_computed_than_was(capture: Capture, counts: Counter[str]) -> None:
    splitknit.reconstruct(capture)
    pixels = counts["pixels"]
    assert counts["features"] == 1
    assert counts["comparisons"] == 3
    assert pixels > 40_000
    assert counts["pixels of the relief network"] < 3 * 1.35 * pixels
    assert counts["pixels of the shape network"] < pixels
    assert counts["transforms"] <= 207


def test_the_finger_is_looked_at_in_its_window(capture: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    measured: Counter[str] = Counter()
    transform, decode = cv2.distanceTransform, light.linear_image

    def measuring(image: np.ndarray, *arguments: object) -> np.ndarray:
        measured["distances"] += image.size
        return transform(image, *arguments)

    def decoding(pixels: np.ndarray, *arguments: object) -> np.ndarray:
        measured["decoded"] += pixels[..., 0].size
        return decode(pixels, *arguments)

    monkeypatch.setattr(cv2, "distanceTransform", measuring)
    monkeypatch.setattr(light, "linear_image", decoding)
    find_finger(capture, FingerSettings())
    size = capture.shape[0] * capture.shape[1]
    assert measured["distances"] < 14 * size
    # white and its ambient image whole, near-infrared and the ambient image for the quality in the finger's window
    assert measured["decoded"] < 14 * size


@pytest.mark.slow
def test_images_are_let_go_before_the_surface_where_they_may_be(
    capture: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept = splitknit.reconstruct(capture, settings={"metric.relief": "colour", "metric.rounds": 1})
    assert set(capture.bands) == {"white", "nir"}
    bands = {name: replace(band, pixels=band.pixels.copy()) for name, band in capture.bands.items()}
    given = replace(capture, bands=bands)
    pixels = [weakref.ref(band.pixels) for band in bands.values()]
    seen = []
    first = metric.metric_skin

    def beginning(*arguments: object, **named: object) -> object:
        seen.extend(reference() for reference in pixels)
        return first(*arguments, **named)

    monkeypatch.setattr(metric, "metric_skin", beginning)
    memory = Memory(given)
    settings = {"metric.relief": "colour", "metric.rounds": 1}
    del bands, given
    found = splitknit.reconstruct(memory.hand_over(), settings=settings, memory=memory)
    assert seen == [None, None] and not memory._known  # nobody holds them any more
    np.testing.assert_array_equal(found.height_mm, kept.height_mm)


def test_a_report_needs_small_images_only(capture: Capture) -> None:
    band = capture.bands["white"]
    small = small_images(band)
    assert small.dtype == band.pixels.dtype and small.shape[0] == len(band.pixels) and small.shape[3] == 3
    assert max(small.shape[1:3]) <= LONGEST_PX


def test_each_field_is_reduced_once_for_all_pictures(
    capture: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = splitknit.reconstruct(capture, "ea")
    reduced: list[tuple[int, ...]] = []
    binned = pictures._binned

    def counting(part: np.ndarray, inside: np.ndarray, factor: int) -> np.ndarray:
        reduced.append(part.shape[2:])
        return binned(part, inside, factor)

    monkeypatch.setattr(pictures, "_binned", counting)
    write_results(result, capture, tmp_path / "result")
    assert Counter(reduced) == {(): 4, (3,): 1}  # mask, height, relief, shape; normals


@pytest.mark.slow
def test_a_run_loads_no_part_of_scipy_but_the_sparse_solver(capture: Capture, tmp_path: Path) -> None:
    write_capture(capture, tmp_path / "capture")
    code = (
        "import sys\nfrom splitknit.cli.main import main\n"
        f"assert main(['reconstruct', {str(tmp_path / 'capture')!r}, '--out', {str(tmp_path / 'result')!r}]) == 0\n"
        "parts = ('fft', 'ndimage', 'special', 'optimize', 'interpolate', 'spatial', 'stats')\n"
        "sys.exit(', '.join(part for part in parts if f'scipy.{part}' in sys.modules) or 0)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr


@pytest.mark.parametrize("binning", [1.0, 1.5, 2.0, 2.125])
def test_the_working_grid_has_the_pitch_that_is_wanted(capture: Capture, binning: float) -> None:
    """Whatever the camera's pixels are: blocks of fractions of pixels lie where the light in them comes from."""
    rows, columns = 203, 251
    window = (slice(40, 40 + rows), slice(60, 60 + columns))
    pitch = capture.rig.camera.pitch_mm
    inside = np.ones((rows, columns), dtype=bool)
    inside[:, :20] = False
    bands = (capture.bands["white"],)
    grid, (white,), found = skin_images(capture, bands, window, inside, binning * pitch)
    assert found == binning and grid.pitch_mm == pytest.approx(binning * pitch)
    assert grid.shape == white.stack.shape[2:] == (int(rows / binning), int(columns / binning))
    assert not grid.mask[:, : int(20 / binning)].any() and grid.mask[:, int(np.ceil(20 / binning)) :].all()
    fine, (images,), _ = skin_images(capture, bands, window, inside, pitch)
    x = np.interp(grid.x_mm, fine.x_mm, np.arange(columns))
    np.testing.assert_allclose(x, (np.arange(grid.shape[1]) + 0.5) * binning - 0.5, atol=1e-6)
    cells = white.stack[0, 0, :32, :32]
    side = int(32 * binning)
    expected = images.stack[0, 0, :side, :side]
    assert float(cells.mean()) == pytest.approx(float(expected.mean()), rel=1e-5)  # the same light
