"""What a reconstruction by `metric` computes, loads and keeps: counted, for seconds depend on the
machine."""

import subprocess
import sys
from collections import Counter

import pytest

import splitknit
from splitknit.io.capture import write_capture
from splitknit.methods import metric
from splitknit.networks import unet
from splitknit.skin import learned, shape
from splitknit.skin.grid import Grid
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.twin import simulate_capture


@pytest.fixture(scope="module")
def capture():
    """A small finger whose pixels the networks can read, halved."""
    return simulate_capture(3, None, TwinSettings(scale=0.17))[0]


@pytest.fixture
def counts(monkeypatch):
    """Calls, pixels and transforms of what is run while the test lasts."""
    counter = Counter()
    infer, compare, features = unet._infer, shape.residual_of, learned.features
    forward, inverse = Grid.forward, Grid.inverse

    def inferring(network, image):
        counter[f"pixels of the {network.card.name} network"] += image[0, 0].size
        return infer(network, image)

    def comparing(*arguments):
        counter["comparisons"] += 1
        return compare(*arguments)

    def describing(*arguments):
        counter["features"] += 1
        described = features(*arguments)
        counter["pixels"] = described.fields[0].size
        return described

    def there(grid, field, extend=False):
        counter["transforms"] += field[..., 0, 0].size
        return forward(grid, field, extend)

    def back(grid, spectrum):
        counter["transforms"] += spectrum[..., 0, 0].size
        return inverse(grid, spectrum)

    monkeypatch.setattr(unet, "_infer", inferring)
    monkeypatch.setattr(shape, "residual_of", comparing)
    monkeypatch.setattr(metric, "features", describing)
    monkeypatch.setattr(Grid, "forward", there)
    monkeypatch.setattr(Grid, "inverse", back)
    return counter


@pytest.mark.slow
def test_metric_computes_no_more_than_stated(capture, counts):
    splitknit.reconstruct(capture)
    pixels = counts["pixels"]
    assert counts["features"] == 1
    assert counts["comparisons"] == 3
    assert pixels > 40_000
    assert counts["pixels of the relief network"] < 3 * 1.35 * pixels
    assert counts["pixels of the shape network"] < pixels
    assert counts["transforms"] <= 207


@pytest.mark.slow
def test_a_run_loads_only_the_parts_of_scipy_that_it_uses(capture, tmp_path):
    """The sparse solver, and `least_squares` for the lights' places, which brings `fft`, `special`
    and `spatial`; no other part, as each takes time to load."""
    write_capture(capture, tmp_path / "capture")
    code = (
        "import sys\nfrom splitknit.cli.main import main\nassert main(['reconstruct',"
        f" {str(tmp_path / 'capture')!r}, '--out', {str(tmp_path / 'result')!r}]) == 0\nparts ="
        " ('ndimage', 'interpolate', 'signal', 'stats')\n"
        "sys.exit(', '.join(part for part in parts if f'scipy.{part}' in sys.modules) or 0)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
