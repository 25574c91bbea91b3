"""Direct light by the shipped networks: seconds and memory for the seven white images of one finger.

With ``--thesis`` also the thesis's width of 64, untrained (its weights do not matter for its cost): one image at
inference and a few steps of training. That needs torch (extra ``train``).
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from cases import shadow_case
from splitknit.networks.unet import Network, card_bytes, load_network, network_of, read_network, run_network, use_device
from splitknit.separation.direct import direct_light
from timing import machine, print_table, race


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--network", default="direct", help="shipped network, or path of an .onnx file")
    parser.add_argument("--thesis", action="store_true", help="the thesis's width as well (needs torch)")
    parser.add_argument("--device", default="cpu", help="of the thesis's training: cpu or cuda")
    options = parser.parse_args()
    case = shadow_case()
    grey = case.stack * case.mask
    colours = np.repeat(grey[:, None], 3, axis=1)
    use_device(threads=1)
    alone = load_network(options.network)
    use_device(threads=2)
    network = load_network(options.network)
    facts = network.card.facts
    print(f"Direct light, {' x '.join(map(str, grey.shape))}, network '{network.card.name}', {machine()}")
    print(f"\n{facts.get('architecture', '')}; ", end="")
    before = peak_mb()
    direct_light(colours, network)
    print(f"{peak_mb() - before:.0f} MB more at its peak, images included")
    started = time.process_time()
    direct_light(colours, network)
    busy = time.process_time() - started
    print(
        f"\n{busy:.1f} s of processor time for the seven; what else runs on this machine makes the times below longer"
    )
    contenders = {
        "direct_light, colours, two threads": lambda: direct_light(colours, network),
        "the same, one thread": lambda: direct_light(colours, alone),
        "the same, two threads, tiles of 256 pixels": lambda: direct_light(colours, network, tile=256),
        "direct_light, grey, two threads": lambda: direct_light(grey, network),
        "run_network alone, two threads": lambda: run_network(network, colours),
    }
    print_table("Seven images", race(contenders, options.rounds))
    if options.thesis:
        thesis(colours[:1], options.device)


def thesis(image: np.ndarray, device: str) -> None:
    """Cost of the network as wide as the thesis's."""
    from splitknit_simulator.training.networks import unet_reach
    from splitknit_simulator.training.separation import SeparationSettings, SeparationTrainer

    steps, noise = 2, np.random.default_rng(0).random((32, 3, 72, 72), dtype=np.float32)
    patches: Any = _SamePatches((noise, 0.3 * noise), steps)
    trainer = SeparationTrainer(SeparationSettings(device=device, threads=2), patches)
    weights, _ = trainer.packed({})
    print(f"\n### Width 64: {len(weights) / 1e6:.1f} MB\n")
    for threads in (1, 2):
        use_device(threads=threads)
        network = in_memory(weights, {"channels_in": 3, "channels_out": 3, "stride": 8, "reach": unet_reach(3)})
        started = time.perf_counter()
        run_network(network, image, tile=512)
        print(f"- one image of {image.shape[2]} x {image.shape[3]}, {threads} threads: ", end="")
        print(f"{time.perf_counter() - started:.1f} s")
    trainer.train(1)
    started = time.perf_counter()
    loss = trainer.train(1)["loss"]
    step_s = (time.perf_counter() - started) / steps
    whole_h = step_s * 37_500 / 32 * 50 / 3600
    print(
        f"- one step of training (32 patches) on {device}: {step_s:.2f} s; 37,500 patches x 50 epochs: {whole_h:.0f} h"
    )
    nothing = float(np.mean(np.square(0.3 * noise)))
    print(f"- it learns: loss {loss:.3f} after {2 * steps} steps, {nothing:.3f} for nothing")


class _SamePatches:
    """One batch, several times."""

    def __init__(self, batch: tuple[np.ndarray, np.ndarray], steps: int) -> None:
        self.batch, self.steps = batch, steps

    def __len__(self) -> int:
        return self.steps * len(self.batch[0])

    def shuffled(self, batch: int, seed: int, epoch: int) -> Any:
        return iter([self.batch] * self.steps)


def in_memory(weights: bytes, facts: dict[str, Any]) -> Network:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "thesis.onnx"
        path.write_bytes(weights)
        path.with_suffix(".json").write_bytes(card_bytes("thesis", weights, facts))
        return network_of(*read_network(path))


def peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


if __name__ == "__main__":
    main()
