"""Minutiae on which pictures of a finger agree: normals and albedo of every set of images that
leaves one out.

    python validation/published/voted.py A B [--preset zheng]
    python validation/published/voted.py PEOPLE --out scores.csv

A and B are captures: a result has lost its images.

Q. Zheng, A. Kumar and G. Pan, "Contactless 3D fingerprint identification without 3D
reconstruction", IWBF 2018, as the thesis describes it (section 2.2.1): seven sets of six images,
four pictures of each; no model of the skin.
"""

from __future__ import annotations

import heapq
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scored import run

from splitknit.capture import Capture
from splitknit.errors import BadInput
from splitknit.finger.locate import Finger
from splitknit.finger.ridges import ink
from splitknit.finger.steady import find_steady_finger
from splitknit.io.capture import read_capture
from splitknit.model import FloatArray
from splitknit.observation.coloured import balanced
from splitknit.observation.observe import observe
from splitknit.photometric.lambertian import lambertian
from splitknit.presets import preset_settings
from splitknit_match.prints.minutiae import extract
from splitknit_match.prints.minutiae_record import PPI, Minutiae
from splitknit_match.prints.print_map import plane_map, resample

sys.path.append(str(Path(__file__).resolve().parents[1] / "match"))
from bozorth3 import bozorth3

MAX_DISTANCE_MM = 0.3
"""Minutiae of two pictures that lie further apart are not the same."""
MAX_TURN_DEG = 40.0
"""Minutiae of two pictures whose directions differ by more are not the same."""
MIN_FRACTION = 0.5
"""Fraction of the pictures in which a minutia must be found to be kept."""
PICTURES = ("x", "y", "z", "albedo")
"""Components of the normals in the upright frame, and the albedo."""


def vote(pictures: Sequence[Minutiae], min_fraction: float = MIN_FRACTION) -> Minutiae:
    """Keep the minutiae that enough pictures show.

    Every picture has one vote for a place. The place with most votes is taken first, and the
    minutiae that voted for it have then no vote left for another. A kept minutia lies at the mean
    of its voters, points in their mean direction and has the type of most of them; its quality is
    the fraction of the pictures that show it, 0 to 100.
    """
    pool = _pool(pictures)
    near = _same(pool)
    free = np.ones(len(pool), dtype=np.bool_)
    least = max(1, int(np.ceil(min_fraction * len(pictures) - 1e-9)))
    waiting = [(*_standing(pool, near[k]), k) for k in range(len(pool))]
    heapq.heapify(waiting)
    kept = []
    while waiting:
        votes, spread, k = heapq.heappop(waiting)
        if -votes < least:
            break
        around = near[k][free[near[k]]]
        if not free[k]:
            continue
        now = _standing(pool, around)
        if now != (votes, spread):  # some of its voters have gone: it waits for its turn again
            heapq.heappush(waiting, (*now, k))
            continue
        voters = _voters(pool, around)
        free[voters] = False
        kept.append((*_mean(pool[voters]), len(voters)))
    table = np.array(kept, dtype=np.float64).reshape(-1, 5)
    x, y = (np.rint(table[:, k]).astype(np.int32) for k in (0, 1))
    order = np.lexsort((table[:, 2], y, x))
    fraction = np.rint(100.0 * table[:, 4] / len(pictures)).astype(np.uint8)
    kind = table[order, 3].astype(np.uint8)
    return Minutiae(x[order], y[order], table[order, 2], kind, fraction[order], pictures[0].size)


def _pool(pictures: Sequence[Minutiae]) -> NDArray[np.void]:
    """All minutiae, in an order that does not depend on that of the pictures."""
    rows = np.dtype(
        [(name, float) for name in ("x", "y", "direction")]
        + [(name, int) for name in ("type", "quality", "picture")]
    )
    parts = [
        (
            minutiae.x_px,
            minutiae.y_px,
            minutiae.direction_rad,
            minutiae.type,
            minutiae.quality,
            np.full(minutiae.count, number),
        )
        for number, minutiae in enumerate(pictures)
    ]
    pool = np.rec.fromarrays(
        [np.concatenate(column) for column in zip(*parts, strict=True)], rows
    ).view(np.ndarray)
    return pool[np.lexsort([pool[key] for key in ("type", "quality", "direction", "y", "x")])]


