"""Make the table of random walks that the twin ships (about five minutes): python
tools/make_walk_table.py."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from splitknit_simulator.light.skin import RADIUS_EDGES, REFRACTIVE_INDEX, WalkTable, fresnel

WALKS = 6_000_000
SEED = 20261120
LONGEST_WALK = 3000.0
"""In mean free paths."""
LENGTH_EDGES = np.concatenate([[0.0], np.geomspace(1e-2, LONGEST_WALK, 91)])


def main() -> None:
    """Write ``packages/splitknit-simulator/src/splitknit_simulator/data/walks.npz``."""
    table = walk(WALKS, SEED)
    target = (
        Path(__file__).resolve().parents[1]
        / "packages"
        / "splitknit-simulator"
        / "src"
        / "splitknit_simulator"
        / "data"
        / "walks.npz"
    )
    target.parent.mkdir(exist_ok=True)
    np.savez_compressed(
        target,
        counts=np.rint(table.counts * WALKS).astype(np.uint32),
        lengths=table.lengths,
        walks=np.int64(WALKS),
        seed=np.int64(SEED),
    )


def walk(walks: int, seed: int, batch: int = 200_000) -> WalkTable:
    """Simulate `walks` random walks from one point of a semi-infinite, isotropically scattering
    medium.

    Light enters diffusely, walks without absorption and leaves with the Fresnel transmittance; what
    is reflected inside goes on diffusely, as at a rough surface. Walks longer than `LONGEST_WALK`
    end there.
    """
    counts = np.zeros((RADIUS_EDGES.size - 1, LENGTH_EDGES.size - 1))
    total = np.zeros(LENGTH_EDGES.size - 1)
    for start, child in zip(
        range(0, walks, batch), np.random.SeedSequence(seed).spawn(-(-walks // batch)), strict=True
    ):
        radii, lengths = _walk_batch(min(batch, walks - start), np.random.default_rng(child))
        counts += np.histogram2d(radii, lengths, bins=(RADIUS_EDGES, LENGTH_EDGES))[0]
        total += np.histogram(lengths, bins=LENGTH_EDGES, weights=lengths)[0]
    number = np.sum(counts, axis=0)
    middle = 0.5 * (LENGTH_EDGES[1:] + LENGTH_EDGES[:-1])
    mean = np.where(number > 0, total / np.maximum(number, 1.0), middle)
    return WalkTable(counts=counts / walks, lengths=mean)


def _walk_batch(
    count: int, rng: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Exit radius and length of the walks of one batch that leave."""
    position = np.zeros((3, count))
    direction = _cosine_down(count, rng)
    length = np.zeros(count)
    radii, lengths = [], []
    while length.size:
        step = rng.standard_exponential(length.size)
        moved = position + step * direction
        out = np.flatnonzero(moved[2] > 0.0)
        if out.size:
            up = direction[2, out]
            reach = -position[2, out] / up
            edge = position[:, out] + reach * direction[:, out]
            leaves = rng.random(out.size) >= fresnel(up, 1.0 / REFRACTIVE_INDEX)
            gone, back = out[leaves], out[~leaves]
            radii.append(np.hypot(edge[0, leaves], edge[1, leaves]))
            lengths.append(length[gone] + reach[leaves])
            step[out] = reach
            moved[:, back] = edge[:, ~leaves]
            moved[2, back] = 0.0
        length = length + step
        z = 2.0 * rng.random(length.size) - 1.0
        turn = 2.0 * np.pi * rng.random(length.size)
        side = np.sqrt(1.0 - z * z)
        direction = np.stack([side * np.cos(turn), side * np.sin(turn), z])
        keep = length < LONGEST_WALK
        if out.size:
            direction[:, back] = _cosine_down(back.size, rng)
            keep[gone] = False
        position, direction, length = moved[:, keep], direction[:, keep], length[keep]
    return np.concatenate(radii), np.concatenate(lengths)


def _cosine_down(count: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """(3, count) directions into the medium, cosine-distributed."""
    fraction, turn = rng.random(count), 2.0 * np.pi * rng.random(count)
    side = np.sqrt(fraction)
    return np.stack([side * np.cos(turn), side * np.sin(turn), -np.sqrt(1.0 - fraction)])


if __name__ == "__main__":
    main()
