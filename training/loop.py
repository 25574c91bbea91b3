"""What the three trainings share: stored data, both U-Nets, the loop, and the ONNX file with its
card (torch)."""

from __future__ import annotations

import copy
import hashlib
import io
import json
import math
import shutil
import tempfile
import warnings
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from torch import nn

from splitknit.errors import BadInput
from splitknit.io.csv_table import csv_text
from splitknit.networks.unet import FORMAT, network_of, read_network, run_network
from splitknit.workers import run_jobs

FIELDS = 32  # fields that `relief` and `shape` see, the first of a sample
LAST_RATE = 0.02  # learning rate at the end of a training, relative to its maximum
FURTHER_RATE = 0.4  # maximal rate of a network that begins with stored weights, likewise
# of the exported network, over the output's range: its weights are stored in half precision
MAX_DIFFERENCE = 0.02


# --- data: one folder a subject, empty where the subject was refused
# ----------------------------------------------


def make_data(out, subjects, shoot, workers):
    """Photograph the `subjects` ((kind, number) each) that `out` lacks, and map the arrays of those
    not refused.

    `shoot`: function of a module, from kind and number to a list of arrays.
    """
    (out / "data").mkdir(parents=True, exist_ok=True)
    folders = {subject: out / "data" / "{}_{:07d}".format(*subject) for subject in subjects}
    missing = [subject for subject, folder in folders.items() if not folder.exists()]
    for done, (subject, _) in enumerate(
        run_jobs(partial(_store, out, shoot), missing, workers, f"what is in {out}"), 1
    ):
        print(f"data {done} of {len(missing)}: {subject[0]} {subject[1]}", flush=True)
    files_of = {subject: sorted(folder.glob("*.npy")) for subject, folder in folders.items()}
    return {
        subject: [np.load(file, mmap_mode="r") for file in files]
        for subject, files in files_of.items()
        if files
    }


def _store(out, shoot, subject):
    folder = Path(tempfile.mkdtemp(dir=out))
    try:
        for k, array in enumerate(shoot(*subject)):
            np.save(folder / f"{k:03d}.npy", array)
    except BadInput as refusal:
        print("{} {}: {}".format(*subject, refusal), flush=True)
        shutil.rmtree(folder)
        folder.mkdir()
    folder.rename(out / "data" / "{}_{:07d}".format(*subject))


# --- networks
# -------------------------------------------------------------------------------------------------


def _block(before, after, *more):
    return nn.Sequential(
        nn.Conv2d(before, after, 3, padding=1),
        nn.ReLU(),
        nn.Conv2d(after, after, 3, padding=1),
        nn.ReLU(),
        *more,
    )


class ThesisUNet(nn.Module):
    """The U-Net of the thesis (figure 3.19): three encoder blocks, a bridge, three decoder blocks.

    `width`: channels of the first block, which double from block to block; `dropout`: fraction
    dropped after the last encoder block and the bridge; `start_fraction`: the untrained network
    returns this fraction of its image.
    """

    CHANNELS, DEPTH = 3, 3

    def __init__(self, width, dropout, start_fraction):
        super().__init__()
        widths = [width << level for level in range(self.DEPTH + 1)]
        drop = [nn.Dropout(dropout)] if dropout > 0 else []
        befores = [self.CHANNELS, *widths[:-1]]
        self.encoder = nn.ModuleList(
            _block(before, after, *(drop if level == self.DEPTH - 1 else []))
            for level, (before, after) in enumerate(zip(befores, widths[:-1], strict=False))
        )
        self.bridge = _block(widths[-2], widths[-1], *drop)
        self.rise = nn.ModuleList(
            nn.Sequential(nn.ConvTranspose2d(2 * channels, channels, 2, stride=2), nn.ReLU())
            for channels in reversed(widths[:-1])
        )
        self.decoder = nn.ModuleList(
            _block(2 * channels, channels) for channels in reversed(widths[:-1])
        )
        self.last = nn.Conv2d(width, self.CHANNELS, 1)
        for module in self.modules():
            if isinstance(module, (nn.Conv2d, nn.ConvTranspose2d)):  # He et al. 2015
                nn.init.kaiming_normal_(module.weight, nonlinearity="relu")
                nn.init.zeros_(module.bias)
        with torch.no_grad():
            self._begin_with(start_fraction, width)

    def _begin_with(self, fraction, width):
        """Let first channels pass the image on, and the last layer listen to them."""
        self.last.weight.mul_(0.1)
        if fraction == 0:
            return
        outer, inner = self.encoder[0], self.decoder[-1]
        for layer, first in ((outer[0], 0), (outer[2], 0), (inner[0], width), (inner[2], 0)):
            for channel in range(self.CHANNELS):
                layer.weight[channel] = 0.0
                layer.weight[channel, first + channel, 1, 1] = 1.0
        for channel in range(self.CHANNELS):
            self.last.weight[channel, : self.CHANNELS] = 0.0
            self.last.weight[channel, channel] = fraction

    def forward(self, image):
        skipped = []
        for stage in self.encoder:
            image = stage(image)
            skipped.append(image)
            image = nn.functional.max_pool2d(image, 2)
        image = self.bridge(image)
        for rise, stage in zip(self.rise, self.decoder, strict=True):
            image = stage(torch.cat([rise(image), skipped.pop()], dim=1))
        return self.last(image)


