"""Direct light by the shipped networks: seconds and memory for the seven white images of one
finger."""

from __future__ import annotations

import argparse
import resource
import time

import numpy as np

from cases import shadow_case
from splitknit.networks.unet import load_network, run_network, use_network_threads
from splitknit.separation.direct import direct_light
from timing import machine, print_table, race


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    case = shadow_case()
    grey = case.stack * case.mask
    colours = np.repeat(grey[:, None], 3, axis=1)
    use_network_threads(1)
    alone = load_network("direct")
    use_network_threads(2)
    network = load_network("direct")
    facts = network.card.facts
    print(
        f"Direct light, {' x '.join(map(str, grey.shape))}, network '{network.card.name}',"
        f" {machine()}"
    )
    print(f"\n{facts.get('architecture', '')}; ", end="")
    before = peak_mb()
    direct_light(colours, network)
    print(f"{peak_mb() - before:.0f} MB more at its peak, images included")
    started = time.process_time()
    direct_light(colours, network)
    busy = time.process_time() - started
    print(
        f"\n{busy:.1f} s of processor time for the seven; what else runs on this machine makes the"
        " times below longer"
    )
    contenders = {
        "direct_light, colours, two threads": lambda: direct_light(colours, network),
        "the same, one thread": lambda: direct_light(colours, alone),
        "direct_light, grey, two threads": lambda: direct_light(grey, network),
        "run_network alone, two threads": lambda: run_network(network, colours),
    }
    print_table("Seven images", race(contenders, options.rounds))


def peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


if __name__ == "__main__":
    main()
