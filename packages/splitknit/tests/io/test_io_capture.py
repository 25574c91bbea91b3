import hashlib
import json
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from refusals import bad_input
from small_capture import edit
from splitknit.capture import Ambient
from splitknit.io.capture import read_capture, write_capture
from splitknit.io.images import read_image, write_image
from splitknit.io.npz import read_npz
from splitknit.io.rig import read_rig, write_rig
from splitknit.model import Camera, Led, Rig
from splitknit.observation.observe import observe


def assert_same(a, b):
    assert list(a.bands) == list(b.bands)
    for key, first in a.bands.items():
        second = b.bands[key]
        assert first.pixels.dtype == second.pixels.dtype
        assert_array_equal(first.pixels, second.pixels)
        assert first.leds == second.leds
        assert_array_equal(first.exposure, second.exposure)
        assert_array_equal(first.black_level, second.black_level)
        assert (first.ambient is None) == (second.ambient is None)
        if first.ambient is not None:
            assert_array_equal(first.ambient.pixels, second.ambient.pixels)
            assert first.ambient.exposure == second.ambient.exposure
            assert first.ambient.black_level == second.ambient.black_level
    assert a.rig.leds == b.rig.leds
    assert a.rig.provenance == b.rig.provenance
    assert a.rig.camera.px_per_mm == b.rig.camera.px_per_mm
    assert a.shape == b.shape
    for name in ("encoding", "material", "tip_direction_deg", "subject", "captured_at"):
        assert getattr(a, name) == getattr(b, name)
    assert (a.mask is None) == (b.mask is None)
    if a.mask is not None:
        assert_array_equal(a.mask, b.mask)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("images", ["png", "tiff"])
