import json
import re
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image
from PIL.PngImagePlugin import PngInfo

import splitknit
from io_shared import import_photographs
from refusals import bad_input
from splitknit.errors import BadInput
from splitknit.imaging.pixels import srgb_code
from splitknit.imaging.view import plane_points
from splitknit.io.capture import read_capture, write_capture
from splitknit.io.images import write_image
from splitknit.io.light_list import read_light_list, write_light_list
from splitknit.io.paging import PagedStack
from splitknit.io.photos import encoding_of
from splitknit.io.rig import write_rig
from splitknit.model import Camera, Led, Rig
from splitknit.observation.observe import observe
from splitknit.pipeline import located


@pytest.fixture
def plain(tmp_path):
    rng = np.random.default_rng(2)
    for k in range(4):
        write_image(tmp_path / f"{k}.png", rng.integers(80, 200, (25, 35)).astype(np.uint8))
    write_image(tmp_path / "mask.png", np.eye(25, 35, dtype=np.uint8) * np.uint8(255))
    write_image(tmp_path / "dark.png", np.full((25, 35), 20, dtype=np.uint8))
    return tmp_path


LIGHTS = np.array([[1.0, 0, 2], [-1, 0, 2], [0, 1, 2], [0, -1, 3]])


@pytest.fixture
def unmasked(plain):
    """The photographs alone."""
    for name in ("mask.png", "dark.png"):
        (plain / name).unlink()
    return plain


def convert(plain, lights=LIGHTS, count=4, intensities=None, **options):
    for k in range(count, 4):
        (plain / f"{k}.png").unlink()
    lights = np.asarray(lights, dtype=np.float64)
    if intensities is not None:
        np.savetxt(plain / "list.txt", np.column_stack([lights, intensities]))
        lights = plain / "list.txt"
    options = {"encoding": "linear", **options}
    return import_photographs(plain / "{light}.png", lights, 12.5, **options).capture


def test_photographs_and_lights_become_a_capture(plain):
    capture = convert(
        plain,
        mask=plain / "mask.png",
        background=71,
        intensities=[1, 2, 3, 4],
        tip_direction_deg=90,
    )
    assert_allclose(
        [led.direction for led in capture.rig.leds],
        LIGHTS / np.linalg.norm(LIGHTS, axis=1, keepdims=True),
    )
    assert [led.intensity for led in capture.rig.leds] == pytest.approx([0.4, 0.8, 1.2, 1.6])
    assert capture.rig.camera.px_per_mm == 12.5
    assert capture.shape == (25, 35)
    assert (capture.material, capture.encoding, capture.tip_direction_deg) == (
        "opaque",
        "linear",
        90,
    )
    assert capture.mask.sum() == 25
    assert len(capture.hashes) == 6
    band = capture.bands["white"]
    assert_allclose(
        observe(capture).white.grey, (band.pixels[..., 0].astype(float) - 71) / 255, atol=1e-6
    )
    write_capture(capture, plain / "capture")
    again = read_capture(plain / "capture")
    assert_array_equal(again.bands["white"].pixels, band.pixels)
    assert_allclose(again.rig.light_vectors(), capture.rig.light_vectors(), atol=1e-12)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"count": 2, "lights": LIGHTS[:2]}, "at least 3"),
        ({"lights": LIGHTS[:3]}, "4 photographs .* has 3 lights"),
        ({"lights": LIGHTS * [1, 0, 1]}, "same direction"),
        ({"lights": LIGHTS * [0, 0, 1]}, "same direction"),
        ({"lights": [[0, 0, 1], [1, 0, 1], [2, 0, 1], [3, 0, 1]]}, "coplanar"),
        ({"lights": np.where(LIGHTS == 3, np.nan, LIGHTS)}, "NaN"),
        ({"lights": LIGHTS * [1, 1, -1]}, "points away"),
        ({"intensities": [1, 1, 1, 0]}, "positive"),
        ({"material": "wood"}, "material"),
        ({"encoding": "log"}, "encoding"),
        ({"background": 255}, "background"),
        ({"background": "no.png"}, "does not exist"),
    ],
)
def test_lights_and_options_that_cannot_be_used_are_refused(options, words, plain):
    with bad_input(words):
        convert(plain, **options)


