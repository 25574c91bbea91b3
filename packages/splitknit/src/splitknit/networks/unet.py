"""Trained networks: their files, and running them on images of any size, the same for any number of
threads.

``NAME.onnx`` holds the weights, and ``NAME.json``, the card, states what goes in and out, where the
weights come from (data, seed, metrics, licence, the command that makes them again), and their
SHA-256, which is checked whenever they are read. Every network that turns an image of C channels
into one of D channels and the same size can be run: the U-Net that separates direct light (thesis,
section 3.3.1.4), and others of the library.
"""

from __future__ import annotations

import hashlib
import json
import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import resources
from importlib.resources.abc import Traversable
from itertools import pairwise, product
from pathlib import Path
from typing import Any
from weakref import WeakValueDictionary

import numpy as np

from splitknit.errors import BadInput, importing, refusing, require
from splitknit.files import read_bytes
from splitknit.model import FloatArray

FORMAT = "splitknit-network"
REINSTALL = "reinstall splitknit, or name another network"


@dataclass(frozen=True, slots=True)
class Card:
    """What is known of a network; :attr:`facts` holds the whole document."""

    name: str
    sha256: str  # hash of the ``.onnx`` file, hexadecimal
    channels_in: int
    channels_out: int
    stride: int  # both sides of an image must be multiples of this; :func:`run_network` sees to it
    # a pixel further than this from a tile on the stride's grid does not change the tile's result
    reach: int
    # data, training, metrics, licence, command
    facts: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        limits = (
            ("channels_in", 1, 4096),
            ("channels_out", 1, 4096),
            ("stride", 1, 256),
            ("reach", 0, 4096),
        )
        for name, low, high in limits:
            value = getattr(self, name)
            require(
                type(value) is int and low <= value <= high,
                f"the card of network '{self.name}' gives {name} as {value!r}; it must be a whole "
                f"number from {low} to {high}.",
            )


def read_network(name: str | os.PathLike[str]) -> tuple[Card, bytes]:
    """A network's card and the bytes of its ONNX file, checked. `name`: of a network in the
    package, or an ``.onnx`` file with its card, a ``.json``, beside it. Raises BadInput if one is
    missing or damaged, or they do not belong together.
    """
    weights_file, card_file, remedy = _files(name)
    weights = _read(weights_file, f"the weights '{weights_file}'", remedy)
    card = _parse(_read(card_file, f"the card '{card_file}'", remedy), card_file, remedy)
    digest = hashlib.sha256(weights).hexdigest()
    require(
        digest == card.sha256,
        f"the weights '{weights_file}' are damaged or not those of their card (SHA-256 "
        f"{digest[:12]}... instead of {card.sha256[:12]}...); {remedy}.",
    )
    return card, weights


def _files(name: str | os.PathLike[str]) -> tuple[Traversable, Traversable, str]:
    """Paths of weights and card, and the remedy for messages."""
    text = os.fspath(name)
    if text.endswith(".onnx"):
        path = Path(text).expanduser()
        return (
            path,
            path.with_suffix(".json"),
            "copy the network again or train it again (training/README.md)",
        )
    shipped = resources.files("splitknit.networks") / "shipped"
    known = sorted(
        Path(file.name).stem for file in shipped.iterdir() if file.name.endswith(".onnx")
    )
    require(
        text in known,
        f"there is no network '{text}' in this installation; name one of {', '.join(known)}, or "
        "the path of an .onnx file.",
    )
    return shipped / f"{text}.onnx", shipped / f"{text}.json", REINSTALL


def _read(file: Traversable, words: str, remedy: str) -> bytes:
    try:
        # bytes; the shipped ones have less than 1 MB
        return read_bytes(file, 500_000_000) if isinstance(file, Path) else file.read_bytes()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error).rstrip(".")
        raise BadInput(f"{words} cannot be read ({reason}); {remedy}.") from error


def _parse(data: bytes, file: Traversable, remedy: str) -> Card:
    with refusing(f"the card '{file}' is damaged; {remedy}."):
        # bytes; the shipped ones have 3 kB
        require(
            len(data) <= 1_000_000,
            f"the card '{file}' has {len(data)} bytes, too many; {remedy}.",
        )
        document = json.loads(data)
        require(
            document["format"] == FORMAT and document["version"] == 1,
            f"'{file}' is not the card of a network (format {FORMAT}, version 1); {remedy}.",
        )
        sizes = {key: document[key] for key in ("channels_in", "channels_out", "stride", "reach")}
        return Card(str(document["name"]), str(document["sha256"]), **sizes, facts=document)


