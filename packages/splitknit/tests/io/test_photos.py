"""Photographs of every format, however they are turned, and as a capture."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

from io_shared import import_photographs
from refusals import bad_input
from splitknit.errors import BadInput
from splitknit.imaging.light_field import few_lights
from splitknit.io.capture import read_capture, write_capture
from splitknit.io.images import decode_pixels
from splitknit.io.photos import read_photo
from splitknit.observation.observe import observe
from splitknit.photometric.lambertian import lambertian

DIRECTIONS = np.array(
    [[0.5, 0, 0.9], [-0.5, 0, 0.9], [0, 0.5, 0.9], [0, -0.5, 0.9], [0.1, 0.1, 1.0]]
)


def picture(rows=40, columns=60):
    noise = np.random.default_rng(3).integers(0, 255, (rows, columns, 3)).astype(np.uint8)
    return cv2.GaussianBlur(noise, (9, 9), 3)


TURNED = {
    1: lambda a: a,
    2: lambda a: a[:, ::-1],
    3: lambda a: a[::-1, ::-1],
    4: lambda a: a[::-1],
    5: lambda a: a.swapaxes(0, 1),
    6: lambda a: np.rot90(a, -1),
    7: lambda a: np.rot90(a, 2).swapaxes(0, 1),
    8: lambda a: np.rot90(a, 1),
}


@pytest.mark.parametrize("orientation", TURNED)
@pytest.mark.parametrize("suffix", ["png", "tif", "webp", "jpg"])
def test_the_exif_orientation_is_applied(orientation, suffix, tmp_path):
    exif = Image.Exif()
    exif[274] = orientation
    file = tmp_path / f"x.{suffix}"
    # `quality` is of JPEG, `lossless` of WebP
    Image.fromarray(picture()).save(file, exif=exif, quality=95, lossless=True)
    photo = read_photo(file)
    assert photo.orientation == orientation
    expected = TURNED[orientation](picture()).astype(int)
    assert photo.pixels.shape == expected.shape
    assert np.abs(photo.pixels - expected).mean() < (4.0 if suffix == "jpg" else 1e-9)


def test_bmp_and_float_tiff_are_read_and_nan_is_refused(tmp_path):
    Image.fromarray(picture()).save(tmp_path / "x.bmp")
    assert_array_equal(read_photo(tmp_path / "x.bmp").pixels, picture())
    values = (picture() / 7.0).astype(np.float32)
    for options in ({}, {"compression": "zlib", "tile": (16, 16)}):
        tifffile.imwrite(tmp_path / "x.tif", values, photometric="rgb", **options)
        assert_array_equal(read_photo(tmp_path / "x.tif").pixels, values)
    values[3, 4] = np.nan
    tifffile.imwrite(tmp_path / "x.tif", values, photometric="rgb")
    with bad_input("not finite"):
        read_photo(tmp_path / "x.tif")


def test_heic_is_read_upright(tmp_path):
    heif = pytest.importorskip("pillow_heif", reason="of the extra photos")
    exif = Image.Exif()
    exif[274] = 6
    heif.from_pillow(Image.fromarray(picture())).save(
        tmp_path / "x.heic", exif=exif.tobytes(), quality=95
    )
    photo = read_photo(tmp_path / "x.heic")
    expected = np.rot90(picture(), -1).astype(int)
    assert photo.pixels.shape == expected.shape
    assert np.abs(photo.pixels - expected).mean() < 8.0


def write_raw(file, mosaic, orientation=1):
    """The smallest DNG that LibRaw reads: black level 256, white level 4095."""
    unit = tuple(x for value in (1, 0, 0, 0, 1, 0, 0, 0, 1) for x in (value, 1))
    tags = [
        (33421, "H", 2, (2, 2), True),
        (33422, "B", 4, bytes([0, 1, 1, 2]), True),
        (50721, "2i", 9, unit, True),
        (50706, "B", 4, bytes([1, 4, 0, 0]), True),
        (50707, "B", 4, bytes([1, 1, 0, 0]), True),
        (50708, "s", 0, "Test", True),
        (50714, "H", 1, 256, True),
        (50717, "H", 1, 4095, True),
        (274, "H", 1, orientation, True),
    ]
    tifffile.imwrite(file, mosaic, photometric="CFA", extratags=tags, metadata=None)


def test_raw_values_are_linear_and_on_one_scale(tmp_path):
    pytest.importorskip("rawpy", reason="of the extra photos")
    for name, level in (("dim", 500), ("bright", 3000)):
        write_raw(tmp_path / f"{name}.dng", np.full((64, 96), level, dtype=np.uint16), 6)
    dim, bright = (read_photo(tmp_path / f"{name}.dng") for name in ("dim", "bright"))
    assert dim.pixels.shape == (96, 64, 3) and dim.pixels.dtype == np.uint16
    assert dim.orientation == 6
    dark, light = (photo.pixels[20:-20, 20:-20].mean(axis=(0, 1)) for photo in (dim, bright))
    assert_allclose(light / dark, (3000 - 256) / (500 - 256), rtol=0.01)
    assert np.ptp(light) < 0.01 * light.mean()  # no white balance


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "is empty"),
        (b"nothing", "is not a PNG, TIFF or JPEG"),
        (b"RIFF\x20\0\0\0WEBPVP8X\x0a\0\0\0\0\0\0\0\xff\xff\xff\xff\xff\xff", "damaged"),
        (b"RIFF\x20\0\0\0WEBPVP8L\x0a\0\0\0\x2f\xff\x3f\0\0", "damaged"),
        (
            b"RIFF\x14\0\0\0WEBPVP8L\x08\0\0\0\x2f\x0f\xe7\xc3\x09\0\0\0",
            "10000 x 10000 .* cannot be in 28",
        ),
        (b"BM" + bytes(26) + b"\x18\0\0\0" + bytes(24), "damaged"),
        (b"BM" + bytes(16) + b"\xff\xff\0\0\xff\x0f\0\0\x01\0\x18\0" + bytes(24), "damaged"),
        (b"\0\0\0\x18ftypheic" + bytes(40), "cannot be decoded|pip install"),
    ],
)
def test_data_that_are_no_photograph_are_refused(data, words, tmp_path):
    (tmp_path / "x.png").write_bytes(data)
    with bad_input(words):
        read_photo(tmp_path / "x.png")


def ball(light, size=60):
    rows, columns = np.mgrid[:size, :size]
    x, y = (columns - (size - 1) / 2) / (0.45 * size), ((size - 1) / 2 - rows) / (0.45 * size)
    normals = np.stack([x, y, np.sqrt(np.clip(1 - x * x - y * y, 0, None))], axis=-1)
    shade = np.where(
        x * x + y * y < 1, np.clip(normals @ (light / np.linalg.norm(light)), 0, None), 0
    )
    return np.rint(shade * 200).astype(np.uint8)


@pytest.fixture
def folder(tmp_path):
    """Five photographs of a ball, their lights and a mask."""
    root = tmp_path / "photos"
    root.mkdir()
    for k, light in enumerate(DIRECTIONS):
        # p8, p9, p10: not in the order of letters
        Image.fromarray(ball(light)).save(root / f"p{k + 8}.png")
    Image.fromarray((ball(np.array([0, 0, 1.0])) > 0).astype(np.uint8) * np.uint8(255)).save(
        root / "mask.png"
    )
    (root / "lights.txt").write_text("\n".join(" ".join(map(str, light)) for light in DIRECTIONS))
    return root


def files_of(photographs):
    return [Path(name).name for name in photographs.capture.bands["white"].files]


def test_a_folder_becomes_a_capture(folder):
    (folder / "notes.docx").write_text("x")
    (folder / ".hidden").write_text("x")
    (folder / "other.mask.png").write_bytes((folder / "mask.png").read_bytes())
    imported = import_photographs(folder, px_per_mm=12.0)
    assert files_of(imported) == ["p8.png", "p9.png", "p10.png", "p11.png", "p12.png"]
    assert imported.capture.mask is not None
    assert imported.capture.encoding == "srgb"  # 8 bits, undecided
    left_out = "notes.docx (not a photograph), other.mask.png (a mask? name it with `mask`)."
    assert set(imported.capture.hashes) == {"lights.txt", "mask.png", *files_of(imported)}
    assert any(
        note.code == "skipped-files" and str(note).endswith(left_out) for note in imported.notes
    )


def never(*_):
    raise AssertionError("it was decoded")


@pytest.mark.parametrize("suffix", ["png", "tif", "jpg", "webp", "bmp", "heic"])
def test_a_size_is_refused_before_memory_is_taken(suffix, tmp_path, monkeypatch):
    file = tmp_path / f"x.{suffix}"
    image, exif = Image.fromarray(picture()), Image.Exif()
    exif[274] = 6
    if suffix == "heic":
        heif = pytest.importorskip("pillow_heif", reason="of the extra photos")
        heif.from_pillow(image).save(file)
    else:
        image.save(file, exif=exif)
        monkeypatch.setattr("splitknit.io.photos.decode_pixels", never)

    def check(rows, columns):
        raise BadInput(f"{rows} x {columns}")

    turned = suffix not in ("heic", "bmp")  # BMP has no EXIF
    with bad_input("60 x 40" if turned else "40 x 60"):
        read_photo(file, check)


@pytest.mark.parametrize("which", ["p9.png", "mask.png", "dark.png"])
def test_a_picture_of_another_size_than_the_first_is_not_decoded(which, folder, monkeypatch):
    decoded = []

    def decode(data, header, name):
        decoded.append((header.rows, header.columns))
        return decode_pixels(data, header, name)

    monkeypatch.setattr("splitknit.io.photos.decode_pixels", decode)
    Image.fromarray(picture(41)).save(folder / which)
    dark = folder / which if which == "dark.png" else None
    with bad_input(f"{which} has 41 x 60 pixels"):
        import_photographs(folder, background=dark)
    assert set(decoded) == {(60, 60)}


def test_an_unknown_scale_survives_a_capture_folder(folder):
    capture = import_photographs(folder).capture
    write_capture(capture, folder / "capture")
    assert '"px_per_mm": null' in (folder / "capture" / "rig.json").read_text()
    again = read_capture(folder / "capture").rig.camera
    assert not again.scale_known and again.px_per_mm == capture.rig.camera.px_per_mm == 60 / 25
    assert "scale unknown" in repr(again) or "scale unknown" in repr(
        read_capture(folder / "capture")
    )


def test_names_in_the_light_list_choose_the_photographs(folder):
    lines = ["p12.png 0.1 0.1 1", "0 -0.5 0.9 p11", "p10.png, 0, 0.5, 0.9"]
    (folder / "lights.txt").write_text("\n".join(lines))
    imported = import_photographs(folder)
    assert files_of(imported) == ["p12.png", "p11.png", "p10.png"]
    left_out = "p8.png (not in lights.txt), p9.png (not in lights.txt)."
    assert any(str(note).endswith(left_out) for note in imported.notes)


TWO_LIGHTS = "p10.png 0 0.5 0.9\np11 0 -0.5 0.9\n"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (TWO_LIGHTS + "p99.png 0.3 0 1", r"names 'p99\.png', but there is no such photograph"),
        (TWO_LIGHTS + "p12 0.1 0.1 1\np12.png 0.3 0 1", r"p12\.png is named twice"),
        ("a 0 0 1\n1 0 1", "some of its lines"),
        ("a 0 0 1\na 1 0 1", "twice"),
        ("0 0 1 7 8", "three"),
    ],
)
def test_wrong_names_in_the_light_list_are_refused(text, words, folder):
    (folder / "lights.txt").write_text(text)
    with bad_input(words):
        import_photographs(folder)


def test_a_wrong_number_of_photographs_names_the_skipped_files(folder):
    (folder / "p12.png").rename(folder / "p12.gif")
    with bad_input(r"4 photographs .* 5 lights; skipped: p12\.gif"):
        import_photographs(folder)
    for file in folder.glob("p*"):
        file.rename(file.with_suffix(".txt"))
    with bad_input(r"holds no photographs .*skipped: p8\.txt"):
        import_photographs(folder)


def test_a_series_with_one_exif_orientation_is_turned_as_a_whole(folder):
    """As a camera that lies on its head writes it: stored the other way up, and marked so."""
    exif = Image.Exif()
    exif[274] = 3
    for file in folder.glob("p*.png"):
        Image.fromarray(np.ascontiguousarray(np.asarray(Image.open(file))[::-1, ::-1])).save(
            file, exif=exif
        )
    imported = import_photographs(folder)
    assert_array_equal(imported.capture.bands["white"].pixels[0, ..., 0], ball(DIRECTIONS[0]))
    assert any("orientation 3" in str(note) for note in imported.notes)
    Image.fromarray(ball(DIRECTIONS[2])).save(folder / "p10.png")
    with bad_input(r"p10\.png is turned differently"):
        import_photographs(folder)


def test_floats_are_brought_to_one_scale(folder):
    for k, file in enumerate(sorted(folder.glob("p*.png"), key=lambda file: int(file.stem[1:]))):
        tifffile.imwrite(
            file.with_suffix(".tiff"), ball(DIRECTIONS[k]).astype(np.float32) * 40.0 + 3.0
        )
        file.unlink()
    imported = import_photographs(folder, background=3.0)
    light = observe(imported.capture).white.grey
    expected = np.stack([ball(direction) for direction in DIRECTIONS]).astype(float)
    factor = light.max() / expected.max()
    assert_allclose(light, expected * factor, atol=2e-5)


def test_an_assumed_tone_curve_gets_a_note(folder):
    for file in folder.glob("p*.png"):
        Image.open(file).save(file.with_suffix(".jpg"), quality=95)
        file.unlink()
    imported = import_photographs(folder)
    assert imported.capture.encoding == "srgb"
    assert any("srgb is assumed of the .jpg files" in str(note) for note in imported.notes)
    Image.fromarray(ball(DIRECTIONS[0])).save(folder / "p8.png")
    (folder / "p8.jpg").unlink()
    with bad_input("`encoding`"):
        import_photographs(folder)


@pytest.mark.parametrize("count", [3, 4, 5])
def test_the_stated_error_of_few_lights_is_that_of_noise(count):
    azimuth = 2 * np.pi * np.arange(count) / count
    lights = np.stack(
        [0.57 * np.cos(azimuth), 0.57 * np.sin(azimuth), np.full(count, 0.82)], axis=1
    )
    words = few_lights(lights)
    assert len(words) == (count < 5)
    if words:
        rng, lengths = np.random.default_rng(1), np.linalg.norm(lights, axis=1)
        stack = rng.normal(lights[:, 2, None, None], 0.01, (count, 100, 100))
        stack = (stack / lengths[:, None, None]).astype(np.float32)
        normals, _ = lambertian(stack, lights / lengths[:, None])
        tilt = np.degrees(np.sqrt((normals[..., :2] ** 2).sum(axis=-1).mean()))
        stated_deg = float(str(words[0]).split("normals by ")[1].split(" deg")[0])
        assert stated_deg == pytest.approx(tilt, abs=0.08)