def test_a_written_capture_is_read_back(dtype, channels, images, tmp_path, build_capture):
    mask = np.zeros((40, 30), dtype=bool)
    mask[5:30, 4:20] = True
    capture = build_capture(
        dtype,
        channels,
        mask=mask,
        encoding="srgb",
        material="opaque",
        tip_direction_deg=-12.5,
        subject={"id": "anonymous", "session": 2},
        captured_at="2026-11-20T10:00:00Z",
    )
    white = capture.bands["white"]
    white = replace(
        white,
        exposure=np.array([0.5, 1.0, 0.25, 1 / 3]),
        black_level=np.array([1.0, 0.0, 2.5, 0.0]),
        ambient=Ambient(white.pixels[0] // 20, 0.7, 1.0),
        leds=((0, 1), (1,), (2,), (3,)),
    )
    capture = replace(capture, bands={**capture.bands, "white": white})
    truth = {"height_mm": np.ones((3, 4), np.float32), "mask": np.ones((3, 4), bool)}
    write_capture(capture, tmp_path / "c", truth, images=images)
    again = read_capture(tmp_path / "c")
    assert_same(capture, again)
    assert {file.suffix[1:] for file in (tmp_path / "c").glob("*_[0-9]*")} == {images}
    assert again.truth == tmp_path / "c" / "truth.npz"
    assert_array_equal(read_npz(again.truth)["height_mm"], truth["height_mm"])
    assert again.hashes == {
        name.name: hashlib.sha256(name.read_bytes()).hexdigest()
        for name in (tmp_path / "c").iterdir()
        if name.name not in ("truth.npz", ".splitknit")
    }
    write_capture(again, tmp_path / "d", images=images)
    assert_same(again, read_capture(tmp_path / "d" / "capture.json"))
    assert (tmp_path / "d" / "truth.npz").read_bytes() == again.truth.read_bytes()
    assert (tmp_path / "d" / "capture.json").read_bytes() == (
        tmp_path / "c" / "capture.json"
    ).read_bytes()


def test_a_minimal_document_is_read_and_unknown_fields_are_ignored(folder):
    def least(document):
        white = document["bands"]["white"]
        white["comment"] = ["not", {"known": None}]
        document.clear()
        document |= {
            "format": "splitknit-capture",
            "version": 1,
            "rig": "rig.json",
            "bands": {"white": white},
            "x": 1,
        }
        document |= dict.fromkeys(("mask", "truth", "subject", "captured_at", "tip_direction_deg"))

    edit(folder / "capture.json", least)
    capture = read_capture(folder)
    assert (capture.encoding, capture.material, list(capture.bands)) == (
        "linear",
        "skin",
        ["white"],
    )
    assert capture.mask is capture.truth is capture.tip_direction_deg is capture.captured_at is None


def test_exposure_gain_and_black_level_bring_images_to_one_scale(folder):
    def expose(document):
        images = document["bands"]["white"]["images"]
        images[0] = {"file": images[0], "exposure_s": 0.5, "gain": 4.0, "black_level": 3}
        images[1] = {"file": images[1], "gain": 2}
        images[2] = {"file": images[2]}

    before = observe(read_capture(folder)).white.grey
    edit(folder / "capture.json", expose)
    capture = read_capture(folder)
    band = capture.bands["white"]
    assert band.exposure.tolist() == [2.0, 2.0, 1.0, 1.0]
    assert band.black_level.tolist() == [3.0, 0.0, 0.0, 0.0]
    after = observe(capture).white.grey
    assert_allclose(after[0], (before[0] - 3 / 255) / 2, atol=1e-6)
    assert_allclose(after[1], before[1] / 2, atol=1e-6)
    assert_allclose(after[2:], before[2:])


@pytest.mark.parametrize(
    ("exposures", "ambient", "expected"),
    [
        ([None] * 4, None, 1.0),
        ([0.02] * 4, None, 0.02),
        ([0.02] * 4, 0.5, 0.5),
        ([0.02, None, 0.02, 0.02], None, 1.0),
        ([0.02, 0.04, 0.02, 0.02], None, "its own exposure_s"),
    ],
)
def test_the_ambient_image_has_its_own_or_the_common_exposure(exposures, ambient, expected, folder):
    write_image(folder / "dark.png", np.ones((40, 30, 3), np.uint8))

    def expose(document):
        white = document["bands"]["white"]
        white["images"] = [
            name if s is None else {"file": name, "exposure_s": s}
            for name, s in zip(white["images"], exposures, strict=True)
        ]
        white["ambient"] = (
            "dark.png" if ambient is None else {"file": "dark.png", "exposure_s": ambient}
        )

    edit(folder / "capture.json", expose)
    if isinstance(expected, str):
        with bad_input(expected):
            read_capture(folder)
    else:
        assert read_capture(folder).bands["white"].ambient.exposure == expected


def test_a_mask_of_any_image_type_is_read(folder):
    mask = np.zeros((40, 30), np.uint8)
    mask[10:20, 5:9] = 1
    edit(folder / "capture.json", document_with(mask="m.png"))
    for values in (
        mask,
        mask * 255,
        np.repeat(mask[..., None] * 255, 3, axis=2),
        mask.astype(np.uint16) * 65535,
    ):
        write_image(folder / "m.png", values)
        read = read_capture(folder).mask
        assert read is not None
        assert_array_equal(read, mask > 0)


@pytest.mark.parametrize(
    ("mask", "words"),
    [
        (np.full((40, 30), 100, np.uint8), r"m\.png is an empty mask"),
        (np.full((39, 30), 255, np.uint8), r"m\.png has 39 x 30 pixels"),
    ],
)
def test_a_dark_mask_or_one_of_another_size_is_refused(mask, words, folder):
    edit(folder / "capture.json", document_with(mask="m.png"))
    write_image(folder / "m.png", mask)
    with bad_input(words):
        read_capture(folder)


def document_with(**values):
    return lambda document: document.update(values)


def white(**values):
    return lambda document: document["bands"]["white"].update(values)


def image(place, value):
    return lambda document: document["bands"]["white"]["images"].__setitem__(place, value)


def camera_with(**values):
    return lambda document: document["camera"].update(values)


def led_with(**values):
    return lambda document: document["leds"][0].update(values)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d.pop("format"), "missing required field format"),
        (document_with(format="splitknit-rig"), "format: "),
        (document_with(version=2), "version: "),
        (document_with(rig={"leds": []}), "rig: Expected str, got object"),
        (document_with(rig="no.json"), r"no\.json does not exist"),
        (document_with(encoding="log"), "encoding: Expected linear or srgb"),
        (document_with(tip_direction_deg=10**400), "tip_direction_deg: |not valid JSON"),
        (document_with(truth="no.npz"), r"no\.npz, the truth that .* does not exist"),
        (lambda d: d["bands"].pop("white"), "bands: .*missing required field white"),
        (lambda d: d["bands"].update(uv={}), "bands: .*unknown field uv"),
        (lambda d: d["bands"]["white"].pop("leds"), r"bands\.white: .*missing required field leds"),
        (white(images=["white_0.png"] * 2), "at least three"),
        (white(images=[f"{k}.png" for k in range(1001)]), r"bands\.white\.images: .*1000"),
        (white(leds=[0, 1, 2]), "4 images but 3 entries"),
        (white(leds=[0, 1, 2, 99]), "LED 99 is not in the rig, which has 8"),
        (white(leds=[0, 1, 2, -1]), r"leds\[3\]: "),
        (white(leds=[0, 1, 2, [3, 3]]), r"leds\[3\] names an LED twice"),
        (white(leds=[0, 1, 2, 4]), "is a 'nir' LED in the rig, not 'white'"),
        (white(leds=[0, 1, 2, 2]), "same direction"),
        (image(0, {}), r"images\[0\]: .*field file"),
        (image(0, "white_1.png"), r"names 'white_1\.png' twice"),
        (image(2, "./white_1.png"), r"white.* '\./white_1\.png' twice"),
        (image(0, {"file": "white_0.png", "exposure_s": 0}), r"images\[0\]\.exposure_s: "),
        (
            image(0, {"file": "white_0.png", "black_level": 255}),
            r"white_0\.png has the black level 255",
        ),
    ],
)
def test_wrong_capture_documents_are_refused(change, words, folder):
    edit(folder / "capture.json", change)
    with bad_input(words):
        read_capture(folder)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (b"", "not valid JSON"),
        (b'{"format": ', "not valid JSON"),
        (b"\xff\xfe", "not valid JSON"),
        (b"[1]", "Expected object, got array"),
        (b'{"version": NaN}', "not valid JSON"),
        (b'{"version": 1e999}', "not valid JSON"),
        (b"[" * 100_000, "nested too deeply"),
        (b" " * 16_000_001, "too large"),
    ],
)
@pytest.mark.parametrize("file", ["capture.json", "rig.json"])
def test_broken_json_is_refused(text, words, file, folder):
    (folder / file).write_bytes(text)
    with bad_input(words) as caught:
        read_capture(folder)
    assert str(folder / file) in str(caught.value)


