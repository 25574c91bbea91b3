"""Prints from files of any format and resolution, brought to 500 ppi; their minutiae are those that were drawn."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from fmr_samples import three_minutiae
from spiral_prints import PLACES, spiral_print
from splitknit.errors import BadInput
from splitknit.io.minutiae_record import pixels_per_cm
from splitknit.io.prints import PrintFile
from splitknit.prints.from_file import (
    _ridge_period_px,
    minutiae_of,
    pressed_print,
    print_at_500_ppi,
    read_one_finger,
    read_print_file,
)
from splitknit.prints.make import enhance, minutiae_by_phase


def saved(image: NDArray[np.uint8], kind: str, ppi: float | None, **more) -> bytes:
    """As Pillow writes it; grey."""
    stream = io.BytesIO()
    Image.fromarray(image).save(stream, kind, **({} if ppi is None else {"dpi": (ppi, ppi)}), **more)
    return stream.getvalue()


def found_in(image: NDArray[np.uint8]) -> tuple[int, int]:
    """How many of the drawn minutiae are found within 0.25 mm, and how many others."""
    made = pressed_print(PrintFile(image, 500.0, {}))
    found = minutiae_by_phase(made, enhance(made, 500.0), 500.0)
    apart = np.hypot(found.x_px[:, None] - PLACES[:, 0], found.y_px[:, None] - PLACES[:, 1])
    return int((apart.min(axis=0) < 5).sum()), int((apart.min(axis=1) >= 5).sum())


Data = Callable[[], bytes]
EXIF = Image.Exif()
EXIF[282] = EXIF[283] = 600.0
EXIF[296] = 2


def coloured(*seeds: int) -> np.ndarray:
    return np.stack([spiral_print(seed=seed) for seed in seeds], axis=-1)


@pytest.mark.parametrize(
    ("scale", "data"),
    [
        (1.0, lambda: saved(spiral_print(), "PNG", 500)),
        (2.0, lambda: saved(spiral_print(scale=2.0), "PNG", 1000)),
        (0.6, lambda: saved(spiral_print(scale=0.6), "TIFF", 300)),
        (1.2, lambda: saved(spiral_print(scale=1.2), "JPEG", 600, quality=90)),
        (1.2, lambda: saved(spiral_print(scale=1.2), "JPEG", None, quality=90, exif=EXIF)),
        (1.6, lambda: saved(spiral_print(scale=1.6), "BMP", 800)),
        (1.0, lambda: saved(coloured(1, 1, 1), "PNG", 500)),
        (1.0, lambda: saved(coloured(1, 1, 1), "JPEG", 500, quality=80)),
        (1.0, lambda: saved(spiral_print().astype(np.uint16) * 257, "PNG", 500)),
    ],
    ids=["png", "png 1000", "tiff 300", "jpeg 600", "exif 600", "bmp 800", "rgb", "rgb jpeg", "16 bits"],
)
def test_every_format_and_resolution_gives_the_same_print(tmp_path: Path, scale: float, data: Data) -> None:
    file = tmp_path / "scan.of.a.print"  # the bytes show the format
    file.write_bytes(data())
    (stored,) = read_print_file(file)
    assert isinstance(stored, PrintFile)
    assert stored.resolution_ppi == pytest.approx(500 * scale, rel=1e-3)
    one = print_at_500_ppi(stored)
    assert one.image.shape == (500, 380)
    known, others = found_in(one.image)
    assert known >= len(PLACES) - 1
    assert others <= 3


@pytest.mark.parametrize(("scale", "named"), [(0.6, 300), (1.0, 500), (1.1, 500), (2.0, 1000), (3.0, 1400)])
def test_unmarked_prints_are_measured_and_asked_about(tmp_path: Path, scale: float, named: int) -> None:
    file = tmp_path / "scan.png"
    file.write_bytes(saved(spiral_print(scale=scale), "PNG", None))
    with pytest.raises(BadInput, match=rf"does not state its resolution; .* `input_ppi` {named}\.") as refused:
        read_one_finger(file)
    assert "\n" not in str(refused.value)
    one = read_one_finger(file, 500 * scale)
    assert isinstance(one, PrintFile)
    assert print_at_500_ppi(one).image.shape == (500, 380)


def test_resolutions_of_screens_are_asked_about(tmp_path: Path) -> None:
    file = tmp_path / "scan.jpg"
    file.write_bytes(saved(spiral_print(), "JPEG", 72))
    with pytest.raises(BadInput, match=r"states 72 ppi, too few for ridges; .* `input_ppi` 500"):
        read_one_finger(file)
    file.write_bytes(saved(np.full((200, 200), 255, np.uint8), "PNG", None))
    with pytest.raises(BadInput, match=r"no ridges to measure it by: .* `input_ppi` 500"):
        read_one_finger(file)
    file.write_bytes(saved(spiral_print(), "PNG", 9000))
    with pytest.raises(BadInput, match="more than 5080"):
        read_one_finger(file)
    with pytest.raises(BadInput, match="200 to 5080"):
        read_one_finger(file, 100)


def test_pictures_without_ridges_have_no_period() -> None:
    random = np.random.default_rng(1)
    noise = random.integers(0, 256, (400, 400)).astype(np.uint8)
    for picture in (noise, np.full((300, 300), 9, np.uint8), np.repeat(np.repeat(noise[:20, :20], 20, 0), 20, 1)):
        assert _ridge_period_px(picture) is None
    assert _ridge_period_px(spiral_print()[200:250]) is None  # too small to tell


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (lambda: b"", "is empty"),
        (lambda: b"hello", "of another kind"),
        (lambda: b"%PDF-1.4 and more", "prints and minutiae are read from PNG"),
        (lambda: saved(coloured(1, 2, 1), "PNG", 500), "colour image"),
        (lambda: saved(spiral_print(), "PNG", 500)[:-40], "damaged|truncated"),
        (lambda: saved(spiral_print(), "BMP", 500)[:-4000], "truncated"),
    ],
    ids=["empty", "text", "pdf", "colour", "cut png", "cut bmp"],
)
def test_other_files_are_refused_in_one_sentence(tmp_path: Path, data: Data, words: str) -> None:
    file = tmp_path / "scan.png"
    file.write_bytes(data())
    with pytest.raises(BadInput, match=words) as refused:
        read_one_finger(file)
    assert str(refused.value).count("\n") == 0


def test_minutiae_of_records_lie_on_the_grid_of_500_ppi() -> None:
    same = minutiae_of(three_minutiae())
    np.testing.assert_array_equal(same.x_px, three_minutiae().x_px)
    fine = three_minutiae(resolution_ppcm=pixels_per_cm(1000), quality=np.array([80, 254, 255]))
    half = minutiae_of(fine)
    assert np.abs(half.x_px - fine.x_px / 2).max() <= 0.51
    assert half.size == (round(fine.size[0] / 2), round(fine.size[1] / 2))
    assert half.quality.tolist() == [80, 0, 0]
