"""What reads bytes that somebody else made, and a sound sample of each.

A target's function gets the files as they are and, if it reads files, the folder they lie in. It
returns, or raises ``BadInput``; what it asserts beside that must hold for whatever is accepted.
"""

from __future__ import annotations

import contextlib
import csv
import hashlib
import io
import json
import os
import struct
import tempfile
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

import cv2
import numpy as np
from tests.fuzz import PACKAGES
from tests.fuzz.mutators import Files

from batch_stores import waves
from fmr_samples import ANSI_2009_BYTES, ANSI_BYTES, ISO_BYTES, transaction, type_14
from handmade import finger
from png_files import png_of
from splitknit.capture import Ambient, Band, Capture
from splitknit.cli.options import parse_assignment, read_changes
from splitknit.errors import BadInput
from splitknit.folders import read_photographs
from splitknit.io.capture import read_capture, write_capture
from splitknit.io.enrolment import open_enrolment
from splitknit.io.images import decode_image, encode_image, read_image, write_float_tiff
from splitknit.io.light_list import read_intensities, read_light_list
from splitknit.io.normal_maps import read_mask, read_normal_map
from splitknit.io.npz import read_npz, write_npz
from splitknit.io.photographs import GivenPhotographs
from splitknit.io.photos import read_photo
from splitknit.io.prints import encode_print_png, write_print_png
from splitknit.io.results import read_result
from splitknit.io.rig import read_rig
from splitknit.io.targets import check_target
from splitknit.model import Camera, Led, Rig
from splitknit.networks.unet import load_network
from splitknit.observation.plain import capture_from_photographs, read_flat
from splitknit.pipeline import reconstruct
from splitknit.presets import preset_settings
from splitknit.reconstruction import Surface
from splitknit.report.surface import scene_of
from splitknit.settings import override
from splitknit_match.batch.cases import Case
from splitknit_match.batch.features import failed_row
from splitknit_match.batch.population import read_population
from splitknit_match.batch.store import (
    Store,
    open_store,
    read_origin,
    read_surface,
    write_surface,
    write_table,
)
from splitknit_match.evaluation.gallery_scores import gallery_scores
from splitknit_match.evaluation.scores import read_scores
from splitknit_match.gallery.candidates import Candidates
from splitknit_match.gallery.file import Entry, GalleryFile, NewCapture, key_of
from splitknit_match.gallery.folder import export_gallery, import_gallery
from splitknit_match.gallery.serve import read_token
from splitknit_match.gallery.verbs import identify
from splitknit_match.matching.inputs import Pixels, read_side
from splitknit_match.matching.inputs import read_surface as read_matched
from splitknit_match.matching.match import make_template as template_of
from splitknit_match.matching.match import match
from splitknit_match.matching.ridge_band import ridge_band
from splitknit_match.matching.score import DECISION_FORMAT, read_own_rates
from splitknit_match.matching.template import VERSION, Template, make_template, pack, unpack
from splitknit_match.prints.fingerphoto import read_fingerphoto
from splitknit_match.prints.from_file import (
    minutiae_of,
    read_one_finger,
    read_print_file,
    read_print_folder,
    ridge_period_px,
)
from splitknit_match.prints.sources import read_source
from splitknit_match.records.finger_image import encode_finger_image
from splitknit_match.records.iso39794 import encode_finger_image_block
from splitknit_match.records.minutiae_files import decode_minutiae_record, read_minutiae_record
from splitknit_match.records.minutiae_record import Minutiae, pack_minutiae, unpack_minutiae
from splitknit_match.records.pictures import PrintFile, encode_print_tiff, read_print_png
from splitknit_match.records.print_formats import read_prints
from splitknit_match.records.templates import encode_template, read_template
from splitknit_match.records.what import what
from splitknit_match.records.wsq_image import encode_wsq
from splitknit_rig.calibration.lights import COLUMNS, read_tips
from splitknit_rig.calibration.lights_found import check_tips
from splitknit_rig.calibration.nail_photos import read_stack
from splitknit_rig.calibration.radiometry_folder import read_exposures
from splitknit_simulator.accuracy import read_truth

TINY_NETWORK = PACKAGES / "splitknit" / "tests" / "networks" / "tiny.onnx"
DOCUMENTS: tuple[dict[str, Any], ...] = ({"ea": Case("ea", "ea").document()}, {}, {})
"""Cases, matchers and pairs of the store."""