UNITS = np.array([[1, 0, 1], [0, 1.5, 1]])
ANGLES = np.array([[0.5, 0, np.sqrt(0.75)], [0, np.sqrt(0.75), 0.5]])


@pytest.mark.parametrize(
    ("text", "lights", "names", "bright"),
    [
        ("2\n1 0 1\n0 1.5e0 1\n", UNITS, (), None),
        ("1 0 1\n0 1.5 1", UNITS, (), None),
        ("# x y z\n\n1, 0, 1  # first\r\n0;1.5;1\n", UNITS, (), None),
        ("\ufeff1 0 1\n0 1.5 1\n", UNITS, (), None),
        ("1,0 0,0 1,0\n0,0 1,5 1,0\n", UNITS, (), None),
        ("1,0; 0,0; 1,0\n0,0; 1,5; 1,0\n", UNITS, (), None),
        ("1.0, 0.0, 1.0\n0.0, 1.5, 1.0\n", UNITS, (), None),
        ("x y z\n1,0\t0,0\t1,0\n0,0\t1,5\t1,0\n", UNITS, (), None),
        ("1 0 1 2\n0 1.5 1 0.5\n", UNITS, (), [[2], [0.5]]),
        ("1 0 1 2 3 4\n0 1.5 1 1 1 1\n", UNITS, (), [[2, 3, 4], [1, 1, 1]]),
        ("a b.png 1 0 1 2\nc.png 0 1.5 1 0.5\n", UNITS, ("a b.png", "c.png"), [[2], [0.5]]),
        ("1 0 1 2 a.png\n0 1.5 1 0.5 b.png\n", UNITS, ("a.png", "b.png"), [[2], [0.5]]),
        ("coin 7 1 0 1\ncoin 8 0 1.5 1\n", UNITS, ("coin 7", "coin 8"), None),
        ("azimuth_deg elevation_deg\n0 60\n90 30\n", ANGLES, (), None),
        ("# Azimuth_deg;Elevation_deg\n360,0;60,0\n-270,0;30,0\n", ANGLES, (), None),
        (
            "file, azimuth_deg, elevation_deg\na 1.png, 0, 60\nb.png, 90, 30",
            ANGLES,
            ("a 1.png", "b.png"),
            None,
        ),
        ("azimuth_deg elevation_deg\n0 60 2\n90 30 1\n", ANGLES, (), [[2], [1]]),
    ],
)
def test_light_lists_of_several_forms_are_read(text, lights, names, bright, tmp_path):
    (tmp_path / "l.txt").write_bytes(text.encode())
    table = read_light_list(tmp_path / "l.txt")
    assert_allclose(table.lights, lights, rtol=0, atol=0 if lights is UNITS else 1e-12)
    assert (table.places, table.names) == (False, names)
    assert (None if table.intensities is None else table.intensities.tolist()) == bright


BAD_BRIGHTNESS = r"brightness|three finite numbers"


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
        (b"azimuth_deg elevation_deg\n60 120\n", "azimuth stands first"),
        (b"azimuth_deg elevation_deg\n9 60\n60\n", "line 3: two finite"),
        (b"0,5,0,3,0,8\n", "line 1: .*; write decimals with a point, or put spaces"),
        (b"1 0 1 2\n0 1.5 1\n", BAD_BRIGHTNESS),
        (b"1 0 1 0\n0 1.5 1 1\n", BAD_BRIGHTNESS),
        (b"1 0 1 2\n0 1.5 1 1 1 1\n", BAD_BRIGHTNESS),
        (b"1 0 1 2 3\n", BAD_BRIGHTNESS),
    ],
)
def test_wrong_light_lists_are_refused(text, words, tmp_path):
    (tmp_path / "l.txt").write_bytes(text)
    with bad_input(words):
        read_light_list(tmp_path / "l.txt")


