"""Independent photographs through the whole pipeline, with every preset."""

import json
import re

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from splitknit.capture import Band, Capture
from splitknit.cli.main import main
from splitknit.io.capture import write_capture
from splitknit.io.light_list import read_light_list
from splitknit.io.photographs import GivenPhotographs
from splitknit.model import Camera, Led, Rig
from splitknit.observation.observe import observe
from splitknit.observation.plain import capture_from_photographs
from splitknit.photometric.lambertian import lambertian
from splitknit.photometric.robust import robust
from splitknit.pipeline import reconstruct
from splitknit.report.result import FILES

pytestmark = pytest.mark.external

PRESETS = ("metric", "snk", "pr", "ea")


def needed(path):
    if not path.exists():
        pytest.skip(f"{path} is absent")
    return path


@pytest.fixture(scope="module")
def bear(data_dir):
    """DiLiGenT's bear and its scanned normals."""
    with np.load(needed(data_dir / "diligent" / "bear.npz")) as data:
        names = "images", "lights", "mask", "normals"
        images, lights, mask, normals = (data[name] for name in names)
    directions = lights / np.linalg.norm(lights, axis=1, keepdims=True)
    return opaque_capture(images, directions, 4.0, mask.astype(bool)), normals


def opaque_capture(images, directions, px_per_mm, mask):
    """White images (L, H, W) under distant lights (L, 3)."""
    count = len(images)
    leds = tuple(Led("white", direction=tuple(towards)) for towards in directions.tolist())
    shots = tuple((k,) for k in range(count))
    band = Band("white", images[..., None], shots, np.ones(count), np.zeros(count))
    rig = Rig(Camera(px_per_mm, images.shape[1:]), leds)
    return Capture(rig, {"white": band}, material="opaque", mask=mask)


@pytest.fixture(scope="module")
def ball(data_dir):
    """The grey ball, and the heights in mm of the sphere that its outline gives."""
    folder = needed(data_dir / "psm_spheres")
    lights = read_light_list(folder / "lights.txt").lights
    photographs = GivenPhotographs(
        folder / "gray" / "gray.{light}.png",
        lights,
        5.0,
        mask=folder / "gray" / "gray.mask.png",
        encoding="linear",
    )
    capture, _ = capture_from_photographs(photographs)
    rows, columns = np.nonzero(capture.mask)
    radius = (np.ptp(columns) + np.ptp(rows) + 2) / 4
    i, j = np.mgrid[0 : capture.shape[0], 0 : capture.shape[1]]
    x = (j - (columns.min() + columns.max()) / 2) / radius
    y = (i - (rows.min() + rows.max()) / 2) / radius
    sphere = np.where(np.hypot(x, y) < 0.95, np.sqrt(np.clip(1 - x * x - y * y, 0, None)), np.nan)
    return capture, sphere * radius / 5.0


@pytest.fixture(scope="module")
def phalange(data_dir):
    """The sculpted phalange, at a scale that makes it 16 mm wide."""
    folder = needed(data_dir / "blender_finger" / "phalange")
    lights = read_light_list(folder / "lights.txt").lights
    photographs = GivenPhotographs(
        folder / "light_{light}.png",
        lights,
        40.0,
        mask=folder / "mask.png",
        background=71,
        encoding="linear",
    )
    return capture_from_photographs(photographs)[0]


def assert_complete(result, mask):
    assert_array_equal(result.mask, mask)  # a given mask is used as it is
    for field in (result.height_mm, result.ridge_mm, result.shape_mm, result.albedo):
        assert_array_equal(np.isfinite(field), mask)
    assert_allclose(np.linalg.norm(result.normals[mask], axis=-1), 1.0, atol=1e-5)
    assert not result.normals[~mask].any()


def angle_deg(first, second, mask):
    return float(np.degrees(np.arccos(np.clip((first * second).sum(axis=-1), -1, 1)))[mask].mean())


