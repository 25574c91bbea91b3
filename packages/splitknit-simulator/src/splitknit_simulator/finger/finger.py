"""A person's finger, how it is laid down, and the surface a camera sees of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Annotated, Any

import cv2
import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from splitknit import Camera
from splitknit.errors import require
from splitknit.model import Array, BoolArray, FloatArray
from splitknit.settings import Checked, Limits
from splitknit_simulator.camera.lens import picture_on_plane
from splitknit_simulator.finger.master_print import MasterPrint, MasterPrintSettings, master_print
from splitknit_simulator.finger.raycast import PlacedFinger, Placement, above, finger_in_view
from splitknit_simulator.finger.shape import FingerBody, FingerShape
from splitknit_simulator.finger.skin_map import FlexionCrease, SkinMap, SkinRelief, skin_map
from splitknit_simulator.surface import SimulatedSurface

FREQUENCIES = {
    "arch": 0.037,
    "tented_arch": 0.029,
    "left_loop": 0.338,
    "right_loop": 0.317,
    "whorl": 0.229,
    "twin_loop": 0.05,
}
"""Natural frequencies of the classes (Wilson, Candela and Watson 1994; twin loops from the
whorls)."""


@dataclass(frozen=True, slots=True)
class SimulatedFinger:
    """Everything of one finger that does not depend on its pose."""

    seed: int
    pattern: str
    shape: FingerShape = field(default_factory=FingerShape)
    skin: SkinRelief = field(default_factory=SkinRelief)
    print_settings: MasterPrintSettings = field(default_factory=MasterPrintSettings)
    printed: MasterPrint | None = None
    """Its ridges where they are a real print's, see
    :func:`splitknit_simulator.finger.master_print.master_of_print`; None: drawn."""

    def master(self) -> MasterPrint:
        """Draw the finger's master print (the same at every call)."""
        return self.printed or master_print(self.pattern, self.seed, self.print_settings)


@dataclass(frozen=True, slots=True)
class FingerPose(Checked):
    """How a finger lies under the camera. It enters from the lower image border, tip towards row 0.

    The finger turns about its axis (roll), then about x (pitch), then about the camera's axis
    (yaw).
    """

    yaw_rad: Annotated[float, Limits(-0.6, 0.6)] = 0.0
    """Counter-clockwise in the image: the tip turns to the left. Up to 0.35 (20 deg)."""
    pitch_rad: Annotated[float, Limits(-0.6, 0.6)] = 0.0
    """Positive lifts the tip towards the camera. Up to 0.14 (8 deg)."""
    roll_rad: Annotated[float, Limits(-0.6, 0.6)] = 0.0
    """Positive turns the pad to the right. Up to 0.35 (20 deg)."""
    x_mm: Annotated[float, Limits()] = 0.0
    """Where the middle of the distal phalanx lies beside the image centre."""
    insertion_mm: Annotated[float, Limits(0.0, above=True)] = 32.0
    """From the lower image border to the tip, along the rows, as measured on the finger plane."""
    height_mm: Annotated[float, Limits()] = 0.0
    """z of the highest point of the pad (shape without ridges): at 0 the finger plane touches the
    pad."""

    def rotation(self) -> Array:
        """(3, 3) from the finger's frame to the camera's."""
        cy, sy = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        cp, sp = np.cos(self.pitch_rad), np.sin(self.pitch_rad)
        cr, sr = np.cos(self.roll_rad), np.sin(self.roll_rad)
        yaw = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
        pitch = np.array([[1, 0, 0], [0, cp, -sp], [0, sp, cp]])
        roll = np.array([[cr, 0, sr], [0, 1, 0], [-sr, 0, cr]])
        return np.asarray(yaw @ pitch @ roll, dtype=np.float64)


# What makes fingers look like their owner's: forms of the pad, creases and ridge depths, with their
# spread.


@dataclass(frozen=True, slots=True)
class _Trait:
    """A normally distributed number that is cut off."""

    mean: float
    spread: float
    low: float
    high: float
    sided: bool = False  # whether the left hand has it mirrored