def test_photographs_without_a_list_are_refused_with_what_to_give(unmasked):
    words = "give `lights`, a list of directions or places, or a rig file: a ball in the pictures"
    with bad_input(words):
        import_photographs(unmasked)


def test_lp_files_find_photographs_by_their_names_alone(unmasked):
    """Their paths are of another machine, with spaces and other capitals."""
    names = ("C:\\Scans\\coin 7\\3.PNG", "/home/a user/coin/0.png", "jpeg-exports/1.jpg", "2.png")
    rows = [f"{name} {x} {y} {z}" for name, (x, y, z) in zip(names, LIGHTS, strict=True)]
    (unmasked / "coin.lp").write_text("\r\n".join(["4", *rows]))
    table = read_light_list(unmasked / "coin.lp")
    assert table.names == ("3.PNG", "0.png", "1.jpg", "2.png")
    assert_array_equal(table.lights, LIGHTS)
    band = import_photographs(unmasked).capture.bands["white"]
    assert [Path(file).name for file in band.files] == ["3.png", "0.png", "1.png", "2.png"]


def test_places_in_mm_are_near_lights(unmasked):
    places = LIGHTS * 40.0
    table = unmasked / "lights.txt"
    np.savetxt(table, places, header="x_mm y_mm z_mm", comments="")
    rig = import_photographs(unmasked, px_per_mm=20.0).capture.rig
    assert_array_equal([led.position_mm for led in rig.leds], places)
    with bad_input("`px_per_mm`"):
        import_photographs(unmasked)
    leds = (Led("nir", position_mm=(1.0, 2.0, 90.0)), *rig.leds)
    write_rig(Rig(Camera(12.5, (25, 35)), leds), unmasked / "rig.json")
    again = import_photographs(unmasked, unmasked / "rig.json").capture.rig
    assert again.leds == rig.leds and again.camera.px_per_mm == 12.5
    assert splitknit.read_photographs(unmasked, rig).rig.camera.px_per_mm == 20.0


def test_the_encoding_that_a_png_states_is_used(tmp_path):
    image = Image.fromarray(np.zeros((4, 4), np.uint8))
    for name, kind, data in (("s", b"sRGB", b"\0"), ("g", b"gAMA", (45455).to_bytes(4, "big")),
                             ("l", b"gAMA", (100000).to_bytes(4, "big"))):  # fmt: skip
        info = PngInfo()
        info.add(kind, data)
        image.save(tmp_path / f"{name}.png", pnginfo=info)
    write_image(tmp_path / "n.png", np.zeros((4, 4), np.uint8))
    encodings = {name: encoding_of([tmp_path / f"{name}.png"], "linear")[0] for name in "sgln"}
    assert encodings == {"s": "srgb", "g": "srgb", "l": "linear", "n": "linear"}
    assumed, note = encoding_of([tmp_path / "n.png"])
    assert assumed == "srgb" and "is assumed" in note and "`encoding`" in note
    write_image(tmp_path / "d.png", np.zeros((4, 4), np.uint16))
    assert encoding_of([tmp_path / "d.png"])[0] == "linear"
    with pytest.raises(BadInput, match=r"several kinds.*`encoding`"):
        encoding_of([tmp_path / "s.png", tmp_path / "n.png"])


def ball_normals(size=120):
    """Of a ball; their z is 0 beside it."""
    rows, columns = np.mgrid[:size, :size]
    x, y = (columns - size / 2 + 0.5) / (0.45 * size), (size / 2 - 0.5 - rows) / (0.45 * size)
    return np.stack([x, y, np.sqrt(np.clip(1.0 - x * x - y * y, 0, 1))], axis=-1)


