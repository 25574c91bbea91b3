"""``import splitknit`` and ``splitknit --help`` load none of the heavy packages (and so stay far
below 0.3 s)."""

import json
import subprocess
import sys

import numpy as np
import pytest

from splitknit_match.matching.template import VERSION, Template, pack
from splitknit_match.records.templates import write_template

HEAVY = ("numpy", "cv2", "scipy", "jinja2", "torch", "onnxruntime", "matplotlib")
REPORT = "import sys, json; print(json.dumps([m for m in {heavy!r} if m in sys.modules]))"


def _loaded_after(code, names=HEAVY):
    run = subprocess.run(
        [sys.executable, "-c", code + "\n" + REPORT.format(heavy=names)],
        capture_output=True,
        text=True,
        check=True,
    )
    return list(json.loads(run.stdout.splitlines()[-1]))


def test_import_loads_nothing_heavy():
    assert _loaded_after("import splitknit; splitknit.__version__; dir(splitknit)") == []


def test_help_needs_no_numerics():
    for words in (["--help"], ["reconstruct", "--help"]):
        assert (
            _loaded_after(f"from splitknit.cli.main import main\nassert main({words}) == 0") == []
        )


def test_the_pipeline_loads_scipy_in_parts_when_they_are_used():
    parts = (
        "scipy.fft",
        "scipy.ndimage",
        "scipy.linalg",
        "scipy.sparse",
        "scipy.spatial",
        "onnxruntime",
    )
    assert _loaded_after("import splitknit.pipeline", parts) == []


def test_a_comparison_of_templates_loads_no_reconstruction(tmp_path):
    """The whole of ``splitknit match a.skt b.skt``: numpy, OpenCV, and of this library what
    compares ridges."""
    rng = np.random.default_rng(0)
    for name in ("a", "b"):
        level = np.repeat(rng.integers(0, 4, (90, 23), dtype=np.uint8), 4, axis=1)
        write_template(
            tmp_path / f"{name}.skt",
            pack(Template(level, np.ones(level.shape, np.bool_), 0.1)),
            VERSION,
        )
    others = (
        "pipeline",
        "finger",
        "skin",
        "networks",
        "prints",
        "photometric",
        "io.capture",
        "io.images",
        "cli.batch",
    )
    parts = (
        "scipy",
        "numpy.ma",
        "onnxruntime",
        "jinja2",
        "tomllib",
        "secrets",
        "concurrent.futures",
    )
    words = ["match", str(tmp_path / "a.skt"), str(tmp_path / "b.skt")]
    code = f"from splitknit.cli.main import main\nassert main({words}) == 0"
    assert _loaded_after(code, (*(f"splitknit.{name}" for name in others), *parts)) == []


def test_types_need_numpy_only():
    assert _loaded_after("from splitknit import Capture, BadInput") == ["numpy"]


def test_every_public_name_resolves():
    import splitknit

    for name in splitknit.__all__:
        assert getattr(splitknit, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        splitknit.nothing  # noqa: B018
