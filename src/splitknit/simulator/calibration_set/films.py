"""Polarising films on the bench: a glossy black ball and a card behind them, and what calibration should find.

The ball reflects an LED's light with Fresnel's signed amplitudes; cards and the ball's body return it depolarised.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from splitknit.model import Camera, Films, Led, Rig
from splitknit.simulator.calibration_set.bench import Array, BenchSettings, SightLines
from splitknit.simulator.calibration_set.solids import Lines, SphereScene, directions, mirrored, unit
from splitknit.simulator.light.films import reflected_through


@dataclass(frozen=True, eq=False, kw_only=True)
class BlackBallScene(SphereScene):
    """A glossy ball whose body and ground return a few per cent of the light, half of which passes the analyser."""

    radius_mm: float = 14.0
    chrome: bool = True
    reflectance: float | None = 0.01
    ground: float = 0.025
    extinction: float = 1000.0
    """Of both films together; each is twice as good."""
    angle_deg: tuple[float, ...] = ()
    """Of each LED's polariser, from the image's columns towards up."""
    analyser_deg: float = 0.0

    def _mirrored(self, leds: tuple[Led, ...], lines: SightLines, seen: Lines) -> Array:
        rays, view = mirrored(lines, seen), -directions(lines)
        image = self._matt(leds, seen)
        for led in leds:
            face = self._led_in_mirror(led, lines, rays)
            lit = face > 0.0
            image[lit] += face[lit] * self._passed(led, rays[1][lit], view[lit])
        return image

    def _passed(self, led: Led, towards: Array, view: Array) -> Array:
        """Fraction of an LED's light that passes both films and is reflected, of the directions (..., 3) to both."""
        to_led, to_camera = (np.moveaxis(way, -1, 0) for way in (towards, view))
        polariser, analyser = (float(np.deg2rad(a)) for a in (self.angle_deg[self.leds.index(led)], self.analyser_deg))
        leak = self.extinction - float(np.sqrt(self.extinction**2 - 1.0))  # of both films 2 leak / (1 + leak^2)
        return 0.5 * reflected_through(to_led, to_camera, polariser, analyser, leak)

    def highlight(self, index: int) -> tuple[float, float]:
        """Turn in degrees of an LED's reflection towards the camera, and what of it is left when films are crossed."""
        point, led = self.highlights_mm()[index], self.leds[index]
        ways = unit(np.asarray(led.position_mm) - point), unit(self._towards_camera(point))
        level, up, slant = (float(replace(self, analyser_deg=a)._passed(led, *ways)) for a in (0.0, 90.0, 45.0))
        return float(np.rad2deg(0.5 * np.arctan2(2.0 * slant - level - up, level - up))), up / (level + up)


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
    turns, leak = zip(*(ball.highlight(k) for k in leds), strict=True)
    tint = rng.uniform(0.93, 1.02, 3) * rng.uniform(0.95, 1.05, (len(leds), 1))
    x, y = rng.uniform(-2.0, 2.0, 2)
    films = Films(
        leds=leds,
        leak=leak,
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