class FieldsUNet(nn.Module):
    """The U-Net (Ronneberger et al. 2015) of the `metric` networks: it runs on a processor.

    Every level, of `widths` channels, the finest first, is two convolutions; down: maxima over 2 x
    2 pixels; up: pixels doubled. Fields are first multiplied by `scale`.
    """

    def __init__(self, widths, scale, outputs):
        super().__init__()
        befores = [len(scale), *widths[:-1]]
        self.widths = widths
        self.down = nn.ModuleList(
            _block(before, after) for before, after in zip(befores, widths, strict=True)
        )
        self.up = nn.ModuleList(
            _block(fine + coarse, fine) for fine, coarse in reversed(list(pairwise(widths)))
        )
        self.out = nn.Conv2d(widths[0], outputs, 1)
        self.register_buffer("scale", torch.from_numpy(scale))

    def forward(self, image):
        image = image * self.scale[:, None, None]
        kept = []
        for number, stage in enumerate(self.down):
            image = stage(nn.functional.max_pool2d(image, 2) if number else image)
            kept.append(image)
        kept.pop()
        for stage, coarse in zip(self.up, reversed(self.widths[1:]), strict=True):
            image = nn.functional.interpolate(image, scale_factor=2, mode="nearest")
            # beside what the level had: two sums instead of joined maps, which take a third of all
            # memory
            weight, bias = (part.float() for part in (stage[0].weight, stage[0].bias))
            above = nn.functional.conv2d(image, weight[:, :coarse], padding=1)
            image = stage[1:](
                above + nn.functional.conv2d(kept.pop(), weight[:, coarse:], bias, padding=1)
            )
        return self.out(image)


# --- the loop
# -------------------------------------------------------------------------------------------------


class Training:
    """A network in training (AdamW); on a processor the same data, seed and threads give the same
    weights."""

    def __init__(
        self, build, *, seed, threads, device, mixed, weight_decay=0.0, gradient_limit=None
    ):
        """Draw the weights; `mixed`: bfloat16 products, float32 weights and sums."""
        torch.set_num_threads(threads)
        torch.manual_seed(seed)
        self.device, self.mixed, self.gradient_limit = device, mixed, gradient_limit
        # channels last: convolutions of few channels run about twice as fast
        self.network = build().to(device, memory_format=torch.channels_last)
        self.optimiser = torch.optim.AdamW(self.network.parameters(), weight_decay=weight_decay)

    def tensor(self, array):
        return torch.from_numpy(np.ascontiguousarray(array)).to(
            self.device, memory_format=torch.channels_last
        )

    def forward(self, images):
        with torch.autocast(self.device, dtype=torch.bfloat16, enabled=self.mixed):
            output = self.network(images)
        return output.float()

    def run(self, images):
        """(n, H, W) or (N, n, H, W) through the network as it is, in single precision."""
        self.network.eval()
        with torch.no_grad():
            output = (
                self.network(self.tensor(images if images.ndim == 4 else images[None]))
                .float()
                .cpu()
                .numpy()
            )
        return output if images.ndim == 4 else output[0]

    def step(self, loss, learning_rate):
        for group in self.optimiser.param_groups:
            group["lr"] = learning_rate
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()
        if self.gradient_limit is not None:
            nn.utils.clip_grad_norm_(self.network.parameters(), self.gradient_limit)
        self.optimiser.step()


def report(out, rows, row):
    """Add a row to the learning curve, `curve.csv`, and print it."""
    if not all(map(math.isfinite, row.values())):
        raise SystemExit("the training diverged: its loss is not finite.")
    rows.append(row)
    (out / "curve.csv").write_text(csv_text([list(rows[0]), *(line.values() for line in rows)]))
    print(", ".join(f"{name} {value:.4g}" for name, value in row.items()), flush=True)


# --- relief and shape: patches of samples (channels, h, w), fields first, the weight last
# -------------------------