LINEAR = {"enhance.cells.grey": "linear"}
"""Equalise linear light; the thesis's images were equalised in their sRGB code, which bends shapes
twice as much."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("preset", "changes", "limit_deg"),
    [
        ("metric", {}, 6.0),
        ("snk", {}, 9.6),
        ("ea", {}, 9.6),
        ("pr", LINEAR, 12.8),
        ("pr", {}, 19.6),
    ],
)
def test_normals_of_the_bear_are_near_the_scanned_ones(bear, preset, changes, limit_deg):
    """Those of the surface; integration adds less than half a degree to the error of `metric`."""
    capture, truth = bear
    result = reconstruct(capture, preset, changes)
    assert_complete(result, capture.mask)
    error = angle_deg(result.normals, truth, capture.mask)
    assert error < limit_deg
    if preset == "metric":
        white = observe(capture).white
        normals, _ = robust(white.grey, white.rig.light_vectors(), capture.mask)
        assert error < angle_deg(normals, truth, capture.mask) + 0.5


def test_measured_normals_are_those_of_photometric_stereo(bear):
    """They are kept, as integration adds to the error of `ea`."""
    capture, truth = bear
    result = reconstruct(capture, "ea")
    white = observe(capture).white
    plain, _ = lambertian(white.grey, white.rig.light_vectors(), capture.mask)
    measured = result.normals_measured
    assert_allclose(measured[capture.mask], plain[capture.mask], atol=1e-6)
    error_deg = angle_deg(measured, truth, capture.mask)
    assert error_deg < 8.95
    assert error_deg + 0.2 < angle_deg(result.normals, truth, capture.mask)
    assert not measured[~capture.mask].any()
    assert result.facts["yaw_deg"] == 0.0
    assert result.warnings == ()


@pytest.mark.parametrize(
    ("preset", "changes", "limit"),
    [
        ("metric", {}, 0.04),
        ("snk", {}, 0.03),
        ("ea", {}, 0.03),
        ("pr", LINEAR, 0.05),
        ("pr", {}, 0.105),
    ],
)
def test_heights_of_the_ball_are_within_a_few_per_cent_of_its_radius(ball, preset, changes, limit):
    """Though the camera's response is unknown and its lens not orthographic."""
    capture, sphere = ball
    result = reconstruct(capture, preset, changes)
    assert_complete(result, capture.mask)
    error = (result.height_mm - sphere)[np.isfinite(sphere)]
    assert error.std() < limit * np.nanmax(sphere)


