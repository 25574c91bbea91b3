"""Several fingers in one view, cut apart; parts of a picture as captures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from splitknit.capture import Band, Capture
from splitknit.cli.main import main
from splitknit.errors import BadInput
from splitknit.finger.hand import fingers_apart
from splitknit.finger.mask import finger_mask
from splitknit.imaging.view import plane_points
from splitknit.io.capture import read_capture, write_capture
from splitknit.model import Camera, Rig
from splitknit.nominal import default_rig, nominal_rig
from splitknit.observation.crop import cropped
from splitknit.observation.observe import observe

PX_PER_MM, SHAPE = 8.0, (320, 720)
MIDDLES_MM, TIPS_MM, HALF_MM = (-33.0, -11.0, 11.0, 33.0), (24.0, 33.0, 36.0, 31.0), 7.0


def view(
    middles_mm: tuple[float, ...] = MIDDLES_MM, tips_mm: tuple[float, ...] = TIPS_MM
) -> Capture:
    """Flat bright fingers with round tips, under seven near lights of white and NIR."""
    rig = default_rig(1.0, 0)
    rig = replace(rig, camera=Camera(PX_PER_MM, SHAPE))
    rng = np.random.default_rng(0)
    row, column = np.indices(SHAPE)
    x, up = (column - (SHAPE[1] - 1) / 2) / PX_PER_MM, (SHAPE[0] - row) / PX_PER_MM
    inside = np.zeros(SHAPE, bool)
    for middle, tip in zip(middles_mm, tips_mm, strict=True):
        inside |= np.hypot(x - middle, np.maximum(up - (tip - HALF_MM), 0)) < HALF_MM
    colour = np.where(inside[..., None], [150.0, 100.0, 80.0], 6.0)
    bands = {}
    for name, first in (("white", 0), ("nir", 7)):
        colours = colour if name == "white" else colour[..., :1]
        pixels = np.stack(
            [colours * (0.8 + 0.05 * k) + rng.normal(0, 1.0, colours.shape) for k in range(7)]
        )
        leds = tuple((first + k,) for k in range(7))
        bands[name] = Band(
            name, pixels.clip(0, 255).astype(np.uint8), leds, np.ones(7), np.zeros(7)
        )
    return Capture(rig, bands, subject={"id": "S01", "session": 1})


def test_four_fingers_are_cut_apart_and_named():
    capture = view()
    fingers = fingers_apart(capture)
    assert list(fingers) == ["right_little", "right_ring", "right_middle", "right_index"]
    for (name, own), middle, tip in zip(fingers.items(), MIDDLES_MM, TIPS_MM, strict=True):
        assert own.subject == {"id": "S01", "session": 1, "finger": name}
        mask = finger_mask(observe(own).white.grey.mean(axis=0), PX_PER_MM)
        rows, columns = np.nonzero(mask)
        assert columns.max() - columns.min() == pytest.approx(2 * HALF_MM * PX_PER_MM, abs=3)
        # the part's frame has its origin in the part's middle; lights moved against it
        moved = np.array(own.rig.leds[3].position_mm) - np.array(capture.rig.leds[3].position_mm)
        x_mm, y_mm = plane_points(own.rig.camera, [[columns.mean(), rows.min()]])[0]
        assert x_mm - moved[0] == pytest.approx(middle, abs=0.3)
        assert y_mm - moved[1] == pytest.approx(tip - SHAPE[0] / PX_PER_MM / 2, abs=0.4)
        assert own.bands["nir"].pixels.shape[1:3] == own.shape


def test_a_neighbouring_finger_is_painted_over():
    own = fingers_apart(view((-8.0, 9.0), (30.0, 36.0)), ["left_index", "left_middle"])[
        "left_index"
    ]
    right = own.bands["white"].pixels[:, :, -10:]
    assert right.max() < 12


@pytest.mark.slow
def test_hands_and_names_are_checked_against_the_fingers_in_view():
    assert "left_index" in fingers_apart(view(tips_mm=TIPS_MM[::-1]))
    assert list(fingers_apart(view(), "left", keep=True))[-1] == "left_little"
    with pytest.raises(BadInput, match="equally far up"):
        fingers_apart(view(tips_mm=(30.0,) * 4))
    with pytest.raises(BadInput, match="stand apart in the view: 3; named by `fingers`: 4"):
        fingers_apart(view((-33.0, -6.5, 6.5, 33.0)))
    with pytest.raises(BadInput, match="letters, digits and _"):
        fingers_apart(view(), ["a", "b", "c", "../d"])


@pytest.mark.parametrize("encoding", ["linear", "srgb"])
def test_cropping_keeps_the_linear_light(encoding):
    capture, window = view(), (slice(40, 240), slice(60, 200))
    shading = (-0.4, 0.1)
    camera = replace(capture.rig.camera, shading=shading)
    white = replace(
        capture.bands["white"],
        exposure=np.linspace(1, 2, 7),
        black_level=np.full(7, 2.0),
    )
    capture = replace(
        capture, rig=replace(capture.rig, camera=camera), bands={"white": white}, encoding=encoding
    )
    part = cropped(capture, window)
    assert part.rig.camera.shading == ()
    before, after = (
        observe(capture).white.at(1, window).grey,
        observe(part).white.grey,
    )
    ratio = after[:, before[0] > 0.1] / before[:, before[0] > 0.1]
    assert np.ptp(ratio) / ratio.mean() < 0.01


def test_cropping_keeps_the_rays_of_a_perspective_camera():
    rig = nominal_rig(0.1)
    rows, columns = rig.camera.image_size
    pixels = np.full((7, rows, columns, 1), 50, np.uint8)
    capture = Capture(
        rig,
        {"white": Band("white", pixels, tuple((k,) for k in range(7)), np.ones(7), np.zeros(7))},
    )
    part = cropped(capture, (slice(30, 130), slice(200, 300)))
    assert np.allclose(
        plane_points(part.rig.camera, [[5, 7]]), plane_points(rig.camera, [[205, 37]])
    )
    assert part.rig.leds == rig.leds


def test_cropping_keeps_the_aim_of_the_leds():
    capture = view()
    leds = tuple(replace(led, lobe_exponent=4.8) for led in capture.rig.leds)
    part = cropped(
        replace(capture, rig=Rig(capture.rig.camera, leds)), (slice(0, 100), slice(0, 100))
    )
    assert np.allclose(part.rig.leds[0].axis, leds[0].axis)


@pytest.mark.slow
def test_import_writes_a_capture_of_each_finger(tmp_path, capsys):
    def run(capture: str, fingers: str, out: str, *options: str) -> int:
        folders = str(tmp_path / capture), "--out", str(tmp_path / out)
        return main(["import", *folders, "--fingers", fingers, *options])

    write_capture(view((-12.0, 12.0), (30.0, 36.0)), tmp_path / "two")
    assert run("two", "left_index,left_middle", "hand") == 0
    assert read_capture(tmp_path / "hand" / "left_middle").subject["finger"] == "left_middle"
    assert run("two", "left_index,left_middle", "hand") == 2
    assert "give --overwrite" in capsys.readouterr().err
    assert run("two", "auto", "hand") == 2
    assert "stand apart in the view: 2" in capsys.readouterr().err
    write_capture(view(), tmp_path / "right")
    assert run("right", "left", "wrong") == 2
    assert "those of a right hand (the outer ones differ by 7 mm)" in capsys.readouterr().err
    assert not (tmp_path / "wrong").exists()
    assert run("right", "left", "wrong", "--keep") == 0
    assert (tmp_path / "wrong" / "left_index").is_dir()
