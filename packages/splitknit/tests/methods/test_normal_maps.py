"""Normal maps: formats, axes, accuracy, and photographs that contradict them."""

import cv2
import numpy as np
import pytest

import splitknit
from refusals import bad_input
from splitknit.errors import BadInput
from splitknit.folders import reconstruct_to_folder
from splitknit.io.normal_maps import read_normal_map
from splitknit.io.photographs import GivenPhotographs

PX_PER_MM = 79 / 8
Y, X = np.mgrid[4.0:-4.0:80j, -4.0:4.0:80j]  # mm
INSIDE = X**2 + Y**2 < 14.0
HEIGHT_MM = np.where(INSIDE, 2.0 - 0.05 * X**2 - 0.08 * Y**2 + 0.06 * X * Y, 0.0)
SLOPES = -0.1 * X + 0.06 * Y, -0.16 * Y + 0.06 * X


def normals_of(slope_x, slope_y):
    vectors = np.dstack([-slope_x, -slope_y, np.ones_like(slope_x)])
    return vectors / np.linalg.norm(vectors, axis=2, keepdims=True) * INSIDE[..., None]


NORMALS = normals_of(*SLOPES)


def off_um(result):
    error = (result.height_mm - HEIGHT_MM)[result.mask]
    return float(1000 * np.std(error))


def written(kind, folder):
    file = folder / f"map.{kind}"
    if kind == "npy":
        np.save(file, NORMALS.astype(np.float32))
    elif kind == "npz":
        np.savez(file, normals=NORMALS, other=np.zeros(3))
    elif kind == "exr":
        exr = pytest.importorskip("OpenEXR", reason="of the extra photos")
        channels = {
            name: np.ascontiguousarray(NORMALS[..., k].astype(np.float32))
            for k, name in enumerate("XYZ")
        }
        exr.File({"type": exr.scanlineimage}, channels).write(str(file))
    else:
        code = np.rint(65535 * (NORMALS + 1) / 2) * INSIDE[..., None]
        cv2.imwrite(str(file), code.astype(np.uint16)[..., ::-1])
    return file


@pytest.mark.parametrize("kind", ["png", "tif", "npy", "npz", "exr"])
def test_every_format_gives_the_surface_in_mm(kind, tmp_path):
    normals, hashes = read_normal_map(written(kind, tmp_path))
    result = splitknit.surface_of_normals(normals, px_per_mm=PX_PER_MM)
    assert off_um(result) < 0.5
    assert len(hashes[f"map.{kind}"]) == 64
    assert not result.findings


def test_a_reversed_y_axis_shows_by_its_curl():
    reversed_y = NORMALS * [1, -1, 1]
    result = splitknit.surface_of_normals(reversed_y, px_per_mm=PX_PER_MM)
    assert off_um(result) < 0.5
    assert [each.code for each in result.findings] == ["normals-y"]
    stated = splitknit.surface_of_normals(reversed_y, px_per_mm=PX_PER_MM, y="up")
    assert [str(each.severity) for each in stated.findings] == ["doubt"]
    right = splitknit.surface_of_normals(reversed_y, px_per_mm=PX_PER_MM, y="down")
    assert not right.findings


def test_colours_from_0_to_1_are_vectors_too():
    result = splitknit.surface_of_normals((NORMALS + 1) / 2, INSIDE, px_per_mm=PX_PER_MM)
    assert off_um(result) < 0.5


def test_unknown_scale_is_a_note_and_the_files_are_those_of_a_result(tmp_path):
    file = written("png", tmp_path)
    facts = reconstruct_to_folder(out=tmp_path / "out", normals=file).facts
    assert [each["code"] for each in facts["findings"]] == ["scale-unknown"]
    names = {"surface.ply", "height.tiff", "height.npz", "normals_measured.png", "report.html"}
    assert names <= set(facts["files"])
    assert set(facts["inputs_sha256"]) == {"map.png"}
    again = splitknit.read_result(tmp_path / "out")
    assert np.allclose(again.normals_measured[INSIDE], NORMALS[INSIDE], atol=1e-3)


