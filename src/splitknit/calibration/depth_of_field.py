"""How deep the camera sees sharply, and whether a finger fits into that."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splitknit.errors import require


@dataclass(frozen=True, slots=True)
class DepthOfField:
    """Sharpness against depth of a camera that is focused on the finger plane."""

    focal_length_mm: float
    f_number: float
    focus_mm: float
    """Distance of the plane in focus."""
    confusion_um: float
    """Diameter, on the sensor, of the disc that still counts as a point."""
    near_mm: float
    """Nearest distance at which a point is no larger than that."""
    far_mm: float
    """Farthest; infinite beyond the hyperfocal distance."""
    finger_depth_mm: float
    """Depth of the finger that the camera sees."""
    blur_px: float
    """Diameter, in pixels of the image, of a point's disc at half the finger's depth from the plane in focus."""
    needed_f_number: float
    """At which the finger's depth would just be sharp, focused in its middle."""
    diffraction_px: float
    """Diameter of the Airy disc at that f-number, in pixels of the image, for light of 550 nm."""

    @property
    def depth_mm(self) -> float:
        """From the near to the far limit."""
        return self.far_mm - self.near_mm

    @property
    def best_f_number(self) -> float:
        """At which defocus at the finger's ends and diffraction blur alike: stopping down further gains nothing."""
        return self.needed_f_number / float(np.sqrt(self.diffraction_px))

    @property
    def fits(self) -> bool:
        """Whether the finger is sharp throughout."""
        return self.depth_mm >= self.finger_depth_mm


def depth_of_field(
    focal_px: float,
    pixel_um: float,
    f_number: float,
    focus_mm: float,
    *,
    finger_depth_mm: float = 8.0,
    confusion_px: float = 1.0,
) -> DepthOfField:
    """Limits of sharpness of a thin lens.

    A camera matrix holds the distance v from lens to sensor. With the distance u of the plane in focus the focal length
    is F = u v / (u + v), and the lens's opening A = F / N. A point at the distance s becomes a disc of the diameter
    b = A v |1/u - 1/s|. With b = c, the circle of confusion, 1/near = 1/u + c / (A v) and 1/far = 1/u - c / (A v). This
    is the same as near = u (H - F) / (H + u - 2 F) and far = u (H - F) / (H - u) with the hyperfocal distance
    H = F^2 / (N c) + F.

    Parameters
    ----------
    focal_px : focal length of the camera matrix
    pixel_um : side of one pixel of the *image* on the sensor (the sensor's pixel times the binning)
    f_number : N
    focus_mm : u, distance of the plane in focus from the camera's centre: its height over the finger plane
    finger_depth_mm : depth of the finger that the camera sees
    confusion_px : c in pixels of the image; one pixel by default

    Returns
    -------
    DepthOfField

    Raises
    ------
    BadInput
        If a value cannot be.

    References
    ----------
    S. F. Ray, "Applied Photographic Optics", 3rd edition, 2002, chapter 22 (depth of field); M. Born and E. Wolf,
    "Principles of Optics", 7th edition, 8.5.2 (Airy's disc, 2.44 times wavelength times working f-number).

    Examples
    --------
    >>> field = depth_of_field(10598.0, 1.12, 2.0, 140.0)
    >>> round(field.focal_length_mm, 2), round(field.depth_mm, 2), field.fits
    (10.94, 0.68, False)
    """
    for name, value in (
        ("focal_px", focal_px),
        ("pixel_um", pixel_um),
        ("f_number", f_number),
        ("focus_mm", focus_mm),
        ("finger_depth_mm", finger_depth_mm),
        ("confusion_px", confusion_px),
    ):
        require(bool(np.isfinite(value)) and value > 0, f"{name} must be a positive number, but it is {value}.")
    pixel_mm = pixel_um / 1000
    behind = focal_px * pixel_mm
    focal = focus_mm * behind / (focus_mm + behind)
    confusion = confusion_px * pixel_mm
    reach = confusion * f_number / (focal * behind)  # c / (A v)
    near, beyond = 1 / (1 / focus_mm + reach), 1 / focus_mm - reach
    side = finger_depth_mm / 2
    side_reach = side / (focus_mm * max(focus_mm - side, 1e-9))
    # near to far of the finger about its middle: reach that its two ends need, the nearer one more
    needed = side_reach * focal * behind / confusion
    airy_mm = 2.44 * 550e-6 * needed * (1 + behind / focus_mm)
    return DepthOfField(
        focal_length_mm=focal,
        f_number=f_number,
        focus_mm=focus_mm,
        confusion_um=1000 * confusion,
        near_mm=near,
        far_mm=1 / beyond if beyond > 0 else float("inf"),
        finger_depth_mm=finger_depth_mm,
        blur_px=focal / f_number * behind * side_reach / pixel_mm,
        needed_f_number=needed,
        diffraction_px=airy_mm / pixel_mm,
    )
