"""The shots of a moving finger, brought onto one of them: shift, turn and, where wanted, small elastic shifts.

Every shot is lit from elsewhere, so two shots of a still finger differ, and a method that compares them takes light for
motion. But what all shots of a matt surface may show together is known: at every pixel their brightnesses are a
combination of the three components of the light vectors, whatever the surface is. What is left after the best such
combination has been taken off is motion (or glare, which colours tell apart before). All shots are moved at once until
least is left: the surface itself is never needed, it is eliminated pixel by pixel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitknit.check import check_mask, check_stack, require
from splitknit.preprocess.regions import dilate, erode
from splitknit.preprocess.registration_flow import Array, Family, Flow, finger_family, places_of, still
from splitknit.preprocess.registration_level import Level, aligned, details_of, in_blocks, robust_root, slopes_of
from splitknit.types import BoolArray, FloatArray

FOLLOWING = 1e3
"""Weight against elastic shifts that follow the light, over that against others."""


@dataclass(frozen=True, slots=True)
class RegistrationSettings:
    """How shots are registered."""

    coarse_mm: tuple[float, ...] = (0.5, 0.3, 0.15)
    """Fine ends (sigma) of the band-pass filters in which the outline counts too, coarse to fine."""
    fine_mm: tuple[float, ...] = (0.08,)
    """The same of the filters in which only the skin counts."""
    band_ratio: float = 3.2
    """Coarse end of each filter over its fine end."""
    working_px_per_mm: float = 12.5
    """Scale of the copies that are compared in the finest band."""
    tilts: bool = False
    """Whether the finger may roll and pitch; light is taken for a little of either."""
    elastic_mm: float = 0.0
    """Spacing of the control points of elastic shifts, at least 2; 0: the finger shifts and turns only."""
    stiffness: float = 1.0
    """Weight against elastic shifts, over that of what the images say of a control point on average."""
    iterations: int = 20
    """Most refinements in each band."""
    surround_mm: float = 0.7
    """Width of the backdrop around the finger that is used, for the sake of its silhouette."""
    rim_mm: float = 0.8
    """Width of the finger's edge that is left out of the fine bands."""
    block_mm: float = 0.6
    """Side of the squares over which light and shifts are taken as even."""

    def __post_init__(self) -> None:
        bands = (*self.coarse_mm, *self.fine_mm)
        require(len(self.fine_mm) > 0 and min(bands) > 0, "motion.registration's bands must be positive numbers.")
        require(self.band_ratio > 1, "motion.registration.band_ratio must be above 1.")
        for name in ("working_px_per_mm", "block_mm"):
            require(getattr(self, name) > 0, f"motion.registration.{name} must be positive.")
        for name in ("stiffness", "surround_mm", "rim_mm"):
            require(getattr(self, name) >= 0, f"motion.registration.{name} must not be negative.")
        require(
            self.elastic_mm == 0 or self.elastic_mm >= 2, "motion.registration.elastic_mm must be 0, or at least 2."
        )
        require(self.iterations >= 1, "motion.registration.iterations must be at least 1.")

    @property
    def resolution(self) -> Array:
        """Most px/mm, and side of the blocks in mm."""
        return np.array([self.working_px_per_mm, self.block_mm])


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """Where the skin of the reference shot lies in every shot."""

    flow: Flow
    before: NDArray[np.float64]
    """(L,) details of each image that no matt surface explains, as they are, over its details (rms)."""
    after: NDArray[np.float64]
    """(L,) the same with the motion undone."""


