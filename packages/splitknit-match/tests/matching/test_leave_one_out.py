"""Pictures of the sets that leave an image out, from a simulated capture."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from splitknit.cli.main import main
from splitknit.errors import BadInput
from splitknit.finger.ridges import surface_print
from splitknit.io.capture import write_capture
from splitknit.model import Band, Capture
from splitknit.pipeline import reconstruct
from splitknit.presets import preset_settings
from splitknit_match.matching.minutiae_record import Minutiae
from splitknit_match.matching.voted_minutiae import (
    PICTURES,
    LeaveOneOutSettings,
    _component,
    left_out_pictures,
    voted_minutiae,
)
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.twin import simulate_capture

ZHENG = preset_settings("zheng")


@pytest.fixture(scope="module")
def capture() -> Capture:
    return simulate_capture(11, "whorl", TwinSettings(scale=0.2))[0]


def fewer(capture: Capture, kept: list[int]) -> Capture:
    white = capture.bands["white"]
    band: Band = replace(
        white, pixels=white.pixels[kept], leds=tuple(white.leds[k] for k in kept), exposure=white.exposure[kept],
        black_level=white.black_level[kept],
    )  # fmt: skip
    return replace(capture, bands={**capture.bands, "white": band})


@pytest.mark.slow
def test_seven_sets_of_four_pictures_in_the_frame_of_the_print(capture: Capture) -> None:
    found = list(left_out_pictures(capture, ZHENG))
    assert [(one.image, one.picture) for one in found] == [(k, name) for k in range(7) for name in PICTURES]
    result = reconstruct(capture, "zheng")
    printed = surface_print(result)
    inked = (printed < 255).mean()
    for one in found:
        assert one.print_image.shape == printed.shape
        assert one.print_image.dtype == np.uint8
        assert abs((one.print_image < 255).mean() - inked) < 0.1
    albedo = {one.image: one.print_image.astype(float) for one in found if one.picture == "albedo"}
    assert 0 < np.abs(albedo[0] - albedo[3]).mean() < 40  # similar, and not the same


def test_pictures_of_a_turned_finger_are_turned_back(capture: Capture) -> None:
    """x and y belong to the upright finger: turned by a right angle, x of the one is y of the other."""
    white = capture.bands["white"]
    chosen = LeaveOneOutSettings(pictures=("y",), sigma_px=2.0)
    upright = next(left_out_pictures(capture, ZHENG, chosen)).print_image
    turn = {name: _turned(band) for name, band in capture.bands.items()}
    camera = replace(capture.rig.camera, image_size=(capture.shape[1], capture.shape[0]))
    leds = tuple(
        replace(led, position_mm=(-led.position_mm[1], led.position_mm[0], led.position_mm[2]))
        for led in capture.rig.leds
        if led.position_mm is not None
    )
    turned = replace(
        capture, bands=turn, rig=replace(capture.rig, camera=camera, leds=leds), tip_direction_deg=90.0
    )  # fmt: skip
    other = next(left_out_pictures(turned, ZHENG, chosen)).print_image
    assert white.pixels.shape[1:3] == capture.shape
    rows, columns = (min(a, b) for a, b in zip(upright.shape, other.shape, strict=True))

    def middle(image: np.ndarray) -> np.ndarray:
        top, left = (image.shape[0] - rows) // 2 + rows // 4, (image.shape[1] - columns) // 2 + columns // 4
        return image[top : top + rows // 2, left : left + columns // 2].astype(float)

    best = max(
        np.corrcoef(np.roll(middle(upright), (i, j), (0, 1)).ravel(), middle(other).ravel())[0, 1]
        for i in range(-6, 7)
        for j in range(-6, 7)
    )
    assert best > 0.7


def test_components_point_right_and_towards_the_tip() -> None:
    normals = np.zeros((1, 3, 3), np.float32)
    normals[0] = [[0.6, 0.0, 0.8], [0.0, 0.6, 0.8], [0.0, 0.0, 1.0]]
    albedo = np.array([[0.2, np.nan, 0.4]], np.float32)
    upright = SimpleNamespace(upright=SimpleNamespace(input_from_upright=np.eye(3)))
    quarter = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 5.0], [0.0, 0.0, 1.0]])  # the tip points to column 0
    lying = SimpleNamespace(upright=SimpleNamespace(input_from_upright=quarter))
    for finger, right, up in ((upright, [0.6, 0, 0], [0, 0.6, 0]), (lying, [0, 0.6, 0], [-0.6, 0, 0])):
        np.testing.assert_allclose(_component(normals, albedo, "x", finger)[0], right, atol=1e-6)
        np.testing.assert_allclose(_component(normals, albedo, "y", finger)[0], up, atol=1e-6)
    np.testing.assert_allclose(_component(normals, albedo, "z", lying)[0], [0.8, 0.8, 1.0])
    np.testing.assert_allclose(_component(normals, albedo, "albedo", lying)[0], np.float32([0.2, 0.0, 0.4]))


def _turned(band: Band) -> Band:
    ambient = None if band.ambient is None else np.rot90(band.ambient).copy()
    return replace(band, pixels=np.rot90(band.pixels, axes=(1, 2)).copy(), ambient=ambient)


def test_three_images_are_too_few_and_names_are_checked(capture: Capture) -> None:
    with pytest.raises(BadInput, match="at least four"):
        next(left_out_pictures(fewer(capture, [0, 2, 4]), ZHENG))
    with pytest.raises(BadInput, match="no picture 'w'"):
        LeaveOneOutSettings(pictures=("w",))


@pytest.mark.slow
def test_voted_minutiae_are_those_that_most_pictures_show(capture: Capture) -> None:
    pytest.importorskip("nbis")
    chosen = LeaveOneOutSettings(pictures=("albedo",))
    found = voted_minutiae(capture, ZHENG, chosen)
    assert isinstance(found, Minutiae)
    assert found.acquired
    assert set(found.quality.tolist()) <= {round(100 * k / 7) for k in range(1, 8)}
    assert found.quality.min() >= 50


@pytest.mark.slow
def test_match_by_votes_needs_captures(capture: Capture, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("nbis")
    write_capture(capture, tmp_path / "a")
    given = ["--method", "voted", "--preset", "zheng", "--set", "leave_one_out.pictures=['albedo']"]
    assert main(["match", str(tmp_path / "a"), str(tmp_path / "a"), *given, "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["similarity"] > 60
    assert facts["a"]["minutiae"] == facts["b"]["minutiae"] >= 10
    assert main(["reconstruct", str(tmp_path / "a"), "--out", str(tmp_path / "r"), "--preset", "zheng"]) == 0
    capsys.readouterr()
    assert main(["match", str(tmp_path / "r"), str(tmp_path / "a"), *given]) == 2
    said = capsys.readouterr().err
    assert "without the images" in said
    assert said.count("\n") == 1
