import json
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[1] / "tools" / "measure_house.py"


@pytest.mark.slow
def test_a_small_house_is_measured(tmp_path):
    package = tmp_path / "src" / "splitknit"
    (package / "cli").mkdir(parents=True)
    (package / "photometric").mkdir()
    files = {
        "__init__.py": "",
        "cli/__init__.py": "",
        "folders.py": "def run():\n    from splitknit.pipeline import lambertian\n",
        "photometric/__init__.py": "",
        "photometric/lambertian.py": (
            "import numpy.linalg\n\n\ndef lambertian(): ...\n\n\n"
            "def _solve(a, b, c, d, e, *, p: PipelineSettings): ...  # noqa: X\n"
        ),
        "pipeline.py": (
            "from splitknit.photometric.lambertian import lambertian\nfrom splitknit import"
            " steps\n\n\nclass NearSettings:\n    rows: int = 1\n    name: str = ''\n\n\ndef"
            " lambertian(): ...\n\n\nclass Near(Checked):\n    rows: int = 1\n"
        ),
        "__init__.pyi": "from splitknit.pipeline import lambertian as lambertian\n",
        "steps.py": "def late():\n    import splitknit.pipeline\n",
    }
    for name, text in files.items():
        (package / name).write_text(text)
    run = subprocess.run(
        [sys.executable, str(SCRIPT), "--json", "--src", str(tmp_path / "src")],
        capture_output=True,
        text=True,
        check=True,
    )
    measured = json.loads(run.stdout)
    assert measured["python_files"] == 7 and measured["lines"] == 25
    assert (
        measured["settings_fields"] == 3
        and measured["names_of_modules"] == 6
        and measured["homonyms"] == 1
    )
    assert measured["members"][0] == {
        "member": "splitknit",
        "files": 8,
        "lines": 26,
        "tokens": 101,
        "public_names": 1,
    }
    assert (
        measured["functions_with_whole_settings"]
        == measured["functions_with_many_parameters"]
        == measured["noqa"]
        == 1
    )
    assert measured["words"]["index.md"] > 0 and measured["words"]["all"] < sum(
        measured["words"].values()
    )
    assert measured["files_to_the_equations"] == 3 and measured["files_to_the_ply"] == 0
    assert measured["import_circles"] == 1
    assert measured["one_importer_in_the_same_folder"] == 1  # steps.py, of pipeline.py alone


NUMBERS = '''
A, B = 1, 2
INCH = 25.4
"""Source: definition."""
_C = (3.0, 4)
"""Angles.

Chosen on: real photographs."""
NAME = "a"
TABLE = {}
small = 1
DARK = Limit("a", 1)
"""Chosen on: speed."""

class BallThresholds:
    radius_px: float = 8.5
    """Source: thesis."""
    rays: int = 360
    name: str = ""

class Ball:
    radius_px: float = 1.0
'''


def test_tuned_constants_are_numbers_without_a_source(tmp_path):
    (tmp_path / "near.py").write_text(NUMBERS)
    constants = list(runpy.run_path(str(SCRIPT))["constants"](tmp_path))
    assert [(c.name, c.tuned) for c in constants] == [
        ("A", True),
        ("B", True),
        ("INCH", False),
        ("_C", True),
        ("DARK", True),
        ("BallThresholds.radius_px", False),
        ("BallThresholds.rays", True),
    ]
    assert constants[3].words == "Angles. Chosen on: real photographs."
