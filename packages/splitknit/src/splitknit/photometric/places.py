"""Where the lights of photographs stand: from their glints on balls, and from the light that a flat
matt ground reflects, in one fit.

Coordinates are mm, x right, y up, z to the camera; the ground is z = 0, and photographs are seen on
it. The three kinds of evidence complete each other. Glints on one ball give directions, whose
elevation depends on the ball's radius; glints on two balls give places, up to a scale that the
radii and the camera's centre share; the ground gives distances, up to a bas-relief ambiguity.
Lights usually sit on a dome, which is a prior.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from splitknit.errors import require
from splitknit.imaging.robust import cauchy, deviation
from splitknit.imaging.view import plane_points
from splitknit.model import Array, BoolArray, Camera, FloatArray

_GLINT_SD_PX = 0.8
"""Of a glint's place: low ones touch mirrored ground and err together; with 0.15 px the intervals
of two balls alone held 4 of 10 lights. Chosen on: rendered domes, and two sets of photographs of
one dome (validation/objects/dome.py)."""
_DIRECTION_SD = 0.2
"""Of the normal that gives a glint, of a stated direction: 24 deg of it. Chosen on: how well two
sets of photographs agree on the lights of one dome (validation/objects/dome.py)."""
_OUTLINE_SD = 0.15  # of a ball's outlined radius, relative: a dark ball has a soft rim
_MIDDLE_SD = 0.08  # of its outlined middle, over the radius
_DOME_SD = 0.03  # lights off their common sphere, over its radius: 0.02 to 0.03 on a home-made dome
_CENTRE_SD = 0.05
"""Of the dome's centre off the picture's middle on the ground, over its radius. Chosen on: the
same."""
CAMERA_HEIGHT = 0.77
"""Height of a camera that nobody measured over the longer side of its picture on the ground: a lens
of 66 deg across."""
_GROUND_SD = 0.03  # of a matt ground's light, relative, before the scale is estimated
_LAMP_SD = 0.05  # of the logarithm of a lamp's brightness: lamps of one kind differ so
_BEAM_SD = 0.5
"""Of the logarithm of the exponent of the lamps' beam: a bare LED has 1, one with a lens 5. Chosen
on: two sets of photographs of one dome (validation/objects/dome.py), 1.3 mm apart; with 1.0 2.0."""
_AIM_SD = 0.06  # of a lamp's aim off the picture's middle, rad: 5 mm under a dome of 80 mm
GROUND_POINTS = 4000  # over the whole picture
_OF_BLOCKS = 8.0
"""Observations of means of blocks, which are less noisy. Chosen on: a photographed coin, tilt 1.1
to 0.8 deg and bow 0.08 to 0.05 mm of 20 to 8."""
_FEWEST_POINTS, _FEWEST_LIT = 50, 6  # points that so many lights must light, at least
_GROUND_REACH = 0.5
"""Radius of the ground that counts over the picture's shorter side: at grazing incidence, far from
a lamp, felt is not Lambertian. Chosen on: a photographed coin, whose middle then lies
0.003 mm off its rim's plane; with the whole picture 0.15 mm and more."""
_LIKE_GROUND = np.log(3.0)  # brightness of ground over that of most of the picture
_DARK, _BRIGHT = 0.003, 0.85  # ground that is lit and not clipped
_TILES = 8.0  # along the picture's longer side, of which every second one is judged


@dataclass(frozen=True, slots=True, eq=False)
class BallGlints:
    """A ball and the glints of the lights on it, as photographs show them on the ground."""

    outline_mm: tuple[float, float, float]
    """x, y and radius of its outline."""
    glints_mm: Array
    """(L, 2) x and y of each light's glint; NaN where it shows none."""
    place_sd_mm: float | None = None
    """Standard deviation of the middle of a ball whose place is not known: its glints are relative
    to its middle, and as uncertain as a stated direction."""


@dataclass(frozen=True, slots=True, eq=False)
class MattGround:
    """Points of a flat matt ground, and how bright each light makes them."""

    points_mm: Array
    """(P, 2) x and y."""
    values: Array
    """(L, P) linear light."""
    usable: BoolArray
    """(L, P) where a value is neither clipped nor in shadow."""

    observations: float = 20.0
    """Number of independent observations that one light's photograph of the ground counts as: its
    points share one reflectance, which is not quite matt."""

    @classmethod
    def of(cls, points_mm: Array, values: Array) -> MattGround:
        """The ground at points (P, 2) with values (L, P)."""
        return cls(points_mm, values, (values > _DARK) & (values < _BRIGHT))

    def of_points(self, chosen: BoolArray) -> MattGround:
        """Some of its points."""
        return replace(
            self,
            points_mm=self.points_mm[chosen],
            values=self.values[:, chosen],
            usable=self.usable[:, chosen],
        )


