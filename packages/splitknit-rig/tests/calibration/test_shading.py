"""Balls pressed into a synthetic gel: slopes from their shading, judged by spheres, planes and a bump never seen."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

import splitknit
from splitknit.errors import BadInput
from splitknit.imaging.band import coarse_flat, over_flat
from splitknit.integration.poisson import poisson, trusted_height
from splitknit.photometric.shading import read_shading, shading_slopes, shading_terms, term_count, write_shading
from splitknit_rig.calibration.jobs import ShadingJob
from splitknit_rig.calibration.shading import calibrate_shading, find_balls, lattice_spacing
from splitknit_rig.calibration.shading_folder import read_centres, shading_to_file

PITCH_MM, RADIUS_MM, SPACING_MM, SIZE = 0.01, 0.25, 1.0, (360, 460)


def rendered(normals, azimuths_deg, noise, seed=0):
    """Images (L, H, W) of a matt coat: broad lights from the sides that grow weaker over the field, ambient light."""
    rows, columns = normals.shape[:2]
    y, x = np.mgrid[:rows, :columns]
    x, y = (x - columns / 2) / (columns / 2), -(y - rows / 2) / (columns / 2)
    rng, images = np.random.default_rng(seed), []
    for azimuth in np.deg2rad(azimuths_deg):
        across, up = np.cos(azimuth), np.sin(azimuth)
        towards = np.dstack([0.8 * across - 0.1 * x, 0.8 * up - 0.1 * y, np.full_like(x, 0.5)])
        towards /= np.linalg.norm(towards, axis=2, keepdims=True)
        cosine = (normals * towards).sum(axis=2)
        lit = 0.05 * np.logaddexp(0.0, cosine / 0.05)  # the terminator of a broad light is soft
        light = (0.25 + 0.6 * lit) * (1.0 + 0.15 * (across * x + up * y)) * 0.6
        images.append(light + noise * rng.normal(size=light.shape))
    return np.stack(images).astype(np.float32)


def normals_of(height_px):
    down, right = np.gradient(height_px)
    normals = np.dstack([-right, down, np.ones_like(right)])
    return normals / np.linalg.norm(normals, axis=2, keepdims=True)


def gel(centres):
    """Heights in pixels: spherical caps up to 0.85 of the radius that blend into the plane."""
    radius = RADIUS_MM / PITCH_MM
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]]
    height = np.zeros(SIZE)
    for column, row in centres:
        off = np.hypot(columns - column, rows - row)
        inner = np.sqrt(np.maximum(radius**2 - np.minimum(off, 0.85 * radius) ** 2, 0)) - radius * np.sqrt(1 - 0.85**2)
        tail = -1.6 * radius * 0.1 * (1 - np.exp(-(off - 0.85 * radius) / (0.1 * radius)))
        height += np.where(off < 0.85 * radius, inner + 0.16 * radius, np.maximum(tail + 0.16 * radius, 0.0))
    return height


@pytest.fixture(scope="module")
def pressed():
    angle = np.deg2rad(4.0)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]) * SPACING_MM / PITCH_MM
    centres = [np.array([76.3, 68.7]) + turn @ [i, j] for i in range(4) for j in range(3)]
    flat = rendered(np.dstack([np.zeros(SIZE), np.zeros(SIZE), np.ones(SIZE)]), range(0, 360, 60), 0.002, 1)
    coarse = np.stack([coarse_flat(one) for one in flat])
    return np.array(centres), rendered(normals_of(gel(centres)), range(0, 360, 60), 0.004), coarse


@pytest.fixture(scope="module")
def fit(pressed):
    _, images, flat = pressed
    return calibrate_shading([images], flat, RADIUS_MM, SPACING_MM)


def test_scale_and_centres(pressed, fit):
    centres = pressed[0]
    assert fit.shading.pitch_mm == pytest.approx(PITCH_MM, rel=1e-3)
    assert fit.used.all() and len(fit.balls) == len(centres)
    off = np.hypot(*(fit.balls[:, None, 1:3] - centres[None]).transpose(2, 0, 1)).min(axis=1)
    assert off.max() < 0.3


def test_caps_left_out(fit):
    assert fit.shading.facts["cap_rms_um"] < 0.5  # of caps 50 um high
    assert fit.cap_gain == pytest.approx(1.0, abs=0.03)
    assert fit.shading.degree > 1  # no linear map undoes ambient light and soft terminators


def test_a_bump_never_seen(pressed, fit):
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]]
    height = 12.0 * np.exp(-((columns - 230) ** 2 + (rows - 150) ** 2) / (2 * 22.0**2))
    images = over_flat(rendered(normals_of(height), range(0, 360, 60), 0.004, 3), pressed[2])
    gradient, deviation = shading_slopes(fit.shading, images)
    down, right = np.gradient(height)
    error = np.stack([gradient[0] - right, gradient[1] + down])
    assert 0.8 < float(np.sqrt((error**2).mean())) / float(np.sqrt((deviation**2).mean())) < 1.25
    found = trusted_height(gradient[0], gradient[1], (deviation.min() / deviation) ** 2)
    assert float(np.std(found - height)) * 1000 * PITCH_MM < 1.5  # um, of 120


def test_lights_by_physics(fit):
    azimuth = np.rad2deg(np.arctan2(fit.shading.direction[:, 1], fit.shading.direction[:, 0]))
    assert (np.abs((azimuth - np.arange(0, 360, 60) + 180) % 360 - 180) < 4).all()
    assert ((fit.shading.ambient > 0.1) & (fit.shading.ambient < 0.7)).all()


def test_beyond_what_was_seen_the_deviation_grows(fit):
    shading = replace(fit.shading, weights=3.0 * fit.shading.weights)
    images = np.ones((6, *SIZE), dtype=np.float32)
    images[:3] = 1.3
    images[3:] = 0.4
    steep = np.hypot(*shading_slopes(shading, images)[0])
    assert float(steep.max()) <= 1.5001 * shading.max_slope
    assert float(shading_slopes(shading, images)[1].min()) > 1.2 * float(shading.deviation.max())


def test_file_round_trip(fit, tmp_path):
    write_shading(tmp_path / "a.npz", fit.shading)
    write_shading(tmp_path / "b.npz", read_shading(tmp_path / "a.npz"))
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    with pytest.raises(BadInput, match="6 images of 360 x 460"):
        shading_slopes(fit.shading, np.ones((3, *SIZE), dtype=np.float32))
    np.savez(tmp_path / "other.npz", height=np.zeros(3))
    with pytest.raises(BadInput, match="calibrate shading"):
        read_shading(tmp_path / "other.npz")


def test_no_balls_are_refused(pressed):
    _, images, flat = pressed
    with pytest.raises(BadInput, match="no balls"):
        calibrate_shading([np.ones_like(images) * 0.3], np.ones_like(flat) * 0.3, 0.25)


def test_balls_with_no_flat_gel_beside_them_are_refused(pressed):
    """It was an internal error: there was nothing from which to fit the plane."""
    centres, images, flat = pressed
    near = [slice(int(at) - 22, int(at) + 23) for at in centres[4][::-1]]
    with pytest.raises(BadInput, match="lies flat beside the balls"):
        calibrate_shading([images[:, *near]], flat[:, *near], 0.25, None, [np.array([[22, 22, 25]])])


def test_terms_are_all_monomials():
    values = np.random.default_rng(0).random((3, 5)).astype(np.float32) + 1
    terms = shading_terms(values, False, 3)
    assert len(terms) == term_count(3, 3) == 20
    x, y, z = np.sqrt(values) - 1
    expected = {"xyz": x * y * z, "x2y": x * x * y, "z3": z**3, "yz": y * z}
    for product in expected.values():
        assert min(np.abs(terms - product).max(axis=1)) < 1e-6


def test_lattices():
    for basis in ([[50, 3], [-3, 50]], [[50, 0], [25, 43.3]]):
        points = np.array([i * np.array(basis[0]) + j * np.array(basis[1]) for i in range(4) for j in range(4)], float)
        points += np.random.default_rng(0).normal(0, 0.3, points.shape)
        assert lattice_spacing(np.delete(points, [2, 9], axis=0)) == pytest.approx(np.hypot(*basis[0]), rel=5e-3)


def test_balls_are_found_sub_pixel(pressed):
    centres, images, flat = pressed
    found = find_balls(over_flat(images, flat))
    assert np.hypot(*(found[:, None, :2] - centres[None]).transpose(2, 0, 1)).min(axis=1).max() < 1.0


def test_folders_to_file(pressed, tmp_path):
    centres, images, _ = pressed
    flat = rendered(np.dstack([np.zeros(SIZE), np.zeros(SIZE), np.ones(SIZE)]), range(0, 360, 60), 0.0)
    for name, stack in (("balls", images), ("flat", flat)):
        (tmp_path / name).mkdir()
        for k, image in enumerate(stack):
            code = np.rint(np.clip(image, 0, 1) * 65535).astype(np.uint16)
            cv2.imwrite(str(tmp_path / name / f"light_{k}.png"), code)
    (tmp_path / "centres.txt").write_text("\n".join(f"{x:.2f} {y:.2f} 25" for x, y in centres))
    job = ShadingJob(
        (tmp_path / "balls",),
        out=tmp_path / "s.npz",
        flat=tmp_path / "flat",
        radius_mm=RADIUS_MM,
        spacing_mm=SPACING_MM,
        centres=tmp_path / "centres.txt",
    )
    assert shading_to_file(job).shading.facts["cap_rms_um"] < 0.5
    shown = {"shading": tmp_path / "s.npz", "encoding": "linear"}
    with pytest.raises(BadInput, match="name their folder with `flat`"):
        splitknit.reconstruct(splitknit.read_photographs(tmp_path / "balls", **shown))
    empty = splitknit.read_photographs(tmp_path / "flat", flat=tmp_path / "flat", **shown)
    bent, level = (splitknit.reconstruct(empty, settings={"height.level": order}) for order in (0, 4))
    assert float(np.std(level.height_mm)) <= float(np.std(bent.height_mm)) + 1e-9
    assert level.facts["level_order"] == 4
    assert "level_order" not in bent.facts
    card = ShadingJob((), out=tmp_path / "card.npz", flat=tmp_path / "flat")
    fall_off = shading_to_file(card).shading.fall_off
    assert fall_off[0, 1] > 0.1 > -0.1 > fall_off[3, 1]  # lights from the right and from the left
    with pytest.raises(BadInput, match="without balls"):
        shading_slopes(read_shading(tmp_path / "card.npz"), images)
    (tmp_path / "bad.txt").write_text("1 2\n3 four\n")
    with pytest.raises(BadInput, match="line 2"):
        read_centres(tmp_path / "bad.txt")


def test_trusted_height_is_the_weighted_one():
    rng = np.random.default_rng(0)
    rows, columns = np.mgrid[:90, :131]
    height = 6 * np.sin(columns / 13) * np.cos(rows / 17)
    down, right = (part.astype(np.float32) for part in np.gradient(height))
    trust = np.ones((90, 131), dtype=np.float32)
    trust[30:60, 40:80] = 0.02
    right[30:60, 40:80] += rng.normal(0.5, 0.3, (30, 40)).astype(np.float32)  # wrong, and not trusted
    exact = poisson(right, -down, weights=trust)
    plain = poisson(right, -down)
    near = trusted_height(right, -down, trust)
    outside = trust == 1
    assert np.std((near - exact)[outside]) < 0.15 * np.std((plain - exact)[outside])
