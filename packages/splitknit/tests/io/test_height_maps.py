"""X3P, TMD, PTM and .lp files: written, read back, and read by programs of others."""

from __future__ import annotations

import datetime
import io
import zipfile
from pathlib import Path
from unittest import mock

import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit.imaging.roughness import areal_roughness
from splitknit.io.height_maps import ptm_chunks, read_tmd, read_x3p, tmd_bytes, x3p_bytes
from splitknit.io.light_list import read_light_list, read_named_lights, write_light_list
from splitknit.model import Led

PITCH = 0.0125


@pytest.fixture
def height() -> np.ndarray:
    """A sloping wave that no flip leaves as it is, with a hole; mm."""
    y, x = np.mgrid[:30, :40] * PITCH
    z = 0.02 * np.sin(x * 20) + 0.1 * x + 0.05 * y
    z[3:6, 10:14] = np.nan
    return z.astype(np.float32)


def test_x3p_comes_back(height, tmp_path: Path) -> None:
    pytest.importorskip("x3pio")
    (tmp_path / "a.x3p").write_bytes(x3p_bytes(height, PITCH, "test"))
    back, steps = read_x3p(tmp_path / "a.x3p")
    np.testing.assert_allclose(back, height, atol=1e-6)
    np.testing.assert_allclose(steps, (PITCH, PITCH))
    assert x3p_bytes(height, PITCH, "test") == (tmp_path / "a.x3p").read_bytes()


def test_x3p_is_metres_from_the_lower_left(height, tmp_path: Path) -> None:
    x3pio = pytest.importorskip("x3pio")
    (tmp_path / "a.x3p").write_bytes(x3p_bytes(height, PITCH, "test", datetime.date(2026, 1, 31)))
    file = x3pio.read(tmp_path / "a.x3p")
    x, y, z = file.layers[0].points()[4, 7]
    assert (x, y) == pytest.approx((7 * PITCH / 1000, 4 * PITCH / 1000))
    assert z == pytest.approx(height[-5, 7] / 1000)
    assert file.metadata.date.date() == datetime.date(2026, 1, 31)


def _packed_again(data: bytes, change, kind: int = zipfile.ZIP_DEFLATED) -> bytes:
    """An X3P file whose main.xml is changed, without its checksum."""
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(out, "w", kind) as new:
        for name in (one for one in old.namelist() if not one.endswith(".hex")):
            new.writestr(name, change(old.read(name)) if name == "main.xml" else old.read(name))
    return out.getvalue()


@pytest.mark.parametrize(
    ("change", "kind", "words"),
    [
        (lambda xml: xml.replace(b"<Record3>", b"<Datum/>" * 2_000_001 + b"<Record3>"), 8, "main.xml is too large"),
        (lambda xml: xml.replace(b"<Record3>", b"<Record3>" + b" " * 33_000_000), 8, "main.xml is too large"),
        (lambda xml: xml.replace(b"<SizeZ>1<", b"<SizeZ>900000<"), 8, "points in its layers"),
        (lambda xml: xml, zipfile.ZIP_BZIP2, "damaged or of another format"),
    ],
)
def test_what_an_x3p_unpacks_to_is_bounded(height, tmp_path: Path, change, kind: int, words: str) -> None:
    x3pio = pytest.importorskip("x3pio")
    data = _packed_again(x3p_bytes(height, PITCH, "test"), change, kind)
    (tmp_path / "a.x3p").write_bytes(data)
    seen = mock.patch.object(x3pio, "read", side_effect=AssertionError("is read"))
    with seen, pytest.raises(BadInput, match=words):
        read_x3p(tmp_path / "a.x3p")


def test_tmd_comes_back_and_holes_stay(height, tmp_path: Path) -> None:
    (tmp_path / "a.tmd").write_bytes(tmd_bytes(height, PITCH))
    back, steps = read_tmd(tmp_path / "a.tmd")
    np.testing.assert_array_equal(back, height)
    np.testing.assert_allclose(steps, (PITCH, PITCH), rtol=1e-6)


def test_tmd_of_gelsight_has_an_empty_comment(height, tmp_path: Path) -> None:
    data = tmd_bytes(height, PITCH)
    (tmp_path / "a.tmd").write_bytes(data[:32] + b"\0" + data[32 + 24 :])
    np.testing.assert_array_equal(read_tmd(tmp_path / "a.tmd")[0], height)


@pytest.mark.parametrize("cut", [10, 40, 70, 500])
def test_a_cut_tmd_is_refused(height, tmp_path: Path, cut: int) -> None:
    (tmp_path / "a.tmd").write_bytes(tmd_bytes(height, PITCH)[:cut])
    with pytest.raises(BadInput, match=r"TMD file|cut short"):
        read_tmd(tmp_path / "a.tmd")


def test_others_read_them_alike(height, tmp_path: Path) -> None:
    surfalize = pytest.importorskip("surfalize")
    pytest.importorskip("x3pio")
    (tmp_path / "a.tmd").write_bytes(tmd_bytes(height, PITCH))
    (tmp_path / "a.x3p").write_bytes(x3p_bytes(height, PITCH, "test"))
    tmd, x3p = (surfalize.Surface.load(tmp_path / name) for name in ("a.tmd", "a.x3p"))
    assert tmd.step_x == pytest.approx(PITCH * (1 if tmd.step_x < 1 else 1000), rel=1e-5)
    assert x3p.step_x == pytest.approx(1000 * PITCH)
    np.testing.assert_allclose(x3p.data[::-1] / 1000, height, atol=1e-6)
    assert tmd.data.shape == height.shape


