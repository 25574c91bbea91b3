"""Polarising films on the bench: a glossy black ball and a card behind them, and what calibration should find.

Light of an LED passes its polariser, is reflected by the ball with Fresnel's amplitudes, one for each of its two
states, and passes the analyser. Cards and the ball's body return it depolarised.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from splitknit.model import Camera, Films, Led, Rig
from splitknit.simulator.calibration_set.bench import Array, BenchSettings, SightLines
from splitknit.simulator.calibration_set.solids import Lines, SphereScene, directions, mirrored, unit

INDEX = 1.5
"""Refractive index of the ball."""


@dataclass(frozen=True, eq=False, kw_only=True)
class BlackBallScene(SphereScene):
    """A glossy ball whose body and ground return a few per cent of the light, half of which passes the analyser."""

    radius_mm: float = 14.0
    chrome: bool = True
    reflectance: float | None = 0.01
    ground: float = 0.025
    extinction: float = 1000.0
    angle_deg: tuple[float, ...] = ()
    """Of each LED's polariser, from the image's columns towards up."""
    analyser_deg: float = 0.0

    def _mirrored(self, leds: tuple[Led, ...], lines: SightLines, seen: Lines) -> Array:
        rays = mirrored(lines, seen)
        image = self._matt(leds, seen)
        for led in leds:
            image += self._passed(led, lines, (seen[1], rays[1])) * self._led_in_mirror(led, lines, rays)
        return image

    def _passed(self, led: Led, lines: SightLines, mirror: Lines) -> Array:
        """Fraction (h, w) of an LED's unpolarised light that normals reflect (its rays' directions) and films pass."""
        field, towards = self._reflected(self.angle_deg[self.leds.index(led)], directions(lines), mirror)
        along = (field * _across(self.analyser_deg, towards)).sum(axis=-1) ** 2
        return np.asarray(0.5 * (along + ((field**2).sum(axis=-1) - along) / self.extinction))

    @staticmethod
    def _reflected(angle_deg: float, down: Array, mirror: Lines) -> tuple[Array, Array]:
        """Electric field (h, w, 3) that leaves the ball, of one that came in with length one, and the way it goes."""
        normals, way = mirror
        comes, goes = -way, -down
        across = unit(np.cross(comes, normals) + 1e-12)
        field = _across(angle_deg, comes)
        cosine = np.abs((comes * normals).sum(axis=-1))
        inner = np.sqrt(1.0 - (1.0 - cosine**2) / INDEX**2)
        s = (cosine - INDEX * inner) / (cosine + INDEX * inner)
        p = (INDEX * cosine - inner) / (INDEX * cosine + inner)
        out = (s * (field * across).sum(axis=-1))[..., None] * across
        out = out + (p * (field * np.cross(across, comes)).sum(axis=-1))[..., None] * np.cross(across, goes)
        return out, goes

    def turn_deg(self, index: int) -> float:
        """Of the polarisation of an LED's specular reflection towards the camera."""
        point = self.highlights_mm()[index]
        view = unit(self._towards_camera(point))
        way = unit(np.asarray(self.leds[index].position_mm) - point)
        field = self._reflected(self.angle_deg[index], -view, (unit(view + way), way))[0]
        side = (field @ _across(0.0, view), field @ _across(90.0, view))
        return float((np.rad2deg(np.arctan2(side[1], side[0])) + 90.0) % 180.0 - 90.0)


def _across(angle_deg: float, way: Array) -> Array:
    """Unit vectors (..., 3) across ways (..., 3) nearest to a film's axis."""
    turn = np.deg2rad(angle_deg)
    axis = np.array([np.cos(turn), np.sin(turn), 0.0])
    return unit(axis - (way @ axis)[..., None] * way)


def drawn_films(
    rig: Rig, seed: np.random.SeedSequence, bench: BenchSettings, extinction: float | None = None
) -> tuple[Films, BlackBallScene]:
    """Films as a person cuts and mounts them, as calibration should find them, and the ball behind them.

    The extinction ratio is drawn between 100 and 5000 where it is not given.
    """
    rng = np.random.default_rng(seed)
    leds = tuple(k for k, led in enumerate(rig.leds) if led.band == "white")
    angles = rng.normal(0.0, 1.0) + rng.normal(0.0, 1.0, len(rig.leds))
    drawn = float(np.exp(rng.uniform(np.log(100.0), np.log(5000.0))))
    extinction = drawn if extinction is None else extinction
    ball = BlackBallScene(
        camera=rig.camera,
        leds=rig.leds,
        bench=bench,
        extinction=extinction,
        angle_deg=tuple(float(angle) for angle in angles),
    )
    turns = tuple(ball.turn_deg(k) for k in leds)
    lost = np.sin(np.deg2rad(turns)) ** 2
    leak = (lost + (1.0 - lost) / extinction) / (1.0 + 1.0 / extinction)
    tint = rng.uniform(0.93, 1.02, 3) * rng.uniform(0.95, 1.05, (len(leds), 1))
    x, y = rng.uniform(-2.0, 2.0, 2)
    films = Films(
        leds=leds,
        leak=tuple(float(one) for one in leak),
        brightness=tuple((float(r), float(g), float(b)) for r, g, b in tint),
        shift_px=(float(x), float(y)),
        scale=float(1.0 + rng.normal(0.0, 5e-4)),
        extinction_ratio=extinction,
        angle_deg=turns,
    )
    return films, ball


def behind_analyser(camera: Camera, films: Films) -> Camera:
    """The camera whose image the turned analyser moves and stretches about its middle."""
    assert camera.matrix is not None
    middle = (np.array(camera.image_size[::-1]) - 1.0) / 2.0
    moved = np.eye(3)
    moved[[0, 1], [0, 1]] = films.scale
    moved[:2, 2] = middle * (1.0 - films.scale) + films.shift_px
    return replace(camera, matrix=moved @ camera.matrix)
