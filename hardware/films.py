"""Side lights of a rig, and its linear polarising films: before the white LEDs, and as the
analyser.

All axes are seen from the camera: those of the parallel series, and of the analyser in its parallel
position, lie along x, those of the crossed series along y; those of side lights are turned
(:func:`side_film_deg`). ``provenance.films`` of the rig file says which kind they are
(:func:`splitknit_rig.capture.pins.rig_films`).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np

from hardware import sizes
from hardware.geometry import RigDimensions
from splitknit.errors import require
from splitknit.io.rig import read_rig
from splitknit.model import Camera, Led, Rig
from splitknit.nominal import default_rig
from splitknit_rig.capture.pins import (
    DEFAULT_PINS,
    PULSES_MS,
    SECOND_PINS,
    SERVO_PIN,
    WHITE_PINS,
    rig_films,
)
from splitknit_simulator.light.films import side_lights, turned_film_rad

TRANSMISSION = 0.45
"""Largest transmission of unpolarised white light by one film, for what an eye gets; 0.5 is a film
without losses."""


def rig_of(s: SimpleNamespace) -> Rig:
    """The rig that is drawn, with its films and side lights."""
    rig = default_rig()
    if s.rig.file:
        rig = read_rig(s.rig.file)
    else:
        high, circle = s.rig.camera_height_mm, s.rig.led_radius_mm / 52.5
        camera = Camera(
            px_per_mm=s.rig.px_per_mm, image_size=tuple(s.rig.image_size), height_mm=high
        )
        places = [np.array(led.position_mm) * (circle, circle, high / 140.0) for led in rig.leds]
        leds = [
            replace(led, position_mm=tuple(place.tolist()))
            for led, place in zip(rig.leds, places, strict=True)
        ]
        rig = Rig(camera, tuple(leds), rig.provenance)
    return with_side_lights(with_films(rig, s.rig.films or None), s.rig.side)


def with_films(rig: Rig, kind: str | None) -> Rig:
    """Give a rig films of a kind: its file's word and, for ``neighbours``, further white LEDs, each
    half way to the next one counter-clockwise, and lines; None changes nothing. Raises BadInput if
    the rig has films of another kind, an LED without a place, or too many.
    """
    present = rig_films(rig)
    if kind is None or (present is not None and present.kind == kind):
        return rig
    require(
        present is None,
        f"the rig file has films of the kind '{present and present.kind}'; leave rig.films out, or "
        "take a rig file without films.",
    )
    films: dict[str, object] = {"kind": kind}
    if kind == "servo":
        films |= {"servo": SERVO_PIN, "pulses_ms": list(PULSES_MS)}
    if kind != "neighbours":
        return replace(rig, provenance={**rig.provenance, "films": films})
    white = [led for led in rig.leds if led.band == "white"]
    require(
        not side_lights(rig.leds),
        "LEDs beside the white ones need the side lights' lines; take other films (rig.films).",
    )
    require(
        3 <= len(white) <= len(SECOND_PINS)
        and all(led.position_mm is not None for led in rig.leds),
        f"LEDs beside the white ones need a rig of 3 to {len(SECOND_PINS)} white LEDs, each LED"
        f" with its position_mm; this one has {len(white)}.",
    )
    pins = {band: list(lines) for band, lines in rig.provenance.get("pins", DEFAULT_PINS).items()}
    pins["white"] = pins["white"][: len(white)] + list(SECOND_PINS[: len(white)])
    films["crossed"] = [len(rig.leds) + k for k in range(len(white))]
    leds = (*rig.leds, *(_neighbour(led, rig.leds) for led in white))
    return replace(rig, leds=leds, provenance={**rig.provenance, "pins": pins, "films": films})


def _neighbour(led: Led, leds: Sequence[Led]) -> Led:
    azimuths = [
        math.atan2(neighbour.position_mm[1], neighbour.position_mm[0])
        for neighbour in (led, *leds)
        if neighbour.position_mm
    ]
    turn = (
        min(
            (gap for a in azimuths if (gap := (a - azimuths[0]) % math.tau) > 0.01), default=math.pi
        )
        / 2
    )
    cos = math.cos(turn)
    sin = math.sin(turn)

    def turned(vector: tuple[float, float, float] | None) -> tuple[float, float, float] | None:
        return vector and (
            cos * vector[0] - sin * vector[1],
            sin * vector[0] + cos * vector[1],
            vector[2],
        )

    return replace(led, position_mm=turned(led.position_mm), aim=turned(led.aim))


SIDE_RADIUS_MM = 90.0
"""Distance of the side lights from the axis. Slopes of 45 to 60 deg are measured about five times
as well with seven of them (``docs/experiments/rig-optimise.md``)."""
SIDE_HEIGHT_MM = 30.0
"""Height of the side lights over the finger plane."""
SIDE_ARC_DEG = (-25.0, 205.0)
"""First and last azimuth of the side lights; the hand comes from -90 deg."""


def with_side_lights(rig: Rig, count: int) -> Rig:
    """Give a rig `count` further white LEDs at the side, on an arc that leaves the hand free, as
    bright in the middle as the others; 0 changes nothing. Raises BadInput if the rig has side
    lights, no near white LEDs, or crossed ones of their own, whose lines they need.
    """
    if count == 0:
        return rig
    white = [led for led in rig.leds if led.band == "white"]
    films = rig_films(rig)
    require(
        2 <= count <= len(SECOND_PINS),
        f"rig.side must be from 2 to {len(SECOND_PINS)}, or 0, but it is {count}.",
    )
    require(
        films is None or films.kind != "neighbours",
        "side lights need the second LED board, which white LEDs with crossed film have; take films"
        " servo or hand.",
    )
    require(
        not side_lights(rig.leds)
        and 0 < len(white) <= len(WHITE_PINS)
        and None not in [w.position_mm for w in white],
        f"side lights need a rig of 1 to {len(WHITE_PINS)} white LEDs with position_mm, none of"
        " them at the side; leave rig.side out.",
    )
    leds = (*rig.leds, *side_leds(white, count))
    pins = {band: list(lines) for band, lines in rig.provenance.get("pins", DEFAULT_PINS).items()}
    pins["white"] = pins["white"][: len(white)] + list(SECOND_PINS[:count])
    return replace(rig, leds=leds, provenance={**rig.provenance, "pins": pins})


def side_leds(
    white: Sequence[Led],
    count: int,
    radius_mm: float = SIDE_RADIUS_MM,
    height_mm: float = SIDE_HEIGHT_MM,
) -> tuple[Led, ...]:
    """Side lights for a rig's near white LEDs, as bright as these in the middle of the finger
    plane."""
    level = np.mean(
        [led.intensity / float(np.sum(np.square(led.position_mm or ()))) for led in white]
    )
    intensity = round(float(level * (radius_mm**2 + height_mm**2)), 6)
    azimuths = np.deg2rad(np.linspace(*SIDE_ARC_DEG, count)).tolist()
    places = [(radius_mm * math.cos(a), radius_mm * math.sin(a), height_mm) for a in azimuths]
    return tuple(
        Led("white", p, intensity=intensity, lobe_exponent=white[0].lobe_exponent) for p in places
    )


def side_film_deg(light_mm: Sequence[float]) -> float:
    """Axis of the film before a side light: clockwise from upright, seen from behind the LED, above
    -90 to 90."""
    x, y, z = light_mm
    turn = turned_film_rad(light_mm) - math.atan2(y, x)
    angle = math.degrees(math.atan2(math.sin(turn), -z / math.hypot(x, y, z) * math.cos(turn)))
    return 90.0 - (90.0 - angle) % 180.0


# Where films are mounted: a ring of windows below the LEDs, and before the lens a plate on which
# the analyser turns.

FILM_MM = 0.8  # depth of the pockets that films lie in
LEVER_MM = 14.0
"""From the analyser's axis to the hole in its lever; the servo's horn is as long, so that both turn
by one angle."""
# from the analyser's axis to the servo's, along -x: the length of the wire between lever and horn
LINK_MM = 28.0
PLATE_MM = 2.4  # thickness of the analyser's plate
FLANGE_MM = 2.0  # thickness of the analyser's flange and lever, above the plate
POST_MM = 3.5  # radius of the posts that screws through the frame's floor hold
_PLATE_POSTS_DEG = (90.0, 215.0, 325.0)  # azimuths of the plate's posts
_PLATE_POSTS_MM = 21.5  # distance of the plate's posts from the axis
ROD_Y_MM = 0.85 * LEVER_MM
"""Place of the rod of an analyser that is turned by hand: half way between both ends of its
turn."""


@dataclass(frozen=True, slots=True, eq=False)
class FilmMounts:
    """Places in the rig's frame, mm, with the analyser in its parallel position."""

    kind: str  # see :class:`splitknit_rig.capture.pins.RigFilms`
    # x and y of the windows below the rig's LEDs, and the axis of the film there: ``x``, ``y`` or
    # empty without
    windows: tuple[tuple[float, float, str], ...]
    window_mm: float  # radius of every window
    ring_z_mm: float  # upper face of the ring of windows
    ring_posts: tuple[tuple[float, float], ...]
    plate_z_mm: float  # upper face of the analyser's plate
    plate_posts: tuple[tuple[float, float], ...]
    aperture_mm: float  # radius of the analyser's opening
    piece_mm: float  # side of the square pockets in the ring
    ring_mm: tuple[float, float]  # radii between which the ring's pockets lie
    analyser_piece_mm: float  # side of the analyser's square pocket
    turning_mm: float  # radius of the part of the analyser that turns in its plate
    rod_z_mm: float  # height of the rod, or of the servo's wire, over the lever