def ball_photographs(folder, code, count=8, bright=1.0):
    """A matt ball under `count` lights as `bright` as is given, stored through `code`; its
    directions."""
    normals = ball_normals()
    angles = 2 * np.pi * np.arange(count) / count
    lights = np.stack(
        [0.5 * np.cos(angles), 0.5 * np.sin(angles), np.full(count, 0.75**0.5)], axis=1
    )
    for k, (light, strength) in enumerate(zip(lights, np.broadcast_to(bright, count), strict=True)):
        shade = np.where(normals[..., 2] > 0, np.clip(normals @ light, 0, 1) * 0.9 * strength, 0)
        write_image(folder / f"{k}.png", np.rint(255 * code(shade)).astype(np.uint8))
    np.savetxt(folder / "lights.txt", lights)
    return lights


def judged_encoding(folder):
    """As which photographs of a folder are read."""
    write_image(folder / "mask.png", np.uint8(255) * (ball_normals()[..., 2] > 0.3))
    photographs = located(splitknit.read_photographs(folder, px_per_mm=10.0))
    return photographs.observation.encoding


UNEQUAL = np.array([1.0, 0.5, 0.9, 0.7, 0.4, 1.0, 0.8, 0.6])


@pytest.mark.parametrize(("bright", "listed"), [(1.0, False), (UNEQUAL, False), (UNEQUAL, True)])
@pytest.mark.parametrize(("code", "encoding"), [(np.asarray, "linear"), (srgb_code, "srgb")])
def test_the_encoding_of_8_bit_files_is_judged_by_the_shading(
    tmp_path, code, encoding, bright, listed
):
    """Unequal lights looked like a wrong curve: sRGB was taken for linear, and normals came out 16
    deg wrong."""
    lights = ball_photographs(tmp_path, code, bright=bright)
    if listed:
        np.savetxt(tmp_path / "lights.txt", np.column_stack([lights, bright]))
    note = import_photographs(tmp_path).notes[0]
    assert note.code == "assumed-encoding" and "srgb is assumed" in str(note)
    assert judged_encoding(tmp_path) == encoding


@pytest.mark.parametrize(
    ("code", "right", "wrong"), [(np.asarray, "linear", "srgb"), (srgb_code, "srgb", "linear")]
)
def test_a_wrongly_stated_encoding_spoils_a_matt_thing(tmp_path, code, right, wrong):
    """It was a note, although heights are wrong by a factor of about two."""
    ball_photographs(tmp_path, code)
    write_image(tmp_path / "mask.png", np.uint8(255) * (ball_normals()[..., 2] > 0.3))
    sound = splitknit.read_photographs(tmp_path, px_per_mm=10.0, encoding=right)
    codes = {finding.code for finding in splitknit.reconstruct(sound).findings}
    assert "other-encoding" not in codes
    spoilt = splitknit.read_photographs(tmp_path, px_per_mm=10.0, encoding=wrong)
    with bad_input(f"shade as {right}, not as {wrong}"):
        splitknit.reconstruct(spoilt)


def test_lights_that_were_said_to_be_equal_are_doubted_where_they_are_not(tmp_path):
    """A contradiction of 7.4 deg went without a word."""
    bright = np.array([1.0, 0.8, 1.1, 0.9, 1.2])
    ball_photographs(tmp_path, np.asarray, count=5, bright=0.8 * bright)
    write_image(tmp_path / "mask.png", np.uint8(255) * (ball_normals()[..., 2] > 0.5))
    known = {"px_per_mm": 10.0, "encoding": "linear"}
    capture = splitknit.read_photographs(tmp_path, brightness="equal", **known)
    (doubt,) = (
        each for each in splitknit.reconstruct(capture).findings if each.severity == "doubt"
    )
    assert doubt.code == "unequal-lights" and doubt.effect_deg > 3.0
    listed = re.findall(r"\d\.\d{3}", str(doubt))
    assert np.array(listed, float) == pytest.approx(bright / bright.mean(), rel=0.03)


def test_brightness_is_estimated_or_equal_as_chosen(tmp_path):
    bright = UNEQUAL
    lights = ball_photographs(tmp_path, np.asarray, bright=bright)
    np.savetxt(tmp_path / "lights.txt", np.column_stack([lights, bright[::-1]]))  # a wrong list
    for way in ("estimate", "equal"):
        rig = import_photographs(tmp_path, brightness=way).capture.rig
        assert {led.intensity for led in rig.leds} == {1.0} and rig.intensities_assumed == (
            way == "estimate"
        )
    capture = splitknit.read_photographs(tmp_path, px_per_mm=10.0, brightness="estimate")
    estimated = splitknit.reconstruct(capture).facts["light_brightness"]
    assert estimated == pytest.approx((bright / bright.mean()).tolist(), rel=0.03)


