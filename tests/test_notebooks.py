"""The notebooks of the documentation run, and store nothing that was computed; `make docs` puts
them into the site."""

import json
from pathlib import Path

import pytest

NOTEBOOKS = sorted(
    (Path(__file__).resolve().parents[1] / "docs" / "guide" / "notebooks").glob("*.ipynb")
)


def code_cells_of(notebook):
    cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
    return [cell for cell in cells if cell["cell_type"] == "code"]


def test_each_journey_has_a_notebook():
    names = [notebook.stem for notebook in NOTEBOOKS]
    assert names == ["look", "match", "object", "reconstruct", "rig"]


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_no_output_is_stored(notebook):
    for cell in code_cells_of(notebook):
        assert cell["outputs"] == [] and cell["execution_count"] is None


@pytest.mark.slow
@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_and_draws(notebook, tmp_path, monkeypatch):
    pyplot = pytest.importorskip("matplotlib.pyplot")
    pyplot.switch_backend("Agg")
    monkeypatch.chdir(tmp_path)
    variables = {}
    for number, cell in enumerate(code_cells_of(notebook)):
        exec(compile("".join(cell["source"]), f"{notebook.stem}, cell {number}", "exec"), variables)
    assert pyplot.get_fignums()
    pyplot.close("all")