@dataclass(frozen=True, slots=True, eq=False)
class LightPlaces:
    """Where lights stand."""

    places_mm: Array
    """(L, 3)."""
    interval_mm: Array
    """(L,) half of the 95 % interval, in the least certain direction."""
    eye_mm: Array
    """(3,) the camera's centre."""
    dome_mm: Array
    """(4,) x, y, z and radius of the sphere on which the lights lie best."""
    glint_px: float
    """rms distance of the glints from where the fit expects them."""
    ground_misfit: float | None
    """Relative (robust) deviation of the ground from a matt plane under these lights."""
    lobe_exponent: float
    """Of the lamps' beam, aimed at the picture's middle; zero without a ground."""
    off_stated: Array
    """(L,) distance of each light's glints, or stated direction, from where the fit expects them,
    in standard deviations."""


def fit_places(
    balls: Sequence[BallGlints],
    px_per_mm: float,
    *,
    ground: MattGround | None = None,
    eye_mm: tuple[float, float, float],
    eye_sd_mm: tuple[float, float, float],
) -> LightPlaces:
    """Places of lights that explain glints and ground, by robust least squares (Gauss-Newton).

    The albedo of each point of the ground is eliminated (variable projection: G. H. Golub and V.
    Pereyra, Inverse Problems 19, 2003). A glint lies where the ball's normal halves the angle
    between light and camera; inverse square and the cosine of incidence give the ground's light.

    Parameters
    ----------
    balls
        One or more, each with a glint for most lights.
    px_per_mm
        Scale of the photographs on the ground.
    ground
        Without it, one ball leaves the distances to the dome's prior.
    eye_mm, eye_sd_mm
        The camera's centre as it is known, and its standard deviations.

    Raises
    ------
    BadInput
        If a light has no glint on any ball.
    """
    seen = np.stack([ball.glints_mm for ball in balls])
    missing = np.flatnonzero(np.isnan(seen[..., 0]).all(axis=0))
    require(not len(missing), f"light {missing[0] if len(missing) else 0} has no glint on a ball.")
    problem = _Problem(balls, seen, px_per_mm, np.array(eye_mm), np.array(eye_sd_mm))
    places, shared = problem.start()
    size = 4 * len(places) + 1
    lamps = np.append(np.arange(3, size, 4), size - 1)
    gains = np.zeros(len(lamps))  # logarithms of each lamp's brightness, and of the beam's exponent
    sd = np.append(np.full(len(places), _LAMP_SD), _BEAM_SD)
    ground_misfit = None
    for _ in range(60):
        normal, right = problem.linearised(places, shared)
        if ground is not None:
            of_ground, of_right, ground_misfit = _of_ground(places, gains, ground)
            normal[:size, :size] += of_ground
            right[:size] += of_right
        normal[lamps, lamps] += 1.0 / sd**2
        right[lamps] -= gains / sd**2
        diagonal = np.einsum("ii->i", normal)
        diagonal *= 1.0001
        step = np.linalg.solve(normal, right)
        gains = gains + np.clip(step[lamps], -0.2, 0.2)
        moved = step[: size - 1].reshape(-1, 4)[:, :3]
        reach = 0.15 * shared[-1]
        length = np.linalg.norm(moved, axis=1, keepdims=True)
        places = places + moved * np.minimum(1.0, reach / np.maximum(length, 1e-12))
        places[:, 2] = np.maximum(places[:, 2], 0.01 * shared[-1])
        shared = problem.inside(shared + np.clip(step[size:], -reach, reach))
        if np.abs(moved).max() < 1e-3 * shared[-1]:
            break
    covariance = np.linalg.inv(normal)[: size - 1, : size - 1].reshape(
        len(places), 4, len(places), 4
    )
    of_places = np.einsum("kikj->kij", covariance[:, :3, :, :3])
    exponent = 0.0 if ground is None else float(np.exp(gains[-1]))
    # a lamp aimed elsewhere shades the ground as one that stands elsewhere, whose light falls with
    # the cube of its distance
    of_aim = np.square(_AIM_SD * shared[-1] * exponent / 3.0)
    glints = problem.glints(places, shared)
    weight = cauchy(glints, 3.0)
    return LightPlaces(
        places,
        1.96 * np.sqrt(np.linalg.eigvalsh(of_places)[:, -1] + of_aim),
        shared[-7:-4],
        shared[-4:],
        _GLINT_SD_PX * float(np.sqrt((weight * glints**2).sum() / weight[glints != 0].sum())),
        ground_misfit,
        exponent,
        np.linalg.norm(glints, axis=1),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    """Glints, outlines and priors, each over its standard deviation.

    What all lights share: x, y, z and radius of each ball; the camera's centre (3); centre and
    radius of the dome (4).
    """

    balls: Sequence[BallGlints]
    seen: Array
    px_per_mm: float
    eye: Array
    eye_sd: Array

    def start(self) -> tuple[Array, Array]:
        """Lights on a dome as large as the camera is high, in the direction of their mean glint."""
        normals = []
        for ball, glints in zip(self.balls, self.seen, strict=True):
            x, y = ((glints - np.nanmedian(glints, axis=0)) / ball.outline_mm[2]).T
            normals.append([x, y, np.sqrt(np.maximum(1 - x * x - y * y, 0.05))])
        normal = np.nanmean(normals, axis=0).T
        towards = 2 * normal[:, 2:] * normal - (0.0, 0.0, 1.0)
        towards[:, 2] = np.maximum(towards[:, 2], 0.1)
        towards /= np.linalg.norm(towards, axis=1, keepdims=True)
        radius = 0.8 * self.eye[2]
        of_balls = [(x, y, size, size) for x, y, size in (ball.outline_mm for ball in self.balls)]
        return radius * towards, np.array([*np.ravel(of_balls), *self.eye, 0.0, 0.0, 0.0, radius])

    def inside(self, shared: Array) -> Array:
        """Radii and the camera's height stay positive."""
        shared = shared.copy()
        for k, ball in enumerate(self.balls):
            shared[4 * k + 3] = max(shared[4 * k + 3], 0.2 * ball.outline_mm[2])
        shared[-5] = max(shared[-5], 0.3 * self.eye[2])
        shared[-1] = max(shared[-1], 0.2 * self.eye[2])
        return shared

    def glints(self, places: Array, shared: Array) -> Array:
        """(L, 2 B) glints off their expected places; zero where none is seen."""
        eye = shared[-7:-4]
        off = []
        for k, ball in enumerate(self.balls):
            middle, radius = shared[4 * k : 4 * k + 3], shared[4 * k + 3]
            glints = glints_on(places, middle, radius, eye) - self.seen[k]
            sd_mm = _GLINT_SD_PX / self.px_per_mm
            if ball.place_sd_mm is not None:
                glints -= drawn(middle, eye)
                sd_mm = _DIRECTION_SD * ball.outline_mm[2]
            off.append(glints / sd_mm)
        return np.asarray(np.nan_to_num(np.concatenate(off, axis=1)))

    def of_light(self, places: Array, shared: Array) -> Array:
        """(L, 2 B + 1) residuals of each light: glints, and the dome."""
        centre, radius = shared[-4:-1], shared[-1]
        off_dome = np.linalg.norm(places - centre, axis=1) / radius - 1.0
        return np.column_stack([self.glints(places, shared), off_dome / _DOME_SD])

    def of_shared(self, shared: Array) -> Array:
        """(S,) residuals of what all lights share: outlines, the camera, and the dome's centre."""
        eye = shared[-7:-4]
        residuals = [(eye - self.eye) / self.eye_sd, shared[-4:-1] / (_CENTRE_SD * shared[-1])]
        for k, ball in enumerate(self.balls):
            middle, radius = shared[4 * k : 4 * k + 3], shared[4 * k + 3]
            nearer = eye[2] / (eye[2] - middle[2])
            x, y, outlined = ball.outline_mm
            residuals += [
                (drawn(middle, eye) - (x, y)) / (ball.place_sd_mm or _MIDDLE_SD * outlined),
                [(radius * nearer / outlined - 1.0) / _OUTLINE_SD],
                [middle[2] / radius - 1.0],  # it lies on the ground, or in a holder
            ]
        return np.concatenate(residuals)

    def linearised(self, places: Array, shared: Array) -> tuple[Array, Array]:
        """Normal equations (4 L + 1 + S) of each light's place and lamp, the beam, and what lights
        share, with robust weights; lamps and beam stay empty, as glints do not show them."""
        residual, prior = self.of_light(places, shared), self.of_shared(shared)
        lights, first = np.arange(len(places)), 4 * len(places) + 1
        slope = np.zeros((*residual.shape, first + len(shared)))
        of_prior = np.zeros((len(prior), slope.shape[-1]))
        for k, step in enumerate(1e-3 * np.eye(3)):
            slope[lights, :, 4 * lights + k] = self.of_light(places + step, shared) - residual
        slope *= 1e3
        for k, step in enumerate(1e-4 * np.eye(len(shared)), first):
            slope[..., k] = 1e4 * (self.of_light(places, shared + step) - residual)
            of_prior[:, k] = 1e4 * (self.of_shared(shared + step) - prior)
        rows = np.concatenate([slope.reshape(-1, slope.shape[-1]), of_prior])
        weighted = rows * np.append(cauchy(residual, 3.0), np.ones(len(prior)))[:, None]
        return weighted.T @ rows, -weighted.T @ np.append(residual, prior)


def plain_ground(
    stack: FloatArray, step: int, camera: Camera, covered: BoolArray
) -> MattGround | None:
    """Points of the ground in photographs: what is about as bright as most of the picture that is
    not covered; None where too little is.

    Parameters
    ----------
    stack
        (L, h, w) linear light in blocks of `step` pixels.
    covered
        (h, w) blocks that show an object.
    """
    rows, columns = np.nonzero(~covered)
    if not rows.size:
        return None
    values = stack[:, rows, columns].astype(np.float64)
    pixels = step * (np.column_stack([columns, rows]).astype(np.float64) + 0.5) - 0.5
    on_ground = like_ground(values, pixels, camera.image_size)
    ground = MattGround.of(plane_points(camera, pixels[on_ground]), values[:, on_ground])
    if (ground.usable.sum(axis=1) > _FEWEST_POINTS).sum() < _FEWEST_LIT:
        return None
    return replace(ground, observations=_OF_BLOCKS)


def like_ground(values: Array, pixels: Array, image_size: tuple[int, int]) -> BoolArray:
    """(P,) whether pixels (P, 2; column, row) with values (L, P) are about as bright as most of
    them, and near enough to the picture's middle."""
    level = np.log(np.maximum(values.max(axis=0), 1e-6))  # noise may be negative
    off = pixels - (np.array(image_size[::-1]) - 1) / 2
    near = np.hypot(*off.T) < _GROUND_REACH * min(image_size)
    return np.asarray(near & (np.abs(level - np.median(level)) < _LIKE_GROUND))


def places_by_ground(
    directions: Array, ground: MattGround, picture_mm: float
) -> tuple[LightPlaces, float]:
    """Places of lights whose directions somebody stated, by the light of the ground; and how much
    better they explain it than distant lights do, where they were not fitted.

    A list of directions is read as glints on a ball whose place in the picture is not known. Wrong
    lights are wrong everywhere on the ground: places are fitted to every second tile of it, as on a
    chessboard, and judged on the other tiles, once each way.

    Parameters
    ----------
    directions
        (L, 3) towards the lights.
    ground
        Of the picture, whose longer side has `picture_mm` on the ground.

    Returns
    -------
    places, explained
        Logarithm of the ground's misfit under distant lights over that under the places, the mean
        of both ways.
    """
    half = directions / np.linalg.norm(directions, axis=1, keepdims=True) + (0.0, 0.0, 1.0)
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    ball = BallGlints((0.0, 0.0, 1.0), half[:, :2], place_sd_mm=0.25 * picture_mm)
    height = CAMERA_HEIGHT * picture_mm
    eye = (0.0, 0.0, height)
    eye_sd = (0.1 * height, 0.1 * height, 0.3 * height)
    tiles = np.floor(ground.points_mm * (_TILES / picture_mm)).sum(axis=1) % 2 > 0
    explained = []
    for fitted in (tiles, ~tiles):
        own, rest = ground.of_points(fitted), ground.of_points(~fitted)
        fit = fit_places([ball], 1.0, ground=own, eye_mm=eye, eye_sd_mm=eye_sd)
        near = _misfit(rest, _shading(fit.places_mm, fit.lobe_exponent, rest)[0])
        explained.append(np.log(_misfit(rest, np.ones(rest.values.shape)) / near))
    places = fit_places([ball], 1.0, ground=ground, eye_mm=eye, eye_sd_mm=eye_sd)
    return places, float(np.mean(explained))


def glints_on(places: Array, middle: Array, radius: float, eye: Array) -> Array:
    """(L, 2) where lights (L, 3) glint on a ball, as the camera's centre sees it on the ground.

    The normal there halves the angle between light and camera; both change with the place, so that
    it is iterated.

    >>> eye = np.array([0.0, 0.0, 100.0])
    >>> glints_on(np.array([[0.0, 0.0, 50.0]]), np.zeros(3), 2.0, eye).tolist()
    [[0.0, 0.0]]
    """
    point = middle + radius * np.array([0.0, 0.0, 1.0])
    for _ in range(12):
        view, light = (
            towards / np.linalg.norm(towards, axis=-1, keepdims=True)
            for towards in (eye - point, places - point)
        )
        half = view + light
        point = middle + radius * half / np.linalg.norm(half, axis=-1, keepdims=True)
    return drawn(point, eye)


def drawn(points: Array, eye: Array) -> Array:
    """(..., 2) where the camera's centre sees points (..., 3) on the ground."""
    nearer = eye[2] / (eye[2] - points[..., 2:])
    return np.asarray(eye[:2] + (points[..., :2] - eye[:2]) * nearer)


def _albedo_of(ground: MattGround, shading: Array) -> tuple[Array, Array, float]:
    """Albedo (P,) of the ground's points under a shading (L, P), the robust weights (L, P) of their
    values, and the relative misfit."""
    weight = ground.usable.astype(np.float64)
    misfit = 0.0
    for _ in range(6):
        power = (weight * shading * shading).sum(axis=0) + 1e-12
        albedo = (weight * shading * ground.values).sum(axis=0) / power
        expected = albedo * shading
        size = expected + 0.1 * expected.mean()
        relative = (ground.values - expected) / size
        misfit = max(deviation(relative[ground.usable]), _GROUND_SD)
        weight = ground.usable * cauchy(relative, 3.0 * misfit) / np.square(misfit * size)
    return albedo, weight, misfit


def _misfit(ground: MattGround, shading: Array) -> float:
    """Relative misfit of the ground under lights that shade it so, (L, P), of any brightness."""
    misfit = 0.0
    strengths = np.median(ground.values, axis=1) / np.median(shading, axis=1)
    for _ in range(8):
        albedo, weight, misfit = _albedo_of(ground, strengths[:, None] * shading)
        expected = albedo * shading
        strengths = (weight * ground.values * expected).sum(axis=1)
        strengths /= (weight * expected * expected).sum(axis=1) + 1e-12
    return misfit


def _shading(places: Array, exponent: float, ground: MattGround) -> tuple[Array, Array, Array]:
    """(L, P) irradiance of the ground by lights of equal brightness, its derivatives (L, P, 3) by
    their places, and the cosine (L, P) off their beams' axes."""
    points = np.column_stack([ground.points_mm, np.zeros(len(ground.points_mm))])
    towards = places[:, None] - points
    square = np.einsum("kpi,kpi->kp", towards, towards)
    own = np.einsum("ki,ki->k", places, places)[:, None]
    along = np.maximum(np.einsum("kpi,ki->kp", towards, places), 0.05 * own)
    cosine = along / np.sqrt(square * own)
    strength = cosine**exponent * float(np.median(square)) / (square * np.sqrt(square))
    shading = places[:, None, 2] * strength
    turned = (towards + places[:, None]) / along[..., None] - (places / own)[:, None]
    slope = exponent * turned - ((3.0 + exponent) / square)[..., None] * towards
    slope *= shading[..., None]
    slope[..., 2] += strength
    return shading, slope, cosine


def _of_ground(places: Array, gains: Array, ground: MattGround) -> tuple[Array, Array, float]:
    """Normal equations (4 L + 1) of each light's place and lamp, and of the beam, by the ground's
    light, the albedo of each point eliminated; and its relative misfit."""
    exponent = float(np.exp(gains[-1]))
    shading, by_place, cosine = _shading(places, exponent, ground)
    of_beam = exponent * np.log(cosine) * shading
    by_light = np.concatenate([by_place, np.stack([shading, of_beam], axis=2)], axis=2)
    strengths = np.exp(gains[:-1])[:, None]
    shading *= strengths
    by_light *= strengths[..., None]
    albedo, weight, misfit = _albedo_of(ground, shading)
    expected = albedo * shading
    weight *= (ground.observations / np.maximum(ground.usable.sum(axis=1), 1))[:, None]
    root = np.sqrt(weight)
    slope = by_light * (root * albedo)[..., None]
    residual = root * (ground.values - expected)
    column = root * shading
    column /= np.sqrt((column * column).sum(axis=0)) + 1e-12
    by_point = np.einsum("kp,kpi->kip", column, slope).reshape(5 * len(places), -1)
    normal = -by_point @ by_point.T
    for k, each in enumerate(slope):
        own = slice(5 * k, 5 * k + 5)
        normal[own, own] += each.T @ each
    right = np.einsum("kpi,kp->ki", slope, residual).ravel()
    right -= by_point @ (column * residual).sum(axis=0)
    last = 4 * len(places)
    unknown = np.pad(np.arange(last).reshape(-1, 4), ((0, 0), (0, 1)), constant_values=last)
    shared = np.eye(last + 1)[:, unknown.ravel()]  # all lamps have one beam
    return shared @ normal @ shared.T, shared @ right, misfit
