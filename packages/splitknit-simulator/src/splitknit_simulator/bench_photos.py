"""All photographs that calibrate a rig, of a simulated one, so that calibration is measured without
hardware."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from splitknit import Ambient, Band, Camera, Capture, Led, Rig, write_capture, write_rig
from splitknit.io.atomic import atomic_folder
from splitknit.io.images import write_image
from splitknit.io.targets import check_capture
from splitknit.model import Array, Films, PixelArray, Progress
from splitknit.nominal import nominal_rig
from splitknit.settings import Checked, Limits
from splitknit_simulator.calibration_set.bench import (
    BenchSettings,
    photograph_bench,
    well_exposed,
)
from splitknit_simulator.calibration_set.flat import (
    BoardScene,
    CardScene,
    PrintedBoard,
    board_poses,
)
from splitknit_simulator.calibration_set.solids import (
    Lines,
    NailScene,
    SphereScene,
    mirrored,
    unit,
)
from splitknit_simulator.camera.device import LitScene
from splitknit_simulator.camera.lens import SightLines
from splitknit_simulator.camera.sensor import SensorSettings, binning_scale, record
from splitknit_simulator.light.films import reflected_through
from splitknit_simulator.rigs import built_rig, triple

MARKER = "rig_true.json"
BOARD = PrintedBoard(rows=6, columns=9, square_mm=3.0)
"""The checkerboard. Source: printed sheet of docs/guide/calibration.md."""


@dataclass(frozen=True, slots=True)
class BenchPhotos(Checked):
    """How many photographs of what."""

    boards: Annotated[int, Limits(3)] = 15
    """Photographs of the checkerboard that is held in the hand, at least 3."""
    nails: Annotated[int, Limits(1, 4)] = 4
    """Places of the nail, 1 to 4; at each it is photographed under every LED."""
    polarisers: bool = False
    """Also a printed card and a glossy black ball behind polarising films."""


_NAIL_HEIGHT_MM = 13.0
_PUPIL_MM = 1.6
"""Diameter, as of 12.8 mm at f/8: boards that are held obliquely are blurred by up to a few
pixels."""


def bench_to_folder(
    out: Path,
    *,
    seed: int,
    scale: float,
    photos: BenchPhotos,
    overwrite: bool,
    progress: Progress,
) -> dict[str, Any]:
    """Photograph everything that calibrates the rig that person `seed` built.

    Writes ``board/`` (the checkerboard in the hand), ``plane.png`` (the same on the finger plane),
    ``nail/nail_K/`` (the nail under every LED), ``card/`` (a capture folder of a white card, with
    an exposure series), ``polarisers/`` where asked for, ``rig_drawn.json`` (the nominal rig) and
    ``rig_true.json`` (what calibration should find). Raises BadInput if `out` holds something else,
    or numbers are out of range.
    """
    check_capture(out, overwrite=overwrite, marker=MARKER, words="an earlier simulated bench")
    rig, drawn = built_rig(seed, scale=scale), nominal_rig(scale)
    count = photos.boards + photos.nails + 2 + 2 * photos.polarisers
    ball = None
    if photos.polarisers:
        films, ball = drawn_films(
            rig, np.random.SeedSequence([seed, 0xF1]), BenchSettings(aperture_mm=_PUPIL_MM)
        )
        rig = replace(rig, films=films)
    with atomic_folder(out, overwrite=overwrite) as target:
        write_rig(rig, target / MARKER)
        write_rig(drawn, target / "rig_drawn.json")
        # one scene after another: each keeps arrays of the picture's size
        stages = _photographed(rig, photos, np.random.SeedSequence([seed, 0xBE]), target)
        if ball is not None:
            films_seed = np.random.SeedSequence([seed, 0xF2])
            stages = chain(stages, behind_films(rig, ball, films_seed, target))
        for k, stage in enumerate(stages):
            progress(stage, k / count)
    progress("done", 1.0)
    return {
        "out": str(out),
        "seed": seed,
        "image_size": list(rig.camera.image_size),
        "board": f"{BOARD.columns}x{BOARD.rows}",
        "square_mm": BOARD.square_mm,
        "nail_mm": _NAIL_HEIGHT_MM,
        "boards": photos.boards,
        "nails": photos.nails,
    }


_NAIL_PLACES_MM = ((-5.0, -3.5), (5.5, -3.0), (4.5, 4.0), (-5.5, 3.5))
"""Where nails stand, x and y: all shadows stay in a picture of 42 x 29 mm."""


def _photographed(
    rig: Rig, photos: BenchPhotos, seeds: np.random.SeedSequence, target: Path
) -> Iterator[str]:
    """Photograph board, nail and card into the folder `target`; each is named before it is
    taken."""
    tilt = tuple(rig.provenance["base_tilt_deg"])
    under: dict[str, Any] = {
        "camera": rig.camera,
        "leds": rig.leds,
        "bench": BenchSettings(aperture_mm=_PUPIL_MM),
    }
    white = [k for k, led in enumerate(rig.leds) if led.band == "white"]
    of_boards, of_plane, of_nails, of_card = seeds.spawn(4)
    board_seed = int(of_boards.generate_state(1)[0])
    (target / "board").mkdir()
    for k, pose in enumerate(board_poses(board_seed, photos.boards, rig.camera, BOARD)):
        yield "board"
        scene = BoardScene(**under, board=BOARD, **pose)
        _one(scene, white, of_boards.spawn(1)[0], target / "board" / f"board_{k:02d}.png")
    yield "plane"
    plane = BoardScene(**under, board=BOARD, rotation_vector=_turn_of(rig))
    _one(plane, white, of_plane.spawn(1)[0], target / "plane.png")
    under["tilt_deg"] = tilt
    for n, place in enumerate(_NAIL_PLACES_MM[: photos.nails]):
        yield "nail"
        nail = NailScene(**under, position_mm=place, nail_mm=_NAIL_HEIGHT_MM)
        _series(nail, of_nails.spawn(1)[0], target / "nail" / f"nail_{n}")
    yield "card"
    _card(CardScene(**under), rig, of_card, target / "card")


def _turn_of(rig: Rig) -> tuple[float, float, float]:
    """Rotation vector of the rig's base."""
    x, y = np.deg2rad(rig.provenance["base_tilt_deg"]).tolist()
    return x, y, 0.0