def photographs(folder):
    """Eight photographs of the surface, and the list of their lights."""
    turns = 2 * np.pi * np.arange(8) / 8
    lights = np.column_stack([0.6 * np.cos(turns), 0.6 * np.sin(turns), np.full(8, 0.8)])
    for k, light in enumerate(lights):
        light_seen = np.maximum(NORMALS @ light, 0.0)
        cv2.imwrite(str(folder / f"{k}.png"), np.rint(60000 * light_seen).astype(np.uint16))
    cv2.imwrite(str(folder / "mask.png"), np.uint8(255) * INSIDE.astype(np.uint8))
    np.savetxt(folder / "lights.txt", lights)
    return folder


def test_photographs_name_the_region_that_contradicts_them(tmp_path):
    images = tmp_path / "photos"
    images.mkdir()
    given = GivenPhotographs(photographs(images), px_per_mm=PX_PER_MM)
    right = tmp_path / "right.npy"
    np.save(right, NORMALS)
    facts = reconstruct_to_folder(out=tmp_path / "a", normals=right, photographs=given).facts
    assert facts["facts"]["misfit"] < 0.01
    assert "normals-contradicted" not in [each["code"] for each in facts["findings"]]
    wrong = NORMALS.copy()
    turned = np.hypot(X - 1.5, Y - 1.0) < 1.0
    wrong[turned] = normals_of(SLOPES[0] + 0.6, SLOPES[1])[turned]
    np.save(right, wrong)
    facts = reconstruct_to_folder(out=tmp_path / "b", normals=right, photographs=given).facts
    (finding,) = [each for each in facts["findings"] if each["code"] == "normals-contradicted"]
    assert finding["severity"] == "doubt"
    assert "about column 54, row 30" in finding["message"]
    assert "misfit.png" in facts["files"]
    misfit = splitknit.read_result(tmp_path / "b").misfit
    assert misfit[turned].min() > 0.05 > misfit[INSIDE & ~turned].max()


def test_bad_maps_are_refused_in_one_sentence(tmp_path):
    refused = {
        "grey.npy": (np.zeros((8, 8)), "one array (H, W, 3)"),
        "noise.npy": (np.full((8, 8, 3), 7.0), "no normal map"),
        "zero.npy": (np.zeros((8, 8, 3)), "is empty"),
        "away.npy": (NORMALS * [1, 1, -1], "away from the camera"),
    }
    for name, (array, words) in refused.items():
        np.save(tmp_path / name, array)
        with bad_input(words.replace("(", r"\(").replace(")", r"\)")):
            reconstruct_to_folder(out=tmp_path / "out", normals=tmp_path / name)
    (tmp_path / "short.npy").write_bytes((tmp_path / "away.npy").read_bytes()[:-9])
    with bad_input("damaged"):
        read_normal_map(tmp_path / "short.npy")
    with bad_input(r"`keep` goes with photographs"):
        reconstruct_to_folder(out=tmp_path / "out", normals=tmp_path / "away.npy", keep=True)
    with bad_input(r"`normals_y` goes with `normals`"):
        reconstruct_to_folder("capture", out=tmp_path / "out", normals_y="up")
    other = written("png", tmp_path)
    cv2.imwrite(str(tmp_path / "mask.png"), np.full((8, 8), 255, np.uint8))
    given = GivenPhotographs(mask=tmp_path / "mask.png")
    with pytest.raises(BadInput, match=r"8 x 8 pixels .*, but 80 x 80 are expected by"):
        reconstruct_to_folder(out=tmp_path / "out", normals=other, photographs=given)
    assert not (tmp_path / "out").exists()


def test_a_rig_gives_the_rays_and_the_scale(tmp_path):
    matrix = np.array([[800.0, 0.0, 39.5], [0.0, 800.0, 39.5], [0.0, 0.0, 1.0]])
    camera = splitknit.Camera(
        PX_PER_MM, (80, 80), 800 / PX_PER_MM, "perspective", matrix, (0.0,) * 5
    )
    light = splitknit.Led("white", direction=(0.0, 0.0, 1.0))
    splitknit.write_rig(splitknit.Rig(camera, (light,)), tmp_path / "rig.json")
    file = written("npy", tmp_path)
    reconstruct_to_folder(out=tmp_path / "out", normals=file, rig=tmp_path / "rig.json")
    result = splitknit.read_result(tmp_path / "out")
    assert result.x_mm is not None
    assert result.pitch_mm == pytest.approx(1 / PX_PER_MM)
    with bad_input(r"^\S*none\.json does not exist"):
        reconstruct_to_folder(out=tmp_path / "x", normals=file, rig=tmp_path / "none.json")