def test_the_brightness_of_four_lights_cannot_be_estimated(unmasked):
    with bad_input("five lights or more"):
        import_photographs(unmasked, LIGHTS, brightness="estimate")


@pytest.mark.slow
def test_large_stacks_are_processed_in_strips_from_disk(tmp_path, monkeypatch):
    """The surface is that of images in memory; the file of the stack has no name."""
    ball_photographs(tmp_path, srgb_code)
    monkeypatch.setenv("TMPDIR", str(tmp_path / "scratch"))
    (tmp_path / "scratch").mkdir()
    results = []
    bounds = ("io.paging.IN_MEMORY", "methods.photometry.LIGHT_BYTES", "finger.locate.LIGHT_BYTES")
    for small in (False, True):
        write_image(tmp_path / "mask.png", np.full((120, 120), 255, np.uint8))
        for name in bounds if small else ():
            monkeypatch.setattr(f"splitknit.{name}", 100_000)
        capture = import_photographs(tmp_path, px_per_mm=20.0).capture
        assert isinstance(capture.bands["white"].pixels, PagedStack) == small
        assert list((tmp_path / "scratch").iterdir()) == []
        results.append([splitknit.reconstruct(capture, preset) for preset in ("metric", "ea")])
    for whole, strips in zip(*results, strict=True):
        assert_array_equal(whole.mask, strips.mask)
        assert_allclose(whole.normals_measured, strips.normals_measured, atol=1e-5)
        assert_allclose(whole.height_mm, strips.height_mm, atol=1e-4)


def test_a_link_to_itself_is_refused(plain):
    (plain / "3.png").unlink()
    (plain / "3.png").symlink_to("3.png")
    with bad_input("has 4 lights"):
        convert(plain)
    (plain / "lights.txt").write_text(
        "\n".join(f"{k}.png {x} {y} {z}" for k, (x, y, z) in enumerate(LIGHTS))
    )
    with bad_input(r"3\.png"):
        import_photographs(plain, px_per_mm=12.5)
    with bad_input(r"3\.png"):
        import_photographs(plain, None, 12.5, mask=plain / "3.png")


@pytest.mark.parametrize("columns", [1, 3])
def test_an_intensities_file_beside_the_list_is_used(columns, unmasked):
    """DiLiGenT's way: the photographs of a light twice as bright count as half."""
    values = np.ones((len(LIGHTS), columns))
    values[1] = 2.0
    np.savetxt(unmasked / "light_directions.txt", LIGHTS)
    np.savetxt(unmasked / "light_intensities.txt", values)
    imported = import_photographs(unmasked)
    bright = [led.intensity for led in imported.capture.rig.leds]
    assert bright[1] == pytest.approx(2 * bright[0])
    assert not imported.capture.rig.intensities_assumed
    assert not any("light_intensities" in str(note) for note in imported.notes)
    (unmasked / "light_intensities.txt").write_text("1\n2\n")
    with bad_input("has 2 lines, but there are"):
        import_photographs(unmasked)


def test_one_photograph_under_three_coloured_lights_is_three_images(tmp_path):
    image = np.random.default_rng(0).integers(2000, 60000, (24, 30, 3)).astype(np.uint16)
    write_image(tmp_path / "frame.png", image)
    lights = np.array([[0.5, 0, 1], [-0.3, 0.4, 1], [-0.3, -0.4, 1]])
    capture = import_photographs(tmp_path, lights).capture
    assert_array_equal(capture.bands["white"].pixels[..., 0], np.moveaxis(image, 2, 0))
    write_image(tmp_path / "frame.png", image[..., 0])
    with bad_input(r"frame\.png is grey"):
        import_photographs(tmp_path, lights)


