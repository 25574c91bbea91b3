"""More phases from the same 25 images: a checkerboard shifted by one check is its own complement.

With the checkerboard as 1/2 + chi/2, an image is half the white image plus half the response D to chi. Shifted by one
check along one axis chi changes its sign, and so does D. With an odd number of shifts a period, D is therefore known at
twice as many phases along both axes: 25 images hold it at 100 phases. Its largest value, read off a parabola through
the neighbouring phases along each axis, is the maximum minus the minimum over all phases.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from splitknit.check import require

Array32 = NDArray[np.float32]


def by_symmetry(stack: Array32, white: Array32 | None = None, *, refine: bool = True) -> tuple[Array32, Array32]:
    """Direct and global light from all shifts of a checkerboard with equal checks and a black projector (b = 0).

    Parameters
    ----------
    stack : (n n, H, W, C) images, n odd; the second axis's shift changes slowest
    white : (H, W, C) image under full light; None takes twice the mean of the stack, which is true but for the
        n-th harmonics
    refine : between the phases

    References
    ----------
    Nayar et al. 2006, equations (3) and (4), for what direct and global light are.
    """
    steps = round(len(stack) ** 0.5)
    require(steps**2 == len(stack) and steps % 2 == 1, f"an odd number squared of images is needed, not {len(stack)}.")
    full = np.asarray(2 * stack.mean(axis=0) if white is None else white, dtype=np.float32)
    responses = np.empty((2 * steps, 2 * steps, *full.shape), dtype=np.float32)
    for k, image in enumerate(stack):
        second, first = divmod(k, steps)
        response = 2 * image - full
        for down in (0, 1):
            for across in (0, 1):
                place = ((2 * second + steps * down) % (2 * steps), (2 * first + steps * across) % (2 * steps))
                responses[place] = response if down == across else -response
    flat = responses.reshape(4 * steps**2, *full.shape)
    best = flat.argmax(axis=0)
    largest = np.take_along_axis(flat, best[None], axis=0)[0]
    direct = largest.copy()
    if refine:
        for axis in (0, 1):
            place = list(np.unravel_index(best, (2 * steps, 2 * steps)))
            sides = []
            for move in (-1, 1):
                moved = list(place)
                moved[axis] = (place[axis] + move) % (2 * steps)
                index = moved[0] * (2 * steps) + moved[1]
                sides.append(np.take_along_axis(flat, index[None], axis=0)[0])
            bend = np.minimum(sides[0] + sides[1] - 2 * largest, -1e-12 * np.maximum(largest, 1e-12))
            direct -= (sides[1] - sides[0]) ** 2 / (8 * bend)
    direct = np.minimum(direct, full)
    return direct, full - direct