def draw_patch(task, samples, rng):
    """(channels, side, side) anywhere in any sample that holds enough skin; zero where it reaches
    over the sample. `samples`: arrays of each kind, drawn by ``task.shares``."""
    side, beyond = task.patch_px, task.beyond_px
    kinds = list(samples)
    shares = np.array([task.shares[kind] for kind in kinds])
    while True:
        of_kind = samples[kinds[int(rng.choice(len(kinds), p=shares / shares.sum()))]]
        sample = of_kind[int(rng.integers(len(of_kind)))]
        corner = [
            int(rng.integers(-beyond, max(1 - beyond, length - side + beyond)))
            for length in sample.shape[1:]
        ]
        window = tuple(slice(max(start, 0), max(start + side, 0)) for start in corner)
        part = np.asarray(sample[(slice(None), *window)], dtype=np.float32)
        before = [max(-start, 0) for start in corner]
        beside = [
            (low, side - low - length) for low, length in zip(before, part.shape[1:], strict=True)
        ]
        patch = np.pad(part, ((0, 0), *beside))
        if patch[-1].mean() >= task.min_weight:
            return patch


_ORIENTATIONS = ((0, 0), (1, 0), (1, 2), (0, 2), (1, 1), (0, 1), (0, 3), (1, 3))
"""Whether a patch is mirrored, and its quarter turns then, by the number that is drawn."""


def mirrored(symmetry, fields):
    """Left and right swapped: x becomes -x, an azimuth a becomes pi - a."""
    swapped = np.array(fields[:, :, ::-1])
    harmonics = symmetry.vectors, symmetry.second_harmonics, symmetry.third_harmonics
    for order, pairs in enumerate(harmonics, 1):
        for cosine, sine in pairs:
            swapped[cosine if order % 2 else sine] *= -1
    return swapped


def draw_batch(task, samples, iteration):
    """(batch, channels, side, side) of an iteration, in one of eight orientations each."""
    rng = np.random.default_rng(np.random.SeedSequence([0, 0xBE, iteration]))
    patches = []
    for _ in range(task.batch):
        patch = draw_patch(task, samples, rng)
        swapped, quarters = _ORIENTATIONS[rng.integers(8)]
        patch = mirrored(task.symmetry, patch) if swapped else patch
        patch = task.symmetry.turned(patch, quarters)
        if task.nir_fields and rng.random() < task.no_nir_share:
            patch = np.array(patch, dtype=np.float32)
            patch[list(task.nir_fields)] = 0.0
        patches.append(patch)
    return np.stack(patches)


def field_scale(task, samples):
    """(32,) factors that bring the fields to about one scale: one over their standard deviation in
    a few patches."""
    rng = np.random.default_rng(np.random.SeedSequence([0, 0x5C]))
    drawn = [draw_patch(task, samples, rng)[:FIELDS] for _ in range(task.scale_patches)]
    return np.asarray(
        1.0 / np.maximum(np.stack(drawn).std(axis=(0, 2, 3)), task.min_deviation), dtype=np.float32
    )


def weights_of(file):
    """Weights and field scale of a network that :func:`train_fields` wrote, by their names."""
    import onnx

    return {
        tensor.name: torch.from_numpy(onnx.numpy_helper.to_array(tensor).astype(np.float32))
        for tensor in onnx.load(file).graph.initializer
    }


def train_fields(
    task, out, command, samples, held_out, *, iterations, start=None, threads=1, device="cpu"
):
    """Train `relief` or `shape` (a `Task` of their scripts), and write it into `out`.

    `samples`, `held_out`: arrays of each kind, to be trained and judged on; `start`: file of the
    network whose weights it begins with.
    """
    stored = weights_of(start) if start else {}
    scale = stored["scale"].numpy() if stored else field_scale(task, samples)
    training = Training(
        lambda: FieldsUNet(task.widths, scale, task.outputs),
        seed=0,
        threads=threads,
        device=device,
        mixed=True,
        weight_decay=task.weight_decay,
        gradient_limit=5.0,
    )
    if stored:
        training.network.load_state_dict(stored)
    maximal_rate = task.learning_rate * (FURTHER_RATE if stored else 1.0)
    rows, losses = [], []
    stride = 2 ** (len(task.widths) - 1)
    for iteration in range(iterations):
        training.network.train()
        patches = training.tensor(draw_batch(task, samples, iteration))
        seen = patches[:, :FIELDS].contiguous(memory_format=torch.channels_last)
        loss = task.loss(training.forward(seen), patches)
        fall = 0.5 * (1.0 + math.cos(math.pi * min(iteration / iterations, 1.0)))
        rise = min(1.0, (iteration + 1) / task.warm_up)
        training.step(loss, maximal_rate * rise * (fall * (1.0 - LAST_RATE) + LAST_RATE))
        losses.append(float(loss.detach()))
        if (iteration + 1) % 200 == 0 or iteration + 1 == iterations:
            means = {}
            for kind, arrays in held_out.items():
                figures = [task.judge(training.run, sample, stride) for sample in arrays]
                means |= _mean_figures(kind, figures)
            report(out, rows, {"iteration": iteration + 1, "loss": float(np.mean(losses)), **means})
            losses = []
    widths = ", ".join(map(str, task.widths))
    judged_on = ", ".join(f"{len(arrays)} samples of {kind}" for kind, arrays in held_out.items())
    facts = {
        "command": command,
        "training": {
            "iterations": iterations,
            "batch": task.batch,
            "patch_px": task.patch_px,
            "threads": threads,
        },
        "data": {
            kind: {"samples": len(arrays), "share": task.shares[kind]}
            for kind, arrays in samples.items()
        },
        "metrics": {
            "held_out": f"{judged_on} not trained on{task.held_out}",
            "mean": {name: round(value, 4) for name, value in means.items()},
        },
        "architecture": f"U-Net of {len(task.widths)} levels, widths {widths}",
    }
    write_network(
        out, task.name, training, task.what, (FIELDS, task.outputs), len(task.widths) - 1, facts
    )


