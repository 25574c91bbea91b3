"""Whatever bytes a file holds, a reader gives a result or a BadInput, and nothing appears on stderr."""

from __future__ import annotations

import atexit
import copy
import json
import shutil
import struct
import tempfile
import zlib
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from splitknit.check import BadInput
from splitknit.io import (
    canonical_json,
    read_capture,
    read_lights_txt,
    read_npz,
    rig_from_json,
    write_capture,
    write_npz,
)
from splitknit.io.images import decode_image
from splitknit.io.png import SIGNATURE, decode_png
from splitknit.types import Band, Camera, Capture, Led, Rig

FUZZ = settings(
    max_examples=150,
    derandomize=True,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)

SCALARS = (
    st.none()
    | st.booleans()
    | st.integers(-(10**30), 10**30)
    | st.floats()
    | st.text(max_size=8)
    | st.sampled_from(
        ["white_0.png", "rig.json", "..", "/", "capture.json", "srgb", "perspective", "nir", 1e308, 1e-308]
    )
)
JSON = st.recursive(
    SCALARS, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=6), inner, max_size=4)
)


@cache
def sound_folder() -> Path:
    scratch = Path(tempfile.mkdtemp(prefix="splitknit-fuzz-"))
    atexit.register(shutil.rmtree, scratch, ignore_errors=True)
    folder = scratch / "capture"
    rng = np.random.default_rng(3)
    pixels = rng.integers(60, 200, (6, 7, 9, 3)).astype(np.uint8)
    leds = [
        Led(band, position_mm=(50 * np.cos(a), 50 * np.sin(a), 140.0)) for band in ("white", "nir") for a in (0, 2, 4)
    ]
    bands = {
        name: Band(name, pixels[k : k + 3], ((k,), (k + 1,), (k + 2,)), np.full(3, 0.5), np.ones(3), pixels[0] // 30)
        for name, k in (("white", 0), ("nir", 3))
    }
    capture = Capture(Rig(Camera(20.0, (7, 9)), tuple(leds)), bands, mask=np.ones((7, 9), bool), subject={"id": "x"})
    write_capture(capture, folder, {"height_mm": np.zeros((7, 9))})
    return folder


@cache
def document(name: str) -> Any:
    return json.loads((sound_folder() / name).read_text())


def places(node: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """All places in a JSON document."""
    yield path
    children = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    for key, child in children:
        yield from places(child, (*path, key))


@st.composite
def mutated(draw: st.DrawFn, name: str) -> Any:
    """Return the sound document with one to three values replaced, removed or doubled."""
    root = {"root": copy.deepcopy(document(name))}
    for _ in range(draw(st.integers(1, 3))):
        path = draw(st.sampled_from(list(places(root))[1:]))
        parent = root
        for key in path[:-1]:
            parent = parent[key]
        action = draw(st.sampled_from(["replace", "remove", "double"]))
        if action == "remove" and path != ("root",):
            del parent[path[-1]]
        elif action == "double" and isinstance(parent, list):
            parent.append(parent[path[-1]])
        else:
            parent[path[-1]] = draw(JSON)
    return root["root"]


def attempt(function: Any, *arguments: Any) -> Any:
    """Return the result, or None for a refusal; the refusal must be one printable sentence."""
    try:
        return function(*arguments)
    except BadInput as error:
        text = str(error)
        assert text
        assert "\n" not in text
        text.encode("utf-8")
        return None


def read_with(name: str, text: bytes) -> Capture | None:
    """Read the sound capture with one of its files replaced."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for file in sound_folder().iterdir():
            (folder / file.name).write_bytes(file.read_bytes())
        (folder / name).write_bytes(text)
        result: Capture | None = attempt(read_capture, folder)
        return result


@FUZZ
@given(JSON)
@example([])
@example({"format": "splitknit-rig", "version": 1, "camera": {}, "leds": [{}]})
def test_any_json_as_rig(value: Any) -> None:
    attempt(rig_from_json, value, "rig.json")


@FUZZ
@given(mutated("rig.json"))
def test_mutated_rigs(value: Any) -> None:
    rig = attempt(rig_from_json, value, "rig.json")
    if rig is not None and rig.leds:
        assert np.isfinite(rig.light_vectors()).all()


@FUZZ
@given(mutated("capture.json"))
def test_mutated_captures(value: Any) -> None:
    capture = read_with("capture.json", json.dumps(value).encode())
    if capture is not None:
        assert capture.bands["white"].pixels.shape[1:] == (7, 9, 3)
        assert np.isfinite(capture.bands["white"].exposure).all()


@FUZZ
@given(mutated("rig.json"))
def test_captures_with_mutated_rigs(value: Any) -> None:
    read_with("rig.json", json.dumps(value).encode())


@FUZZ
@given(st.binary(max_size=200) | JSON.map(lambda value: json.dumps(value).encode()), st.booleans())
def test_any_bytes_as_documents(data: bytes, rig: bool) -> None:
    read_with("rig.json" if rig else "capture.json", data)


@cache
def sound_pngs() -> tuple[bytes, ...]:
    rng = np.random.default_rng(4)
    shapes: list[tuple[tuple[int, ...], Any]] = [
        ((7, 9), np.uint8),
        ((7, 9, 3), np.uint8),
        ((7, 9, 4), np.uint16),
        ((40, 30, 3), np.uint8),
    ]
    images = [rng.integers(0, np.iinfo(kind).max, shape).astype(kind) for shape, kind in shapes]
    return tuple(cv2.imencode(".png", image)[1].tobytes() for image in images)


def chunk(kind: bytes, body: bytes) -> bytes:
    return len(body).to_bytes(4, "big") + kind + body + zlib.crc32(kind + body).to_bytes(4, "big")


def split_chunks(data: bytes) -> list[tuple[bytes, bytes]]:
    chunks, position = [], 8
    while position < len(data):
        length = int.from_bytes(data[position : position + 4], "big")
        chunks.append((data[position + 4 : position + 8], data[position + 8 : position + 8 + length]))
        position += 12 + length
    return chunks


def check_image(data: bytes) -> np.ndarray | None:
    image: np.ndarray | None = attempt(decode_image, data, "x.png")
    if image is not None:
        assert image.ndim == 3
        assert image.shape[2] in (1, 3)
        assert image.dtype in (np.uint8, np.uint16)
    return image


@FUZZ
@given(st.binary(max_size=300), st.sampled_from([b"", SIGNATURE, b"\xff\xd8\xff", b"II*\0", b"MM\0*", b"II+\0"]))
def test_any_bytes_as_image(capfd: pytest.CaptureFixture[str], data: bytes, start: bytes) -> None:
    check_image(start + data)
    assert capfd.readouterr().err == ""


@FUZZ
@given(st.integers(0, 3), st.lists(st.tuples(st.floats(0, 0.999), st.integers(1, 255)), min_size=1, max_size=4))
def test_png_with_changed_bytes(
    capfd: pytest.CaptureFixture[str], which: int, changes: list[tuple[float, int]]
) -> None:
    sound = sound_pngs()[which]
    data = bytearray(sound)
    for place, value in changes:
        data[int(place * len(data))] ^= value
    assert bytes(data) == sound or check_image(bytes(data)) is None  # every byte is covered by a checksum
    assert capfd.readouterr().err == ""


def test_png_cut_at_every_chunk(capfd: pytest.CaptureFixture[str]) -> None:
    for sound in sound_pngs():
        position = 8
        for kind, body in split_chunks(sound):
            for cut in {position, position + 4, position + 8, position + 8 + len(body) // 2, position + 8 + len(body)}:
                assert check_image(sound[:cut]) is None, (kind, cut)
            position += 12 + len(body)
        assert check_image(sound) is not None
    assert capfd.readouterr().err == ""


@FUZZ
@given(st.data())
def test_png_with_changed_chunks_and_sound_checksums(capfd: pytest.CaptureFixture[str], data: st.DataObject) -> None:
    chunks = split_chunks(data.draw(st.sampled_from(sound_pngs())))
    for _ in range(data.draw(st.integers(1, 3))):
        k = data.draw(st.integers(0, len(chunks) - 1))
        kind, body = chunks[k]
        action = data.draw(st.sampled_from(["flip", "drop", "double", "cut", "kind", "header"]))
        if action == "flip" and body:
            changed = bytearray(body)
            changed[data.draw(st.integers(0, len(body) - 1))] ^= data.draw(st.integers(1, 255))
            chunks[k] = kind, bytes(changed)
        elif action == "drop" and len(chunks) > 1:
            del chunks[k]
        elif action == "double":
            chunks.insert(k, (kind, body))
        elif action == "cut":
            chunks[k] = kind, body[: len(body) // 2]
        elif action == "kind":
            chunks[k] = (
                data.draw(st.sampled_from([b"PLTE", b"IDAT", b"tRNS", b"acTL", b"fcTL", b"eXIf", b"zzzz"])),
                body,
            )
        else:
            small = st.integers(0, 70)
            fields = [data.draw(small), data.draw(small), *(data.draw(st.sampled_from(v)) for v in HEADER_VALUES)]
            chunks[0] = b"IHDR", struct.pack(">IIBBBBB", *fields)
    check_image(SIGNATURE + b"".join(chunk(*item) for item in chunks))
    assert capfd.readouterr().err == ""


HEADER_VALUES = ([1, 2, 4, 8, 16, 3], [0, 2, 3, 4, 6, 1], [0, 0, 1], [0, 0, 1], [0, 1, 2])


@FUZZ
@given(
    st.integers(1, 12),
    st.integers(1, 12),
    st.sampled_from([1, 2, 4, 8, 16]),
    st.sampled_from([0, 2, 3, 4, 6]),
    st.booleans(),
    st.randoms(use_true_random=False),
)
def test_any_sound_png_is_decoded_as_opencv_does(  # noqa: PLR0917
    rows: int, columns: int, depth: int, colour: int, interlaced: bool, random: Any
) -> None:
    header = (columns, rows, depth, colour, 0, 0, int(interlaced))
    ihdr = SIGNATURE + chunk(b"IHDR", struct.pack(">IIBBBBB", *header))
    if depth not in {0: (1, 2, 4, 8, 16), 3: (1, 2, 4, 8)}.get(colour, (8, 16)):
        assert check_image(ihdr + chunk(b"IEND", b"")) is None
        return
    samples = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}[colour]
    steps = (
        ((0, 0, 8, 8), (0, 4, 8, 8), (4, 0, 8, 4), (0, 2, 4, 4), (2, 0, 4, 2), (0, 1, 2, 2), (1, 0, 2, 1))
        if interlaced
        else ((0, 0, 1, 1),)
    )
    lines = b""
    for r, c, dr, dc in steps:
        height, width = len(range(r, rows, dr)), len(range(c, columns, dc))
        size = (width * samples * depth + 7) // 8
        lines += b"".join(bytes([random.randrange(5)]) + random.randbytes(size) for _ in range(height if width else 0))
    palette = chunk(b"PLTE", random.randbytes(768)) if colour == 3 else b""
    data = ihdr + palette + chunk(b"IDAT", zlib.compress(lines)) + chunk(b"IEND", b"")
    expected = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    expected = expected[..., None] if expected.ndim == 2 else expected
    expected = expected[..., :1] if colour in (0, 4) else expected[..., 2::-1]
    np.testing.assert_array_equal(decode_png(data, "x"), expected)


@cache
def sound_images() -> tuple[bytes, ...]:
    image = np.random.default_rng(4).integers(0, 255, (20, 24, 3)).astype(np.uint8)
    kinds = [(".jpg", []), (".tif", [cv2.IMWRITE_TIFF_COMPRESSION, 1])]
    return tuple(cv2.imencode(kind, image, options)[1].tobytes() for kind, options in kinds)


@FUZZ
@given(st.integers(0, 1), st.lists(st.tuples(st.floats(0, 0.999), st.integers(1, 255)), max_size=4), st.floats(0, 1))
def test_jpeg_and_tiff_with_changed_bytes(which: int, changes: list[tuple[float, int]], keep: float) -> None:
    data = bytearray(sound_images()[which])
    for place, value in changes:
        data[int(place * len(data))] ^= value
    check_image(bytes(data[: int(keep * len(data))]))
    check_image(bytes(data))


@FUZZ
@given(st.binary(max_size=80) | st.text(alphabet="0123456789.-+e ,#\n\tnaif", max_size=80).map(str.encode))
def test_any_bytes_as_lights(data: bytes) -> None:
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "lights.txt"
        path.write_bytes(data)
        lights = attempt(read_lights_txt, path)
    assert lights is None or (lights.ndim == 2 and lights.shape[1] == 3 and np.isfinite(lights).all())


@FUZZ
@given(JSON)
def test_canonical_json_is_a_fixed_point(value: Any) -> None:
    text = attempt(canonical_json, value)
    if text is not None:
        assert canonical_json(json.loads(text)) == text


@FUZZ
@given(
    st.dictionaries(
        st.text(alphabet="abcdef_0", min_size=1, max_size=5),
        st.integers(-(2**60), 2**60) | st.floats() | st.lists(st.integers(-5, 5), max_size=5) | st.booleans(),
        max_size=4,
    ),
    st.integers(0, 9),
)
def test_any_numbers_survive_an_archive(arrays: dict[str, Any], level: int) -> None:
    with tempfile.TemporaryDirectory() as scratch:
        write_npz(Path(scratch) / "a.npz", arrays, level)
        found = read_npz(Path(scratch) / "a.npz")
    assert list(found) == list(arrays)
    for name, value in arrays.items():
        np.testing.assert_array_equal(found[name], value)
