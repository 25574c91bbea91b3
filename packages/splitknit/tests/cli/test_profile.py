"""``splitknit profile``: a cut through a surface, its table, its roughness."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from handmade import finger
from refusals import bad_input
from splitknit.cli.main import main
from splitknit.imaging.roughness import profile_roughness


@pytest.fixture(scope="module")
def waves(tmp_path_factory):
    """A result of an opaque thing: waves 0.25 mm long and 20 um high on a slope, along x."""
    result, _ = finger(px_per_mm=40.0, size=(60, 520), yaw_deg=0.0)
    x = (np.arange(520) - 259.5) / 40.0
    height = np.tile(0.1 * x + 0.01 * np.sin(2 * np.pi * x / 0.25), (60, 1)).astype(np.float32)
    height[:20] += 3.0 * (x > 0.0)  # a wall
    height[:, :20] = np.nan
    mask = np.isfinite(height)
    out = tmp_path_factory.mktemp("waves") / "result"
    replace(
        result,
        **dict.fromkeys(("ridge_mm", "shape_mm", "height_mm", "albedo"), height),
        uncertainty_um=None,
        mask=mask,
        normals=np.float32([0, 0, 1]) * mask[..., None],
        facts={"material": "opaque", "height_factor_sd": 0.1},
        input_from_upright=np.eye(3),
    ).save(out)
    return out


def test_the_roughness_of_sine_waves_is_exact(waves, tmp_path, capsys):
    out = tmp_path / "profile"
    assert main(f"profile {waves} -4,0 4,0.1 --out {out} --json".split()) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["Ra_um"] == pytest.approx(20 / np.pi, rel=0.03)
    assert facts["Rz_um"] == pytest.approx(20, rel=0.05)  # ten heights a wave miss its top
    assert facts["sampling_lengths"] == 9
    table = np.genfromtxt(out / "profile.csv", delimiter=",", names=True)
    assert np.ptp(table["height_um"]) == pytest.approx(800, rel=0.05)
    assert np.nanstd(table["roughness_um"]) == pytest.approx(facts["Rq_um"], rel=0.01)
    assert facts["height_range_mm"] == pytest.approx(0.8, rel=0.05)
    assert not facts["steep_mm"]
    drawn = re.search('points="(.*?)"', (out / "profile.svg").read_text())[1]
    assert drawn.count(",") == len(table)
    assert (waves / "surface.ply").is_file() and not (waves / "phalange.ply").exists()


def test_the_height_of_a_wall_is_a_lower_limit_and_uncertain(waves, tmp_path, capsys):
    assert main(f"profile {waves} -4,0.6 4,0.6 --out {tmp_path / 'profile'}".split()) == 0
    height, limit, *_ = capsys.readouterr().out.splitlines()
    assert "3.8 ± 0.38 mm from lowest" in height
    assert "50 µm of the section are steeper" in limit


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["-4,0", "-3.5,0"], "0.5 mm long, with a height every 25 um"),
        (["-6.4,0", "4,0"], "has a gap"),
        (["-4,0", "4,0", "--cutoff", "0.1"], "use --cutoff 0.25"),
        (["-4", "4,0"], "'-4' must be X,Y"),
        (["nan,0", "4,0"], "must be X,Y"),
        (["90,0", "95,0"], "no surface lies between"),
    ],
)
def test_a_section_without_roughness_is_refused(waves, tmp_path, capsys, arguments, message):
    assert main(["profile", str(waves), *arguments, "--out", str(tmp_path / "out")]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_the_cut_off_passes_half_a_wave_of_its_length_and_removes_form():
    along = 0.005 * np.arange(4000)
    # half of a wave as long as the cut-off passes (ISO 16610-21)
    for length, part in ((0.8, 0.5), (8.0, 0.007)):
        _, figures = profile_roughness(0.01 * np.sin(2 * np.pi * along / length), 0.005, 0.8)
        assert figures["Rq_um"] == pytest.approx(part * 10 / np.sqrt(2), rel=0.1)
    with bad_input("gap"):
        profile_roughness(np.full(4000, np.nan), 0.005, 0.8)