@pytest.mark.parametrize(
    "name",
    [
        "../secret.png",
        "sub/../../secret.png",
        "../capture/white_0.png",
        "/etc/passwd",
        "~/secret.png",
        "C:\\secret.png",
        "..\\secret.png",
        "link.png",
        "linked/secret.png",
    ],
)
@pytest.mark.parametrize("field", ["image", "ambient", "mask", "truth", "rig"])
def test_paths_stay_inside_the_folder(name, field, folder):
    write_image(folder.parent / "secret.png", np.ones((40, 30, 3), np.uint8))
    (folder / "link.png").symlink_to(folder.parent / "secret.png")
    (folder / "linked").symlink_to(folder.parent)

    def change(document):
        if field == "image":
            document["bands"]["white"]["images"][0] = {"file": name}
        elif field == "ambient":
            document["bands"]["white"]["ambient"] = name
        else:
            document[field] = name

    edit(folder / "capture.json", change)
    with bad_input("leaves the capture folder"):
        read_capture(folder)


@pytest.mark.parametrize("name", ["a\0b.png", "\ud800.png", "x" * 5000, " ", ""])
def test_unusable_file_names_are_refused(name, folder):
    edit(folder / "capture.json", document_with(mask=name))
    with bad_input():
        read_capture(folder)


def test_missing_folders_and_files_are_refused(tmp_path, folder):
    with bad_input("does not exist"):
        read_capture(tmp_path / "nowhere")
    with bad_input(r"holds no capture\.json"):
        read_capture(tmp_path)
    with bad_input("is not a capture"):
        read_capture(folder / "white_0.png")
    with bad_input():
        read_capture("\0")
    (folder / "nir_2.png").unlink()
    with bad_input(r"nir_2\.png does not exist"):
        read_capture(folder)


