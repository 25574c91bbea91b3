"""Minutiae that several pictures of one finger agree on; pictures of every set of images that leaves one out."""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np
from numpy.typing import NDArray

from splitknit import BadInput, Capture, Checked, FloatArray, Limits, require
from splitknit_match.matching.minutiae import extract
from splitknit_match.matching.minutiae_record import PPI, Minutiae, no_minutiae

if TYPE_CHECKING:
    from splitknit import Finger, FingerSettings

MM_PER_INCH = 25.4

_REACH_MM = 0.3
"""Minutiae of two pictures are the same if they lie no further apart: a third to two thirds of a ridge period."""
_TURN_DEG = 40.0
"""... and their directions differ by no more."""


@dataclass(frozen=True, slots=True)
class VoteSettings(Checked):
    """When minutiae of two pictures are the same, and how many pictures must agree."""

    _group = "voted"
    least_share: Annotated[float, Limits(0, 1, above=True)] = 0.5
    """Fraction of the pictures in which a minutia must be found to be kept."""


def vote(pictures: Sequence[Minutiae], settings: VoteSettings | None = None) -> Minutiae:
    """Keep the minutiae that enough pictures show.

    Every picture has one vote for a place. The place with most votes is taken first, and the minutiae that voted for it
    have then no vote left for another, so that each minutia counts once. A kept minutia lies at the mean of its voters,
    points in their mean direction and has the type of most of them. Raises BadInput if there are no pictures, or their
    sizes differ. The result lists minutiae by column and row; the quality is the fraction of the pictures that show it,
    0 to 100. The order of the pictures changes nothing.

    Source: Q. Zheng, A. Kumar and G. Pan, "Contactless 3D fingerprint identification without 3D reconstruction", IWBF
    2018, as the thesis describes it (section 2.2.1).
    >>> import numpy as np
    >>> def one(x):
    ...     small = np.array([1], np.uint8)
    ...     return Minutiae(np.array([x]), np.array([20]), np.zeros(1), small, small, (40, 40))
    >>> found = vote([one(10), one(12), one(30)], VoteSettings(least_share=0.5))
    >>> found.x_px.tolist(), found.quality.tolist()
    ([11], [67])
    """
    settings = settings or VoteSettings()
    require(len(pictures) > 0, "a vote needs at least one picture.")
    size = pictures[0].size
    for one in pictures:
        require(
            one.size == size,
            f"pictures that vote must be of one size, but one is {size[0]} x {size[1]} and another {one.size[0]} x "
            f"{one.size[1]}.",
        )
    pool = _pool(pictures)
    near = _same(pool)
    free = np.ones(len(pool), dtype=np.bool_)
    least = max(1, int(np.ceil(settings.least_share * len(pictures) - 1e-9)))
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
    return _listed(kept, size, len(pictures))


def _pool(pictures: Sequence[Minutiae]) -> NDArray[np.void]:
    """All minutiae, in an order that does not depend on that of the pictures."""
    rows = np.dtype(
        [("x", float), ("y", float), ("direction", float), ("type", int), ("quality", int), ("picture", int)]
    )
    parts = [
        (one.x_px, one.y_px, one.direction_rad, one.type, one.quality, np.full(one.count, number))
        for number, one in enumerate(pictures)
    ]
    pool = np.rec.fromarrays([np.concatenate(column) for column in zip(*parts, strict=True)], rows).view(np.ndarray)
    return pool[np.lexsort([pool[key] for key in ("type", "quality", "direction", "y", "x")])]


def _same(pool: NDArray[np.void]) -> list[NDArray[np.intp]]:
    """For each minutia those that are near enough to be the same, itself among them."""
    import scipy.spatial  # a comparison of templates needs none of it

    if not len(pool):
        return []
    places = np.stack([pool["x"], pool["y"]], axis=1)
    reach = _REACH_MM * PPI / MM_PER_INCH
    found = []
    for k, around in enumerate(scipy.spatial.cKDTree(places).query_ball_point(places, reach, return_sorted=True)):
        index = np.array(around, dtype=np.intp)
        turn = np.abs(np.angle(np.exp(1j * (pool["direction"][index] - pool["direction"][k]))))
        found.append(index[turn <= np.deg2rad(_TURN_DEG)])
    return found


def _standing(pool: NDArray[np.void], around: NDArray[np.intp]) -> tuple[int, float]:
    """How many pictures show a place, negative, and how far its voters lie apart: the smallest comes first."""
    here = pool[around]
    votes = len(set(here["picture"].tolist()))
    return -votes, round(float(here["x"].var() + here["y"].var()), 6)


def _voters(pool: NDArray[np.void], where: NDArray[np.intp]) -> NDArray[np.intp]:
    """For each picture, the minutia nearest to the mean position of all nearby ones."""
    around = pool[where]
    away = np.hypot(around["x"] - around["x"].mean(), around["y"] - around["y"].mean())
    order = np.lexsort([np.arange(len(where)), np.round(away, 6), around["picture"]])
    _, first = np.unique(around["picture"][order], return_index=True)
    return np.asarray(where[order[first]])


def _mean(voters: NDArray[np.void]) -> tuple[float, float, float, int]:
    """Place, direction and type of a kept minutia; the reliable voters decide where the types are even."""
    direction = float(np.angle(np.exp(1j * voters["direction"]).sum()))
    support = {}
    for kind in np.unique(voters["type"]).tolist():
        qualities = voters["quality"][voters["type"] == kind]
        support[kind] = len(qualities), int(qualities.sum())
    kind = max(support, key=support.__getitem__)
    return float(voters["x"].mean()), float(voters["y"].mean()), direction % (2 * np.pi), kind