def register_shots(
    stack: FloatArray,
    lights: NDArray[np.float64],
    mask: BoolArray,
    px_per_mm: float,
    *,
    reference: int,
    shots: NDArray[np.intp] | None = None,
    settings: RegistrationSettings | None = None,
) -> Registration:
    """Find where the skin of shot `reference` lies in every other shot.

    Parameters
    ----------
    stack : (L, H, W) float32 linear, at least five images; best without glare (:func:`without_glare`)
    lights : (L, 3) towards the light, its length the relative strength
    mask : (H, W) bool
        The finger, roughly.
    px_per_mm : float
    reference : int
        Shot onto which the others are brought.
    shots : (L,) shot of every image, where several lights share one; None = every image is a shot
    settings : RegistrationSettings, optional

    Raises
    ------
    BadInput
        With fewer than five images, or where shapes do not fit.

    References
    ----------
    Golub, G. and Pereyra, V., "The differentiation of pseudo-inverses and nonlinear least squares problems whose
    variables separate", SIAM J. Numer. Anal. 10(2), 1973 (the surface is eliminated from the least squares).
    """
    settings = settings or RegistrationSettings()
    stack = check_stack(stack, least=5)
    mask = check_mask(mask, (stack.shape[1], stack.shape[2]))
    count = len(stack)
    lights = np.asarray(lights, dtype=np.float64)
    require(lights.shape == (count, 3), f"lights must have the shape ({count}, 3), but they have {lights.shape}.")
    shots = np.arange(count) if shots is None else np.asarray(shots)
    require(shots.shape == (count,), f"shots must have the shape ({count},), but they have {shots.shape}.")
    number = int(shots.max()) + 1
    require(0 <= reference < number, f"the reference must be one of {number} shots, but it is {reference}.")
    problem = Problem(lights, shots, reference, settings)
    around, skin = dilate(mask, settings.surround_mm * px_per_mm), erode(mask, settings.rim_mm * px_per_mm)
    flow = unmoved = still(number, (mask.shape[0], mask.shape[1]), px_per_mm)
    for step, sigma in enumerate((*settings.coarse_mm, *settings.fine_mm)):
        fine = step >= len(settings.coarse_mm)
        region = skin if fine and skin.any() else around
        level = details_of(stack, region, px_per_mm, (sigma, settings.band_ratio * sigma), settings.resolution)
        flow = problem.settled(level, flow, finger_family(mask, px_per_mm, turns=step > 0))
        if fine and (settings.tilts or settings.elastic_mm > 0):
            family = finger_family(mask, px_per_mm, tilts=settings.tilts, hats_mm=settings.elastic_mm)
            flow = problem.settled(level, flow, family)
    return Registration(flow, problem.unexplained(level, unmoved), problem.unexplained(level, flow))