def _mean_figures(kind, figures):
    """Means over fingers, named ``KIND_FIGURE``; a figure that is NaN for every finger is left
    out."""
    columns = {name: [row[name] for row in figures] for name in figures[0]}
    return {
        f"{kind}_{name}": float(np.nanmean(values))
        for name, values in columns.items()
        if np.isfinite(values).any()
    }


# --- the file
# -------------------------------------------------------------------------------------------------


def reach(depth):
    """How far beyond a stretch that begins on the stride's grid an input can change the network's
    result, in pixels."""
    pixels = 0
    for _ in range(depth):  # decoder, from fine to coarse
        pixels = -(-(pixels + 2) // 2)
    pixels += 2  # bridge
    for _ in range(depth):  # encoder, from coarse to fine
        pixels = 2 * pixels + 2
    return pixels


class _Halved(nn.Module):
    """A convolution whose weights are stored in half precision and computed with in single: 0.05 %
    at most."""

    def __init__(self, layer):
        super().__init__()
        self.register_buffer("weight", layer.weight.detach().half())
        self.register_buffer("bias", layer.bias.detach().half())
        self.padding, self.stride = layer.padding, layer.stride
        rising = isinstance(layer, nn.ConvTranspose2d)
        self.convolve = nn.functional.conv_transpose2d if rising else nn.functional.conv2d

    def forward(self, image):
        return self.convolve(
            image, self.weight.float(), self.bias.float(), stride=self.stride, padding=self.padding
        )


def onnx_bytes(network, channels, stride):
    """The ONNX file; height and width of images may be any multiples of `stride`."""
    stored = copy.deepcopy(network).cpu().eval()
    for module in list(stored.modules()):
        for name, child in list(module.named_children()):
            if isinstance(child, (nn.Conv2d, nn.ConvTranspose2d)):
                setattr(module, name, _Halved(child))
    axes = {0: "images", 2: "rows", 3: "columns"}
    buffer = io.BytesIO()
    with warnings.catch_warnings(), torch.no_grad():
        # of the older exporter, which needs no further packages, that it is older
        warnings.simplefilter("ignore")
        torch.onnx.export(
            stored,
            (torch.zeros(1, channels, 8 * stride, 8 * stride),),
            buffer,
            dynamo=False,
            input_names=["image"],
            output_names=["direct"],
            dynamic_axes={"image": axes, "direct": axes},
            opset_version=17,
            do_constant_folding=False,
        )
    return buffer.getvalue()


def write_network(out, name, training, what, channels, depth, facts):  # noqa: PLR0917
    """Write `NAME.onnx` and its card; check that onnxruntime computes what torch does."""
    weights = onnx_bytes(training.network, channels[0], 2**depth)
    head = {
        "format": FORMAT,
        "version": 1,
        "name": name,
        "sha256": hashlib.sha256(weights).hexdigest(),
        "channels_in": channels[0],
        "channels_out": channels[1],
        "stride": 2**depth,
        "reach": reach(depth),
        "what": what,
        "licence": "Apache-2.0",
    }
    file = out / f"{name}.onnx"
    file.write_bytes(weights)
    card = json.dumps({**head, **facts}, indent=1, allow_nan=False)
    file.with_suffix(".json").write_text(f"{card}\n", encoding="utf-8")
    sides = (1, channels[0], 10 * 2**depth, 11 * 2**depth)
    probe = np.random.default_rng(0).uniform(-0.3, 0.3, sides).astype(np.float32)
    exported = run_network(network_of(*read_network(file)), probe)
    wanted = training.run(probe)
    difference = float(np.abs(exported - wanted).max() / np.abs(wanted).max())
    if difference > MAX_DIFFERENCE:
        raise SystemExit(
            f"the exported network differs from the trained one by {100 * difference:.2g} %."
        )
    print(f"{file}: {len(weights)} bytes")
