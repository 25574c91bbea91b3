"""Surfaces for other programs: colours, models with a texture, closed solids."""

import io
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import splitknit
from splitknit.imaging.pixels import GREY_WEIGHTS
from splitknit.reconstruction import Reconstruction
from splitknit_match.records.surface_files import surface_bytes
from written_files import read_ply

SIDE = 90
Y, X = np.mgrid[1 : -1 : SIDE * 1j, -1 : 1 : SIDE * 1j]
MASK = X**2 + Y**2 < 0.8
COLOURS = np.where((X > 0)[..., None], (0.8, 0.3, 0.1), (0.1, 0.4, 0.7))


@pytest.fixture(scope="module")
def dome():
    """A glossy dome of two colours with bumps, from colour photographs under eight lights."""
    height = 0.6 * np.sqrt(1.9 - X**2 - Y**2, where=MASK, out=np.zeros_like(X))
    height += 0.004 * np.cos(30 * X) * np.cos(30 * Y)
    down, across = np.gradient(height, 2 / (SIDE - 1))
    normals = np.dstack([-across, down, np.ones_like(X)])
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    around = np.arange(8) * np.pi / 4
    lights = np.column_stack([np.cos(around), np.sin(around), np.full(8, 1.2)])
    lights /= np.linalg.norm(lights, axis=1, keepdims=True)
    halfway = lights + np.array([0, 0, 1])
    halfway /= np.linalg.norm(halfway, axis=1, keepdims=True)
    matt = np.clip(np.einsum("hwi,li->lhw", normals, lights), 0, 1)[..., None] * COLOURS
    gloss = np.clip(np.einsum("hwi,li->lhw", normals, halfway), 0, 1) ** 60
    light = (matt + 0.3 * gloss[..., None]) / 1.2
    return splitknit.reconstruct_images(np.round(light * 65535).astype(np.uint16), lights, MASK, 9)


def loaded(data, kind):
    trimesh = pytest.importorskip("trimesh")
    return trimesh.load(io.BytesIO(data), kind, force="mesh", process=kind == "stl")


def test_the_colour_is_the_surfaces_and_not_the_highlights(dome):
    assert dome.colour is not None
    colour, true = dome.colour[MASK], COLOURS[MASK]
    assert np.abs(colour / (colour * true).sum() * (true * true).sum() - true).mean() < 0.02
    assert_allclose(colour @ GREY_WEIGHTS, dome.albedo[MASK], rtol=1e-4)
    assert not dome.colour[~MASK].any()


def test_a_result_keeps_its_colours(dome, tmp_path):
    dome.save(tmp_path / "result")
    mesh = read_ply(tmp_path / "result" / "surface.ply")
    read = splitknit.read_result(tmp_path / "result")
    assert mesh.colours is not None
    assert read.colour is not None
    assert dome.colour is not None
    assert (mesh.colours[mesh.vertices_mm[:, 0] > 0.2, 0] > 180).all()  # red
    assert (mesh.colours[mesh.vertices_mm[:, 0] < -0.2, 2] > 180).all()  # blue
    white = np.percentile(dome.colour[MASK], 99.9)
    assert_allclose(read.colour, np.minimum(dome.colour / white, 1.0), atol=0.01)


def test_a_model_has_its_colours_in_a_texture(dome: Reconstruction) -> None:
    facts, data = surface_bytes(dome, "glb", "a dome")
    mesh = loaded(data, "glb")
    assert len(mesh.vertices) == facts["vertices"] == MASK.sum()
    np.testing.assert_allclose(mesh.extents[:2], 2 * np.sqrt(0.8) * 45 / 9000, rtol=0.1)  # metres
    texture = np.asarray(mesh.visual.material.baseColorTexture)
    column, row = (mesh.visual.uv * texture.shape[1::-1]).T
    here = texture[(texture.shape[0] - row).astype(int), column.astype(int)]
    assert (here[mesh.vertices[:, 0] > 3e-4, 0] > 180).all()
    assert (here[mesh.vertices[:, 0] < -3e-4, 2] > 180).all()


def test_a_grey_result_becomes_a_grey_model(dome):
    _, data = surface_bytes(replace(dome, colour=None), "glb", "a dome")
    texture = np.asarray(loaded(data, "glb").visual.material.baseColorTexture)
    assert texture.max() > 250
    assert not np.ptp(texture, axis=-1).any()


def test_a_solid_is_closed_and_stands_on_a_flat_base(dome):
    mask = MASK & (np.random.default_rng(0).random(MASK.shape) > 0.03)  # outlines that cross
    for inside in (MASK, mask):
        _, data = surface_bytes(replace(dome, mask=inside), "stl", "a dome", base_mm=2.0)
        solid = loaded(data, "stl")
        assert solid.is_watertight
        assert solid.is_winding_consistent
        lowest = np.nanmin(np.where(inside, dome.height_mm, np.nan))
        assert solid.bounds[0, 2] == pytest.approx(lowest - 2.0, abs=0.2)
        low, high = 2.0, 2.0 + np.ptp(dome.height_mm[MASK])
        area = inside.sum() / 81
        assert 0.8 * area * low < solid.volume < area * high
