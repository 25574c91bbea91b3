"""A capture with mirrors through the whole pipeline: the shape from mirrors, or the front view
alone."""

from dataclasses import replace

import numpy as np
import pytest

from enrolled import facts_of, refusal_of
from refusals import bad_input
from splitknit.io.capture import write_capture
from splitknit.pipeline import reconstruct
from splitknit_simulator.accuracy import compare
from splitknit_simulator.finger.finger import FingerPose
from splitknit_simulator.rigs import MirrorSettings
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.twin import simulate_capture


@pytest.fixture(scope="module")
def photographed():
    mirrors = MirrorSettings(names=("left",), nir=False)
    pose = FingerPose(yaw_rad=0.05, roll_rad=-0.06, insertion_mm=28.5)
    return simulate_capture(9002, settings=TwinSettings(scale=0.2, mirrors=mirrors, pose=pose))


@pytest.mark.slow
def test_the_command_line_takes_the_shape_from_the_mirror(photographed, tmp_path, capsys):
    capture, truth = photographed
    write_capture(capture, tmp_path / "capture", truth)
    out = tmp_path / "result"
    options = "--out", out, "--shape", "mirror"
    facts = facts_of(capsys, "reconstruct", tmp_path / "capture", *options)
    assert facts["facts"]["shape_source"] == "mirror"
    assert facts["facts"]["mirror_shape"]["mirrors"] == ["left"]
    assert set(facts["facts"]["mirror_drawing"]["masks"]) == {"front", "left"}
    assert facts["comparison"]["metric, changed"]["surface_rms_mm"] < 0.3
    assert facts["settings"]["shape"]["source"] == "mirror"
    assert "Views in the mirrors" in (out / "report.html").read_text()


@pytest.mark.slow
def test_snk_adds_its_relief_to_the_shape_from_mirrors(photographed):
    capture, truth = photographed
    result = reconstruct(capture, "snk", {"shape.source": "mirror", "direct.method": "none"})
    assert compare(result, truth).figures["shape_rms_mm"] < 0.3
    inside = result.mask
    assert np.allclose(
        result.height_mm[inside], (result.shape_mm + result.ridge_mm)[inside], atol=1e-5
    )


def test_by_default_the_front_view_alone_is_reconstructed(photographed):
    capture, truth = photographed
    result = reconstruct(capture, "ea")
    both = result.mask & truth["mask"]
    assert both.sum() > 0.99 * result.mask.sum() and both.sum() > 0.6 * truth["mask"].sum()
    assert "mirror_shape" not in result.facts and result.facts["shape_source"] == "white"


def test_captures_and_presets_without_a_shape_from_mirrors_are_refused(
    photographed, tmp_path, capsys
):
    capture, _ = photographed
    bare = replace(capture, rig=replace(capture.rig, mirrors=()))
    mask = np.zeros(capture.shape, dtype=np.bool_)
    # a given mask: two views in the picture would be two fingers else
    mask[200:400, 250:400] = True
    with bad_input("the rig has no mirrors"):
        reconstruct(replace(bare, mask=mask), "snk", {"shape.source": "mirror"})
    with bad_input("keeps the visible surface whole"):
        reconstruct(capture, "pr", {"shape.source": "mirror", "direct.method": "none"})
    with bad_input("'nir', 'white', 'mirror'"):
        reconstruct(capture, "metric", {"shape.source": "sonar"})
    write_capture(replace(bare, mask=mask), tmp_path / "bare")
    options = "--out", tmp_path / "out", "--shape", "mirror"
    assert "no mirrors" in refusal_of(capsys, "reconstruct", tmp_path / "bare", *options)
    assert not (tmp_path / "out").exists()
