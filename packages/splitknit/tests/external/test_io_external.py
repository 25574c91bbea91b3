"""Data that nobody on this project made, read as captures."""

import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit.imaging.pixels import srgb_code
from splitknit.io.capture import read_capture, write_capture
from splitknit.io.images import read_image, write_image
from splitknit.io.light_list import read_light_list
from splitknit.io.photographs import GivenPhotographs
from splitknit.observation.observe import observe
from splitknit.observation.plain import capture_from_photographs
from splitknit.pipeline import located

pytestmark = pytest.mark.external


def test_photographs_of_the_blender_phalange_survive_a_capture_folder(data_dir, tmp_path):
    folder = data_dir / "blender_finger" / "phalange"
    lights = read_light_list(folder / "lights.txt").lights
    photographs = GivenPhotographs(
        folder / "light_{light}.png",
        lights,
        40.0,
        mask=folder / "mask.png",
        background=71,
        encoding="linear",
    )
    capture, _ = capture_from_photographs(photographs)
    write_capture(capture, tmp_path / "capture")
    again = read_capture(tmp_path / "capture")
    assert again.bands["white"].pixels.shape[:3] == (12, *again.shape)
    assert again.mask is not None
    light = observe(again).white.grey
    outside = light[:, ~again.mask]
    assert abs(float(np.median(outside))) < 1e-6  # the constant background is gone
    assert float(np.median(light[:, again.mask])) > 0.1


def test_the_shading_of_the_spheres_agrees_with_their_lights(data_dir, tmp_path):
    folder = data_dir / "psm_spheres"
    lights = read_light_list(folder / "lights.txt").lights
    assert lights.shape == (12, 3)
    photographs = GivenPhotographs(
        folder / "gray" / "gray.{light}.png",
        lights,
        5.0,
        mask=folder / "gray" / "gray.mask.png",
        encoding="linear",
    )
    capture, _ = capture_from_photographs(photographs)
    write_capture(capture, tmp_path / "capture")
    again = read_capture(tmp_path / "capture")
    assert again.mask is not None
    rows, columns = np.nonzero(again.mask)
    radius = (np.ptp(columns) + 1) / 2
    x = (columns - (columns.min() + columns.max()) / 2) / radius
    y = ((rows.min() + rows.max()) / 2 - rows) / radius
    normals = np.stack([x, y, np.sqrt(np.clip(1 - x * x - y * y, 0, 1))], axis=1)
    for image, light in zip(observe(again).white.grey, lights, strict=True):
        shade = image[again.mask]
        lit = shade > 0.25 * shade.max()
        seen = np.linalg.lstsq(normals[lit], shade[lit], rcond=None)[0]
        assert seen @ light > np.cos(np.deg2rad(10.0)) * np.linalg.norm(seen) * np.linalg.norm(
            light
        )


def test_every_independent_image_is_read_or_refused_by_name(data_dir):
    files = [
        file
        for kind in ("png", "jpg", "tif", "bmp")
        for file in sorted(data_dir.rglob(f"*.{kind}"))
    ]
    read = 0
    for file in files[:: max(1, len(files) // 60)]:
        try:
            read += read_image(file).ndim == 3
        except BadInput as error:
            assert str(file) in str(error)
            assert file.suffix not in (".png", ".jpg")
    assert read > 20


@pytest.mark.parametrize("stored", ["linear", "srgb"])
def test_the_encoding_of_8_bit_files_is_found_by_the_shading(data_dir, tmp_path, stored):
    """The bear as 8-bit PNG without a word on its encoding: a wrong guess doubles the error (16 deg
    instead of 8)."""
    file = data_dir / "diligent" / "bear.npz"
    if not file.is_file():
        pytest.skip(f"{file} is absent")
    bear = np.load(file)
    light = bear["images"][::3] / 65535.0
    codes = np.rint(255.0 * (srgb_code(light) if stored == "srgb" else light)).astype(np.uint8)
    for k, code in enumerate(codes):
        write_image(tmp_path / f"{k}.png", code)
    write_image(tmp_path / "mask.png", np.uint8(255) * bear["mask"])
    capture, notes = capture_from_photographs(GivenPhotographs(tmp_path, bear["lights"][::3]))
    assert located(capture).observation.encoding == stored
    assert "`encoding`" in str(notes[0])


def test_renders_without_a_tone_curve_stay_linear(data_dir):
    folder = data_dir / "blender_finger" / "phalange"
    if not folder.is_dir():
        pytest.skip(f"{folder} is absent")
    capture, notes = capture_from_photographs(GivenPhotographs(folder))
    assert "give `encoding` linear" in str(notes[0])
    assert located(capture).observation.encoding == "linear"
