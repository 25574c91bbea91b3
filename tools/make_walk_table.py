"""Make the table of random walks that the twin ships (about five minutes): python tools/make_walk_table.py."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from splitknit.simulator.light.skin import walk

WALKS = 6_000_000
SEED = 20261120


def main() -> None:
    """Write ``src/splitknit/simulator/data/walks.npz``."""
    table = walk(WALKS, SEED)
    target = Path(__file__).resolve().parents[1] / "src" / "splitknit" / "simulator" / "data" / "walks.npz"
    target.parent.mkdir(exist_ok=True)
    np.savez_compressed(
        target,
        counts=np.rint(table.counts * WALKS).astype(np.uint32),
        lengths=table.lengths,
        walks=np.int64(WALKS),
        seed=np.int64(SEED),
    )


if __name__ == "__main__":
    main()