def test_a_mask_is_read_from_transparency_or_covers_all(tmp_path):
    ball_photographs(tmp_path, np.asarray)
    inside = ball_normals()[..., 2] > 0
    picture = np.tile(np.linspace(60, 250, 120).astype(np.uint8)[:, None], (120, 1, 3))
    alpha = np.dstack([picture, 255 * inside.astype(np.uint8)])
    Image.fromarray(alpha).save(tmp_path / "mask.png")
    imported = import_photographs(tmp_path, px_per_mm=5.0)
    assert_array_equal(imported.capture.mask, inside)
    assert any("not transparent" in str(note) for note in imported.notes)
    file = tmp_path / "mask.tif"
    Image.fromarray(alpha).save(file)
    known = {"px_per_mm": 5.0, "encoding": "linear"}
    imported = import_photographs(tmp_path, mask=file, **known)
    assert_array_equal(imported.capture.mask, inside)
    Image.fromarray(picture).save(tmp_path / "mask.png")
    with bad_input("is a picture and no mask"):
        import_photographs(tmp_path, px_per_mm=5.0)
    assert import_photographs(tmp_path, mask="all", **known).capture.mask.all()


def test_the_transparency_of_photographs_is_their_mask(tmp_path):
    ball_photographs(tmp_path, np.asarray)
    inside = ball_normals()[..., 2] > 0
    for file in tmp_path.glob("*.png"):
        image = np.dstack([np.asarray(Image.open(file)), np.where(inside, 255, 0)])
        Image.fromarray(image.astype(np.uint8), "LA").save(file)
    imported = import_photographs(tmp_path, None, 0.002, encoding="linear")
    assert_array_equal(imported.capture.mask, inside)
    result = splitknit.reconstruct(imported.capture)
    assert any("longer side of the pictures is 60000 mm" in warning for warning in result.warnings)


def test_a_written_lp_file_names_the_photographs_and_holds_directions_only(tmp_path):
    leds = [Led("white", direction=(1.0, 2.0, 2.0)), Led("white", direction=(0.0, 0.0, 5.0))]
    write_light_list(leds, tmp_path / "a.lp", ["one.jpg", "two.jpg"])
    assert (tmp_path / "a.lp").read_text().splitlines()[0] == "2"
    table = read_light_list(tmp_path / "a.lp")
    assert table.names == ("one.jpg", "two.jpg")
    assert_allclose(table.lights, [[1 / 3, 2 / 3, 2 / 3], [0, 0, 1]], atol=1e-6)
    place = Led("white", position_mm=(10.0, 20.0, 20.0))
    write_light_list([place], tmp_path / "b.lp", ["one.jpg"])
    assert_allclose(read_light_list(tmp_path / "b.lp").lights, [[1 / 3, 2 / 3, 2 / 3]], atol=1e-6)


@pytest.mark.parametrize("near", [True, False])
def test_a_dome_file_of_relight_holds_places_or_directions(near, tmp_path):
    """Its places are mm from the picture's middle, also where the rig's origin is elsewhere."""
    lights = np.array([[0.0, 0.6, 0.8], [0.6, 0.0, 0.8]]) * (60.0 if near else 1.0)
    leds = [
        Led("white", tuple(light)) if near else Led("white", direction=tuple(light))
        for light in lights.tolist()
    ]
    matrix = np.array([[2000.0, 0, 349.5], [0, 2000.0, 249.5], [0, 0, 1]])
    camera = Camera(20.0, (480, 640), 100.0, "perspective", matrix)
    write_light_list(leds, tmp_path / "a.dome", ["1.jpg", "2.jpg"], camera=camera)
    table = read_light_list(tmp_path / "a.dome")
    assert table.places == near and table.intensities is None
    shift = [1.5, -0.5, 0.0] if near else [0, 0, 0]  # of the middle against the camera's foot
    assert_allclose(table.lights, lights + shift, atol=1e-6)
    assert json.loads((tmp_path / "a.dome").read_text())["imageWidth"] == 32.0


