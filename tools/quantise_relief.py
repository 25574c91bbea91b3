"""Make the relief network compute in whole numbers of 8 bits: half the time and memory of single precision.

    python tools/quantise_relief.py DIR/relief.onnx --out src/splitknit/networks/shipped

takes what `splitknit train relief --out DIR` made. The ranges of all layers are those on simulated fingers (static
quantisation); the two convolutions nearest to the input and the two nearest to the output stay as they are, and the
last is fitted anew, by least squares, to what the network drew before. Weights have seven bits, so that no processor's
sums overflow and all of them compute the same. Needs onnx (extra `train`).
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

import splitknit
from splitknit.networks.unet import _onnxruntime
from splitknit.networks.weights import card_bytes, read_network
from splitknit.pipeline import linear_images, locate_finger, reconstruct_skin
from splitknit.presets import preset_settings
from splitknit.settings import override
from splitknit.skin.learned import Networks

FINGERS = (2006, 2007)
"""Seeds of the simulated fingers, which no page measures."""
SIDE, RIM = 192, 32
"""Pixels of a piece, and those of it that do not count in the fit since the network sees no further."""


def fields_of(seed: int, network: Path) -> list[Any]:
    """What the network sees of a finger: (32, h, w) in each of its runs."""
    settings = override(preset_settings("metric"), {"metric.network": str(network)})
    capture, finger = locate_finger(splitknit.simulate_capture(seed, settings={"scale": 0.5})[0], settings.finding())
    images = linear_images(capture, finger, settings)
    assert images.networks is not None
    relief, seen = images.networks.relief, []

    def recording(fields: Any) -> Any:
        seen.append(fields.copy())
        return relief(fields)

    networks = Networks(recording, images.networks.shape)
    reconstruct_skin(images.bands, images.grid, settings.skin, settings.metric, None, networks)
    return seen


def pieces(fields: list[Any], count: int, seed: int) -> Iterator[Any]:
    """Pieces (1, 32, SIDE, SIDE) of all fingers in turns."""
    draw = np.random.default_rng(seed)
    for _ in range(count):
        for one in fields:
            row, column = (int(draw.integers(length - SIDE)) for length in one.shape[1:])
            yield np.ascontiguousarray(one[None, :, row : row + SIDE, column : column + SIDE])


def quantised(file: Path, fields: list[Any]) -> bytes:
    """The network of `file` in 8 bits."""
    onnxruntime = _onnxruntime()
    import onnx  # noqa: PLC0415 - of the extra `train`
    from onnxruntime import quantization as q  # noqa: PLC0415

    def running(model: Any) -> Any:
        return onnxruntime.InferenceSession(model, providers=["CPUExecutionProvider"])

    with tempfile.TemporaryDirectory() as folder:
        folded, small = Path(folder) / "folded.onnx", Path(folder) / "small.onnx"
        options = onnxruntime.SessionOptions()
        options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_ENABLE_BASIC
        options.optimized_model_filepath = str(folded)  # its weights in single precision
        before = onnxruntime.InferenceSession(str(file), options, providers=["CPUExecutionProvider"])
        graph = onnx.load(folded).graph
        source, made = graph.input[0].name, graph.output[0].name
        convolutions = [node.name for node in graph.node if node.op_type == "Conv"]
        kept = [node.name for node in graph.node if node.op_type == "Mul"] + convolutions[:2] + convolutions[-2:]

        class Reader(q.CalibrationDataReader):
            given = pieces(fields, 8, 0)

            def get_next(self) -> Any:
                piece = next(self.given, None)
                return None if piece is None else {source: piece}

        q.quantize_static(
            folded, small, Reader(), quant_format=q.QuantFormat.QDQ, per_channel=True, reduce_range=True,
            activation_type=q.QuantType.QUInt8, weight_type=q.QuantType.QInt8, nodes_to_exclude=kept,
        )  # fmt: skip
        model = onnx.load(small)
    (last,) = (node for node in model.graph.node if node.name == convolutions[-1])
    model.graph.output.append(onnx.helper.make_tensor_value_info(last.input[0], onnx.TensorProto.FLOAT, None))
    after = running(model.SerializeToString())
    del model.graph.output[-1]
    normal: Any = 0.0
    wanted: Any = 0.0
    for piece in pieces(fields, 8, 1):
        skin = np.zeros((SIDE, SIDE), dtype=bool)
        skin[RIM:-RIM, RIM:-RIM] = piece[0, :, RIM:-RIM, RIM:-RIM].any(axis=0)
        drawn = before.run([made], {source: piece})[0][0][:, skin].astype(np.float64)
        level = after.run([last.input[0]], {source: piece})[0][0][:, skin].astype(np.float64)
        level = np.concatenate([level, np.ones((1, level.shape[1]))])
        normal, wanted = normal + level @ level.T, wanted + level @ drawn.T
    numbers = {one.name: one for one in model.graph.initializer}
    weight, bias = (onnx.numpy_helper.to_array(numbers[name]) for name in last.input[1:])
    given = np.concatenate([weight.reshape(len(weight), -1).T, bias[None]])
    little = 1e-4 * np.trace(normal) / len(normal) * np.eye(len(normal))  # stay near what was there
    fitted = np.linalg.solve(normal + little, wanted + little @ given).astype(np.float32)
    for name, values in zip(last.input[1:], (fitted[:-1].T.reshape(weight.shape), fitted[-1]), strict=True):
        numbers[name].CopyFrom(onnx.numpy_helper.from_array(np.ascontiguousarray(values), name))
    return bytes(model.SerializeToString())


def main() -> None:
    """Write network and card into a folder."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("network", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    card, _ = read_network(options.network)
    weights = quantised(options.network, [one for seed in FINGERS for one in fields_of(seed, options.network)])
    facts = {name: value for name, value in card.facts.items() if name not in {"format", "version", "name", "sha256"}}
    facts["quantised"] = {
        "command": "python tools/quantise_relief.py DIR/relief.onnx --out DIR",
        "from_sha256": card.sha256,
        "fingers": list(FINGERS),
        "precision": "activations 8 bits, weights 7; single precision in the first and the last two convolutions",
        "metrics": "those of this card are the network's before",
    }
    (options.out / f"{card.name}.onnx").write_bytes(weights)
    (options.out / f"{card.name}.json").write_bytes(card_bytes(card.name, weights, facts))


if __name__ == "__main__":
    main()