TRAITS: Mapping[str, _Trait] = {
    "thickness": _Trait(0.80, 0.05, 0.68, 0.92),
    "squareness": _Trait(0.18, 0.09, 0.02, 0.40),
    "tip_length": _Trait(1.02, 0.12, 0.78, 1.30),
    "tip_squareness": _Trait(0.12, 0.10, 0.0, 0.38),
    "taper": _Trait(0.06, 0.025, 0.01, 0.12),
    "pad_bulge": _Trait(0.06, 0.025, 0.01, 0.12),
    "pad_center": _Trait(0.50, 0.06, 0.38, 0.62),
    "neck": _Trait(0.03, 0.012, 0.005, 0.06),
    "arching_per_mm": _Trait(0.0015, 0.0010, -0.0005, 0.004),
    "sideways_mm": _Trait(0.0, 0.35, -0.9, 0.9, sided=True),
    "skew": _Trait(0.0, 0.03, -0.08, 0.08, sided=True),
    "tip_drop": _Trait(2.0, 0.5, 0.8, 3.2),
    "ridge_depth": _Trait(65.0, 13.0, 40.0, 95.0),
    "depth_variation": _Trait(0.12, 0.03, 0.05, 0.2),
    "pore_depth": _Trait(25.0, 6.0, 10.0, 45.0),
    "pore_darkening": _Trait(0.06, 0.02, 0.0, 0.12),
    "first_depth": _Trait(0.38, 0.09, 0.2, 0.6),
    "first_width": _Trait(0.28, 0.05, 0.18, 0.42),
    "first_tilt": _Trait(0.0, 0.04, -0.1, 0.1, sided=True),
    "first_bow": _Trait(0.003, 0.006, -0.01, 0.015),
    "first_reach": _Trait(10.5, 1.2, 8.0, 13.0),
    "first_darkening": _Trait(0.22, 0.06, 0.08, 0.4),
    "second_depth": _Trait(0.48, 0.08, 0.3, 0.6),
    "second_width": _Trait(0.34, 0.05, 0.2, 0.5),
    "second_tilt": _Trait(0.0, 0.03, -0.1, 0.1, sided=True),
    "second_bow": _Trait(0.0, 0.005, -0.01, 0.01),
    "second_reach": _Trait(11.5, 1.2, 8.0, 14.0),
    "second_darkening": _Trait(0.25, 0.06, 0.08, 0.4),
}
"""Those of :func:`draw_finger` and of people; the tip's drop (for a finger 13.5 mm thick) is our
choice: a fingertip ends near its nail, not half-way down."""


def shape_of(
    trait: Callable[[str], float], length_mm: float, width_mm: float, flatter: float = 1.0
) -> FingerShape:
    """The form of a pad of this size from its traits; its thickness is `flatter` times the
    trait's."""
    as_drawn = (
        "tip_squareness",
        "taper",
        "pad_bulge",
        "pad_center",
        "neck",
        "arching_per_mm",
        "sideways_mm",
        "skew",
    )
    return FingerShape(
        length_mm=length_mm,
        width_mm=width_mm,
        thickness_mm=width_mm * trait("thickness") * flatter,
        squareness=trait("squareness"),
        tip_length_mm=min(0.5 * width_mm * trait("tip_length"), 13.8),
        **{name: trait(name) for name in as_drawn},
    )


def crease_of(
    trait: Callable[[str], float],
    which: str,
    v_mm: float,
    side_lines: Callable[[], int],
    broad: float = 1.0,
) -> FlexionCrease:
    """The ``first`` or ``second`` crease of a finger that is `broad` times as broad as the mean."""
    return FlexionCrease(
        v_mm=v_mm,
        depth_mm=trait(f"{which}_depth"),
        width_mm=trait(f"{which}_width"),
        tilt=trait(f"{which}_tilt"),
        bow_per_mm=trait(f"{which}_bow"),
        reach_mm=trait(f"{which}_reach") * broad,
        side_lines=side_lines(),
        darkening=trait(f"{which}_darkening"),
    )


def relief_of(trait: Callable[[str], float], creases: tuple[FlexionCrease, ...]) -> SkinRelief:
    """Depths on the skin of a finger from its traits."""
    return SkinRelief(
        ridge_depth_um=trait("ridge_depth"),
        depth_variation=trait("depth_variation"),
        pore_depth_um=trait("pore_depth"),
        pore_darkening=trait("pore_darkening"),
        creases=creases,
    )