def test_images_that_do_not_match_the_others_are_refused(folder):
    good = read_image(folder / "white_2.png")
    data = (folder / "white_2.png").read_bytes()
    (folder / "white_2.png").write_bytes(data[: len(data) // 2])
    with bad_input(r"white_2\.png is truncated"):
        read_capture(folder)
    write_image(folder / "white_2.png", good[:-1])
    with bad_input(r"white_2\.png has 39 x 30 pixels.* 40 x 30 are expected"):
        read_capture(folder)
    write_image(folder / "white_2.png", good[..., 0])
    with bad_input(r"white_2\.png is 40 x 30 grey, 8 bits, but .*white_0\.png is 40 x 30 RGB"):
        read_capture(folder)
    write_image(folder / "white_2.png", good.astype(np.uint16))
    with bad_input(r"white_2\.png is 40 x 30 RGB, 16 bits"):
        read_capture(folder)
    write_image(folder / "white_2.png", good)
    edit(folder / "rig.json", camera_with(image_size=[30, 40]))
    with bad_input(r"white_0\.png .*rig for another camera"):
        read_capture(folder)


def test_a_capture_that_could_not_be_read_back_is_not_written(tmp_path, build_capture):
    capture = build_capture()
    white = capture.bands["white"]

    def refused(words, **changes):
        with bad_input(words):
            write_capture(replace(capture, **changes), tmp_path / "out")
        assert list(tmp_path.iterdir()) == []

    refused("a band 'white'", bands={"nir": capture.bands["nir"]})
    refused("not 'uv'", bands={"white": white, "uv": white})
    refused("have the shape", bands={"white": replace(white, pixels=white.pixels[:, 1:])})
    refused("have the shape", bands={"white": replace(white, pixels=white.pixels[:2])})
    refused("but 3 LEDs", bands={"white": replace(white, leds=white.leds[:3])})
    refused("ambient", bands={"white": replace(white, ambient=Ambient(white.pixels[0, 1:]))})
    refused("mask", mask=np.ones((3, 3), bool))
    refused("group of LEDs", rig=capture.rig.select([[0, 1], [2]]))
    refused("does not exist", truth=tmp_path / "no.npz")
    refused("no form in JSON", subject={"age": float("nan")})


def test_a_tiff_file_that_is_not_the_one_written_is_refused(tmp_path, build_capture):
    """TIFF files have no checksums: of a bit that changes within one, nothing else is seen."""
    folder = tmp_path / "c"
    write_capture(build_capture(), folder, images="tiff")
    file = folder / "white_1.tiff"
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1
    file.write_bytes(data)
    assert read_image(file).size > 0
    with bad_input(r"white_1\.tiff is damaged or was changed"):
        read_capture(folder)
    edit(folder / "capture.json", lambda document: document["sha256"].pop("white_1.tiff"))
    read_capture(folder)


def test_a_capture_is_not_overwritten_unless_asked(folder, build_capture):
    with bad_input("exists and is not empty"):
        write_capture(build_capture(), folder)
    write_capture(build_capture(np.uint16), folder, overwrite=True)
    assert read_capture(folder).bands["white"].pixels.dtype == np.uint16
    (folder / "notes.txt").write_text("mine")
    with bad_input(r"'notes\.txt', which splitknit did not write"):
        write_capture(build_capture(), folder, overwrite=True)
    assert (folder / "notes.txt").read_text() == "mine"


RIG = {
    "format": "splitknit-rig",
    "version": 1,
    "camera": {
        "px_per_mm": 75.7,
        "image_size": [22, 32],
        "height_mm": 140.0,
        "matrix": None,
        "distortion": None,
    },
    "leds": [
        {"position_mm": [52.5, 0, 140], "intensity": 1, "band": "white", "lobe_exponent": 1.5}
    ],
}


MATRIX = np.array([[900.0, 0, 15.5], [0, 901.0, 10.5], [0, 0, 1]])


def test_a_written_rig_is_read_back(tmp_path):
    distortion, shading = (0.1, 0.0, 0.0, -0.2, 0.0), (-0.1, 0.02)
    camera = Camera(6.45, (22, 32), 139.5, "perspective", MATRIX, distortion, shading)
    leds = (
        Led("white", position_mm=(1 / 3, -52.5, 140.0), intensity=0.1, lobe_exponent=2.0),
        Led("nir", direction=(0.6, 0.0, 0.8)),
        Led("nir", position_mm=(0.0, 50.0, 140.0), lobe_exponent=5.0, aim=(0.0, -0.3, -0.9)),
    )
    write_rig(Rig(camera, leds, {"by": "hand", "residuals": [1, 2.5]}), tmp_path / "rig.json")
    rig = read_rig(tmp_path / "rig.json")
    assert rig.leds == leds
    assert rig.provenance == {"by": "hand", "residuals": [1, 2.5]}
    assert rig.camera.matrix is not None
    assert_array_equal(rig.camera.matrix, MATRIX)
    for name in ("px_per_mm", "image_size", "height_mm", "model", "distortion", "shading"):
        assert getattr(rig.camera, name) == getattr(camera, name)
    first = (tmp_path / "rig.json").read_bytes()
    write_rig(rig, tmp_path / "rig.json")
    assert (tmp_path / "rig.json").read_bytes() == first


def test_a_lens_without_distortion_is_written_with_zeros(tmp_path):
    camera = Camera(6.45, (22, 32), 139.5, "perspective", MATRIX)
    write_rig(Rig(camera, (Led("white", (0.0, 1.0, 2.0)),)), tmp_path / "r")
    assert read_rig(tmp_path / "r").camera.distortion == (0.0,) * 5


def test_a_rounded_direction_becomes_a_unit_vector(tmp_path):
    document = json.loads(json.dumps(RIG))
    document["leds"] = [{"direction": [0.58, 0.58, 0.57], "band": "white"}]
    (tmp_path / "rig.json").write_text(json.dumps(document))
    direction = read_rig(tmp_path / "rig.json").leds[0].direction
    assert direction is not None
    assert np.linalg.norm(direction) == pytest.approx(1.0, abs=1e-12)
    assert direction[2] == pytest.approx(0.57 / 0.9987, abs=1e-4)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d.pop("camera"), "missing required field camera"),
        (lambda d: d["camera"].pop("px_per_mm"), "camera: .*field px_per_mm"),
        (camera_with(px_per_mm=False), r"camera\.px_per_mm: .*got bool"),
        (camera_with(image_size=[22, -1]), r"camera\.image_size\[1\]: "),
        (camera_with(image_size=[10**6, 10**6]), "pixels that are read"),
        (camera_with(model="fisheye"), r"camera\.model: "),
        (camera_with(model="perspective"), "a perspective camera needs .*distortion"),
        (camera_with(shading=[-1.5]), r"shading leaves no light"),
        (led_with(aim=[0, 0, 1]), r"leds\[0\].*aim must point towards"),
        (camera_with(distortion=[0] * 6), r"a list of 4, 5"),
        (camera_with(matrix=[[1, 0, 0], [0, 1, 0]]), r"camera\.matrix: .*length 3"),
        (camera_with(matrix=[[1, 0, 0], [0, 1, 0], [1, 0, 1]]), "last row"),
        (
            camera_with(
                model="perspective", distortion=[0] * 5, matrix=[[1, 0, 16], [0, 1, 11], [0, 0, 1]]
            ),
            r"camera\.px_per_mm is .*, but camera\.matrix and camera\.height_mm make it",
        ),
        (document_with(provenance=3), r"^[^:]*: provenance: "),
        (document_with(leds=[]), "leds: "),
        (led_with(band=""), r"leds\[0\]\.band: "),
        (lambda d: d["leds"][0].pop("position_mm"), r"leds\[0\]: .*either position_mm"),
        (led_with(direction=[0, 0, 1]), r"leds\[0\]: .*not both"),
        (led_with(position_mm=[1, 2, 1e300]), r"leds\[0\]\.position_mm\[2\]: "),
        (led_with(position_mm=[1, 2, -3]), "above the finger plane"),
        (led_with(intensity=0), r"leds\[0\]\.intensity: "),
        (document_with(leds=[{"band": "white", "direction": [3, 4, 5]}]), "unit vector"),
        (
            document_with(leds=[{"band": "white", "direction": [0, 0.6, -0.8]}]),
            "away from the camera",
        ),
    ],
)
def test_wrong_rigs_are_refused(change, words, tmp_path):
    document = json.loads(json.dumps(RIG))
    change(document)
    (tmp_path / "rig.json").write_text(json.dumps(document))
    with bad_input(words) as caught:
        read_rig(tmp_path / "rig.json")
    assert str(tmp_path / "rig.json") in str(caught.value)


def test_coplanar_lights_are_refused(folder):
    def flatten(document):
        for k, led in enumerate(document["leds"]):
            led["position_mm"] = [10.0 * (k % 4), 0.0, 140.0]

    edit(folder / "rig.json", flatten)
    with bad_input(r"capture\.json: bands\.white\.leds: lights are coplanar"):
        read_capture(folder)


def test_the_images_of_a_capture_have_a_budget_together(folder, monkeypatch):
    pixels = read_capture(folder).bands["white"].pixels
    monkeypatch.setattr("splitknit.io.images.STACK_BYTES", 2 * pixels.nbytes)
    read_capture(folder)
    monkeypatch.setattr("splitknit.io.images.STACK_BYTES", 2 * pixels.nbytes - 1)
    with bad_input(rf"take {2 * pixels.nbytes} bytes once decoded"):
        read_capture(folder)
