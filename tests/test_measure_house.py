from __future__ import annotations

import json
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[1] / "tools" / "measure_house.py"


@pytest.mark.slow
def test_a_small_house_is_measured(tmp_path: Path) -> None:
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


def test_numbers_outside_of_parameters_name_their_source(tmp_path: Path) -> None:
    unsourced = runpy.run_path(str(SCRIPT))["unsourced_constants"]
    (tmp_path / "near.py").write_text(
        'A, B = 1, 2\nINCH = 25.4\n"""Source: definition."""\n_C = 3\nNAME = "a"\n'
    )
    (tmp_path / "parameters.py").write_text("D = 1\n")
    assert unsourced(tmp_path) == ["near.py: A, B", "near.py: _C"]
    for source in SCRIPT.parents[1].glob("packages/*/src"):
        assert unsourced(source) == []