def draw_finger(
    seed: int, pattern: str | None = None, *, print_settings: MasterPrintSettings | None = None
) -> SimulatedFinger:
    """Draw one finger of the population; `pattern` as in
    :func:`splitknit_simulator.finger.master_print.master_print`, None draws it with its natural
    frequency.

    Greiner 1991, Hand anthropometry of US Army personnel (breadth and length of the distal
    phalanx). Maeno et al. 1998; Misumi and Akiyoshi 1984 (ridge height).
    """
    draws = np.random.default_rng([seed, 0xF1]).spawn(3)
    if pattern is None:
        pattern = str(draws[0].choice(list(FREQUENCIES), p=list(FREQUENCIES.values())))
    if pattern == "loop":
        pattern = str(draws[0].choice(("left_loop", "right_loop")))
    rng = draws[1]
    size = float(np.clip(rng.standard_normal(), -2, 2))

    def around(mean: float, spread: float, low: float, high: float, shared: float = 0.0) -> float:
        own = float(rng.standard_normal())
        return float(
            np.clip(mean + spread * (shared * size + np.sqrt(1 - shared**2) * own), low, high)
        )

    width = around(16.8, 1.4, 14.0, 20.0, shared=0.8)

    def trait(name: str) -> float:
        kind = TRAITS[name]
        return around(
            kind.mean, kind.spread, kind.low, 100.0 if name == "ridge_depth" else kind.high
        )

    shape = shape_of(trait, around(25.0, 1.5, 22.0, 28.0, shared=0.7), width)
    rng = draws[2]
    first = crease_of(trait, "first", 0.0, lambda: int(rng.integers(0, 4)))
    v_mm = -around(23.0, 1.5, 19.5, 26.0, shared=0.7)
    second = crease_of(trait, "second", v_mm, lambda: int(rng.integers(1, 5)))
    skin = relief_of(trait, (first, second))
    return SimulatedFinger(seed, pattern, shape, skin, print_settings or MasterPrintSettings())


def finger_surface(
    finger: SimulatedFinger,
    pose: FingerPose,
    camera: Camera,
    *,
    workers: int = 2,
    skin: SkinMap | None = None,
) -> SimulatedSurface:
    """Show one posed finger to a camera, with `skin` over the body instead of the finger's own
    where it is given.

    The rays of an orthographic camera are parallel; those of a perspective one start at (0, 0,
    height_mm) and go through the pixels, lens distortion included. Every pixel's ray is intersected
    with the smooth body and then with the displaced skin (distance from the body equal to the
    displacement at that point of the chart); normals are the gradient of that implicit skin, so
    they are those of the heights, exact at steep slants too, not differences of neighbours. The
    result does not depend on `workers`, threads. A print made of this finger is the mirror image of
    what the camera sees. Raises BadInput if the camera sees nothing of the finger, or a perspective
    camera does not stand above it.
    """
    body = FingerBody(finger.shape)
    finger = replace(finger, printed=finger.master())
    skin = skin_map(finger.master(), finger.skin) if skin is None else skin
    placement = placement_of(body, pose, camera)
    top = above(body, placement)
    require(
        camera.model == "orthographic" or camera.height_mm > top + 5.0,
        f"the camera stands {camera.height_mm:.1f} mm above the finger plane, but the finger needs"
        f" {top + 5.0:.1f} mm; raise camera.height_mm.",
    )
    surface = finger_in_view(PlacedFinger(body, skin, placement), camera, workers)
    return replace(surface, landmarks=_find_landmarks(finger, pose, surface, skin))


def placement_of(body: FingerBody, pose: FingerPose, camera: Camera) -> Placement:
    """Turn and shift a finger: its tip at the insertion length, the pad's highest point at the
    pose's height."""
    shape = body.shape
    rotation = pose.rotation()
    y, side = np.meshgrid(
        np.linspace(1.0, shape.length_mm, 121), np.linspace(-1.0, 1.0, 81), indexing="ij"
    )
    x = side * 0.55 * shape.width_mm
    z = body.top(x, y)
    seen = np.isfinite(z)
    # `top` works in unskewed sections: undo the axis bend and the skew to find the true point.
    axis, drop = body.axis_line(y)
    points = np.stack([x + axis + shape.skew * (z - drop), y, z], -1)[seen]
    turned = np.einsum("ij,nj->ni", rotation, points)
    along = 0.5 * shape.length_mm
    bend, dip = (float(part[0]) for part in body.axis_line(np.array([along])))
    middle = np.einsum("ij,j->i", rotation, np.array([bend, along, dip]))
    tip = float(turned[:, 1].max())
    centre, lower_border, _ = picture_on_plane(camera)
    right, up = centre + pose.x_mm - middle[0], lower_border + pose.insertion_mm - tip
    shift = np.array([right, up, pose.height_mm - float(turned[:, 2].max())])
    return Placement(rotation, shift)


# What the simulated finger knows about itself, in pixels.


