"""Both kinds of U-Net in torch, and their export to ONNX.

The U-Net of the thesis (figure 3.19) has forty-five layers, counted as its figure does: the input; three encoder blocks
of two convolutions, two ReLUs and a max pooling, the last with a dropout; the bridge of two convolutions, two ReLUs and
a dropout; three decoder blocks of a transposed convolution, a ReLU, a concatenation, two convolutions and two ReLUs; a
last convolution; the regression. The U-Net of the `metric` networks is smaller: it runs on a processor.
"""

from __future__ import annotations

import copy
import importlib
import io
import warnings
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from splitknit import importing

_OPSET = 17


def load_torch() -> Any:
    """Import torch, which only training needs, or raise BadInput."""
    with importing(
        "training needs torch, which cannot be imported ({error}); in splitknit's folder: make install EXTRAS=train."
    ):
        return importlib.import_module("torch")


def unet(
    width: int = 64, depth: int = 3, dropout: float = 0.5, start_fraction: float = 0.0, *, channels: int = 3
) -> Any:
    """Build the U-Net of the thesis from (N, channels, H, W), H and W multiples of 2^depth, to the same shape.

    Weights are drawn after He et al. 2015 from torch's current random state. `width`: channels of the first block,
    doubling from block to block; `dropout`: fraction dropped after the last encoder block and the bridge;
    `start_fraction`: the untrained network returns this fraction of its image; 0: all weights are random.
    """
    torch = load_torch()
    nn = torch.nn

    def block(before: int, after: int, drop: bool = False) -> Any:
        layers = [nn.Conv2d(before, after, 3, padding=1), nn.ReLU(), nn.Conv2d(after, after, 3, padding=1), nn.ReLU()]
        if drop and dropout > 0:
            layers.append(nn.Dropout(dropout))
        return nn.Sequential(*layers)

    class UNet(nn.Module):  # type: ignore[misc, name-defined]
        def __init__(self) -> None:
            super().__init__()
            widths = [width << level for level in range(depth + 1)]
            befores = [channels, *widths[:-1]]
            self.encoder = nn.ModuleList(
                block(before, after, drop=level == depth - 1)
                for level, (before, after) in enumerate(zip(befores, widths[:-1], strict=False))
            )
            self.bridge = block(widths[-2], widths[-1], drop=True)
            self.rise = nn.ModuleList(
                nn.Sequential(nn.ConvTranspose2d(2 * width, width, 2, stride=2), nn.ReLU())
                for width in reversed(widths[:-1])
            )
            self.decoder = nn.ModuleList(block(2 * width, width) for width in reversed(widths[:-1]))
            self.last = nn.Conv2d(width, channels, 1)

        def forward(self, image: Any) -> Any:
            skipped = []
            for stage in self.encoder:
                image = stage(image)
                skipped.append(image)
                image = nn.functional.max_pool2d(image, 2)
            image = self.bridge(image)
            for rise, stage in zip(self.rise, self.decoder, strict=True):
                image = stage(torch.cat([rise(image), skipped.pop()], dim=1))
            return self.last(image)

    network = UNet()
    for module in network.modules():
        if isinstance(module, (nn.Conv2d, nn.ConvTranspose2d)):
            nn.init.kaiming_normal_(module.weight, nonlinearity="relu")
            nn.init.zeros_(module.bias)
    with torch.no_grad():
        _begin_with_fraction(network, width, start_fraction, channels)
    return network


def _begin_with_fraction(network: Any, width: int, start_fraction: float, channels: int) -> None:
    """Let the untrained result be a fraction of the image: first channels pass it on, and the last layer listens."""
    network.last.weight.mul_(0.1)
    if start_fraction == 0 or width < channels:
        return
    outer, inner = network.encoder[0], network.decoder[-1]
    for layer, first in ((outer[0], 0), (outer[2], 0), (inner[0], width), (inner[2], 0)):
        for channel in range(channels):
            layer.weight[channel] = 0.0
            layer.weight[channel, first + channel, 1, 1] = 1.0
    for channel in range(channels):
        network.last.weight[channel, :channels] = 0.0
        network.last.weight[channel, channel] = start_fraction