@dataclass(frozen=True)
class Target:
    """One reader, or several of the same files."""

    name: str
    samples: Callable[[], Sequence[Files]]
    read: Callable[[Path, Files], object]
    repair: Callable[[Files], Files] | None = None
    """Makes checksums fit again."""


def _of_files(name, *readers):
    """Each of several readers of one file gets a chance; the last refusal stands if all refuse."""

    def read(folder, files):
        return _any(*(lambda reader=reader: reader(folder / name) for reader in readers))

    return read


def _of_bytes(*readers):
    def read(folder, files):
        data = files.get("bytes")
        if not isinstance(data, bytes):
            return None
        return _any(*(lambda reader=reader: reader(data) for reader in readers))

    return read


def _any(*readers):
    taken, refusal = [], None
    for reader in readers:
        try:
            taken.append(reader())
        except BadInput as error:
            check_refusal(error)
            refusal = error
    if refusal is not None and not taken:
        raise refusal
    return taken


def check_refusal(error):
    """A refusal is one printable sentence."""
    text = str(error)
    assert text.strip(), "the refusal is empty"
    assert len(text.splitlines()) == 1, f"the refusal has several lines: {text!a}"
    assert text.isprintable(), f"the refusal cannot be printed: {text!a}"
    assert len(text) < 3000, f"the refusal has {len(text)} characters"


def _each(name, *contents):
    return [{name: content} for content in contents]


def _written(name, *writers):
    """What writers of a file make."""
    with tempfile.TemporaryDirectory() as scratch:
        files = []
        for write in writers:
            write(Path(scratch) / name)
            files.append({name: (Path(scratch) / name).read_bytes()})
    return files


def _folder(make):
    """All files that `make` leaves in a folder."""
    with tempfile.TemporaryDirectory() as scratch:
        root = Path(scratch) / "made"
        make(root)
        files = sorted(file for file in root.rglob("*") if file.is_file())
        return {file.relative_to(root).as_posix(): file.read_bytes() for file in files}


def _noise(*shape, kind=np.uint8, seed=4):
    return np.random.default_rng(seed).integers(0, np.iinfo(kind).max, shape).astype(kind)


# --- images
# ------------------------------------------------------------------------------------------------


@cache
def _images():
    import tifffile

    random = Random(1)
    pngs = [
        png_of(9, 11, depth, colour, interlaced, random)
        for depth, colour in (
            (1, 0),
            (8, 0),
            (16, 0),
            (8, 2),
            (16, 2),
            (4, 3),
            (8, 3),
            (8, 4),
            (16, 6),
        )
        for interlaced in (False, True)
    ]
    tiffs = []
    for compression, pixels in (
        (1, _noise(20, 24, 3)),
        (5, _noise(20, 24, 3)),
        (5, _noise(20, 24, kind=np.uint16)),
    ):
        tiffs.append(
            cv2.imencode(".tif", pixels, [cv2.IMWRITE_TIFF_COMPRESSION, compression])[1].tobytes()
        )
    options: list[dict[str, Any]] = [
        {"compression": "zlib"},
        {"tile": (16, 16)},
        {"tile": (16, 16), "compression": "zlib"},
        {"compression": "zlib", "predictor": True},
        {"rowsperstrip": 3},
        {"byteorder": ">"},
        {"bigtiff": True},
        {"resolution": (500, 500)},
    ]
    for more in options:
        for pixels in (_noise(20, 24), _noise(33, 24, 3), _noise(20, 24, kind=np.uint16)):
            stream = io.BytesIO()
            # without codecs tifffile writes fewer kinds
            with contextlib.suppress(ImportError, KeyError, ValueError):
                tifffile.imwrite(
                    stream, pixels, photometric="rgb" if pixels.ndim == 3 else "minisblack", **more
                )
                tiffs.append(stream.getvalue())
    kinds = _noise(20, 24), _noise(33, 24, 3), _noise(20, 24, kind=np.uint16)
    tiffs += [encode_image(pixels, ".tiff", compress=True) for pixels in kinds]
    smooth = cv2.GaussianBlur(_noise(40, 48, 3), (9, 9), 3)
    jpegs = [
        cv2.imencode(".jpg", pixels, options)[1].tobytes()
        for pixels in (smooth, smooth[..., 0])
        for options in ([], [cv2.IMWRITE_JPEG_PROGRESSIVE, 1], [cv2.IMWRITE_JPEG_RST_INTERVAL, 1])
    ]
    return [{"image": data} for data in (*pngs, *tiffs, *jpegs) if _decodes(data)]