@pytest.mark.parametrize("preset", PRESETS)
def test_the_phalange_is_a_finger_with_ridges(phalange, preset):
    result = reconstruct(phalange, preset)
    assert_complete(result, phalange.mask)
    middle = result.ridge_mm[250:450, 500:700]
    window = np.outer(np.hanning(200), np.hanning(200))
    power = np.abs(np.fft.fft2((middle - middle.mean()) * window)) ** 2
    cycles = np.hypot(np.fft.fftfreq(200)[:, None], np.fft.fftfreq(200)[None, :])  # per pixel
    ridges = (cycles > 1 / 60) & (cycles < 1 / 4)
    period_mm = float(power[ridges].sum() / (power * cycles)[ridges].sum()) * result.pitch_mm
    assert 0.35 < period_mm < 0.55
    low, high = np.percentile(result.ridge_mm[phalange.mask], [5, 95])
    assert 0.04 < high - low < 0.4  # sculpted deep
    across = result.shape_mm[350]
    inside = np.flatnonzero(np.isfinite(across))
    flanks = across[inside[[20, -21]]]
    assert (flanks < np.nanmax(across) - 2.0).all()  # round: high in the middle
    assert inside[0] + 0.25 * inside.size < np.nanargmax(across) < inside[-1] - 0.25 * inside.size
    along = result.shape_mm[20:, inside[inside.size // 2]]
    assert np.ptp(along[np.isfinite(along)]) < 8.0


@pytest.mark.slow
def test_the_command_line_segments_the_phalange_without_its_mask(phalange, tmp_path, capsys):
    folder, out = tmp_path / "capture", tmp_path / "result"
    write_capture(phalange, folder)
    document = json.loads((folder / "capture.json").read_text())
    del document["mask"]
    (folder / "capture.json").write_text(json.dumps(document))
    assert main(f"reconstruct {folder} --out {out} --json".split()) == 0
    facts = json.loads(capsys.readouterr().out)
    of_fingers = {"print.png", "phalange.ply"}  # an opaque thing is not a finger
    assert {path.name for path in out.iterdir()} >= {*FILES, "surface.ply"} - of_fingers
    assert facts["facts"]["separation"] == "none (opaque material)"
    with np.load(out / "height.npz") as arrays:
        mask, height_mm = arrays["mask"], arrays["height_mm"]
    assert (mask & phalange.mask).sum() > 0.94 * (mask | phalange.mask).sum()
    assert np.isfinite(height_mm[mask]).all()
    # its lamps stand in one plane, 3 units high: by their distances their light differs by 11 %
    messages = {each["code"]: each["message"] for each in facts["findings"]}
    assert "touches a border of the image" in messages.pop("outline-at-border")  # where it enters
    assert "a lobe of gloss" in messages.pop("glossy")
    assert "off by one factor" in messages.pop("height-factor")
    (brightness,) = messages.values()
    assert "may differ in brightness, by 11 %" in brightness
    assert not (out / "print.png").exists()
    assert main(f"print {out} --method relief --out {tmp_path}/print".split()) == 0
    prints = cv2.imread(str(tmp_path / "print" / "print.png"), cv2.IMREAD_GRAYSCALE)
    assert 0.3 < (prints < 128).mean() < 0.6  # ridges and valleys


GEL_PITCH_MM, BALL_RADIUS_MM = 0.00340346, 0.2475


def gel_images(folder):
    files = [str(folder / f"image{k:02d}.png") for k in range(7, 13)]
    return np.float32([cv2.imread(file, cv2.IMREAD_GRAYSCALE) for file in files])


def cap(x, y):
    """Pixels (n,) of a ball within 0.6 of its radius, and its normals (3, n) there."""
    rows, columns = np.mgrid[int(y - 50) : int(y + 50), int(x - 50) : int(x + 50)]
    u, v = np.array([columns - x, y - rows]) * GEL_PITCH_MM / BALL_RADIUS_MM
    normals = np.stack([u, v, np.sqrt(np.clip(1 - u * u - v * v, 0, None))])
    part = u * u + v * v < 0.36
    return (rows[part], columns[part]), normals[:, part]


@pytest.mark.slow
def test_on_balls_pressed_into_a_gel_metric_is_as_good_as_ea(data_dir):
    """Caps in um. Lights and ambient are fitted to the balls left of the crop; rims of contact cast
    shadows."""
    folder = needed(data_dir / "elastomer")
    ratio = gel_images(folder / "BGA-001") / np.maximum(gel_images(folder / "Flat-001"), 1)
    outlines = (folder / "BGA-001" / "scan.yaml").read_text("utf-8")
    centres = np.array(re.findall(r"x: ([\d.]+)\s+y: ([\d.]+)", outlines), dtype=float)
    left = [cap(x, y) for x, y in centres if 60 < x < 900 and 60 < y < len(ratio[0]) - 60]
    truth = np.concatenate([normals.T for _, normals in left])
    light = np.concatenate([ratio[:, *part].T for part, _ in left])
    *vectors, ambient = np.linalg.lstsq(np.c_[truth, np.ones(len(truth))], light, rcond=None)[0]
    lights = np.array(vectors).T
    crop = np.s_[500:1400, 1000:1900]
    strength = np.linalg.norm(lights, axis=1)
    shading = (ratio - ambient[:, None, None]) / strength[:, None, None]
    images = np.clip(shading[:, *crop] * 12000, 0, 65535).astype(np.uint16)
    mask = np.ones(images.shape[1:], bool)
    capture = opaque_capture(images, lights / strength[:, None], 1 / GEL_PITCH_MM, mask)
    error = {}
    for preset in ("metric", "ea"):
        height = np.full(ratio.shape[1:], np.nan)
        height[crop] = reconstruct(capture, preset).height_mm * 1000
        rms = []
        for x, y in centres:
            if 1060 < x < 1840 and 560 < y < 1340:
                part, normals = cap(x, y)
                rms.append((height[part] - normals[2] * BALL_RADIUS_MM * 1000).std())
        assert len(rms) == 6
        error[preset] = float(np.sqrt(np.mean(np.square(rms))))
    assert error["metric"] < min(1.6, error["ea"])
