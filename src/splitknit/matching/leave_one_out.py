"""Normals and albedo of every set of images that leaves one out, as pictures of one print's frame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, require
from splitknit.matching.minutiae import extract
from splitknit.matching.minutiae_record import Minutiae, no_minutiae
from splitknit.matching.voted_minutiae import VoteSettings, vote
from splitknit.model import Capture, FloatArray

if TYPE_CHECKING:
    from splitknit.finger.locate import Finger, FingerSettings

PICTURES = ("x", "y", "z", "albedo")
"""Components of the normals in the upright frame, and the albedo."""
PPI = 500.0


@dataclass(frozen=True, slots=True)
class LeaveOneOutSettings:
    """Which pictures are made, and how."""

    pictures: tuple[str, ...] = PICTURES
    """Of each set: components ``x``, ``y``, ``z`` of the normals, and ``albedo``."""
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
    """Of :data:`PICTURES`."""
    print_image: NDArray[np.uint8]
    """(h, w) at 500 ppi in the frame of the relief's print, mirrored as paper is; high values are dark."""


def left_out_pictures(
    capture: Capture, settings: FingerSettings, chosen: LeaveOneOutSettings | None = None, finger: Finger | None = None
) -> Iterator[_LeftOut]:
    """Photometric stereo without each white image in its turn: normals and albedo as prints.

    Grey images, distant lights, a matt surface: no model of the skin. The sets share all work but one addition a pixel
    (:func:`splitknit.photometric.lambertian.left_out`), and one set is in memory at a time.

    Parameters
    ----------
    capture : Capture
    settings : of the mask and the orientation
    chosen : LeaveOneOutSettings, optional
    finger : where the finger is, if that is known; otherwise it is found, and its motion undone, as for a surface

    Yields
    ------
    _LeftOut
        For each image that is left out, each of the pictures. A picture without any contrast is left out itself.

    Raises
    ------
    BadInput
        If the capture shows no finger, or the white band has fewer than four images.

    References
    ----------
    Q. Zheng, A. Kumar and G. Pan, "Contactless 3D fingerprint identification without 3D reconstruction", IWBF 2018, as
    the thesis describes it (section 2.2.1): seven sets of six images, four pictures of each.
    """
    # settings of this method belong to those of all, so that every comparison imports this module
    from splitknit.finger.locate import prepared_capture
    from splitknit.finger.steady import find_steady_finger
    from splitknit.imaging.band import linear_stack
    from splitknit.imaging.coloured import balanced
    from splitknit.photometric.lambertian import left_out
    from splitknit.prints.print_map import plane_map, resample
    from splitknit.prints.ridges import PrintSettings, ink

    chosen = chosen or LeaveOneOutSettings()
    capture, _ = prepared_capture(capture, settings)
    if finger is None:
        capture, finger = find_steady_finger(capture, settings)
    white, window = capture.bands["white"], finger.window
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
                yield _LeftOut(k, name, ink(values, weight, PrintSettings(ppi=PPI)))
            except BadInput:  # flat: no vote
                continue


def voted_minutiae(
    capture: Capture,
    settings: FingerSettings,
    chosen: LeaveOneOutSettings | None = None,
    votes: VoteSettings | None = None,
) -> Minutiae:
    """Minutiae on which enough pictures of all sets agree; their quality is the fraction that does.

    Parameters
    ----------
    capture, settings, chosen : as of :func:`left_out_pictures`
    votes : VoteSettings, optional

    Raises
    ------
    BadInput
        As :func:`left_out_pictures`, or if `nbis-py` is not installed.
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