def _listed(kept: list[tuple[float, float, float, int, int]], size: tuple[int, int], pictures: int) -> Minutiae:
    table = np.array(kept, dtype=np.float64).reshape(-1, 5)
    x, y = (np.rint(table[:, k]).astype(np.int32) for k in (0, 1))
    order = np.lexsort((table[:, 2], y, x))
    fraction = np.rint(100.0 * table[:, 4] / pictures)
    return Minutiae(
        x[order], y[order], table[order, 2], table[order, 3].astype(np.uint8), fraction[order].astype(np.uint8), size
    )


# Normals and albedo of every set of images that leaves one out, as pictures of one print's frame.

PICTURES = ("x", "y", "z", "albedo")
"""Components of the normals in the upright frame, and the albedo."""


@dataclass(frozen=True, slots=True)
class LeaveOneOutSettings:
    """Which pictures are made, and how."""

    pictures: tuple[str, ...] = PICTURES
    """Pictures of each set: components ``x``, ``y``, ``z`` of the normals, and ``albedo``."""
    sigma_px: float = 0.5
    """Smoothing of a picture, in pixels of a print of 500 ppi."""

    def __post_init__(self) -> None:
        for name in self.pictures:
            require(name in PICTURES, f"there is no picture '{name}' of a set; known are {', '.join(PICTURES)}.")
        require(len(self.pictures) > 0, "leave_one_out.pictures must name at least one picture.")
        require(0.1 <= self.sigma_px <= 4, f"leave_one_out.sigma_px must be 0.1 to 4, but it is {self.sigma_px}.")


@dataclass(frozen=True, slots=True, eq=False)
class _LeftOut:
    """One picture of one set."""

    image: int
    """Which image of the white band the set leaves out."""
    picture: str
    """One of :data:`PICTURES`."""
    print_image: NDArray[np.uint8]
    """(h, w) at 500 ppi in the frame of the relief's print, mirrored as paper is; high values are dark."""


def left_out_pictures(
    capture: Capture, settings: FingerSettings, chosen: LeaveOneOutSettings | None = None, finger: Finger | None = None
) -> Iterator[_LeftOut]:
    """Photometric stereo without each white image in its turn: normals and albedo as prints.

    Grey images, distant lights, a matt surface: no model of the skin. The sets share all work but one addition a pixel
    (:func:`splitknit.photometric.lambertian.left_out`), and one set is in memory at a time. Raises BadInput if the
    capture shows no finger, or the white band has fewer than four images.

    `settings`: of the mask and the orientation. `finger`: where the finger is, if that is known; otherwise it is found,
    and its motion undone, as for a surface.

    Yields each of the pictures for each image that is left out; a picture without any contrast is left out itself.

    Source: Q. Zheng, A. Kumar and G. Pan, "Contactless 3D fingerprint identification without 3D reconstruction", IWBF
    2018, as the thesis describes it (section 2.2.1): seven sets of six images, four pictures of each.
    """
    # settings of this method belong to those of all, so that every comparison imports this module
    from splitknit import (
        aligned,
        balanced,
        find_steady_finger,
        ink,
        left_out,
        linear_stack,
        prepared_capture,
        without_films,
    )
    from splitknit_match.prints.print_map import plane_map, resample

    chosen = chosen or LeaveOneOutSettings()
    capture, _ = aligned(prepared_capture(capture, settings)[0])
    if finger is None:
        capture, finger = find_steady_finger(capture, settings)
    white, window = without_films(capture).bands["white"], finger.window
    stack = np.maximum(linear_stack(white, capture.encoding, "grey", window), np.float32(0.0))
    require(len(stack) >= 4, f"leaving out one image needs at least four of them, but the white band has {len(stack)}.")
    mask = finger.mask[window]
    if settings.lights.balance and white.colours:
        stack = balanced(stack, capture.rig, white, mask)
    lights = capture.rig.select(white.lights).light_vectors()
    pitch = capture.rig.camera.pitch_mm
    window_from_upright = finger.upright.input_from_upright.copy()
    window_from_upright[:2, 2] -= window[1].start, window[0].start
    print_map = plane_map(pitch, window_from_upright, finger.upright.size, PPI)
    for k, (normals, albedo) in enumerate(left_out(stack, lights, mask)):
        for name in chosen.pictures:
            picture = _component(normals, albedo, name, finger)
            values, weight = resample(picture, mask, pitch, print_map, chosen.sigma_px)
            try:
                yield _LeftOut(k, name, ink(values, weight, PPI))
            except BadInput:  # flat: no vote
                continue


def voted_minutiae(
    capture: Capture,
    settings: FingerSettings,
    chosen: LeaveOneOutSettings | None = None,
    votes: VoteSettings | None = None,
) -> Minutiae:
    """Minutiae on which enough pictures of all sets agree; their quality is the fraction that does.

    Parameters as of :func:`left_out_pictures`. Raises BadInput as that, or if `nbis-py` is not installed.
    """
    found = [extract(one.print_image, PPI) for one in left_out_pictures(capture, settings, chosen)]
    return vote(found, votes) if found else no_minutiae()


def _component(normals: FloatArray, albedo: FloatArray, name: str, finger: Finger) -> FloatArray:
    """(h, w) one picture; x to the right and y towards the tip of the upright finger."""
    if name == "albedo":
        return np.nan_to_num(albedo, nan=0.0)
    if name == "z":
        return normals[..., 2]
    turned = finger.upright.input_from_upright[:2, 0 if name == "x" else 1]
    right, down = turned / np.linalg.norm(turned)  # of the upright axis, in columns and rows of the input
    along = np.float32(right) * normals[..., 0] - np.float32(down) * normals[..., 1]
    return along if name == "x" else -along
