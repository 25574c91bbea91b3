"""A fingertip's shape from a rolled print's silhouettes ([18] of the thesis), beside simulated fingers' own.

    python validation/thesis/rolled_print.py      # 20 fingers: the errors, and rolled-print.png beside this file

The print is that of the finger rolled from side to side, without error of the roll; the true section is no ellipse, and
its height over its half width is the finger's own, where the function takes 0.8 for all.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from print_shape import fingertip_of_print

from splitknit.io.images import write_image
from splitknit_simulator.finger.finger import draw_finger
from splitknit_simulator.finger.master_print import MasterPrint
from splitknit_simulator.finger.shape import FingerBody, FingerShape

PITCH_MM, FINGERS = 0.05, 20
Array = NDArray[np.float64]


def main() -> None:
    found = []
    for seed in range(FINGERS):
        finger = draw_finger(seed)
        inside, u, v = rolled(finger.shape)
        points = fingertip_of_print(inside, PITCH_MM)
        found.append(errors(finger.shape, points))
        if seed == 1:
            picture = figure(finger.shape, points, ink(finger.master(), inside, u, v))
            write_image(Path(__file__).with_name("rolled-print.png"), picture)
    draws = np.random.default_rng(18).integers(0, FINGERS, (1000, FINGERS))
    for words, values in zip(
        ("half width, mm", "height at the middle, mm", "length, mm"), np.array(found).T, strict=True
    ):
        low, high = np.quantile(np.abs(values)[draws].mean(axis=1), (0.025, 0.975))
        size = np.abs(values).mean()
        print(f"{words}: mean error {values.mean():+.2f}, mean of its size {size:.2f} [{low:.2f}, {high:.2f}]")


def outline(shape: FingerShape) -> tuple[Array, Array, Array]:
    """x and z of the right outline over y, from the crease to the tip."""
    body = FingerBody(shape)
    y = np.linspace(0.0, shape.length_mm + 1.0, 4000)
    form = body._sections(y)
    reach2 = np.minimum((form.cap / shape.tip_length_mm) ** 2, 1.0)
    side = np.sqrt((1.0 - reach2) / (1.0 - shape.tip_squareness * reach2))
    return form.axis + side * form.half, y, form.drop


def rolled(shape: FingerShape) -> tuple[NDArray[np.bool_], Array, Array]:
    """Where a print rolled from side to side has ink, and u and v of its columns and rows."""
    body = FingerBody(shape)
    right, y, drop = outline(shape)
    left = 2.0 * body.axis_line(y)[0] - right
    ends = [body.distance_and_chart(x, y, drop + 1e-6)[1:] for x in (left, right)]
    line = np.concatenate([np.stack(ends[0], axis=1), np.stack(ends[1], axis=1)[::-1]])
    line = line[np.isfinite(line).all(axis=1)]
    u = np.arange(-20.0, 20.0, PITCH_MM)
    v = np.arange(float(line[:, 1].max()) + 0.5, 0.0, -PITCH_MM)
    places = np.stack([(line[:, 0] - u[0]) / PITCH_MM, (v[0] - line[:, 1]) / PITCH_MM], axis=1)
    picture = np.zeros((v.size, u.size), dtype=np.uint8)
    cv2.fillPoly(picture, [np.round(places).astype(np.int32)], 1)
    return picture.astype(np.bool_), u, v


def ink(master: MasterPrint, inside: NDArray[np.bool_], u: Array, v: Array) -> NDArray[np.uint8]:
    step = float(master.u_mm[1] - master.u_mm[0])
    x, y = np.meshgrid((u - master.u_mm[0]) / step, (master.v_mm[0] - v) / step)
    skin = cv2.remap(master.ridge, x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR)
    return np.where(inside & (skin > 0.5), 40, 255).astype(np.uint8)


def profiles(shape: FingerShape, points: Array) -> tuple[Array, Array, Array, Array, Array]:
    """y from the tip, half width and height over the axis by the print, and the true ones."""
    rows = np.isfinite(points).any(axis=(1, 2))
    part = points[rows]
    y = np.nanmax(part[..., 1], axis=1)
    half = 0.5 * (np.nanmax(part[..., 0], axis=1) - np.nanmin(part[..., 0], axis=1))
    high = np.nanmax(part[..., 2], axis=1)
    from_tip = y.max() - y
    right, true_y, drop = outline(shape)
    body = FingerBody(shape)
    axis = body.axis_line(true_y)[0]
    top = body.top(0.0 * true_y, true_y) - drop
    good = np.isfinite(top) & (right > axis)
    tip = true_y[good].max()
    order = np.argsort(tip - true_y[good])
    true = [np.interp(from_tip, (tip - true_y[good])[order], values[good][order]) for values in (right - axis, top)]
    return from_tip, half, high, true[0], true[1]


def errors(shape: FingerShape, points: Array) -> tuple[float, float, float]:
    from_tip, half, high, true_half, true_high = profiles(shape, points)
    some = (from_tip > 2.0) & (from_tip < 20.0)
    right, y, _ = outline(shape)
    tip = float(y[right > FingerBody(shape).axis_line(y)[0]].max())
    return (
        float(np.mean((half - true_half)[some])),
        float(np.mean((high - true_high)[some])),
        float(from_tip.max() - tip),
    )


def figure(shape: FingerShape, points: Array, print_image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The print, both silhouettes (black: by the print, orange: true), and the shape, lit."""
    from_tip, half, high, true_half, true_high = profiles(shape, points)
    scale, size = 16.0, (400, 400)
    front, side = (np.full((*size, 3), 255, dtype=np.uint8) for _ in range(2))
    for values, paint, wide in ((true_half, (213, 94, 0), 5), (half, (0, 0, 0), 2)):
        for sign in (-1, 1):
            line = np.stack([200 + sign * scale * values, 20 + scale * from_tip], axis=1)
            cv2.polylines(front, [np.round(line).astype(np.int32)], False, paint, wide, cv2.LINE_AA)
    for values, paint, wide in ((true_high, (213, 94, 0), 5), (high, (0, 0, 0), 2)):
        line = np.stack([120 + scale * values, 20 + scale * from_tip], axis=1)
        cv2.polylines(side, [np.round(line).astype(np.int32)], False, paint, wide, cv2.LINE_AA)
    down, right = (np.gradient(points, axis=k) for k in (0, 1))
    normal = np.cross(right, -down)
    light = normal @ np.array([-0.5, 0.4, 0.77]) / np.maximum(np.linalg.norm(normal, axis=2), 1e-12)
    clay = np.nan_to_num(np.clip(40.0 + 200.0 * light, 0.0, 255.0), nan=255.0) - 40.0 * (print_image < 128)
    shaded = np.full(size, 255, dtype=np.uint8)
    place = np.round(
        np.stack([200 + scale * points[..., 0], 20 + scale * (np.nanmax(points[..., 1]) - points[..., 1])], -1)
    )
    order = np.argsort(np.nan_to_num(points[..., 2], nan=-99.0), axis=None)
    for index in order[np.isfinite(points[..., 2]).ravel()[order]]:
        column, row = place.reshape(-1, 2)[index].astype(int)
        if 0 <= row < size[0] - 1 and 0 <= column < size[1] - 1:
            shaded[row : row + 2, column : column + 2] = np.clip(clay.ravel()[index], 0, 255)
    seen = cv2.resize(
        print_image, None, fx=PITCH_MM * scale * 0.75, fy=PITCH_MM * scale * 0.75, interpolation=cv2.INTER_AREA
    )
    panel = np.full((size[0], max(size[1], seen.shape[1]) + 4), 255, dtype=np.uint8)
    rows = min(size[0], seen.shape[0])
    panel[:rows, : seen.shape[1]] = seen[:rows]
    grey = [np.repeat(part[..., None], 3, axis=2) for part in (panel, shaded)]
    return np.hstack([grey[0], front, side, grey[1]])


if __name__ == "__main__":
    main()
