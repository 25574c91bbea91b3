from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit.imaging.band import linear_stack
from splitknit.io.capture import read_capture, write_capture
from splitknit.io.images import write_image
from splitknit.io.light_list import read_lights_txt
from splitknit.io.plain import capture_from_plain_images


@pytest.fixture
def plain(tmp_path: Path) -> Path:
    rng = np.random.default_rng(2)
    for k in range(4):
        write_image(tmp_path / f"{k}.png", rng.integers(80, 200, (25, 35)).astype(np.uint8))
    write_image(tmp_path / "mask.png", np.eye(25, 35, dtype=np.uint8) * np.uint8(255))
    write_image(tmp_path / "dark.png", np.full((25, 35), 20, dtype=np.uint8))
    return tmp_path


LIGHTS = np.array([[1.0, 0, 2], [-1, 0, 2], [0, 1, 2], [0, -1, 3]])


def convert(plain: Path, lights: Any = LIGHTS, count: int = 4, **options: Any) -> Any:
    return capture_from_plain_images([plain / f"{k}.png" for k in range(count)], lights, 12.5, **options)


def test_plain_images_become_a_capture(plain: Path) -> None:
    capture = convert(plain, mask=plain / "mask.png", background=71, intensities=[1, 2, 3, 4], tip_direction_deg=90)
    np.testing.assert_allclose(
        [led.direction for led in capture.rig.leds], LIGHTS / np.linalg.norm(LIGHTS, axis=1, keepdims=True)
    )
    assert [led.intensity for led in capture.rig.leds] == [1, 2, 3, 4]
    assert capture.rig.camera.px_per_mm == 12.5
    assert capture.shape == (25, 35)
    assert (capture.material, capture.encoding, capture.tip_direction_deg) == ("opaque", "linear", 90)
    assert capture.mask.sum() == 25
    assert len(capture.hashes) == 5
    band = capture.bands["white"]
    np.testing.assert_allclose(linear_stack(band, "linear"), (band.pixels[..., 0].astype(float) - 71) / 255, atol=1e-6)
    write_capture(capture, plain / "capture")
    again = read_capture(plain / "capture")
    np.testing.assert_array_equal(again.bands["white"].pixels, band.pixels)
    np.testing.assert_allclose(again.rig.light_vectors(), capture.rig.light_vectors(), atol=1e-12)


def test_an_image_as_background(plain: Path) -> None:
    band = convert(plain, background=plain / "dark.png").bands["white"]
    np.testing.assert_allclose(linear_stack(band, "linear"), (band.pixels[..., 0].astype(float) - 20) / 255, atol=1e-6)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"count": 2, "lights": LIGHTS[:2]}, "at least three"),
        ({"lights": LIGHTS[:3]}, "differ in number"),
        ({"lights": LIGHTS * [1, 0, 1]}, "coplanar"),
        ({"lights": LIGHTS * [0, 0, 1]}, "three different light directions"),
        ({"lights": [[0, 0, 1], [1, 0, 1], [2, 0, 1], [3, 0, 1]]}, "coplanar"),
        ({"lights": np.where(LIGHTS == 3, np.nan, LIGHTS)}, "NaN"),
        ({"lights": LIGHTS * [1, 1, -1]}, "points away"),
        ({"intensities": [1, 1]}, "2 intensities for 4 lights"),
        ({"intensities": [1, 1, 1, 0]}, "positive"),
        ({"material": "wood"}, "material"),
        ({"encoding": "log"}, "encoding"),
        ({"background": 255}, "background"),
        ({"background": "no.png"}, "does not exist"),
    ],
)
def test_refusals(options: dict[str, Any], words: str, plain: Path) -> None:
    with pytest.raises(BadInput, match=words):
        convert(plain, **options)


def test_images_of_another_size(plain: Path) -> None:
    write_image(plain / "2.png", np.ones((24, 35), np.uint8))
    with pytest.raises(BadInput, match=r"2\.png has 24 x 35 pixels.* expected by .*0\.png"):
        convert(plain)


@pytest.mark.parametrize(
    "text",
    [
        "2\n1 0 1\n0 1.5e0 1\n",
        "1 0 1\n0 1.5 1",
        "# x y z\n\n1, 0, 1  # first\r\n0;1.5;1\n",
        "\ufeff1 0 1\n0 1.5 1\n",
    ],
)
def test_light_files(text: str, tmp_path: Path) -> None:
    (tmp_path / "l.txt").write_bytes(text.encode())
    np.testing.assert_array_equal(read_lights_txt(tmp_path / "l.txt"), [[1, 0, 1], [0, 1.5, 1]])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (b"", "holds no lights"),
        (b"3\n1 0 1\n", "states 3 lights .* but 1 follow"),
        (b"1 0 1\n0 1\n", "line 2: three finite numbers"),
        (b"1 0 nan\n", "line 1"),
        (b"1 0 one\n", "line 1"),
        (b"1 0 1\n7\n", "line 2"),
        (b"\xff\xfe\0", "not a text file"),
    ],
)
def test_light_files_that_are_refused(text: bytes, words: str, tmp_path: Path) -> None:
    (tmp_path / "l.txt").write_bytes(text)
    with pytest.raises(BadInput, match=words):
        read_lights_txt(tmp_path / "l.txt")