def film_mounts(d: RigDimensions) -> FilmMounts:
    """Work out where the films of a rig are mounted; BadInput if LEDs leave no room for films,
    screws, servo or rod."""
    camera, films = d.settings.camera, d.films
    assert films is not None
    lights = np.array([hole.light_mm for hole in d.holes])
    ring_z = min(float(hole.light_mm[2]) - hole.radius_mm for hole in d.holes) - 0.3
    down = np.array([(z - lights[:, 2]) / lights[:, 2] for z in (ring_z, ring_z - 2.0)])[
        ..., None, None
    ]
    # (2, LEDs, corners, 2)
    rays = lights[:, None, :2] - down * (d.lit_corners[None, :, :2] - lights[:, None, :2])
    middles = (rays.min(axis=(0, 2)) + rays.max(axis=(0, 2))) / 2
    spread = float(np.linalg.norm(rays - middles[:, None], axis=-1).max())
    along_y = films.crossed if films.kind == "neighbours" else ()
    axes = ["" if hole.band == "nir" else "y" if hole.index in along_y else "x" for hole in d.holes]
    plate_z = min(d.camera_height_mm - camera.barrel_front_mm - 0.5 - FLANGE_MM, ring_z - 2.0)
    seen = (
        math.hypot(*d.field_mm) / 2 * (d.camera_height_mm - plate_z + PLATE_MM) / d.camera_height_mm
    )
    azimuths = np.sort(np.arctan2(lights[:, 1], lights[:, 0]))
    gaps = np.diff(azimuths, append=azimuths[0] + math.tau)
    wide = (azimuths + gaps / 2)[gaps > 0.9 * gaps.max()]
    count = min(4, len(wide))
    window = spread + 0.8 * max(hole.radius_mm for hole in d.holes)
    aperture = max(6.0, 3.2 + seen)
    piece = 2 * window + 1.2
    analyser_piece = 2 * aperture + 1.4
    diagonal = math.sqrt(0.5)
    away = [math.hypot(x, y) for x, y in middles.tolist()]
    mounts = FilmMounts(
        kind=films.kind,
        windows=tuple(
            (float(x), float(y), axis) for (x, y), axis in zip(middles, axes, strict=True)
        ),
        window_mm=window,
        ring_z_mm=ring_z,
        ring_posts=_around(
            d.bore_mm - POST_MM - 0.7, [float(wide[k * len(wide) // count]) for k in range(count)]
        ),
        plate_z_mm=plate_z,
        plate_posts=_around(_PLATE_POSTS_MM, np.deg2rad(_PLATE_POSTS_DEG).tolist()),
        aperture_mm=aperture,
        piece_mm=piece,
        ring_mm=(min(away) - (piece * diagonal + 1.2), max(away) + (piece * diagonal + 1.2)),
        analyser_piece_mm=analyser_piece,
        turning_mm=analyser_piece * diagonal + 1.6,
        rod_z_mm=plate_z + FLANGE_MM + 1.2,
    )
    _check_room(d, mounts)
    return mounts


def _around(radius: float, azimuths: Sequence[float]) -> tuple[tuple[float, float], ...]:
    return tuple((radius * math.cos(a), radius * math.sin(a)) for a in azimuths)


def _check_room(d: RigDimensions, mounts: FilmMounts) -> None:
    filmed = [(k, x, y) for k, (x, y, axis) in enumerate(mounts.windows) if axis]
    for (i, x, y), (k, u, v) in itertools.combinations(filmed, 2):
        require(
            max(abs(x - u), abs(y - v)) >= mounts.piece_mm,
            f"the films of LEDs {i} and {k}, squares of {mounts.piece_mm:.1f} mm, would overlap;"
            " move the LEDs apart.",
        )
    taken = [(x, y, 3.0, "a screw of the films' ring") for x, y in mounts.ring_posts]
    taken += [(x, y, 3.0, "a screw of the analyser's plate") for x, y in mounts.plate_posts]
    if mounts.kind == "servo":
        taken += [(-LINK_MM, y, 7.0, "the analyser's servo") for y in (0.0, 5.3, 16.0)]
    for hole, (x, y, radius, what) in itertools.product(d.holes, taken):
        away = min(
            math.hypot(x - p[0], y - p[1])
            for p in (hole.at(hole.shoulder_mm), hole.at(hole.back_mm))
        )
        require(
            away >= radius + hole.pocket_radius_mm + d.settings.joint.wall_mm,
            f"LED {hole.index} stands where {what} must be; move the LED outwards, or take other"
            " films (rig.films).",
        )
    for hole in d.holes:
        x, y, _ = hole.at(hole.level_mm(mounts.rod_z_mm))
        require(
            mounts.kind != "hand"
            or x < 0
            or abs(y - ROD_Y_MM) >= 0.15 * LEVER_MM + 1.0 + hole.radius_mm,
            f"the analyser's rod would cut the light of LED {hole.index}; move the LED, or take"
            " films servo.",
        )
    inside, outside = mounts.ring_mm
    horn = math.hypot(LINK_MM + LEVER_MM * math.sqrt(0.5), LEVER_MM * math.sqrt(0.5)) + 3.0
    least = horn if mounts.kind == "servo" else _PLATE_POSTS_MM + POST_MM + 0.5
    require(
        inside >= least,
        f"films below the LEDs would lie {inside:.1f} mm from the camera's axis, where {least:.1f}"
        " mm are taken by analyser and servo; move the LEDs outwards, or take other films"
        " (rig.films).",
    )
    require(
        outside <= d.bore_mm - 2 * sizes.JOINT_CLEARANCE_MM,
        f"films below the LEDs would reach {outside:.1f} mm from the camera's axis, out of the tube"
        f" of {d.bore_mm:g} mm; tilt the LEDs towards the axis.",
    )
