"""A fingertip's shape from a rolled print's silhouettes ([18] of the thesis), beside simulated fingers' own.

    python validation/thesis/rolled_print.py      # 20 fingers: the errors, and rolled-print.png beside this file

The print is that of the finger rolled from side to side, without error of the roll. All that an outline does not show
(thickness over width, squareness, bulge) is another finger's, as in ``splitknit simulate --print FILE --rolled``.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.io.images import write_image
from splitknit_simulator.finger.finger import draw_finger
from splitknit_simulator.finger.master_print import MasterPrint
from splitknit_simulator.finger.shape import FingerBody, FingerShape, shape_of_rolled_print

PITCH_MM, FINGERS = 0.05, 20
Array = NDArray[np.float64]


def main() -> None:
    found = []
    for seed in range(FINGERS):
        finger = draw_finger(seed)
        inside, u, v = rolled(finger.shape)
        by_print = shape_of_rolled_print(inside, PITCH_MM, draw_finger(seed + FINGERS).shape)
        found.append(errors(finger.shape, by_print))
        if seed == 1:
            picture = figure(finger.shape, by_print, ink(finger.master(), inside, u, v))
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


def silhouettes(shape: FingerShape) -> tuple[Array, Array, Array]:
    """Distance from the tip, mm, half width, and height of the top over the axis."""
    body = FingerBody(shape)
    right, y, drop = outline(shape)
    half = right - body.axis_line(y)[0]
    top = body.top(0.0 * y, y) - drop
    good = np.flatnonzero(np.isfinite(top) & (half > 0.0))[::-1]
    return y[good[0]] - y[good], half[good], top[good]


def errors(shape: FingerShape, found: FingerShape) -> tuple[float, float, float]:
    at = np.linspace(2.0, 20.0, 181)
    true, ours = silhouettes(shape), silhouettes(found)
    half, high = (float(np.mean(np.interp(at, ours[0], ours[k]) - np.interp(at, true[0], true[k]))) for k in (1, 2))
    return half, high, found.length_mm - shape.length_mm


def figure(shape: FingerShape, found: FingerShape, print_image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The print, both silhouettes (black: by the print, orange: true), and the shape by the print, lit."""
    scale, size = 16.0, (400, 400)
    front, side = (np.full((*size, 3), 255, dtype=np.uint8) for _ in range(2))
    for one, paint, wide in ((shape, (213, 94, 0), 5), (found, (0, 0, 0), 2)):
        from_tip, half, high = silhouettes(one)
        for picture, middle, values in ((front, 200, half), (front, 200, -half), (side, 120, high)):
            line = np.stack([middle + scale * values, 20 + scale * from_tip], axis=1)
            cv2.polylines(picture, [np.round(line).astype(np.int32)], False, paint, wide, cv2.LINE_AA)
    columns, rows = np.meshgrid(np.arange(size[1]), np.arange(size[0]))
    height = FingerBody(found).top((columns - 200) / scale, found.length_mm - (rows - 20) / scale)
    down, right = np.gradient(height, 1.0 / scale)
    light = np.stack([-right, down, np.ones(size)], -1) @ np.array([-0.5, 0.4, 0.77])
    clay = 40.0 + 200.0 * light / np.sqrt(1.0 + right**2 + down**2)
    shaded = np.nan_to_num(np.clip(clay, 0.0, 255.0), nan=255.0).astype(np.uint8)
    zoom = PITCH_MM * scale * 0.75
    seen = cv2.resize(print_image, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_AREA)
    panel = np.full((size[0], max(size[1], seen.shape[1]) + 4), 255, dtype=np.uint8)
    rows_shown = min(size[0], seen.shape[0])
    panel[:rows_shown, : seen.shape[1]] = seen[:rows_shown]
    grey = [np.repeat(part[..., None], 3, axis=2) for part in (panel, shaded)]
    return np.hstack([grey[0], front, side, grey[1]])


if __name__ == "__main__":
    main()
