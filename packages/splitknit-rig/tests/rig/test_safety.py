"""Light on eye and skin: the standard's tables, makers' worked examples, examples by hand, refusals.

No number here is computed by the module's functions but the one that is checked.
"""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from splitknit.cli.main import main
from splitknit.errors import BadInput
from splitknit.model import Led, default_rig
from splitknit_rig.rig.circuit import NIR_LED, WHITE_LED, CircuitSettings, LedPart, design_stage
from splitknit_rig.rig.films import TRANSMISSION, with_films
from splitknit_rig.rig.safety import (
    _blue_weight,
    _burn_weight,
    _hazards,
    _radiant_intensity,
    check_hazards,
    rig_hazards,
)

POINT = replace(NIR_LED, intensity_w_sr=1.0, half_angle_deg=5.0, source_mm=0.1, forward_v=20.0)


@pytest.mark.parametrize(
    ("nm", "blue", "burn"),
    [  # IEC 62471:2006, table 4.2, as printed
        (380, 0.01, 0.1), (400, 0.10, 1.0), (415, 0.80, 8.0), (435, 1.00, 10.0), (440, 1.00, 10.0), (445, 0.97, 9.7),
        (450, 0.94, 9.4), (460, 0.80, 8.0), (470, 0.62, 6.2), (485, 0.40, 4.0), (490, 0.22, 2.2), (495, 0.16, 1.6),
        (500, 0.10, 1.0), (550, 0.01, 1.0), (600, 0.001, 1.0), (650, 0.001, 1.0), (700, 0.001, 1.0),
        (810, 0.0, 0.603), (850, 0.0, 0.501), (950, 0.0, 0.316), (1050, 0.0, 0.2), (1100, 0.0, 0.2),
        (1175, 0.0, 0.0632), (1300, 0.0, 0.02), (1450, 0.0, 0.0),
    ],
)  # fmt: skip
def test_the_weighting_functions_are_the_tables(nm, blue, burn):
    assert _blue_weight(np.array([float(nm)]))[0] == pytest.approx(blue, rel=0.01)
    assert _burn_weight(np.array([float(nm)]))[0] == pytest.approx(burn, rel=0.005)


def named(found, clause):
    return next(h for h in found if h.clause == clause)


def test_limits_of_the_exempt_group_are_table_6_1():
    white = _hazards("white", WHITE_LED, 0.1, 149.5)  # source of 2 mm: 13.4 mrad
    assert named(white, "4.3.3").limit == 100.0
    assert named(white, "4.3.5").limit == pytest.approx(28000 / (2 / 149.5))
    small = _hazards("white", replace(WHITE_LED, source_mm=1.0), 0.1, 200.0)  # 5 mrad: a small source
    assert named(small, "4.3.4").limit == 1.0
    nir = _hazards("nir", POINT, 0.1, 200.0)
    assert named(nir, "4.3.6").limit == pytest.approx(545_455, rel=1e-5)  # 545.5 mW/mm2/sr in ams OSRAM's note
    everything = rig_hazards(default_rig(), {"nir": design_stage("nir")})
    assert named(everything, "4.3.7").limit == 100.0
    assert named(everything, "4.3.8").limit == pytest.approx(3556.6, rel=1e-4)  # 20000 / 10^0.75


def test_a_point_of_one_watt_per_steradian_at_20_cm():
    """By hand: 25 W/m2; spread over 11 mrad (9.503e-5 sr) 263 kW/m2/sr, weighted by about half at 850 nm."""
    burn = named(_hazards("nir", POINT, 0.1, 200.0), "4.3.6")
    assert burn.value == pytest.approx(25 / 9.503e-5 * 0.5027, rel=2e-3)
    twice = named(_hazards("nir", POINT, 0.2, 200.0, duty=0.25), "4.3.6")
    assert twice.value == pytest.approx(2 * burn.value)  # flashes are not averaged