def _same(pool: NDArray[np.void]) -> list[NDArray[np.intp]]:
    """For each minutia those that are near enough to be the same, itself among them."""
    if not len(pool):
        return []
    places = np.stack([pool["x"], pool["y"]], axis=1)
    groups = []
    for k, around in enumerate(
        cKDTree(places).query_ball_point(places, MAX_DISTANCE_MM * PPI / 25.4, return_sorted=True)
    ):
        index = np.array(around, dtype=np.intp)
        turn = np.abs(np.angle(np.exp(1j * (pool["direction"][index] - pool["direction"][k]))))
        groups.append(index[turn <= np.deg2rad(MAX_TURN_DEG)])
    return groups


def _standing(pool: NDArray[np.void], around: NDArray[np.intp]) -> tuple[int, float]:
    """How many pictures show a place, negative, and how far its voters lie apart: the smallest
    comes first."""
    here = pool[around]
    return -len(set(here["picture"].tolist())), round(float(here["x"].var() + here["y"].var()), 6)


def _voters(pool: NDArray[np.void], where: NDArray[np.intp]) -> NDArray[np.intp]:
    """For each picture, the minutia nearest to the mean position of all nearby ones."""
    around = pool[where]
    away = np.hypot(around["x"] - around["x"].mean(), around["y"] - around["y"].mean())
    order = np.lexsort([np.arange(len(where)), np.round(away, 6), around["picture"]])
    _, first = np.unique(around["picture"][order], return_index=True)
    return np.asarray(where[order[first]])


def _mean(voters: NDArray[np.void]) -> tuple[float, float, float, int]:
    """Place, direction and type of a kept minutia; the reliable voters decide where the types are
    even."""
    direction = float(np.angle(np.exp(1j * voters["direction"]).sum()))
    support = {}
    for kind in np.unique(voters["type"]).tolist():
        qualities = voters["quality"][voters["type"] == kind]
        support[kind] = len(qualities), int(qualities.sum())
    kind = max(support, key=support.__getitem__)
    return float(voters["x"].mean()), float(voters["y"].mean()), direction % (2 * np.pi), kind


def pictures_of(capture: Capture, preset: str = "zheng") -> Iterator[tuple[str, NDArray[np.uint8]]]:
    """Name and print (h, w) of each picture of each set: photometric stereo without each white
    image in its turn.

    Grey images, distant lights, a matt surface. A picture without any contrast is left out.
    """
    settings = preset_settings(preset)
    lit = observe(capture, settings.lights, settings.camera)
    steady, finger = find_steady_finger(lit, settings)
    window = finger.window
    white = steady.without_films().white.at(1, window)
    stack = np.maximum(white.grey, np.float32(0.0))
    if len(stack) < 4:
        raise BadInput(
            "leaving out one image needs at least four of them, but the white band has"
            f" {len(stack)}."
        )
    mask = finger.mask[window]
    if settings.lights.balance and white.colours:
        stack = balanced(stack, white.rig, mask)
    pitch = capture.rig.camera.pitch_mm
    matrix = finger.upright.input_from_upright.copy()
    matrix[:2, 2] -= window[1].start, window[0].start
    print_map = plane_map(pitch, matrix, finger.upright.size, PPI)
    lights = capture.rig.select(white.lights).light_vectors()
    for k in range(len(stack)):
        normals, albedo = lambertian(
            np.delete(stack, k, axis=0), np.delete(lights, k, axis=0), mask
        )
        for name in PICTURES:
            values, weight = resample(
                _component(normals, albedo, name, finger), mask, pitch, print_map
            )
            try:
                yield name, ink(values, weight, PPI)
            except BadInput:  # flat: no vote
                continue


def _component(normals: FloatArray, albedo: FloatArray, name: str, finger: Finger) -> FloatArray:
    """(h, w) one picture; x to the right and y towards the tip of the upright finger."""
    if name == "albedo":
        return np.nan_to_num(albedo, nan=0.0)
    if name == "z":
        return normals[..., 2]
    turned = finger.upright.input_from_upright[:2, 0 if name == "x" else 1]
    # of the upright axis, in columns and rows of the input
    right, down = turned / np.linalg.norm(turned)
    along = np.float32(right) * normals[..., 0] - np.float32(down) * normals[..., 1]
    return along if name == "x" else -along


def features(finger: Path, preset: str) -> Minutiae | None:
    """Minutiae of a capture on which half of the pictures agree; None where they are fewer than
    ten."""
    by_picture = [extract(picture) for _, picture in pictures_of(read_capture(finger), preset)]
    kept = vote(by_picture) if by_picture else None
    return kept if kept is not None and kept.acquired else None


if __name__ == "__main__":
    raise SystemExit(run(features, bozorth3, "zheng"))