def test_a_dome_file_states_which_lights_hold_and_how_bright_they_are(tmp_path):
    document = {
        "label": "mine",
        "lightConfiguration": "spherical",
        "directions": [{"x": 0, "y": 0, "z": 1}],
        "positionsSphere": [{"x": 10, "y": 20, "z": 30.5}],
        "ledAdjust": [{"r": 1.0, "g": 2.0, "b": 4.0}],
    }
    file = tmp_path / "a.dome"
    file.write_text(json.dumps(document))
    table = read_light_list(file)
    assert table.places and table.lights.tolist() == [[10, 20, 30.5]]
    assert table.intensities.tolist() == [[1.0, 0.5, 0.25]]
    wrong = [
        ({"lightConfiguration": "round"}, "lightConfiguration must be one of"),
        ({"lightConfiguration": "lights3d"}, "positions3d is empty"),
        ({"ledAdjust": [{"r": 1.0, "g": 2.0, "b": 0.0}]}, "ledAdjust needs positive"),
        ({"positionsSphere": 3}, "positionsSphere"),
    ]
    for change, words in wrong:
        file.write_text(json.dumps({**document, **change}))
        with bad_input(words):
            read_light_list(file)


def test_a_list_of_places_may_state_the_camera(unmasked):
    """Its rays then pass through one point; the rig's origin lies below it."""
    folder = unmasked
    places = "\n".join(" ".join(map(str, 90.0 * light)) for light in LIGHTS)
    lines = "# x_mm y_mm z_mm\n# camera_mm 1.0 -2.0 80.0\n"
    (folder / "lights.txt").write_text(lines + places)
    rig = import_photographs(folder, None, 10.0, mask="all").capture.rig
    rows, columns = rig.camera.image_size
    assert rig.camera.model == "perspective" and rig.camera.height_mm == 80.0
    middle = np.array([[(columns - 1) / 2, (rows - 1) / 2]])
    assert_allclose(plane_points(rig.camera, middle), [[-1.0, 2.0]], atol=1e-9)
    assert_allclose(rig.leds[0].position_mm, 90 * LIGHTS[0] - [1, -2, 0])
    names = [f"{k}.png" for k in range(len(rig.leds))]
    write_light_list(rig.leds, folder / "again.txt", names, camera=rig.camera)
    again = read_light_list(folder / "again.txt")
    assert again.camera_mm == (1.0, -2.0, 80.0)
    assert_allclose(again.lights, 90 * LIGHTS, atol=1e-5)
    (folder / "lights.txt").write_text("# camera_mm 1.0 80.0\n# x_mm y_mm z_mm\n" + places)
    with bad_input("camera_mm needs three numbers"):
        read_light_list(folder / "lights.txt")
    (folder / "lights.txt").write_text("# camera_mm 1 2 80\n0 0 1\n1 0 1\n0 1 1\n")
    with bad_input("its lights are directions"):
        read_light_list(folder / "lights.txt")


def test_a_written_list_may_name_its_photographs(tmp_path):
    leds = [Led("white", position_mm=(10.0, 20.0, 30.0)), Led("white", position_mm=(0.0, 0.0, 5.0))]
    write_light_list(leds, tmp_path / "a.txt", ["a 1.jpg", "2.jpg"], named=True)
    table = read_light_list(tmp_path / "a.txt")
    assert table.names == ("a 1.jpg", "2.jpg") and table.places


def test_rows_too_long_for_directions_are_refused_without_a_first_line(tmp_path):
    """Places in mm were taken for directions, which turned a surface by 9.7 deg."""
    places = 100.0 * LIGHTS
    file = tmp_path / "lights.txt"
    np.savetxt(file, places)
    with bad_input(r"too long for directions.*x_mm y_mm z_mm"):
        read_light_list(file)
    for title, near in (("x_mm y_mm z_mm", True), ("x y z", False)):
        np.savetxt(file, places, header=title)
        assert read_light_list(file).places == near
    np.savetxt(file, LIGHTS)
    assert not read_light_list(file).places