def without_glare(colours: FloatArray) -> FloatArray:
    """(L, H, W) light that came through the skin, from linear red, green and blue (3, L, H, W): glare is white."""
    return np.asarray(colours[0] - colours[2], dtype=np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """Which images belong together, and what they may show."""

    lights: Array
    """(L, 3)"""
    shots: NDArray[np.intp]
    """(L,)"""
    reference: int
    settings: RegistrationSettings

    def settled(self, level: Level, flow: Flow, family: Family) -> Flow:
        """Move the shots by Gauss-Newton steps within `family` until they hardly move."""
        basis, at_nodes = family.basis(*level.centres()), family.basis(*places_of(flow))
        nodes = flow.nodes_mm.copy()
        free = [k for k in range(len(nodes)) if k != self.reference]
        most = 1.0 / level.px_per_mm
        found = np.zeros((len(free), basis.shape[2]))
        for _ in range(self.settings.iterations):
            tensor, pull = self._statistics(level, aligned(level, Flow(nodes), self.shots))
            used = tensor.any(axis=(1, 2))
            step = self._step(tensor[used], pull[used], basis[used], free, family.rigid, found)
            step = np.clip(step, -most, most)
            found += step
            moved = np.einsum("km,ncm->kcn", step, at_nodes).reshape(len(free), *nodes.shape[1:])
            nodes[free] += moved
            if float(np.abs(moved).max()) < 5e-4:
                break
        return Flow(nodes)

    def unexplained(self, level: Level, flow: Flow) -> NDArray[np.float64]:
        """(L,) rms of what no surface explains over the rms of each image's details."""
        images = aligned(level, flow, self.shots)
        left = np.einsum("kl,lhw->khw", self._beyond_surface().astype(np.float32), images)
        error, power = ((part * part * level.weight).sum(axis=(1, 2), dtype=np.float64) for part in (left, images))
        return np.asarray(np.sqrt(error / np.maximum(power, 1e-30)))

    def _beyond_surface(self) -> Array:
        """(L, L) projection of brightnesses onto what no matt surface shows."""
        basis, _, _ = np.linalg.svd(self.lights, full_matrices=False)
        return np.asarray(np.eye(len(self.lights)) - np.einsum("ki,li->kl", basis, basis))

    def _statistics(self, level: Level, images: FloatArray) -> tuple[Array, Array]:
        """Normal equations of every block for shifts of all images: (B, 2L, 2L) and (B, 2L), robustly weighted."""
        count, height, width = images.shape
        project = self._beyond_surface()
        left = np.einsum("kl,lhw->khw", project.astype(np.float32), images)
        root = robust_root(level, np.sqrt((left * left).sum(axis=0) * level.weight))
        slopes = slopes_of(level, images) * root
        slopes = in_blocks(slopes.reshape(2 * count, height, width), level.block)
        left = in_blocks(left * root, level.block)
        tensor = (slopes @ slopes.transpose(0, 2, 1)).astype(np.float64)
        tensor *= np.repeat(np.repeat(project, 2, axis=0), 2, axis=1)
        pull = np.einsum("bkcp,bkp->bkc", slopes.reshape(len(slopes), count, 2, -1), left)
        return tensor, pull.reshape(len(slopes), -1).astype(np.float64)

    def _step(  # noqa: PLR0917
        self, tensor: Array, pull: Array, basis: Array, free: list[int], rigid: int, found: Array
    ) -> Array:
        """(F, M) change of the parameters of the free shots, which so far are `found`."""
        blocks, _, width = basis.shape
        count, number = len(self.lights), len(free)
        coupled = tensor.reshape(blocks, count, 2, count, 2)
        on_right = np.einsum("bkcld,bdj->bckjl", coupled, basis, optimize=True)
        flat = on_right.reshape(blocks * 2, count * width * count)
        matrix = (basis.reshape(blocks * 2, width).T @ flat).reshape(width, count, width, count)
        belongs = (self.shots[:, None] == np.array(free)).astype(np.float64)  # (L, F)
        matrix = np.einsum("ikjl,kf,lg->figj", matrix, belongs, belongs, optimize=True)
        matrix = matrix.reshape(number * width, number * width)
        force = np.einsum("bkc,bci,kf->fi", pull.reshape(blocks, count, 2), basis, belongs, optimize=True)
        matrix = matrix + 1e-6 * float(np.diag(matrix).mean()) * np.eye(len(matrix))
        if width > rigid:
            soft = np.arange(width) >= rigid
            weight = self.settings.stiffness * float(np.diag(matrix)[np.tile(soft, number)].mean())
            penalty = weight * self._penalty(free)
            matrix = matrix + np.kron(penalty, np.diag(soft.astype(np.float64)))
            force = force + np.einsum("kl,li->ki", penalty, found * soft)
        return np.asarray(-np.linalg.solve(matrix, force.ravel()).reshape(number, width))

    def _penalty(self, free: list[int]) -> Array:
        """(F, F) weight against elastic shifts of the free shots: great for those that follow the light.

        Skin that shifts in proportion to the light's direction looks almost as a surface with other slopes does.
        """
        mean = np.stack([self.lights[self.shots == k, :2].mean(axis=0) for k in range(int(self.shots.max()) + 1)])
        basis, _, _ = np.linalg.svd(mean[free] - mean[self.reference], full_matrices=False)
        return np.asarray(np.eye(len(free)) + FOLLOWING * np.einsum("ki,li->kl", basis, basis))