def _decodes(data):
    try:
        decode_image(data, "x")
    except BadInput:  # kinds that this software does not read serve as bytes to splice nowhere
        return False
    return True


def _pixels(path):
    image = read_image(path)
    assert image.ndim == 3
    assert image.shape[2] in (1, 3)
    assert image.dtype in (np.uint8, np.uint16)


@cache
def _photographs():
    """RAW files are left out: LibRaw prints a line of its own on stderr where one is damaged."""
    from PIL import Image

    exif = Image.Exif()
    exif[274] = 6
    smooth = Image.fromarray(cv2.GaussianBlur(_noise(40, 48, 3), (9, 9), 3))
    floats = np.linspace(0, 1, 20 * 24 * 3, dtype=np.float32).reshape(20, 24, 3)
    files = _written(
        "x.webp",
        lambda path: smooth.save(path, exif=exif),
        lambda path: smooth.save(path, lossless=True),
    )
    files += _written("x.bmp", smooth.save, smooth.convert("L").save)
    files += _written("x.jpg", lambda path: smooth.save(path, exif=exif))
    files += _written("x.png", lambda path: smooth.save(path, exif=exif))
    files += _written("x.tif", lambda path: smooth.save(path, exif=exif))
    files += _written("x.tif", lambda path: write_float_tiff(path, floats, "light"))
    with contextlib.suppress(ImportError):
        import pillow_heif

        files += _written("x.heic", pillow_heif.from_pillow(smooth).save)
    return files


def _normal_maps():
    y, x = np.mgrid[0.7:-0.7:24j, -0.7:0.7:24j]
    units = np.dstack([x, y, np.sqrt(1 - x**2 - y**2)]).astype(np.float32)
    stored = np.rint(32767.5 * (units + 1)).astype(np.uint16)
    mask = np.uint8(255) * (units[..., 2] > 0.5)
    pngs = [cv2.imencode(".png", image)[1].tobytes() for image in (stored[..., ::-1], mask)]
    maps = _written("map.npy", lambda path: np.save(path, units))
    return [*maps, {"map.png": pngs[0]}, {"mask.png": pngs[1]}]


def _normal_map(folder, files):
    for name in files:
        if name == "mask.png":
            read_mask(folder / name, (24, 24))
        else:
            read_normal_map(folder / name)


def _photograph(folder, files):
    for name in files:
        pixels = read_photo(folder / name).pixels
        assert pixels.ndim == 3 and pixels.shape[2] in (1, 3)
        assert pixels.dtype in (np.uint8, np.uint16, np.float32)


def _fingerphotos():
    from PIL import Image

    row, column = np.mgrid[:260:0.5, :230:0.5]
    offset = (column - 115) / 60
    inside = (np.abs(offset) < 1) & ((row > 95) | (offset**2 + ((row - 95) / 60) ** 2 < 1))
    light = np.sqrt(np.clip(1 - offset**2, 0, 1)) * (1 + 0.12 * np.cos(2 * np.pi * row / 4))
    picture = np.where(inside[..., None], light[..., None] * (215, 160, 140), (120, 130, 140))
    noisy = picture + np.random.default_rng(0).normal(0, 2, picture.shape)
    return _written("x.jpg", Image.fromarray(np.clip(np.rint(noisy), 0, 255).astype(np.uint8)).save)


@cache
def _pressed():
    """Template of a print."""
    return template_of(Pixels(_print(), 500.0)).payload or b""


def _matched(folder, files):
    """A whole comparison, of a photograph without a scale."""
    return match(folder / "x.jpg", _pressed(), method="ridge")


def _print():
    rows, columns = np.mgrid[:120, :100]
    return (127 + 120 * np.sin(0.7 * np.hypot(rows - 70, 1.2 * columns - 50))).astype(np.uint8)


# --- captures and results
# ----------------------------------------------------------------------------------------