_threads = min(8, os.cpu_count() or 1)
"""Threads of a network that this process loads."""

# variable of onnxruntime; ``1`` stops files, look-ups, uploads of telemetry
NO_TELEMETRY = "ORT_DISABLE_TELEMETRY"


def network_threads() -> int:
    """Threads of networks that this process loads now."""
    return _threads


def use_network_threads(threads: int) -> None:
    """Choose the threads of networks that this process loads from now on; results are the same for
    any number."""
    global _threads  # noqa: PLW0603 - sessions are the whole process's
    _threads = threads


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class Network:
    """A network that is ready to run; threads may share it."""

    card: Card
    session: Any  # onnxruntime.InferenceSession of one input and one output


def load_network(name: str | os.PathLike[str]) -> Network:
    """Load a network (of the package: once while in use), or an ``.onnx`` file with its card beside
    it, and check its hash. Raises BadInput if one is missing or damaged, or onnxruntime is not
    installed.
    """
    text = os.fspath(name)
    if text.endswith(".onnx"):
        return network_of(*read_network(text))
    network = _IN_USE.get((text, _threads))
    if network is None:
        network = _IN_USE[text, _threads] = network_of(*read_network(text))
    return network


_IN_USE: WeakValueDictionary[tuple[str, int], Network] = WeakValueDictionary()
"""Cache of loaded networks by name and threads, held weakly: their 0.3 GB are freed when unused."""


def network_of(card: Card, weights: bytes) -> Network:
    """Prepare weights in memory. Raises BadInput if `weights` is not such a network, or may refer
    to external files, which no hash covers: ONNX keeps their place under the key ``location``
    (onnx.proto, TensorProto.external_data), a string stored as it is; ONNX Runtime's own format
    (``ORTM``) has further ways.
    """
    require(
        b"location" not in weights and weights[4:8] != b"ORTM",
        f"network '{card.name}' may refer to data outside its file, which the SHA-256 of its card "
        "does not cover; save it as one ONNX file, and name no part of it 'location'.",
    )
    onnxruntime = _onnxruntime()
    options = onnxruntime.SessionOptions()
    # its threads share the values of a result, never the terms of a sum: the same bits for any
    # number of them
    options.intra_op_num_threads = _threads
    options.inter_op_num_threads = 1
    # waiting costs no processor time
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    # it plans memory anew for every shape of a tile and keeps all the plans' memory: 0.5 GB more,
    # and no faster
    options.enable_mem_pattern = False
    options.log_severity_level = 3
    try:
        # without enable_fallback=0 it prints what it could not load, and tries the same once more
        session = onnxruntime.InferenceSession(
            weights, options, providers=["CPUExecutionProvider"], enable_fallback=0
        )
        (_,), (_,) = session.get_inputs(), session.get_outputs()
    # onnxruntime has a dozen exceptions of its own, without a common base
    except Exception as error:
        raise BadInput(
            f"the weights of network '{card.name}' are not a network from one image to one image "
            f"that onnxruntime can run ({_first_line(error)}); train it again."
        ) from error
    return Network(card, session)


def _onnxruntime() -> Any:
    """Import onnxruntime with its telemetry off; every use goes through here. Version 1.31 sends a
    device id and events from the user's cache folder. The variable is read when loaded;
    ``disable_telemetry_events()`` comes too late for the files.
    """
    require(
        sys.modules.get("onnxruntime") is None or os.environ.get(NO_TELEMETRY) == "1",
        "onnxruntime was imported with its telemetry on, before splitknit could turn it off; set "
        f"the environment variable {NO_TELEMETRY}=1 before that import.",
    )
    os.environ[NO_TELEMETRY] = "1"  # also over 0, with which it is on
    with importing("networks need onnxruntime, which cannot be imported; pip install onnxruntime."):
        import onnxruntime  # type: ignore[import-untyped]
    return onnxruntime


