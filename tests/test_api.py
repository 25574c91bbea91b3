"""The public surface: what it holds, that nothing shadows it, and that results go out and come
back."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import splitknit
import splitknit_match
import splitknit_simulator
from splitknit.errors import BadInput
from splitknit.io.capture import write_capture
from splitknit.io.provenance import plain_json
from splitknit_simulator.scene import TwinSettings

SRC = Path(splitknit.__file__).parent


@pytest.fixture(scope="module")
def capture():
    return splitknit_simulator.simulate_capture(3, "whorl", TwinSettings(scale=0.12))[0]


@pytest.fixture(scope="module")
def result(capture):
    return splitknit.reconstruct(capture, "ea")


def test_dir_is_the_public_surface():
    assert dir(splitknit) == sorted(splitknit.__all__)
    assert 15 <= len(splitknit.__all__) <= 30
    for name in splitknit.__all__:
        assert getattr(splitknit, name) is not None
        documented = name == "__version__" or "Examples" in (getattr(splitknit, name).__doc__ or "")
        assert documented or isinstance(getattr(splitknit, name), type), name


def test_no_public_function_has_the_name_of_a_module_beside_it():
    for name in splitknit.__all__:
        assert not (SRC / f"{name}.py").exists() and not (SRC / name).exists(), name
    program = (
        "import importlib, pkgutil, splitknit\nfor found in"
        " pkgutil.iter_modules(splitknit.__path__, 'splitknit.'):\n   "
        " importlib.import_module(found.name)\nassert all(callable(getattr(splitknit, name)) for"
        " name in splitknit.__all__ if name != '__version__')\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True)


def test_reprs_are_short(capture, result):
    for thing in (capture, capture.rig, capture.bands["white"], result):
        assert len(repr(thing)) < 300, repr(thing)
    assert repr(result).startswith("Reconstruction(preset 'ea'")
    html = result._repr_html_()
    assert html.startswith('<img src="data:image/jpeg;base64,') and "<th>preset</th>" in html


def test_a_result_is_saved_and_read_again(capture, result, tmp_path):
    result.save(tmp_path / "with", capture)
    result.save(tmp_path / "without")
    for name in ("with", "without"):
        again = splitknit.read_result(tmp_path / name)
        for field in ("height_mm", "ridge_mm", "shape_mm", "normals", "mask", "input_from_upright"):
            np.testing.assert_array_equal(
                getattr(again, field), getattr(result, field), err_msg=field
            )
        assert (again.preset, again.warnings, again.upright_size) == (
            "ea",
            result.warnings,
            result.upright_size,
        )
        assert again.settings == plain_json(result.settings) and again.hashes == result.hashes
        known = result.mask & np.isfinite(result.albedo)
        assert np.corrcoef(again.albedo[known], result.albedo[known])[0, 1] > 0.98
    pages = [(tmp_path / name / "report.html").read_text() for name in ("with", "without")]
    assert len(pages[0]) > len(pages[1])
    bare = splitknit.read_result(tmp_path / "with" / "height.npz")
    assert bare.preset == "" and not np.isfinite(bare.albedo).any()


@pytest.mark.parametrize("text", ["[]", "{", '{"facts": 3}', '{"settings": "x"}'])
def test_a_damaged_report_is_refused(result, tmp_path, text):
    result.save(tmp_path / "r")
    (tmp_path / "r" / "report.json").write_text(text)
    with pytest.raises(BadInput, match=r"report\.json.*; correct (it|the file)"):
        splitknit.read_result(tmp_path / "r")


@pytest.mark.slow
def test_paths_and_objects_are_the_same(capture, result, tmp_path):
    write_capture(capture, tmp_path / "c")
    by_path = splitknit.reconstruct(splitknit.read_capture(tmp_path / "c"), "ea")
    np.testing.assert_allclose(
        by_path.height_mm[by_path.mask], result.height_mm[result.mask], atol=1e-5
    )
    result.save(tmp_path / "r", capture)
    assert splitknit_match.match(result, tmp_path / "r").similarity == pytest.approx(1.0, abs=1e-3)
    assert splitknit_match.match(capture, result, preset="ea").similarity == pytest.approx(
        1.0, abs=1e-3
    )
    printed = splitknit_match.make_print(result, "relief").image
    np.testing.assert_array_equal(
        printed, splitknit_match.make_print(tmp_path / "r", "relief").image
    )
    assert splitknit_match.make_print(capture, "photo").image.shape == printed.shape


def test_a_folder_that_is_no_capture_is_refused(tmp_path):
    with pytest.raises(BadInput, match="capture"):
        splitknit.read_capture(tmp_path)
