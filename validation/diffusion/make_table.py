"""Make `splitknit/separation/diffusion_table.npz`: how skin blurs light, for any scattering and
absorption.

Random walks in a half space with isotropic scattering (the reduced problem), diffuse entry, Fresnel
reflection inside with a rough boundary (reflected light leaves the boundary diffusely). Lengths are
in units of the mean free path, and no walk is absorbed: the radius of each exit is stored with its
number of scatterings n, so that every single-scattering albedo a follows by the weight a^n. The
transfer function is the Hankel transform of the profile,

    M(x; a) = sum over exits of a^n J0(x r) / number of walks,  x = omega / sigma_t'.

This code is independent of the digital twin's. Run: `python validation/diffusion/make_table.py`
(three minutes).

References
----------
L. Wang, S. Jacques and L. Zheng, "MCML", Computer Methods and Programs in Biomedicine 47 (1995);
W. Egan and T. Hilgeman, "Optical Properties of Inhomogeneous Materials" (1979), for the similarity
in a.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from scipy.special import j0

REFRACTIVE_INDEX = 1.42
ALBEDOS = np.array(
    [0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.85, 0.9, 0.93, 0.95, 0.965, 0.98, 0.99, 0.995, 0.998, 0.9995]
)
FREQUENCIES = np.concatenate([[0.0], np.geomspace(0.003, 60.0, 111)])
TAIL_FREQUENCY = 8.0  # beyond it M x is constant within the noise


def fresnel_inside(cosine):
    """Unpolarised reflectance for light that meets the boundary from within."""
    sine2 = (1 - cosine**2) * REFRACTIVE_INDEX**2
    outside = np.sqrt(np.clip(1 - sine2, 0, 1))
    s = (REFRACTIVE_INDEX * cosine - outside) / (REFRACTIVE_INDEX * cosine + outside)
    p = (cosine - REFRACTIVE_INDEX * outside) / (cosine + REFRACTIVE_INDEX * outside)
    return np.where(sine2 >= 1, 1.0, 0.5 * (s**2 + p**2))


def downwards(rng, count):
    """Cosine-distributed directions into the medium (z < 0)."""
    u = rng.random(count)
    phi = 2 * np.pi * rng.random(count)
    r = np.sqrt(u)
    return np.stack([r * np.cos(phi), r * np.sin(phi), -np.sqrt(1 - u)], axis=1)


def walks(count, most, seed):
    """Exit radii and numbers of scatterings of `count` walks, followed for `most` scatterings at
    the most."""
    rng = np.random.default_rng(seed)
    place = np.zeros((count, 3))
    direction = downwards(rng, count)
    scatterings = np.zeros(count, dtype=np.int64)
    radii, orders = [], []
    while len(place):
        step = -np.log1p(-rng.random(len(place)))
        target = place + direction * step[:, None]
        leaves = target[:, 2] > 0
        reach = np.where(leaves, -place[:, 2] / np.where(leaves, direction[:, 2], 1.0), step)
        target = place + direction * reach[:, None]
        reflected = rng.random(len(place)) < fresnel_inside(np.abs(direction[:, 2]))
        out = leaves & ~reflected
        radii.append(np.hypot(target[out, 0], target[out, 1]))
        orders.append(scatterings[out])
        inside = ~leaves
        scatterings = scatterings + inside
        z = 2 * rng.random(len(place)) - 1
        phi = 2 * np.pi * rng.random(len(place))
        s = np.sqrt(1 - z**2)
        scattered = np.stack([s * np.cos(phi), s * np.sin(phi), z], axis=1)
        direction = np.where(inside[:, None], scattered, downwards(rng, len(place)))
        target[leaves, 2] = 0.0
        stay = ~out & (scatterings < most)
        place, direction, scatterings = target[stay], direction[stay], scatterings[stay]
    return np.concatenate(radii), np.concatenate(orders)


def table(count, most, seed):
    """M (albedos, frequencies), not normalised: M[:, 0] is the diffuse albedo."""
    radii, orders = walks(count, most, seed)
    weights = ALBEDOS[:, None] ** orders[None, :]
    result = np.stack([weights @ j0(x * radii) for x in FREQUENCIES], axis=1) / count
    near = (FREQUENCIES > TAIL_FREQUENCY / 2) & (FREQUENCIES < TAIL_FREQUENCY * 2)
    constant = (result[:, near] * FREQUENCIES[near]).mean(axis=1)
    far = FREQUENCIES >= TAIL_FREQUENCY
    result[:, far] = constant[:, None] / FREQUENCIES[far]
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("--walks", type=int, default=400_000)
    parser.add_argument("--most", type=int, default=4000)
    parser.add_argument("--seed", type=int, default=1)
    here = (
        Path(__file__).resolve().parents[2]
        / "packages"
        / "splitknit"
        / "src"
        / "splitknit"
        / "skin"
        / "diffusion_table.npz"
    )
    parser.add_argument("--out", type=Path, default=here)
    options = parser.parse_args()
    result = table(options.walks, options.most, options.seed)
    np.savez(
        options.out,
        albedo=ALBEDOS,
        frequency=FREQUENCIES,
        transfer=result.astype(np.float32),
        index=np.float64(REFRACTIVE_INDEX),
    )
    print(f"{options.out}: {result.shape[0]} albedos x {result.shape[1]} frequencies")


if __name__ == "__main__":
    main()