def fields_network(widths: Sequence[int], fields: int, outputs: int) -> Any:
    """Build the U-Net (Ronneberger et al. 2015) of the `metric` networks, weights from torch's random state.

    From (N, fields, H, W), H and W multiples of 2^(levels - 1), to (N, outputs, H, W). Every level, of `widths`
    channels, the finest first, is two 3 x 3 convolutions with ReLUs. Down: maxima over 2 x 2 pixels; up: pixels
    doubled, beside what the level had on the way down; last a 1 x 1 convolution. Fields are first multiplied by the
    network's ``scale``.
    """
    torch = load_torch()
    nn = torch.nn

    def level(before: int, after: int) -> Any:
        return nn.Sequential(
            nn.Conv2d(before, after, 3, padding=1), nn.ReLU(), nn.Conv2d(after, after, 3, padding=1), nn.ReLU()
        )

    class FieldsNetwork(nn.Module):  # type: ignore[misc, name-defined]
        def __init__(self) -> None:
            super().__init__()
            befores = [fields, *widths[:-1]]
            self.down = nn.ModuleList(level(before, after) for before, after in zip(befores, widths, strict=True))
            rising = reversed(list(pairwise(widths)))
            self.up = nn.ModuleList(level(fine + coarse, fine) for fine, coarse in rising)
            self.out = nn.Conv2d(widths[0], outputs, 1)
            self.register_buffer("scale", torch.ones(fields))

        def forward(self, image: Any) -> Any:
            image = image * self.scale[:, None, None]
            kept = []
            for number, stage in enumerate(self.down):
                image = stage(nn.functional.max_pool2d(image, 2) if number else image)
                kept.append(image)
            kept.pop()
            for stage, coarse in zip(self.up, reversed(widths[1:]), strict=True):
                image = nn.functional.interpolate(image, scale_factor=2, mode="nearest")
                # beside what the level had: two sums instead of joined maps, which take a third of all memory
                weight, bias = (part.float() for part in (stage[0].weight, stage[0].bias))
                above = nn.functional.conv2d(image, weight[:, :coarse], padding=1)
                image = stage[1:](above + nn.functional.conv2d(kept.pop(), weight[:, coarse:], bias, padding=1))
            return self.out(image)

    return FieldsNetwork()


def unet_reach(depth: int) -> int:
    """How far beyond a stretch that begins on the stride's grid an input can change the network's result, in pixels.

    From the result back to the input: a 3 x 3 convolution needs one pixel more at its scale, a transposed convolution
    the coarse pixels that cover the fine ones, a pooling the fine pixels of the coarse.
    """
    reach = 0
    for _ in range(depth):  # decoder, from fine to coarse
        reach = -(-(reach + 2) // 2)
    reach += 2  # bridge
    for _ in range(depth):  # encoder, from coarse to fine
        reach = 2 * reach + 2
    return reach


def export_onnx(network: Any, channels: int, stride: int) -> bytes:
    """Write `network` as an ONNX file whose weights are stored in half precision and computed with in single. Any
    height and width that are multiples of `stride` are allowed. Halving rounds a weight by at most 0.05 %.
    """
    torch = load_torch()
    stored = _with_stored_halves(torch, copy.deepcopy(network).cpu()).eval()
    side = 8 * stride
    axes = {0: "images", 2: "rows", 3: "columns"}
    buffer = io.BytesIO()
    with warnings.catch_warnings(), torch.no_grad():
        warnings.simplefilter("ignore")  # of the older exporter, which needs no further packages, that it is older
        torch.onnx.export(
            stored,
            (torch.zeros(1, channels, side, side),),
            buffer,
            dynamo=False,
            input_names=["image"],
            output_names=["direct"],
            dynamic_axes={"image": axes, "direct": axes},
            opset_version=_OPSET,
            do_constant_folding=False,
        )
    return buffer.getvalue()


def _with_stored_halves(torch: Any, network: Any) -> Any:
    nn = torch.nn

    class Stored(nn.Module):  # type: ignore[misc, name-defined]
        def __init__(self, layer: Any) -> None:
            super().__init__()
            self.register_buffer("weight", layer.weight.detach().half())
            self.register_buffer("bias", layer.bias.detach().half())
            self.padding, self.stride = layer.padding, layer.stride
            rising = isinstance(layer, nn.ConvTranspose2d)
            self.convolve = nn.functional.conv_transpose2d if rising else nn.functional.conv2d

        def forward(self, image: Any) -> Any:
            weight, bias = self.weight.float(), self.bias.float()
            return self.convolve(image, weight, bias, stride=self.stride, padding=self.padding)

    for module in list(network.modules()):
        for name, child in list(module.named_children()):
            if isinstance(child, (nn.Conv2d, nn.ConvTranspose2d)):
                setattr(module, name, Stored(child))
    return network