def test_an_extended_source_has_its_own_radiance():
    """A round spot of 4 mm with 1 W/sr has 79.6 kW/m2/sr at any distance at which it is over 11 mrad."""
    for distance in (100.0, 300.0):
        burn = named(_hazards("nir", replace(POINT, source_mm=4.0), 0.1, distance), "4.3.6")
        assert burn.value == pytest.approx(1 / (math.pi * 0.002**2) * 0.5027, rel=2e-3)
        assert burn.limit == pytest.approx(6000 / (4 / distance))


def test_blue_light_by_hand():
    """100 cd of 7900 K at 1 m are 100 lx and 0.103 W/m2 of blue; over 0.1 rad (7.854e-3 sr) 13.1 W/m2/sr."""
    lamp = replace(WHITE_LED, intensity_cd=100.0, half_angle_deg=10.0, source_mm=20.0)
    blue = named(_hazards("white", lamp, 0.1, 1000.0), "4.3.3")
    assert blue.value == pytest.approx(100 * 1.03e-3 / 7.854e-3, rel=0.01)
    assert named(_hazards("white", lamp, 0.1, 1000.0, together=3), "4.3.3").value == pytest.approx(3 * blue.value)
    assert named(_hazards("white", lamp, 0.1, 1000.0, duty=0.25), "4.3.3").value == pytest.approx(blue.value / 4)


def test_the_white_spectrum_is_as_hazardous_as_a_cool_white_led():
    """IEC TR 62778 allows 500 lx where E_B is 1 W/m2 from 5750 to 8000 K, with a factor of two in hand: 1.0 mW/lm."""
    lamp = replace(WHITE_LED, intensity_cd=1000.0, forward_v=100.0, source_mm=1.0)
    per_lux = named(_hazards("white", lamp, 0.1, 1000.0), "4.3.4").value / 1000.0
    assert 0.9e-3 < per_lux < 1.1e-3
    assert 1000 / _radiant_intensity(lamp, "white") == pytest.approx(313, rel=0.02)  # lm/W of the light


def test_seven_leds_of_each_kind_by_hand():
    """The drawn rig: LEDs 140 mm up on a circle of 52.5 mm, 149.5 mm away, 100.2 mA at most."""
    stages = {band: design_stage(band) for band in ("white", "nir")}
    found = rig_hazards(default_rig(), stages)
    away, over = 0.1495202, stages["nir"].current_a[2] / 0.1
    assert named(found, "4.3.7").value == pytest.approx(7 * 0.12 * over / away**2, rel=1e-3)
    white_w_sr = 10.0 / 313.3
    assert named(found, "4.3.8").value == pytest.approx(7 * (0.12 + white_w_sr) * over / away**2, rel=2e-3)
    assert all(h.margin > 1.5 for h in found)
    failed = rig_hazards(default_rig(), stages, shorted=True)
    ratio = stages["nir"].shorted_a / stages["nir"].current_a[2]
    assert named(failed, "4.3.7").value == pytest.approx(ratio * named(found, "4.3.7").value)
    # (9.45 V - 1.4 V) over 27 + 33 ohms less 1 %
    assert stages["nir"].shorted_a == pytest.approx(8.05 / 59.4)


def test_leds_seen_together_count_together_and_far_ones_at_20_cm():
    rig = default_rig()
    stage = {"white": design_stage("white")}
    one = replace(rig, leds=(Led("white", (0.0, 0.0, 150.0)),))
    two = replace(rig, leds=(Led("white", (0.0, 0.0, 150.0)), Led("white", (10.0, 0.0, 149.7))))  # 67 mrad apart
    first, both = (named(rig_hazards(r, stage), "4.3.3").value for r in (one, two))
    assert both == pytest.approx(2 * first, rel=0.01)
    far = replace(rig, leds=(Led("white", (0.0, 0.0, 800.0)),))
    near = replace(rig, leds=(Led("white", (0.0, 0.0, 200.0)),))
    assert rig_hazards(far, stage) == rig_hazards(near, stage)