_BRIGHTEST_LEVEL = 0.9
"""Fraction of full scale that the brightest light reaches in the longest exposure of the card."""


def behind_films(
    rig: Rig, ball: BlackBallScene, seed: np.random.SeedSequence, target: Path
) -> Iterator[str]:
    """Photograph the printed card and the ball with the analyser parallel and crossed."""
    assert rig.films is not None
    card = BoardScene(
        camera=rig.camera,
        leds=rig.leds,
        bench=ball.bench,
        board=BOARD,
        rotation_vector=_turn_of(rig),
    )
    away, folder = behind_analyser(rig.camera, rig.films), target / "polarisers"
    yield "card"
    series: dict[str, LitScene] = {"white": card, "white_crossed": replace(card, camera=away)}
    _polarised(series, rig, seed.spawn(1)[0], np.inf, folder / "card")
    yield "ball"
    # behind a crossed analyser the ball is exposed up to 64 times longer than to that level
    longest = 64.0 * _BRIGHTEST_LEVEL / float(ball.light([rig.films.leds[0]]).max())
    series = {"white": ball, "white_crossed": replace(ball, camera=away, analyser_deg=90.0)}
    _polarised(series, rig, seed.spawn(1)[0], longest, folder / "ball")


def _polarised(
    series: Mapping[str, LitScene],
    rig: Rig,
    seed: np.random.SeedSequence,
    longest: float,
    folder: Path,
) -> None:
    """A capture folder of what is behind films under every white LED, each image with its own
    exposure."""
    films, bands, sensor = rig.films, {}, SensorSettings(bits=16)
    assert films is not None
    for name, scene in series.items():
        pixels, exposures = [], []
        for k, led in enumerate(films.leds):
            light = scene.light([led])
            if name == "white_crossed":
                light *= np.array(films.brightness[k], dtype=np.float32)
            exposures.append(min(0.7 / float(light.max()), longest))
            light = light * np.float32(exposures[-1])
            pixels.append(
                record(light, "white", seed.spawn(1)[0], sensor, binning_scale(scene.camera))
            )
        polarisation = "parallel" if name == "white" else "crossed"
        bands[name] = _band(name, pixels, films.leds, exposures, polarisation=polarisation)
    drawn = nominal_rig(rig.camera.image_size[0] / 2200)
    write_capture(Capture(rig=drawn, bands=bands, material="opaque"), folder, overwrite=True)


def _band(
    name: str,
    images: Sequence[PixelArray],
    leds: Sequence[int],
    exposures: Sequence[float],
    **more: Any,
) -> Band:
    stack: Any = np.stack(images)
    groups, black = tuple((led,) for led in leds), np.zeros(len(images))
    return Band(name, stack, groups, np.array(exposures), black, **more)


def _one(scene: LitScene, lit: Sequence[int], seed: np.random.SeedSequence, file: Path) -> None:
    pixels = photograph_bench(scene, lit, seed, exposure=well_exposed(scene, [lit]))
    write_image(file, pixels)


def _series(scene: LitScene, seed: np.random.SeedSequence, folder: Path) -> None:
    """One photograph under every LED, each band at its own exposure."""
    folder.mkdir(parents=True)
    for band in ("white", "nir"):
        members = [k for k, led in enumerate(scene.leds) if led.band == band]
        exposure = well_exposed(scene, [[k] for k in members])
        for number, k in enumerate(members):
            pixels = photograph_bench(scene, [k], seed.spawn(1)[0], exposure=exposure, band=band)
            write_image(folder / f"{band}_{number}.png", pixels)


_CARD_EXPOSURES_S = (0.002, 0.004, 0.006, 0.008, 0.010, 0.012)
"""Of the series of the white card, which shows the sensor's response."""