def _find_landmarks(
    finger: SimulatedFinger, pose: FingerPose, surface: SimulatedSurface, skin: SkinMap
) -> dict[str, Any]:
    """Collect landmarks; pixel positions are (column, row), NaN or absent where not in view."""
    mask, chart, master, camera = surface.mask, surface.chart, finger.master(), surface.camera
    assert chart is not None
    pixels = _finder(mask, chart, max(1, int(0.35 * camera.px_per_mm)))

    def visible(points: Any) -> Array:
        places = pixels(points)
        return places[np.isfinite(places).all(axis=1)]

    creases = [visible(line[::8]) for line in skin.crease_lines]
    # (N, 2) places of the pores on the chart
    rows, columns = np.nonzero(
        (master.pores > 0.25) & (master.pores >= cv2.dilate(master.pores, np.ones((3, 3))))
    )
    pores_mm = np.stack([master.u_mm[columns], master.v_mm[rows]], axis=1)
    return {
        "tip_px": _tip(mask, pose),
        "crease_px": creases,
        "cores_px": pixels(master.cores_mm),
        "deltas_px": pixels(master.deltas_mm),
        "minutiae_px": visible(master.minutiae[:, :2]),
        "pores_px": visible(pores_mm),
        "seed": finger.seed,
        "pattern": master.pattern,
        **asdict(pose),
        "period_mm": master.period_mm,
    }


def _finder(mask: BoolArray, chart: FloatArray, step: int) -> Callable[[Any], Array]:
    """Finds the pixels (N, 2), column and row, that show points (N, 2) of the chart, by Newton
    steps from the nearest of every `step`-th pixel; NaN where none shows it."""
    rows, columns = np.nonzero(mask[::step, ::step])
    seeds = step * np.stack([columns, rows], axis=1)
    tree = cKDTree(chart[rows * step, columns * step].astype(np.float64))
    planes = np.moveaxis(chart, -1, 0).astype(np.float64)

    def at(pixels: Array) -> Array:
        places = pixels.T[::-1]
        sampled = [ndimage.map_coordinates(p, places, order=1, cval=np.nan) for p in planes]
        return np.stack(sampled, axis=1)

    def find(points: Any) -> Array:
        wanted = np.asarray(points, dtype=np.float64).reshape(-1, 2)
        if not len(wanted):
            return wanted
        pixels = seeds[tree.query(wanted)[1]].astype(np.float64)
        with np.errstate(invalid="ignore", divide="ignore"):
            for _ in range(6):
                here = at(pixels)
                u, v = (wanted - here).T
                # in the cell of four pixels at each place, whose chart is bilinear
                x, y = (1e3 * (at(pixels + small) - here).T for small in 1e-3 * np.eye(2))
                steps = np.stack([u * y[1] - v * y[0], x[0] * v - x[1] * u], axis=1)
                pixels = pixels + np.clip(steps / (x[0] * y[1] - x[1] * y[0])[:, None], -60.0, 60.0)
            miss = np.abs(wanted - at(pixels)).max(axis=1)
        return np.where(miss[:, None] < 0.01, pixels, np.nan)

    return find


def _tip(mask: BoolArray, pose: FingerPose) -> Array:
    """(column, row) of the outline's farthest point along the finger."""
    top = np.argmax(mask, axis=0)
    columns = np.nonzero(mask.any(axis=0))[0]
    along = -np.sin(pose.yaw_rad) * columns - np.cos(pose.yaw_rad) * top[columns]
    best = columns[along > along.max() - 0.75]
    return np.array([best.mean(), top[best].mean()])


# How people lay their fingers down.


@dataclass(frozen=True, slots=True)
class PoseRanges:
    """Ranges from which a finger's pose is drawn, evenly."""

    yaw_deg: tuple[float, float] = (-10.0, 10.0)
    """Turn about the camera's axis, counter-clockwise in the image (the tip turns to the left); 34
    deg at most."""
    pitch_deg: tuple[float, float] = (-4.0, 4.0)
    """Turn about the x axis, positive lifts the tip towards the camera; 34 deg at most."""
    roll_deg: tuple[float, float] = (-8.0, 8.0)
    """Turn about the finger's own axis, positive turns the pad to the right; 34 deg at most."""
    x_mm: tuple[float, float] = (-2.5, 2.5)
    """Where the middle of the distal phalanx lies beside the image centre."""
    insertion_mm: tuple[float, float] = (25.0, 28.0)
    """From the lower image border to the tip; cut to what the picture holds."""
    height_mm: tuple[float, float] = (-0.5, 0.5)
    """z of the highest point of the pad."""

    def __post_init__(self) -> None:
        for name, (low, high) in asdict(self).items():
            require(
                bool(np.isfinite([low, high]).all()) and low <= high,
                f"pose range {name} must be (low, high).",
            )

    def draw(self, rng: np.random.Generator, camera: Camera) -> FingerPose:
        """Return one pose; every range takes one number from `rng`, in a fixed order."""
        yaw, pitch, roll, x, insertion, height = (
            float(low + (high - low) * rng.random()) for low, high in asdict(self).values()
        )
        yaw, pitch, roll = (float(np.deg2rad(turn)) for turn in (yaw, pitch, roll))
        _, lower, upper = picture_on_plane(camera)
        return FingerPose(yaw, pitch, roll, x, min(insertion, upper - lower - 0.6), height)
