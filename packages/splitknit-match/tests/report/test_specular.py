"""The specular image of a polarised capture: in the result, its files, the report, and as a
print."""

import json
from dataclasses import replace

import numpy as np
import pytest

import splitknit
import splitknit_match
import splitknit_simulator
from splitknit.cli.main import main
from splitknit.io.images import read_image
from splitknit.io.results import read_result


@pytest.fixture(scope="module")
def polarised():
    """A finger with specular reflection, and without it as crossed films show it."""
    glossy, matt = (
        splitknit_simulator.simulate_capture(
            3, settings={"scale": 0.2, "skin.glare": [strength, strength]}
        )[0]
        for strength in (1.0, 0.0)
    )
    parallel = replace(glossy.bands["white"], polarisation="parallel")
    crossed = replace(matt.bands["white"], name="white_crossed", polarisation="crossed")
    return replace(glossy, bands={"white": parallel, "white_crossed": crossed})


@pytest.fixture(scope="module")
def plain(polarised):
    """The same light without films."""
    return replace(polarised, bands={"white": replace(polarised.bands["white"], polarisation="")})


@pytest.fixture(scope="module")
def result(polarised):
    return splitknit.reconstruct(polarised, "ea")


@pytest.fixture(scope="module")
def folder(result, polarised, tmp_path_factory):
    out = tmp_path_factory.mktemp("specular") / "result"
    result.save(out, polarised)
    return out


def printing(folder, tmp_path):
    return f"print {folder} --method specular --out {tmp_path}/p".split()


@pytest.mark.slow
def test_a_polarised_capture_alone_has_a_specular_image(result, plain):
    np.testing.assert_array_equal(np.isfinite(result.specular), result.mask)
    values = result.specular[result.mask]
    assert abs(values.mean()) < 0.1
    assert values.std() == pytest.approx(1.0, abs=0.2)
    assert splitknit.reconstruct(plain, "ea").specular is None


@pytest.mark.slow
def test_the_specular_image_is_kept_with_the_result(result, folder):
    again = read_result(folder).specular
    assert again is not None
    np.testing.assert_array_equal(again, result.specular)
    picture = read_image(folder / "specular.png")[..., 0]
    assert not picture[~result.mask].any()
    assert 90 < picture[result.mask].mean() < 115
    report = json.loads((folder / "report.json").read_text())
    assert "specular.png" in report["files"]
    assert report["facts"]["motion_white_crossed"]["moved_mm"]
    assert "Specular image" in (folder / "report.html").read_text("utf-8")


@pytest.mark.slow
def test_the_specular_image_is_printed(folder, tmp_path, capsys):
    assert main([*printing(folder, tmp_path), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert (facts["method"], facts["surface"]) == ("specular", "plane")
    assert facts["minutiae"]["count"]
    assert splitknit_match.make_print(read_result(folder), "specular").image.dtype == np.uint8


@pytest.mark.slow
def test_without_films_there_is_no_specular_image_to_print(plain, tmp_path, capsys):
    splitknit.reconstruct(plain, "ea").save(tmp_path / "plain", plain)
    assert main(printing(tmp_path / "plain", tmp_path)) == 2
    assert "there is no specular image" in capsys.readouterr().err
    assert not (tmp_path / "p").exists()