def _card(scene: CardScene, rig: Rig, seed: np.random.SeedSequence, folder: Path) -> None:
    """A capture folder of the card, and an exposure series."""
    bands = {}
    for name in ("white", "nir"):
        members = [k for k, led in enumerate(rig.leds) if led.band == name]
        exposure = well_exposed(scene, [[k] for k in members])
        images = [
            photograph_bench(scene, [k], seed.spawn(1)[0], exposure=exposure, band=name)
            for k in members
        ]
        ambient = photograph_bench(scene, [], seed.spawn(1)[0], exposure=exposure, band=name)
        bands[name] = _band(name, images, members, [1.0] * len(members), ambient=Ambient(ambient))
    # the folder's rig is the one that is known before the calibration: the drawing's
    drawn = replace(nominal_rig(rig.camera.image_size[0] / 2200), provenance={"source": "as drawn"})
    write_capture(Capture(rig=drawn, bands=bands, material="opaque"), folder, overwrite=True)
    steps = []
    brightest = well_exposed(scene, [[0]], _BRIGHTEST_LEVEL)
    for k, seconds in enumerate(_CARD_EXPOSURES_S):
        pixels = photograph_bench(
            scene, [0], seed.spawn(1)[0], exposure=brightest * seconds / _CARD_EXPOSURES_S[-1]
        )
        write_image(folder / f"step_{k}.png", pixels)
        steps.append({"file": f"step_{k}.png", "exposure_s": seconds})
    document = {"format": "splitknit-radiometry", "version": 1, "exposures": steps}
    (folder / "radiometry.json").write_text(json.dumps(document, indent=2) + "\n", encoding="ascii")


# Polarising films: a glossy black ball reflects an LED's light with Fresnel's signed amplitudes;
# cards and the ball's body return it depolarised.


@dataclass(frozen=True, eq=False, kw_only=True)
class BlackBallScene(SphereScene):
    """A glossy ball whose body and ground return a few per cent of the light, half of which passes
    the analyser."""

    radius_mm: float = 14.0
    chrome: bool = True
    reflectance: float | None = 0.01
    ground: float = 0.025
    extinction: float = 1000.0  # extinction of both films together; each is twice as good
    # angle of each LED's polariser, from the image's columns towards up
    angle_deg: tuple[float, ...] = ()
    analyser_deg: float = 0.0

    def _mirrored(
        self, leds: tuple[Led, ...], lines: SightLines, seen: Lines, reflectance: float
    ) -> Array:
        rays, view = mirrored(lines, seen), lines.towards_camera
        image = self._matt(leds, *seen, reflectance)
        for led in leds:
            face = self._led_in_mirror(led, lines, rays)
            lit = face > 0.0
            image[lit] += face[lit] * self._passed(led, rays[1][lit], view[lit])
        return image

    def _passed(self, led: Led, towards: Array, view: Array) -> Array:
        """Fraction of an LED's light that passes both films and is reflected, of the directions
        (..., 3) to both."""
        to_led, to_camera = (np.moveaxis(way, -1, 0) for way in (towards, view))
        polariser, analyser = (
            float(np.deg2rad(a)) for a in (self.angle_deg[self.leds.index(led)], self.analyser_deg)
        )
        # of both films 2 leak / (1 + leak^2)
        leak = self.extinction - float(np.sqrt(self.extinction**2 - 1.0))
        return 0.5 * reflected_through(to_led, to_camera, polariser, analyser, leak)

    def leak(self, index: int) -> float:
        """What is left of an LED's reflection towards the camera when films are crossed."""
        point, led = self.highlights_mm()[index], self.leds[index]
        ways = unit(np.asarray(led.position_mm) - point), unit(self._towards_camera(point))
        level, up = (
            float(replace(self, analyser_deg=angle)._passed(led, *ways)) for angle in (0.0, 90.0)
        )
        return up / (level + up)


def drawn_films(
    rig: Rig, seed: np.random.SeedSequence, bench: BenchSettings, extinction: float | None = None
) -> tuple[Films, BlackBallScene]:
    """Films as a person cuts and mounts them, as calibration should find them, and the ball behind
    them.

    The extinction ratio is drawn between 100 and 5000 where it is not given.
    """
    rng = np.random.default_rng(seed)
    leds = tuple(k for k, led in enumerate(rig.leds) if led.band == "white")
    angles = rng.normal(0.0, 1.0) + rng.normal(0.0, 1.0, len(rig.leds))
    drawn = float(np.exp(rng.uniform(np.log(100.0), np.log(5000.0))))
    extinction = drawn if extinction is None else extinction
    turned = tuple(float(angle) for angle in angles)
    ball = BlackBallScene(
        camera=rig.camera, leds=rig.leds, bench=bench, extinction=extinction, angle_deg=turned
    )
    tint = rng.uniform(0.93, 1.02, 3) * rng.uniform(0.95, 1.05, (len(leds), 1))
    x, y = rng.uniform(-2.0, 2.0, 2)
    films = Films(
        leds=leds,
        leak=tuple(ball.leak(k) for k in leds),
        brightness=tuple(map(triple, tint)),
        shift_px=(float(x), float(y)),
        scale=float(1.0 + rng.normal(0.0, 5e-4)),
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
