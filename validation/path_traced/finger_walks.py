"""Random walks in a whole finger, compiled by numba: the kernels of ``walked_finger.py``.

Lengths are in pixels: x along the columns, y along the rows, z up. The finger is what lies between
two height maps, which are bilinear between the pixels' centres and are mirrored beyond their
border. Fluence is kept in two grids, from independent halves of the walks, in cells of a pixel and
of layers that follow the upper side, even across its slope. Every cell and pixel has random numbers
of its own and every half one thread, so results do not depend on the number of threads.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit, prange

# constants of SplitMix64, of the type that numba needs beside a state
_GAMMA = np.uint64(0x9E3779B97F4A7C15)
_MIX_A = np.uint64(0xBF58476D1CE4E5B9)
_MIX_B = np.uint64(0x94D049BB133111EB)
_S11 = np.uint64(11)
_S27 = np.uint64(27)
_S30 = np.uint64(30)
_S31 = np.uint64(31)

ROULETTE_WEIGHT = 0.3
"""Russian roulette: a walk that will bring back less than this fraction goes on with a probability
in proportion, and more weight."""
STEP_FREE_PATHS = 0.5
"""Step along rays of unscattered light, in mean free paths."""
PLACES_PER_STEP = 3
"""Places on each of these steps where light is left or gathered."""
PLACES_PER_PATH = 2
"""Places on each way of scattered light where it is left."""
R3_STEPS = (0.8191725133961645, 0.6710436067037893, 0.5497004779019703)
"""Steps of a sequence that fills three dimensions evenly (Roberts 2018)."""
MAX_EVENTS = 1_000_000
"""Longest walk, in scatterings and meetings with the boundary."""
MIN_STEP_PX = 0.6
"""Smallest step in search of the surface."""


# Random numbers: Steele, Lea and Flood 2014 (SplitMix64).


@njit(cache=True, fastmath=True, inline="always")
def _mixed(state: Any) -> Any:
    z = (state ^ (state >> _S30)) * _MIX_A
    z = (z ^ (z >> _S27)) * _MIX_B
    return z ^ (z >> _S31)


@njit(cache=True, fastmath=True, inline="always")
def _random(state: Any) -> Any:
    state = state + _GAMMA
    return state, float(_mixed(state) >> _S11) * (1.0 / 9007199254740992.0)


@njit(cache=True, fastmath=True)
def _stream(seed: Any, index: Any) -> Any:
    return _mixed(_mixed(np.uint64(seed) + _GAMMA) + np.uint64(index) * _GAMMA)


@njit(cache=True, fastmath=True)
def _sphere(state: Any) -> Any:
    """A direction, all equally likely (Marsaglia 1972)."""
    while True:
        state, a = _random(state)
        state, b = _random(state)
        a, b = 2.0 * a - 1.0, 2.0 * b - 1.0
        s = a * a + b * b
        if s < 1.0:
            root = 2.0 * math.sqrt(1.0 - s)
            return state, a * root, b * root, 1.0 - 2.0 * s


@njit(cache=True, fastmath=True)
def _normal_pair(state: Any) -> Any:
    state, u = _random(state)
    state, v = _random(state)
    radius = math.sqrt(-2.0 * math.log(1.0 - u))
    return state, radius * math.cos(2.0 * math.pi * v), radius * math.sin(2.0 * math.pi * v)


# The boundary.


@njit(cache=True, fastmath=True)
def _fresnel(cosine: Any, ratio: Any) -> Any:
    """Unpolarised reflectance; `ratio` is n behind over n before the boundary."""
    c = min(max(cosine, 1e-6), 1.0)
    inside = 1.0 - (1.0 - c * c) / (ratio * ratio)
    if inside <= 0.0:
        return 1.0
    t = math.sqrt(inside)
    across, along = (c - ratio * t) / (c + ratio * t), (ratio * c - t) / (ratio * c + t)
    return 0.5 * (across * across + along * along)


@njit(cache=True, fastmath=True)
def _folded(x: Any, last: Any) -> Any:
    """The place in [0, last] that a place beyond the border mirrors, and whether it is turned."""
    turned = False
    while x < 0.0 or x > last:
        x = -x if x < 0.0 else 2.0 * last - x
        turned = not turned
    return x, turned


@njit(cache=True, fastmath=True)
def _cell(field: Any, x: Any, y: Any) -> Any:
    """Row and column of the pixel centres around a place, and the fractions between them."""
    x, _ = _folded(x, field.shape[1] - 1.0)
    y, _ = _folded(y, field.shape[0] - 1.0)
    column, row = min(int(x), field.shape[1] - 2), min(int(y), field.shape[0] - 2)
    return row, column, y - row, x - column


@njit(cache=True, fastmath=True)
def _nearest(field: Any, x: Any, y: Any) -> Any:
    """Row and column of the nearest pixel centre."""
    x, _ = _folded(x, field.shape[1] - 1.0)
    y, _ = _folded(y, field.shape[0] - 1.0)
    return int(y + 0.5), int(x + 0.5)


@njit(cache=True, fastmath=True)
def _sides(sides: Any, x: Any, y: Any) -> Any:
    """Heights of the upper and of the lower side."""
    r, c, v, u = _cell(sides, x, y)
    a, b, d, e = (1 - v) * (1 - u), (1 - v) * u, v * (1 - u), v * u
    top = (
        a * sides[r, c, 0]
        + b * sides[r, c + 1, 0]
        + d * sides[r + 1, c, 0]
        + e * sides[r + 1, c + 1, 0]
    )
    low = (
        a * sides[r, c, 1]
        + b * sides[r, c + 1, 1]
        + d * sides[r + 1, c, 1]
        + e * sides[r + 1, c + 1, 1]
    )
    return top, low


@njit(cache=True, fastmath=True)
def _outward(sides: Any, x: Any, y: Any, side: Any) -> Any:
    """Unit normal out of the upper (0) or lower (1) side."""
    r, c, v, u = _cell(sides, x, y)
    gx = (1 - v) * (sides[r, c + 1, side] - sides[r, c, side]) + v * (
        sides[r + 1, c + 1, side] - sides[r + 1, c, side]
    )
    gy = (1 - u) * (sides[r + 1, c, side] - sides[r, c, side]) + u * (
        sides[r + 1, c + 1, side] - sides[r, c + 1, side]
    )
    if _folded(x, sides.shape[1] - 1.0)[1]:
        gx = -gx
    if _folded(y, sides.shape[0] - 1.0)[1]:
        gy = -gy
    size = (1.0 if side == 0 else -1.0) / math.sqrt(1.0 + gx * gx + gy * gy)
    return -gx * size, -gy * size, size


@njit(cache=True, fastmath=True)
def _turned(a: Any, b: Any, c: Any, nx: Any, ny: Any, nz: Any) -> Any:
    """The vector (a, b, c) of a frame whose third axis is the normal (Duff et al. 2017)."""
    sign = 1.0 if nz >= 0.0 else -1.0
    p = -1.0 / (sign + nz)
    q = nx * ny * p
    x = a * (1.0 + sign * nx * nx * p) + b * q + c * nx
    y = a * sign * q + b * (sign + ny * ny * p) + c * ny
    return x, y, c * nz - a * sign * nx - b * ny


@njit(cache=True, fastmath=True)
def _facet(state: Any, nx: Any, ny: Any, nz: Any, spread: Any) -> Any:
    """Normal of a micro-facet, whose slopes are normal with the standard deviation `spread`."""
    if spread <= 0.0:
        return state, nx, ny, nz
    state, a, b = _normal_pair(state)
    mx, my, mz = _turned(a * spread, b * spread, 1.0, nx, ny, nz)
    size = 1.0 / math.sqrt(mx * mx + my * my + mz * mz)
    return state, mx * size, my * size, mz * size


@njit(cache=True, fastmath=True)
def _refracted(dx: Any, dy: Any, dz: Any, nx: Any, ny: Any, nz: Any, ratio: Any) -> Any:
    """Refracted direction; the normal is against the direction, `ratio` is n before over n
    behind."""
    cosine = -(dx * nx + dy * ny + dz * nz)
    behind = math.sqrt(max(1.0 - ratio * ratio * (1.0 - cosine * cosine), 0.0))
    k = ratio * cosine - behind
    return ratio * dx + k * nx, ratio * dy + k * ny, ratio * dz + k * nz


@njit(cache=True, fastmath=True)
def _cosine(state: Any, nx: Any, ny: Any, nz: Any) -> Any:
    """Direction into the finger, cosine-weighted; the normal points out of it."""
    while True:
        state, dx, dy, dz = _sphere(state)
        dx, dy, dz = dx - nx, dy - ny, dz - nz
        size = math.sqrt(dx * dx + dy * dy + dz * dz)
        if size > 1e-6:
            return state, dx / size, dy / size, dz / size


@njit(cache=True, fastmath=True)
def _diffuse(state: Any, nx: Any, ny: Any, nz: Any, index: Any, reflected: Any) -> Any:
    """Direction into the finger, cosine-weighted times what the boundary reflects or lets pass in
    this direction."""
    while True:
        state, dx, dy, dz = _cosine(state, nx, ny, nz)
        state, u = _random(state)
        if (u < _fresnel(-(dx * nx + dy * ny + dz * nz), 1.0 / index)) == reflected:
            return state, dx, dy, dz


@njit(cache=True, fastmath=True)
def _mirrored(state: Any, dx: Any, dy: Any, dz: Any, nx: Any, ny: Any, nz: Any, facets: Any) -> Any:
    """Direction after a reflection at a micro-facet from inside, and the cosine at it."""
    state, mx, my, mz = _facet(state, nx, ny, nz, facets)
    along = dx * mx + dy * my + dz * mz
    ax, ay, az = dx - 2.0 * along * mx, dy - 2.0 * along * my, dz - 2.0 * along * mz
    if along <= 0.0 or ax * nx + ay * ny + az * nz >= 0.0:
        along = dx * nx + dy * ny + dz * nz
        ax, ay, az = dx - 2.0 * along * nx, dy - 2.0 * along * ny, dz - 2.0 * along * nz
    return state, ax, ay, az, along


@njit(cache=True, fastmath=True)
def _back(state: Any, dx: Any, dy: Any, dz: Any, nx: Any, ny: Any, nz: Any, medium: Any) -> Any:
    """Direction of light that the boundary reflects from inside, and how much of it there is."""
    state, u = _random(state)
    if u < medium[4]:
        blocked = _fresnel(dx * nx + dy * ny + dz * nz, 1.0 / medium[6])
        state, dx, dy, dz = _cosine(state, nx, ny, nz)
        return state, dx, dy, dz, blocked
    state, dx, dy, dz, along = _mirrored(state, dx, dy, dz, nx, ny, nz, medium[5])
    return state, dx, dy, dz, _fresnel(along, 1.0 / medium[6])


@njit(cache=True, fastmath=True)
def _flight(
    sides: Any, x: Any, y: Any, z: Any, dx: Any, dy: Any, dz: Any, length: Any, room: Any, lean: Any
) -> Any:
    """Length of the way inside, up to `length`, room at its end, and the side that was met (-1:
    none).

    Steps are a part of the distance to the surface, which `room`, the vertical distance, and
    `lean`, the cosine of the slope, give about.
    """
    t = 0.0
    while True:
        step = max(MIN_STEP_PX, 0.7 * room * lean)
        last = t + step >= length
        end = length if last else t + step
        top, low = _sides(sides, x + dx * end, y + dy * end)
        above, below = top - (z + dz * end), (z + dz * end) - low
        if above <= 0.0 or below <= 0.0:
            side = 0 if above <= below else 1
            inside, outside = t, end
            for _ in range(12):
                middle = 0.5 * (inside + outside)
                top, low = _sides(sides, x + dx * middle, y + dy * middle)
                above, below = top - (z + dz * middle), (z + dz * middle) - low
                if above <= 0.0 or below <= 0.0:
                    outside = middle
                    side = 0 if above <= below else 1
                else:
                    inside = middle
            return inside, 0.0, side
        room = min(above, below)
        if last:
            return length, room, -1
        t = end


@njit(cache=True, fastmath=True)
def _within(u: Any, length: Any, scattering: Any) -> Any:
    """Where along a way light is scattered, if it is; `u` in [0, 1) is how much of it before."""
    return -math.log(1.0 - u * (1.0 - math.exp(-scattering * length))) / scattering


@njit(cache=True, fastmath=True)
def _upper_part(first: Any, last: Any, depth: Any) -> Any:
    """Fraction of a straight way between two depths that lies above `depth`."""
    high, low = min(first, last), max(first, last)
    if low <= depth:
        return 1.0
    if high >= depth:
        return 0.0
    return (depth - high) / (low - high)


@njit(cache=True, fastmath=True)
def _kept(medium: Any, mottle: Any, x: Any, y: Any, length: Any, first: Any, last: Any) -> Any:
    """What absorption leaves of the light along a straight way between two depths below the
    skin."""
    upper = _upper_part(first, last, medium[3])
    r, c, _, _ = _cell(mottle, x, y)
    return math.exp(-length * (upper * medium[2] + (1.0 - upper) * medium[1] * mottle[r, c]))


# Light until it is scattered for the first time.


@njit(cache=True, fastmath=True)
def _shine(
    state: Any,
    x: Any,
    y: Any,
    z: Any,
    dx: Any,
    dy: Any,
    dz: Any,
    first: Any,
    last: Any,
    weights: Any,
    grid: Any,
    layer_px: Any,
    sides: Any,
    lean: Any,
    mottle: Any,
    medium: Any,
) -> Any:
    """Add the fluence along a ray of the lights `first` to `last`, of `weights`, until little of it
    is left."""
    kept, room = 1.0, 0.0
    full = STEP_FREE_PATHS / medium[0]
    while kept > 1e-3:
        state, u = _random(state)
        r, c = _nearest(lean, x, y)
        slope = lean[r, c]
        length, after, side = _flight(sides, x, y, z, dx, dy, dz, full * (0.5 + u), room, slope)
        state, u = _random(state)
        middle = 0.5 * length
        passed = _kept(
            medium, mottle, x + middle * dx, y + middle * dy, length, room * slope, after * slope
        )
        passed *= math.exp(-medium[0] * length)
        if length > 1e-6:
            way = kept * (1.0 - passed) / (-math.log(passed) * layer_px) * length / PLACES_PER_STEP
            for place in range(PLACES_PER_STEP):
                at = _within((place + u) / PLACES_PER_STEP, length, medium[0])
                px, py = x + at * dx, y + at * dy
                r, c = _nearest(lean, px, py)
                layer = int(
                    max(_sides(sides, px, py)[0] - z - at * dz, 0.0) * lean[r, c] / layer_px
                )
                if layer < grid.shape[2]:
                    for k in range(first, last):
                        grid[r, c, layer, k] += way * lean[r, c] * weights[k]
        kept *= passed
        x, y, z, room = x + length * dx, y + length * dy, z + length * dz, after
        if side >= 0:
            nx, ny, nz = _outward(sides, x, y, side)
            state, dx, dy, dz, blocked = _back(state, dx, dy, dz, nx, ny, nz, medium)
            kept *= blocked
    return state


@njit(parallel=True, cache=True, fastmath=True)
def first_light(
    sides: Any,
    lean: Any,
    mottle: Any,
    entering: Any,
    lights: Any,
    medium: Any,
    layer_px: Any,
    rays: Any,
    seed: Any,
    grids: Any,
) -> None:
    """Add to `grids` (2, H, W, layers, L) the fluence of unscattered light, by independent rays for
    each half."""
    count, rows, columns = lights.shape[0], entering.shape[1], entering.shape[2]
    spread = medium[4]
    for half in prange(2):
        weights = np.zeros(count)
        for side in range(2):
            for row in range(rows):
                for column in range(columns):
                    brightest = 0.0
                    for k in range(count):
                        brightest = max(brightest, entering[side, row, column, k])
                    if brightest <= 0.0:
                        continue
                    state = _stream(seed, ((half * 2 + side) * rows + row) * columns + column)
                    for ray in range(rays * rays):
                        state, u = _random(state)
                        state, v = _random(state)
                        x, y = column + (ray % rays + u) / rays, row + (ray // rays + v) / rays
                        nx, ny, nz = _outward(sides, x, y, side)
                        top, low = _sides(sides, x, y)
                        if top - low < 1e-2:
                            continue
                        z = top - 1e-3 if side == 0 else low + 1e-3
                        if spread > 0.0:
                            for k in range(count):
                                weights[k] = (
                                    entering[side, row, column, k]
                                    * spread
                                    / (rays * rays * abs(nz))
                                )
                            state, dx, dy, dz = _cosine(state, nx, ny, nz)
                            state = _shine(
                                state,
                                x,
                                y,
                                z,
                                dx,
                                dy,
                                dz,
                                0,
                                count,
                                weights,
                                grids[half],
                                layer_px,
                                sides,
                                lean,
                                mottle,
                                medium,
                            )
                        if spread >= 1.0:
                            continue
                        state, mx, my, mz = _facet(state, nx, ny, nz, medium[5])
                        for k in range(count):
                            weights[k] = (
                                entering[side, row, column, k]
                                * (1.0 - spread)
                                / (rays * rays * abs(nz))
                            )
                            dx, dy, dz = x - lights[k, 0], y - lights[k, 1], z - lights[k, 2]
                            size = math.sqrt(dx * dx + dy * dy + dz * dz)
                            dx, dy, dz = dx / size, dy / size, dz / size
                            if weights[k] <= 0.0 or dx * nx + dy * ny + dz * nz >= -1e-3:
                                continue
                            if dx * mx + dy * my + dz * mz > -0.05:
                                dx, dy, dz = _refracted(dx, dy, dz, nx, ny, nz, 1.0 / medium[6])
                            else:
                                dx, dy, dz = _refracted(dx, dy, dz, mx, my, mz, 1.0 / medium[6])
                            state = _shine(
                                state,
                                x,
                                y,
                                z,
                                dx,
                                dy,
                                dz,
                                k,
                                k + 1,
                                weights,
                                grids[half],
                                layer_px,
                                sides,
                                lean,
                                mottle,
                                medium,
                            )


# Light that is scattered.


@njit(parallel=True, cache=True, fastmath=True)
def scatter(
    sides: Any,
    lean: Any,
    mottle: Any,
    first: Any,
    layer_px: Any,
    medium: Any,
    density: Any,
    seed: Any,
    grids: Any,
) -> None:
    """Add to `grids` the fluence of scattered light, by walks that start where `first`'s light is
    scattered.

    `density` walks start in a cell of the mean fluence one.
    """
    count, rows, columns, layers = first.shape[4], first.shape[1], first.shape[2], first.shape[3]
    scattering = medium[0]
    attenuation = math.sqrt(3.0 * medium[1] * (medium[1] + scattering))
    for half in prange(2):
        weights = np.zeros(count)
        for row in range(rows):
            for column in range(columns):
                state = _stream(seed, (half * rows + row) * columns + column)
                for start in range(layers):
                    mean = 0.0
                    for k in range(count):
                        mean += first[half, row, column, start, k] / (count * lean[row, column])
                    state, u = _random(state)
                    walks = int(mean * density + u)
                    if walks == 0 or mean <= 0.0:
                        continue
                    for k in range(count):
                        # energy that is scattered, by walk, over scattering x volume
                        weights[k] = first[half, row, column, start, k] / (
                            mean * density * lean[row, column]
                        )
                    for _ in range(walks):
                        state, u = _random(state)
                        state, v = _random(state)
                        x, y = column + u - 0.5, row + v - 0.5
                        state, u = _random(state)
                        top, low = _sides(sides, x, y)
                        z = top - (start + u) * layer_px / lean[row, column]
                        if z - low < 1e-3:
                            z = 0.5 * (top + low)
                        room = min(top - z, z - low)
                        if room <= 0.0:
                            continue
                        kept = 1.0
                        state, dx, dy, dz = _sphere(state)
                        for _ in range(MAX_EVENTS):
                            state, u = _random(state)
                            length = -math.log(1.0 - u) / scattering
                            r, c = _nearest(lean, x, y)
                            slope = lean[r, c]
                            length, after, side = _flight(
                                sides, x, y, z, dx, dy, dz, length, room, slope
                            )
                            before = kept
                            kept *= _kept(
                                medium,
                                mottle,
                                x + 0.5 * length * dx,
                                y + 0.5 * length * dy,
                                length,
                                room * slope,
                                after * slope,
                            )
                            # what is on its way for a length l in a volume v adds l / v to the
                            # fluence
                            state, u = _random(state)
                            way = 0.5 * (before + kept) * length * scattering / PLACES_PER_PATH
                            for place in range(PLACES_PER_PATH):
                                at = (place + u) / PLACES_PER_PATH * length
                                px, py = x + at * dx, y + at * dy
                                r, c = _nearest(lean, px, py)
                                layer = int(
                                    max(_sides(sides, px, py)[0] - z - at * dz, 0.0)
                                    * lean[r, c]
                                    / layer_px
                                )
                                if layer < layers:
                                    for k in range(count):
                                        grids[half, r, c, layer, k] += way * lean[r, c] * weights[k]
                            x, y, z, room = x + length * dx, y + length * dy, z + length * dz, after
                            if side < 0:
                                state, dx, dy, dz = _sphere(state)
                            else:
                                nx, ny, nz = _outward(sides, x, y, side)
                                state, dx, dy, dz, blocked = _back(
                                    state, dx, dy, dz, nx, ny, nz, medium
                                )
                                kept *= blocked
                            # the deeper, the less of it comes back
                            chance = kept * math.exp(-attenuation * room * slope) / ROULETTE_WEIGHT
                            if chance < 1.0:
                                state, u = _random(state)
                                if u >= chance:
                                    break
                                kept /= chance


# Rays from the camera.


@njit(parallel=True, cache=True, fastmath=True)
def gather(
    sides: Any,
    lean: Any,
    mottle: Any,
    entering: Any,
    grids: Any,
    first: Any,
    layer_px: Any,
    lights: Any,
    strength: Any,
    medium: Any,
    pixels: Any,
    rays: Any,
    seed: Any,
    sums: Any,
    once: Any,
) -> None:
    """Add to `sums` (N, 2, L) the light that `rays` rays from each of N pixels collect in each half
    of the fluence.

    To `once` (N, L): the part that was scattered once, between two refractions at the boundary, in
    both halves.

    Parameters
    ----------
    sides : (H, W, 2) heights; lean : (H, W) cosine of the smooth shape's slope; mottle : (H, W)
    factor of absorption
    entering : (2, H - 1, W - 1, L) light that enters each cell of each side
    grids, first : (2, H, W, layers, L) fluence, and that of unscattered light, in layers `layer_px`
    thick
    lights : (L, 3) places; strength : (L,) their intensity, over the squared distance in pixels
    medium : scattering, absorption of the dermis and of the epidermis, its thickness, fraction of
    diffused light,
        standard deviation of the micro-facets' slopes, refractive index, diffuse reflectance from
        inside
    pixels : (N, 2) rows and columns
    """
    count = lights.shape[0]
    scattering, spread, facets, index, inside = (
        medium[0],
        medium[4],
        medium[5],
        medium[6],
        medium[7],
    )
    lobe = max((index - 1.0) * facets, 0.02)
    full, passing_all = STEP_FREE_PATHS / scattering, (1.0 - inside) * index * index
    for i in prange(pixels.shape[0]):
        state = _stream(seed, pixels[i, 0] * sides.shape[1] + pixels[i, 1])
        radiance, single = np.zeros((2, count)), np.zeros(count)
        state, start_a = _random(state)
        state, start_b = _random(state)
        state, start_c = _random(state)
        for number in range(2 * rays):
            half = number // rays
            state, u = _random(state)
            state, v = _random(state)
            x, y = pixels[i, 1] + u - 0.5, pixels[i, 0] + v - 0.5
            top, low = _sides(sides, x, y)
            if top - low < 1e-2:
                continue
            z = top - 1e-3
            nx, ny, nz = _outward(sides, x, y, 0)
            weight = (1.0 - _fresnel(nz, index)) / (index * index)
            least = 1e-3 * weight
            along, around = (
                (start_a + number * R3_STEPS[0]) % 1.0,
                (start_b + number * R3_STEPS[1]) % 1.0,
            )
            refracted = 1.0 - spread
            if (start_c + number * R3_STEPS[2]) % 1.0 < spread:
                refracted = 0.0
                # evenly within the cone of what can leave, cosine-weighted
                sine = math.sqrt(along) / index
                a, b = (
                    sine * math.cos(2.0 * math.pi * around),
                    sine * math.sin(2.0 * math.pi * around),
                )
                dx, dy, dz = _turned(a, b, -math.sqrt(1.0 - sine * sine), nx, ny, nz)
                weight *= (1.0 - _fresnel(math.sqrt(1.0 - sine * sine), 1.0 / index)) / passing_all
            else:
                state, mx, my, mz = _facet(state, nx, ny, nz, facets)
                if mz < 0.05:
                    mx, my, mz = nx, ny, nz
                dx, dy, dz = _refracted(0.0, 0.0, -1.0, mx, my, mz, 1.0 / index)
            room = 0.0
            while weight > least:
                state, u = _random(state)
                r, c = _nearest(lean, x, y)
                slope = lean[r, c]
                length, after, side = _flight(
                    sides, x, y, z, dx, dy, dz, full * (0.5 + u), room, slope
                )
                state, u = _random(state)
                middle = 0.5 * length
                kept = _kept(
                    medium,
                    mottle,
                    x + middle * dx,
                    y + middle * dy,
                    length,
                    room * slope,
                    after * slope,
                )
                kept *= math.exp(-scattering * length)
                if length > 1e-6:
                    part = (
                        weight
                        * (1.0 - kept)
                        / (-math.log(kept))
                        * length
                        * scattering
                        * (0.25 / math.pi)
                        / PLACES_PER_STEP
                    )
                    for place in range(PLACES_PER_STEP):
                        at = _within((place + u) / PLACES_PER_STEP, length, scattering)
                        px, py = x + at * dx, y + at * dy
                        r, c = _nearest(lean, px, py)
                        layer = int(
                            max(_sides(sides, px, py)[0] - z - at * dz, 0.0) * lean[r, c] / layer_px
                        )
                        if layer < grids.shape[3]:
                            for k in range(count):
                                radiance[half, k] += part * grids[half, r, c, layer, k]
                                single[k] += refracted * part * first[half, r, c, layer, k]
                weight *= kept
                x, y, z, room = x + length * dx, y + length * dy, z + length * dz, after
                if side < 0:
                    continue
                # light that comes in here and has not been scattered
                nx, ny, nz = _outward(sides, x, y, side)
                r, c, _, _ = _cell(sides, x, y)
                for k in range(count):
                    radiance[half, k] += weight * spread * entering[side, r, c, k] / math.pi
                state, u = _random(state)
                if u < spread:
                    weight *= inside
                    state, dx, dy, dz = _diffuse(state, nx, ny, nz, index, True)
                    continue
                passing = 1.0 - _fresnel(dx * nx + dy * ny + dz * nz, 1.0 / index)
                if passing > 0.0:
                    ox, oy, oz = _refracted(dx, dy, dz, -nx, -ny, -nz, index)
                    seen = weight * index * index * passing
                    for k in range(count):
                        lx, ly, lz = lights[k, 0] - x, lights[k, 1] - y, lights[k, 2] - z
                        squared = lx * lx + ly * ly + lz * lz
                        off = ((ox * lx + oy * ly + oz * lz) / math.sqrt(squared) - 1.0) / (
                            lobe * lobe
                        )
                        if off > -20.0:
                            light = (
                                strength[k]
                                / squared
                                * math.exp(off)
                                / (2.0 * math.pi * lobe * lobe)
                            )
                            radiance[half, k] += seen * light
                state, dx, dy, dz, along = _mirrored(state, dx, dy, dz, nx, ny, nz, facets)
                weight *= _fresnel(along, 1.0 / index)
        for half in range(2):
            for k in range(count):
                sums[i, half, k] += radiance[half, k]
        for k in range(count):
            once[i, k] += single[k]
