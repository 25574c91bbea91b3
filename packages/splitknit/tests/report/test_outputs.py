import hashlib
from dataclasses import replace

import cv2
import numpy as np
import pytest

from handmade import capture_of, comparison_of, finger
from splitknit.io.images import read_header
from splitknit.io.npz import read_npz
from splitknit.report import result as result_files
from splitknit.report.result import FILES, write_results
from written_files import read_height_tiff, read_ply


def test_all_files_are_written(written):
    names = {path.name for path in written[0].iterdir() if not path.name.startswith(".")}
    assert names == set(FILES)


def test_fields_lie_on_the_input_grid(written):
    result, _ = finger()
    arrays = read_npz(written[0] / "height.npz")
    for name in (
        "height_mm",
        "ridge_mm",
        "shape_mm",
        "mask",
        "normals",
        "input_from_upright",
        "uncertainty_um",
    ):
        assert np.array_equal(arrays[name], getattr(result, name), equal_nan=name != "mask"), name
    assert float(arrays["pitch_mm"]) == result.pitch_mm
    assert tuple(arrays["upright_size"]) == result.upright_size
    height, pitch_mm, metadata = read_height_tiff(written[0] / "height.tiff")
    assert np.array_equal(height, result.height_mm, equal_nan=True)
    assert pitch_mm == result.pitch_mm
    assert metadata["inputs"] == dict(result.hashes)


def test_pictures_of_fields_lie_on_the_input_grid(written):
    result, _ = finger()
    normals = cv2.imread(str(written[0] / "normals.png"))[..., ::-1]
    albedo = cv2.imread(str(written[0] / "albedo.png"), cv2.IMREAD_UNCHANGED)
    assert normals.shape == (*result.mask.shape, 3)
    assert albedo.shape == result.mask.shape
    assert (normals[~result.mask] == 0).all()
    assert (albedo[~result.mask] == 0).all()
    decoded = normals[result.mask].astype(float) / 127.5 - 1.0
    assert np.abs(decoded - result.normals[result.mask]).max() < 1.01 / 127.5
    ratio = albedo[result.mask] / result.albedo[result.mask]
    assert np.ptp(ratio) < 0.02 * ratio.mean()


def test_mesh_is_upright_and_not_resampled(written):
    """The finger's yaw of 12 deg is gone from the coordinates, and every vertex still is one
    pixel."""
    result, _ = finger()
    mesh = read_ply(written[0] / "phalange.ply")
    assert len(mesh.vertices_mm) == int(result.mask.sum())
    assert np.array_equal(mesh.vertices_mm[:, 2], result.height_mm[result.mask])
    x, y = mesh.vertices_mm[:, 0], mesh.vertices_mm[:, 1]
    assert abs(x.min() + x.max()) < 0.1
    assert np.ptp(x) == pytest.approx(14.8, abs=0.2)
    assert y.max() == pytest.approx(9.4, abs=0.2)  # the tip
    assert y.min() == pytest.approx(-8.5, abs=0.2)
    at_tip = y > 9.0
    assert np.abs(x[at_tip]).max() < 0.3 * np.abs(x).max()


def test_mesh_normals_turn_with_the_mesh(written):
    """They agree with the triangles, outwards."""
    mesh = read_ply(written[0] / "phalange.ply")
    corners = mesh.vertices_mm[mesh.faces[::50]].astype(float)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    cross /= np.linalg.norm(cross, axis=1, keepdims=True)
    agreement = np.sum(cross * mesh.normals[mesh.faces[::50, 0]], axis=1)
    assert (cross[:, 2] > 0).all()
    assert np.median(agreement) > 0.99
    assert np.linalg.norm(mesh.normals, axis=1) == pytest.approx(1.0, abs=1e-5)
    assert 0.0 <= mesh.quality.min() < mesh.quality.max() == 1.0


def test_the_print_states_its_resolution(written):
    result, _ = finger()
    stored = read_header((written[0] / "print.png").read_bytes(), "print.png")
    assert stored.ppi == pytest.approx((500.0, 500.0), abs=0.02)
    assert (stored.rows, stored.columns) == tuple(
        round(n * result.pitch_mm / 25.4 * 500) for n in result.upright_size
    )
    assert "splitknit" in stored.text["Software"]


def test_every_file_names_the_software_and_its_version(written):
    for name in FILES:
        data = (written[0] / name).read_bytes()
        if name != "height.npz":  # compressed
            assert b"splitknit" in data, name
            assert b"0.1.0" in data, name
    assert "settings_sha256" in str(read_npz(written[0] / "height.npz")["provenance"])


def test_the_same_result_gives_the_same_bytes(written, tmp_path):
    """All files but the reports, whatever the number of threads."""
    result, _ = finger()
    threads = cv2.getNumThreads()
    try:
        cv2.setNumThreads(1)
        comparisons = [comparison_of(result)]
        write_results(result, capture_of(result), tmp_path / "again", comparisons)
    finally:
        cv2.setNumThreads(threads)
    for name in FILES:
        if not name.startswith("report"):
            digests = {
                hashlib.sha256((folder / name).read_bytes()).digest()
                for folder in (written[0], tmp_path / "again")
            }
            assert len(digests) == 1, name


def test_a_failed_run_leaves_no_files(tmp_path, monkeypatch):
    result, _ = finger()

    def fail(*_, **__):
        raise RuntimeError("disk on fire")

    monkeypatch.setattr(result_files, "write_mesh", fail)
    with pytest.raises(RuntimeError, match="disk on fire"):
        write_results(result, capture_of(result), tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_a_result_without_uncertainty_has_no_such_array(tmp_path):
    result, _ = finger()
    write_results(replace(result, uncertainty_um=None), capture_of(result), tmp_path / "out")
    assert "uncertainty_um" not in read_npz(tmp_path / "out" / "height.npz")
    assert "Uncertainty of the relief" not in (tmp_path / "out" / "report.html").read_text()


@pytest.mark.parametrize(("relief_by", "stated"), [("network", True), ("polarised", False)])
def test_the_page_states_the_gain_of_modelled_ridges(tmp_path, relief_by, stated):
    result, _ = finger()
    optics = {"relief_by": relief_by, "gain_uncertainty": 0.41}
    result = replace(result, facts={**result.facts, "optics": optics})
    write_results(result, capture_of(result), tmp_path / "out")
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert ("whose standard deviation is 41 %" in page) == stated