def run_network(network: Network, images: FloatArray, *, tile: int = 724) -> FloatArray:
    """Run `network` on every image, (N, H, W) or (N, C, H, W) float32; returns (N, D, H, W)
    float32.

    One channel is repeated for a network that takes more. Sides that are not multiples of the
    stride are lengthened by reflection at the lower and right borders, and the result is cut back;
    tiles overlap by the network's reach. `tile`: side in pixels of the square that is processed at
    once; memory grows with its square (a network of width 12 needs 0.4 GB, of width 64 2 GB), the
    result changes by rounding (about 1e-6). Raises BadInput if the images have the wrong number of
    channels, hold NaN, or are smaller than the network's stride.
    """
    stack = _checked(images, network.card)
    count, channels, height, width = stack.shape
    stride = network.card.stride
    padded = (height + -height % stride, width + -width % stride)
    tiles = _plan_tiles(padded, tile, reach=network.card.reach, stride=stride)
    result = np.empty((count, network.card.channels_out, height, width), dtype=np.float32)

    for k, (source, inner, target) in product(range(count), tiles):
        piece = stack[(k, slice(None), *source)]
        beyond = [(0, s.stop - s.start - n) for s, n in zip(source, piece.shape[1:], strict=True)]
        if any(more for _, more in beyond):
            piece = np.pad(piece, ((0, 0), *beyond), mode="reflect")
        if channels != network.card.channels_in:
            piece = np.broadcast_to(piece, (network.card.channels_in, *piece.shape[1:]))
        output = _infer(network, np.ascontiguousarray(piece)[None])[0]
        room = result[(k, slice(None), *target)]
        room[...] = output[(slice(None), *inner)][:, : room.shape[1], : room.shape[2]]
    return result


def _infer(network: Network, image: FloatArray) -> FloatArray:
    card = network.card
    try:
        (source,) = network.session.get_inputs()
        (output,) = network.session.run(None, {source.name: image})
    except Exception as error:  # as above
        raise BadInput(
            f"network '{card.name}' cannot be run ({_first_line(error)}); see its card."
        ) from error
    expected = (1, card.channels_out, *image.shape[2:])
    require(
        output.shape == expected,
        f"network '{card.name}' gave an array of the shape {output.shape} where its card promises"
        f" {expected}.",
    )
    return np.asarray(output)


def _checked(images: Any, card: Card) -> FloatArray:
    stack = np.asarray(images, dtype=np.float32)
    if stack.ndim == 3:
        stack = stack[:, None]
    require(
        stack.ndim == 4 and stack.size > 0,
        f"images must have the shape (N, H, W) or (N, C, H, W), but they have {np.shape(images)}.",
    )
    _, channels, height, width = stack.shape
    require(
        channels in (1, card.channels_in),
        f"network '{card.name}' takes images of {card.channels_in} channels, but these have"
        f" {channels}.",
    )
    require(
        min(height, width) >= card.stride,
        f"images of {height} x {width} pixels are too small for network '{card.name}': its stride "
        f"is {card.stride} pixels; give images of at least {card.stride} x {card.stride}.",
    )
    require(np.isfinite(stack).all(), "images contain NaN or infinite values.")
    return stack


def _first_line(error: BaseException) -> str:
    lines = str(error).strip().splitlines()
    return lines[0][:200] if lines else type(error).__name__


# Cutting an image into tiles that a convolutional network takes one at a time, with the same result
# as in one piece. A network that halves its images three times works on a grid of 8 pixels (its
# *stride*), and what it makes of a pixel depends on the image up to some distance away (its
# *reach*). Tiles begin and end on that grid and carry a margin of at least the reach on every side
# where the image goes on; the margin's result is thrown away.


def _plan_tiles(shape: tuple[int, int], tile: int, *, reach: int, stride: int) -> list[_Tile]:
    """Cut a padded image, `shape` in multiples of `stride`, across its longer side into as few
    tiles of nearly one size as have, with their margins (`reach`, px), no more pixels than squares
    of side `tile`. Returns rows and columns that the network sees, those of its result that count,
    and where they go.
    """
    require(tile >= 1, f"tile must be at least 1 pixel, but it is {tile}.")
    limit = (-(-tile // stride) * stride + 2 * (-(-reach // stride) * stride)) ** 2
    short, long = sorted(shape)
    for pieces in range(1, long // stride + 1):
        strips = _spans(long, pieces, reach, stride)
        if max(span[0].stop - span[0].start for span in strips) * short <= limit:
            break
    (whole,) = _spans(short, 1, reach, stride)
    pairs = [(strip, whole) if shape[0] == long else (whole, strip) for strip in strips]
    return [((r[0], c[0]), (r[1], c[1]), (r[2], c[2])) for r, c in pairs]


_Span = tuple[slice, slice, slice]
_Part = tuple[slice, slice]
_Tile = tuple[_Part, _Part, _Part]


def _spans(length: int, pieces: int, reach: int, stride: int) -> list[_Span]:
    """Source, inner and target of each of so many pieces along one axis."""
    margin = -(-reach // stride) * stride
    edges = [round(k * (length // stride) / pieces) * stride for k in range(pieces + 1)]
    spans = []
    for first, last in pairwise(edges):
        low, high = max(first - margin, 0), min(last + margin, length)
        spans.append((slice(low, high), slice(first - low, last - low), slice(first, last)))
    return spans