def test_roughness_is_surfalizes(height) -> None:
    surfalize = pytest.importorskip("surfalize")
    whole = np.nan_to_num(height - np.nanmean(height))
    own = areal_roughness(whole, PITCH)
    other = surfalize.Surface(1000 * whole.astype(np.float64), 1000 * PITCH, 1000 * PITCH).center()
    for name, value in {"Sa_um": other.Sa(), "Sq_um": other.Sq(), "Sz_um": other.Sz()}.items():
        assert own[name] == pytest.approx(float(value), rel=1e-4), name
    assert own["Sdr_percent"] == pytest.approx(float(other.Sdr()), rel=0.03)  # of other triangles


def test_roughness_of_a_wave_and_a_slope() -> None:
    wave = np.tile(0.01 * np.sin(2 * np.pi * np.arange(4000) / 100), (4, 1))
    found = areal_roughness(wave, 0.002)
    assert found["Sq_um"] == pytest.approx(10 / np.sqrt(2), rel=1e-3)
    assert found["Sa_um"] == pytest.approx(20 / np.pi, rel=1e-3)
    assert found["Sz_um"] == pytest.approx(20, rel=1e-3)
    slope = np.tile(0.75 * 0.002 * np.arange(50), (40, 1))
    slope[5, 5] = np.nan
    assert areal_roughness(slope, 0.002)["Sdr_percent"] == pytest.approx(25.0, rel=1e-4)
    with pytest.raises(BadInput, match="four known"):
        areal_roughness(np.full((3, 3), np.nan, dtype=np.float32), 1.0)


def ptm_of(data: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients (H, W, 6) and colours (H, W, 3) of a PTM 1.2 LRGB file, by its description."""
    lines = data.split(b"\n", 6)
    assert lines[:2] == [b"PTM_1.2", b"PTM_FORMAT_LRGB"]
    columns, rows = int(lines[2]), int(lines[3])
    scale, bias = np.array(lines[4].split(), float), np.array(lines[5].split(), int)
    assert len(lines[6]) == 9 * rows * columns
    values = np.frombuffer(lines[6], np.uint8)
    coefficients = (values[: 6 * rows * columns].reshape(rows, columns, 6).astype(float) - bias) * scale
    return coefficients[::-1], values[6 * rows * columns :].reshape(rows, columns, 3)[::-1]


def test_ptm_lights_a_matt_surface(height) -> None:
    tilt = np.deg2rad(np.linspace(-40, 40, 21))
    normals = np.zeros((2, 21, 3), dtype=np.float32)
    normals[0] = np.stack([np.sin(tilt), 0 * tilt, np.cos(tilt)], axis=1)  # leans along x in the upper row
    normals[1] = np.stack([0 * tilt, np.sin(tilt), np.cos(tilt)], axis=1)
    albedo = np.arange(42, dtype=np.uint8).reshape(2, 21)
    coefficients, colour = ptm_of(b"".join(ptm_chunks(normals, albedo)))
    np.testing.assert_array_equal(colour[..., 1], albedo)
    for u, v in ((0.0, 0.0), (0.4, 0.0), (0.0, -0.4), (-0.3, 0.3)):
        light = np.array([u, v, np.sqrt(1 - u * u - v * v)])
        shown = coefficients @ np.array([u * u, v * v, u * v, u, v, 1.0]) / 255
        np.testing.assert_allclose(shown, np.maximum(normals @ light, 0), atol=0.09)  # a parabola for a clipped cosine


def test_lp_file_names_photographs(tmp_path: Path) -> None:
    leds = [Led("white", direction=(1.0, 2.0, 2.0)), Led("white", direction=(0.0, 0.0, 5.0))]
    write_light_list(leds, tmp_path / "a.lp", ["one.jpg", "two.jpg"])
    assert (tmp_path / "a.lp").read_text().splitlines()[0] == "2"
    lights, names = read_named_lights(tmp_path / "a.lp")
    assert names == ("one.jpg", "two.jpg")
    np.testing.assert_allclose(lights, [[1 / 3, 2 / 3, 2 / 3], [0, 0, 1]], atol=1e-6)
    with pytest.raises(BadInput, match="holds directions"):
        write_light_list([Led("white", position_mm=(1.0, 2.0, 3.0))], tmp_path / "b.lp", ["one.jpg"])
    assert not (tmp_path / "b.lp").exists()


@pytest.mark.parametrize("near", [True, False])
def test_numpy_reads_our_list_of_lights(near: bool, tmp_path: Path) -> None:
    led = Led("white", position_mm=(1.0, 2.0, 90.0)) if near else Led("white", direction=(0.0, 0.6, 0.8))
    write_light_list([led, led], tmp_path / "lights.txt", ["one.jpg", "two.jpg"])
    found = read_light_list(tmp_path / "lights.txt")
    np.testing.assert_allclose(np.loadtxt(tmp_path / "lights.txt"), found.lights)
    assert (found.names, found.places, found.intensities) == ((), near, None)