@cache
def _captures():
    pixels = _noise(6, 7, 9, 3)
    angles = (0, 2, 4)
    near = [
        Led(b, position_mm=(50 * np.cos(a), 50 * np.sin(a), 140.0))
        for b in ("white", "nir")
        for a in angles
    ]
    distant = [Led("white", direction=(0.4 * np.cos(a), 0.4 * np.sin(a), 0.9)) for a in angles]
    bands = {
        name: Band(
            name,
            pixels[k : k + 3],
            ((k,), (k + 1,), (k + 2,)),
            np.full(3, 0.5),
            np.ones(3),
            Ambient(pixels[0] // 30, 0.5, 1.0),
        )
        for name, k in (("white", 0), ("nir", 3))
    }
    first = Capture(
        Rig(Camera(20.0, (7, 9)), tuple(near)),
        bands,
        mask=np.ones((7, 9), bool),
        subject={"id": "x"},
    )
    grey = Band(
        "white",
        pixels[:3, ..., :1].astype(np.uint16) * 257,
        ((0,), (1,), (2,)),
        np.ones(3),
        np.zeros(3),
    )
    matrix = np.array([[2800.0, 0, 4], [0, 2800, 3], [0, 0, 1]])
    camera = Camera(
        20.0, (7, 9), 140.0, "perspective", matrix, (0.1, 0.0, 0.0, 0.0, 0.0), (0.1,), np.eye(3)
    )
    second = Capture(Rig(camera, tuple(distant)), {"white": grey}, encoding="srgb")
    truth = {"height_mm": np.zeros((7, 9)), "mask": np.ones((7, 9), bool)}
    return [
        _folder(lambda to: write_capture(first, to, truth)),
        _folder(lambda to: write_capture(second, to)),
        _folder(lambda to: write_capture(second, to, images="tiff")),
    ]


def _capture(folder, files):
    capture = read_capture(folder)
    vectors = capture.rig.light_vectors() if capture.rig.leds else np.zeros(1)
    assert np.isfinite(vectors).all()
    for band in capture.bands.values():
        assert band.pixels.shape[1:3] == capture.rig.camera.image_size
        assert np.isfinite(band.exposure).all()
    if capture.truth is not None:
        read_truth(capture)


def _plain_images():
    lights = b"3\n0.5 0 1\n-0.3 0.4 1\n-0.3 -0.4 1\n"
    named = b"".join(b"%d.png %s" % (k, line) for k, line in enumerate(lights.splitlines(True)[1:]))
    photos = {f"{k}.png": encode_image(_noise(16, 17, seed=k), ".png") for k in range(3)}
    mask = encode_image(np.where(_noise(16, 17, seed=0) > 127, 255, 0).astype(np.uint8), ".png")
    return [{"lights.txt": lights, **photos}, {"lights.txt": named, **photos, "mask.png": mask}]


def _plain_capture(folder, files):
    lights = read_light_list(folder / "lights.txt").lights
    assert lights.ndim == 2
    assert lights.shape[1] == 3
    assert np.isfinite(lights).all()
    capture_from_photographs(
        GivenPhotographs(folder / "{light}.png", lights, 10.0, encoding="linear")
    )
    read_photographs(folder)


def _balls():
    """Five photographs of a ball of 40 pixels, near enough sRGB."""
    y, x = np.mgrid[20:-20:-1, -20:20] / 17.0
    inside, z = x**2 + y**2 < 1, np.sqrt(np.clip(1 - x**2 - y**2, 0, 1))
    lights = np.array([[0.5, 0, 1], [0.2, 0.5, 1], [-0.4, 0.3, 1], [-0.4, -0.3, 1], [0.2, -0.5, 1]])
    lights /= np.linalg.norm(lights, axis=1, keepdims=True)
    shades = [
        255 * np.power(np.clip(a * x + b * y + c * z, 0, 1) * inside, 1 / 2.2) for a, b, c in lights
    ]
    names = [f"{k}.jpg" for k in range(5)]
    pictures = [
        cv2.imencode(name[1:], np.rint(shade).astype(np.uint8))[1].tobytes()
        for name, shade in zip(names, shades, strict=True)
    ]
    photos = dict(zip(names, pictures, strict=True))
    rows = "".join(
        f"{name} {a:.3f} {b:.3f} {c:.3f}\n" for name, (a, b, c) in zip(names, lights, strict=True)
    ).encode()
    mask = encode_image((255 * inside).astype(np.uint8), ".png")
    return [{"lights.txt": rows, "mask.png": mask, **photos}, {"lights.txt": rows, **photos}]


def _object(folder, files):
    result = reconstruct(read_photographs(folder, folder / "lights.txt"), "metric")
    assert np.isfinite(result.height_mm[result.mask]).all()


def _flat_images():
    return [
        {f"flat/{k}.png": encode_image(_noise(16, 17, seed=k) // 2 + 90, ".png") for k in range(3)}
    ]


@cache
def _arrays():
    result, _ = finger(px_per_mm=4.0, size=(80, 110))
    names = (
        "height_mm",
        "ridge_mm",
        "shape_mm",
        "mask",
        "normals",
        "pitch_mm",
        "input_from_upright",
        "upright_size",
    )
    return {name: np.asarray(getattr(result, name)) for name in names}


def _npz(arrays):
    return _written(
        "height.npz", lambda path: write_npz(path, arrays), lambda path: np.savez(path, **arrays)
    )


def _results():
    return _npz(_arrays())


_RATES = json.dumps(
    {
        "format": DECISION_FORMAT,
        "version": 1,
        "similarity": [0.0, 1.0, 2.0],
        "fmr": [0.1, 0.01, 0.001],
        "impostors": 1000,
        "what": "prints",
        "method": "fusion",
        "least_mm2": 40.0,
    }
).encode()
_REPORT = (
    b'{"preset": "ea", "settings": {"mask": {}}, "quality": {}, "facts": {}, "warnings": ["dark"],'
    b' "timings_s": {}}'
)


def _result(folder, files):
    path = folder / "height.npz"
    return _any(
        lambda: read_matched(path),
        lambda: read_result(folder),
        lambda: read_source(path, photo=False, surface=True),
        lambda: read_side(folder, "metric"),
    )


# --- templates, records, scores
# ----------------------------------------------------------------------------------


def _templates():
    small = pack(Template(_noise(60, 50) % 4, np.ones((60, 50), bool), 0.1))
    return _each(
        "x.skt", *(encode_template(payload, VERSION) for payload in (waves("S01", 1), small))
    )


def _skt_repaired(files):
    """Size and hash of the payload that there is."""

    def repaired(data):
        head = len(encode_template(b"x", VERSION)) - 1
        payload = data[head:]
        return (
            data[: head - 36]
            + struct.pack("<I", len(payload))
            + hashlib.sha256(payload).digest()
            + payload
        )

    assert repaired(encode_template(b"abc", VERSION)) == encode_template(b"abc", VERSION)
    return {
        name: repaired(file) if isinstance(file, bytes) and name.endswith(".skt") else file
        for name, file in files.items()
    }


def _packed():
    many = np.random.default_rng(1)
    flat = Minutiae(
        many.integers(0, 99, 7).astype(np.int32),
        many.integers(0, 99, 7).astype(np.int32),
        many.uniform(0, 6, 7),
        np.ones(7, np.uint8),
        np.full(7, 50, np.uint8),
        (100, 100),
    )
    return _each("bytes", pack_minutiae(flat))


def _packed_repaired(files):
    """The checksum is the last of the head."""
    data = files.get("bytes")
    if not isinstance(data, bytes):
        return files
    body = data[17:]
    return {"bytes": data[:13].ljust(13, b"\0") + struct.pack("<I", zlib.crc32(body)) + body}


def _record(folder, files):
    path = folder / "x.fmr"
    data = files.get("x.fmr")
    if not isinstance(data, bytes):
        return read_minutiae_record(path)
    return _any(lambda: read_minutiae_record(path), lambda: decode_minutiae_record(data))


def _transactions():
    small, large = _noise(11, 13), _print()
    return _each(
        "x.eft",
        transaction(type_14(small), type_14(small, 13)),
        transaction(type_14(small, CGA=b"PNG", DATA=encode_print_png(small))),
        transaction(type_14(large, CGA=b"WSQ20", DATA=encode_wsq(large))),
    )


SCORES = b"""label,score,finger_a,finger_b,subject_a,subject_b,session_a,session_b
1,0.9,right_index,right_index,S01,S01,1,2
0,0.1,right_index,right_index,S01,S02,1,2
1,0.7,left_index,left_index,S01,S01,1,2
0,0.2,left_index,left_index,S02,S01,1,2
"""


def _scores(folder, files):
    read_scores(folder / "scores.csv", dissimilarity=True)


# --- settings, networks, keys
# ------------------------------------------------------------------------------------


def _settings(name):
    return lambda folder, files: override(
        preset_settings("metric"), read_changes([("--settings", str(folder / name))])
    )


def _assignments(folder, files):
    lines = files.get("set")
    for line in (lines if isinstance(lines, bytes) else b"").decode("utf-8", "replace").split("\n"):
        parse_assignment(line)
        override(preset_settings("metric"), read_changes([("--set", line)]))


_SETTINGS: dict[str, Any] = {
    "knit": {"method": "crossover"},
    "height": {"method": "poisson"},
    "metric": {"coarse_steps": 5},
    "skin": {"invert_blur": None, "scattering_factor": 1.2},
    "metric.rounds": 2,
}
_TOML = b"""cut_at_crease = true
[knit]
method = "crossover"
[height]
method = "poisson"
[metric]
coarse_steps = 5
"""
_SET = b"knit.method=crossover\nmetric.rounds=2\nmetric.coarse_steps=5\nlights.balance=true"


def _networks():
    return [
        {
            "x.onnx": TINY_NETWORK.read_bytes(),
            "x.json": TINY_NETWORK.with_suffix(".json").read_bytes(),
        }
    ]


def _network_repaired(files):
    """The card of the weights that there are."""
    weights, card = files.get("x.onnx"), files.get("x.json")
    try:
        document = dict(json.loads(card))  # type: ignore[arg-type]
        document["sha256"] = hashlib.sha256(weights).hexdigest()  # type: ignore[arg-type]
    except (ValueError, TypeError, RecursionError):
        return files
    return {**files, "x.json": json.dumps(document).encode()}


def _keys(folder, files):
    return key_of(folder / "key")


# --- galleries
# ------------------------------------------------------------------------------------------------


def _new(person, seed, session="1"):
    template = make_template(ridge_band(_relief(seed), np.ones((90, 80), bool), 0.1))
    entry = Entry(person, "right_index", session, "result", f"{seed:064x}", area_mm2=70.0)
    return NewCapture(entry, pack(template))


def _relief(seed):
    row, column = np.mgrid[:90, :80] * 0.1
    return np.sin(
        14 * (np.cos(seed) * column + np.sin(seed) * row) + np.hypot(row - 4, column - 4)
    ).astype(np.float32)


@cache
def _gallery():
    from splitknit_match.gallery.identify import TEMPLATES_HASH

    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "x.skg"
        with GalleryFile(path) as gallery:
            captures = [_new("Ann", 1), _new("Ann", 1, "2"), _new("Bob", 2)]
            gallery.add(captures, TEMPLATES_HASH)
        return path.read_bytes()


def _opened(folder, files):
    path = folder / "x.skg"

    def contents():
        with GalleryFile(path) as gallery:
            gallery.people()

    return _any(contents, lambda: gallery_scores(path))


def _galleries():
    probe = encode_template(_new("x", 1).template, VERSION)
    return [{"x.skg": _gallery(), "x.skt": probe}]


def _identified(folder, files):
    return identify(folder / "x.skg", folder / "x.skt")


def _candidates():
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "x.skg"
        Candidates({"a": _new("x", 1).template, "b": _new("x", 2).template}).save(path)
        return [{"x.skg": path.read_bytes()}]


def _loaded(folder, files):
    Candidates.load(folder / "x.skg").prepare()


def _exports():
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "x.skg"
        path.write_bytes(_gallery())
        return [_folder(lambda to: export_gallery(GalleryFile(path), to))]


def _imported(folder, files):
    with tempfile.TemporaryDirectory(dir=folder.parent) as scratch:
        path = Path(scratch) / "x.skg"
        try:
            import_gallery(GalleryFile(path), folder)
        except BadInput:
            assert not path.exists(), "a refused folder left a gallery"
            raise
        with GalleryFile(path) as gallery:
            assert len(gallery.people().templates) > 0, "nothing was imported"


# --- batch, populations, folders that grow
# -----------------------------------------------------------------------


def _enrolment(folder):
    enrolment = open_enrolment(folder, subjects=2, sessions=1, fingers=("right_index",))
    for place in enrolment.places():
        enrolment.path(place).mkdir(parents=True)
        (enrolment.path(place) / "capture.json").write_bytes(b"{}")
    facts = {
        "format": "splitknit-population",
        "format_version": 1,
        "settings_sha256": "ab" * 32,
        "settings": {},
    }
    (folder / "population.json").write_text(json.dumps(facts))


def _surface(path):
    arrays = _arrays()
    kinds = {"ridge_mm", "shape_mm", "normals", "mask", "input_from_upright", "upright_size"}
    parts = {name: arrays[name] for name in kinds}
    write_surface(path, Surface(pitch_mm=0.25, **parts), arrays["height_mm"])


@cache
def _store():
    def make(out):
        population = out / "people"
        _enrolment(population)
        there = read_population(population)
        store = out / "store"
        store.mkdir()
        open_store(store, there.sha256, *DOCUMENTS)
        for number, capture in enumerate(there.captures):
            filled = {"acquired": True, "template": waves(capture.finger, number)}
            row, name = failed_row(capture, "") | filled, f"{capture.name}.npz"
            write_table(store / "features" / "ea" / name, [row], {"kind": "features"})
            _surface(store / "surfaces" / "ea" / name)

    return _folder(make)


def _batch(folder, files):
    def opened():
        # where there is none, a store is begun
        if os.path.lexists(folder / "store" / "store.json"):
            open_store(folder / "store", read_population(folder / "people").sha256, *DOCUMENTS)

    store = Store(folder / "store")
    return _any(
        opened,
        store.document,
        lambda: store.features("ea"),
        lambda: store.features("ea", ["capture", "template"]),
        lambda: [place.surface() for place in store.places("features", "ea").values()],
        lambda: [read_origin(file) for file in store.files("features", "ea")],
    )


# --- calibration and separated light
# -----------------------------------------------------------------------------


def _tips():
    stream = io.StringIO()
    table = csv.writer(stream, lineterminator="\n")
    table.writerow(COLUMNS)
    for led in range(7):
        for nail in range(2):
            table.writerow(["white", led, nail, 300.5 + nail, 240.25, 280 - led, 250.75])
    return _each("bytes", stream.getvalue().encode())


def _tipped(data):
    check_tips(read_tips(data.decode("utf-8", "replace")), (480, 640))


def _radiometry():
    images = [f"{k}.png" for k in range(6)]
    document = {"format": "splitknit-radiometry", "version": 1}
    document |= {
        "exposures": [
            {"file": image, "exposure_s": 0.01 * (k + 1)} for k, image in enumerate(images)
        ]
    }
    pictures: Files = {
        name: encode_image(_noise(5, 6, seed=9), ".png") for name in (*images, "dark.png")
    }
    stack = {f"white_{k}.png": pictures["0.png"] for k in range(2)} | {
        "ambient_white.png": pictures["dark.png"]
    }
    return [{"radiometry.json": json.dumps(document).encode(), **pictures, **stack}]


def _radiometric(folder, files):
    return _any(
        lambda: read_exposures(folder),
        lambda: read_stack([folder / f"white_{k}.png" for k in range(2)], (5, 6), "srgb"),
    )


# --- the surface inside a page
# -----------------------------------------------------------------------------------


def _pages():
    report = {
        "preset": "metric",
        "warnings": ["x"],
        "quality": {"focus": 0.8},
        "timings_s": {"total": 1.5},
    }
    return [
        {"height.npz": _npz(_arrays())[0]["height.npz"], "report.json": json.dumps(report).encode()}
    ]


def _drawn(folder, files):
    return scene_of(read_result(folder), folder.name)


# --- all of them
# ------------------------------------------------------------------------------------------------


def put(folder, files):
    """Write files, and what stands in for a file."""
    for name, file in files.items():
        path = folder / name
        if not path.parent.is_dir():
            path.parent.mkdir(parents=True)
        if isinstance(file, bytes):
            path.write_bytes(file)
        elif file == "folder":
            path.mkdir()
        elif file == "pipe":
            os.mkfifo(path)
        elif file == "loop":
            path.symlink_to(path.name)
        else:
            path.touch()
            os.truncate(path, 3 << 30)


def _prints():
    return _written(
        "print.png", lambda path: write_print_png(path, _print(), 500.0, {"a": "b"})
    ) + _written("print.png", lambda path: path.write_bytes(encode_image(_print(), ".png")))


def _print_files():
    """A small print in every format, and minutiae in both."""
    image, small = _print(), _noise(70, 66)
    png, jpeg, bmp = (
        cv2.imencode(suffix, image)[1].tobytes() for suffix in (".png", ".jpg", ".bmp")
    )
    bmp = bmp[:38] + struct.pack("<II", 19685, 19685) + bmp[46:]
    held = PrintFile(small, 500.0, {}, "left_thumb")
    records = [encode_finger_image(held, how) for how in ("none", "png", "jp2")]
    records += [encode_finger_image_block(held, how) for how in ("none", "jp2")]
    jfif = jpeg[:13] + struct.pack(">BHH", 2, 394, 394) + jpeg[18:]
    others = encode_print_tiff(image, 600.0), encode_wsq(image), ISO_BYTES, ANSI_BYTES
    return _each("x", png, jfif, bmp, *records, *others)


def _print_file(folder, files):
    path = folder / "x"

    def read(ppi):
        for item in read_print_file(path, ppi):
            if isinstance(item, PrintFile):
                assert item.image.ndim == 2 and item.image.dtype == np.uint8
                assert item.resolution_ppi is not None and 200 <= item.resolution_ppi <= 5080
            else:
                minutiae_of(item)

    def measured():
        return [
            ridge_period_px(item.image) for item in read_prints(path) if isinstance(item, PrintFile)
        ]

    return _any(
        lambda: read(None), lambda: read(700.0), lambda: read_one_finger(path, 500.0), measured
    )


def _print_folder(folder, files):
    read_print_folder(folder)


TARGETS = (
    Target("image", _images, _of_files("image", _pixels)),
    Target("capture", _captures, _capture),
    Target("plain_images", _plain_images, _plain_capture),
    Target("photograph", _photographs, _photograph),
    Target(
        "fingerphoto", _fingerphotos, _of_files("x.jpg", lambda path: read_fingerphoto(path, 14.0))
    ),
    Target("match", _fingerphotos, _matched),
    Target("object", _balls, _object),
    Target(
        "rig",
        lambda: [{"rig.json": capture["rig.json"]} for capture in _captures()],
        _of_files("rig.json", read_rig),
    ),
    Target("normal_map", _normal_maps, _normal_map),
    Target("npz", _results, _of_files("height.npz", read_npz)),
    Target(
        "result", lambda: [{**result, "report.json": _REPORT} for result in _results()], _result
    ),
    Target("print_png", _prints, _of_files("print.png", read_print_png, read_one_finger)),
    Target("print_file", _print_files, _print_file),
    Target(
        "print_folder",
        lambda: [files | {"minutiae.iso": ISO_BYTES} for files in _prints()[:1]],
        _print_folder,
    ),
    Target(
        "template",
        _templates,
        _of_files("x.skt", lambda path: unpack(read_template(path, VERSION))),
        _skt_repaired,
    ),
    Target("template_payload", lambda: _each("bytes", waves("S01", 1)), _of_bytes(unpack)),
    Target("packed", _packed, _of_bytes(unpack_minutiae), _packed_repaired),
    Target(
        "minutiae_record", lambda: _each("x.fmr", ISO_BYTES, ANSI_BYTES, ANSI_2009_BYTES), _record
    ),
    Target("what", _print_files, lambda folder, files: what(folder / "x")),
    Target("transaction", _transactions, _of_files("x.eft", read_prints)),
    Target("wsq", lambda: _each("x.wsq", encode_wsq(_print())), _of_files("x.wsq", read_prints)),
    Target("scores", lambda: [{"scores.csv": SCORES}], _scores),
    Target(
        "settings-json", lambda: [{"x.json": json.dumps(_SETTINGS).encode()}], _settings("x.json")
    ),
    Target("settings-toml", lambda: [{"x.toml": _TOML}], _settings("x.toml")),
    Target("settings-set", lambda: [{"set": _SET}], _assignments),
    Target("network", _networks, _of_files("x.onnx", load_network), _network_repaired),
    Target("key", lambda: _each("key", b"ab" * 32 + b"\n", b"correct horse"), _keys),
    Target("gallery", lambda: _each("x.skg", _gallery()), _opened),
    Target("identify", _galleries, _identified, _skt_repaired),
    Target("candidates", _candidates, _loaded),
    Target("gallery_import", _exports, _imported, _skt_repaired),
    Target("batch", lambda: [_store()], _batch),
    Target(
        "batch_surface",
        lambda: _written("surface.npz", _surface),
        _of_files("surface.npz", read_surface),
    ),
    Target(
        "population", lambda: [_folder(_enrolment)], lambda folder, files: read_population(folder)
    ),
    Target(
        "earlier_output",
        lambda: _each("out/report.json", b'{"format": "x", "settings": {"a": [1, 2]}}'),
        lambda folder, files: check_target(folder / "out", "report.json", "an earlier x", form="x"),
    ),
    Target(
        "flat_images", _flat_images, lambda folder, files: read_flat(folder / "flat", 3, "linear")
    ),
    Target("rates", lambda: _each("rates.json", _RATES), _of_files("rates.json", read_own_rates)),
    Target("token", lambda: _each("token", b"b9T2cYw0\n"), _of_files("token", read_token)),
    Target(
        "intensities",
        lambda: _each("light_intensities.txt", b"1 1.5 2\n0.5, 0.7, 1\n"),
        _of_files("light_intensities.txt", lambda path: read_intensities(path, 2)),
    ),
    Target("light_table", _tips, _of_bytes(_tipped)),
    Target("radiometry", _radiometry, _radiometric),
    Target("result_in_page", _pages, _drawn),
)