def test_designs_above_a_limit_are_refused_by_their_worst():
    def stages(**changes):
        return {"nir": design_stage("nir", CircuitSettings(nir=replace(NIR_LED, **changes)))}

    narrow = rig_hazards(default_rig(), stages(intensity_w_sr=2.0, half_angle_deg=3.0))
    with pytest.raises(BadInput, match=r"the LEDs together would give 627 W/m2 .*above the 100 .*4\.3\.7"):
        check_hazards(narrow)
    check_hazards(rig_hazards(default_rig(), stages()))


@pytest.mark.parametrize(
    ("band", "part", "words"),
    [
        ("nir", replace(NIR_LED, intensity_w_sr=120.0), "light from 0.16 W of power.*mW/sr"),
        ("white", replace(WHITE_LED, intensity_cd=10_000.0), "cd, not mcd"),
        ("white", replace(WHITE_LED, intensity_w_sr=0.1), "must be given once"),
        ("nir", replace(NIR_LED, intensity_w_sr=0.0), "must be given once"),
        ("nir", replace(NIR_LED, intensity_w_sr=0.0, intensity_cd=1.0), "must be given once"),
        ("nir", replace(NIR_LED, intensity_w_sr=math.nan), "must be given once"),
        ("nir", replace(NIR_LED, half_angle_deg=90.0), "half angle"),
        ("nir", replace(NIR_LED, source_mm=0.0), "half angle"),
    ],
)
def test_data_that_cannot_be_are_refused(band: str, part: LedPart, words: str):
    with pytest.raises(BadInput, match=words):
        _radiant_intensity(part, band)


def test_the_page_has_the_figures():
    stages = {band: design_stage(band) for band in ("white", "nir")}
    found, failed = (rig_hazards(default_rig(), stages, shorted=shorted) for shorted in (False, True))
    page = (Path(__file__).resolve().parents[4] / "docs" / "guide" / "rig-safety.md").read_text(encoding="utf-8")
    table = page.partition("<!-- safety -->")[2].partition("<!-- /safety -->")[0].strip().splitlines()[2:]
    assert table == [
        f"| {h.band} | {h.name} | {h.clause} | {h.value:.3g} {h.unit} | {h.limit:.3g} {h.unit} | {h.margin:.2g} | "
        f"{worse.margin:.2g} |"
        for h, worse in zip(found, failed, strict=True)
    ]
    table = page.partition("<!-- safety films -->")[2].partition("<!-- /safety films -->")[0].strip().splitlines()[2:]
    for row, kind in zip(table, ("servo", "neighbours"), strict=True):
        rig = with_films(default_rig(), kind)
        ways = ({"passed": TRANSMISSION}, {"passed": TRANSMISSION, "shorted": True}, {})
        blue = [named(rig_hazards(rig, stages, **way), "4.3.3") for way in ways]
        margins = " | ".join(f"{one.margin:.2g}" for one in blue)
        assert row.endswith(f"| {blue[0].value:.3g} W/m2/sr | {margins} |")
    assert f"{1000 * stages['white'].shorted_a:.0f} mA white, {1000 * stages['nir'].shorted_a:.0f} mA NIR" in page


def test_the_verb_prints_the_margins_and_refuses_in_one_sentence(tmp_path, capsys):
    out = tmp_path / "board"
    assert main(["rig", "circuit", "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert "exempt group of IEC 62471 (calculated, no certificate)" in said
    assert "retina, blue light             58.54 of 100 W/m2/sr, margin 1.71 (1.15 with a shorted transistor)" in said
    facts = json.loads((out / "circuit.json").read_text())
    assert [h["clause"] for h in facts["safety"]] == ["4.3.3", "4.3.5", "4.3.6", "4.3.7", "4.3.8"]
    other = tmp_path / "other"
    bright = ["--set", "circuit.white.intensity_cd=20"]
    assert main(["rig", "circuit", "--out", str(other), *bright]) == 2
    said = capsys.readouterr().err
    assert "117 W/m2/sr (retina, blue light), above the 100" in said
    assert said.count("\n") == 1
    assert not other.exists()
    assert main(["rig", "circuit", "--out", str(other), *bright, "--set", "circuit.duty=0.1"]) == 0
