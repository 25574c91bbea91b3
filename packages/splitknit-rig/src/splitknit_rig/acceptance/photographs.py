"""Photographs for the acceptance test, read from folders or taken one after the other."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from splitknit import Capture, Rig, read_capture
from splitknit.devices import Opened
from splitknit.errors import BadExposure, Refused, require
from splitknit.io.images import write_image
from splitknit.io.provenance import json_text
from splitknit.model import Array, Progress
from splitknit_rig.acceptance.questions import (
    Answer,
    Taken,
    answers_of_ball,
    answers_of_card,
    answers_of_finger,
    answers_of_phantom,
    answers_of_sensor,
)
from splitknit_rig.calibration.card_model import CardPlane
from splitknit_rig.calibration.radiometry_folder import DOCUMENT, base_tilt_deg, exposure_series
from splitknit_rig.capture.folder import CaptureOptions, capture_to_folder
from splitknit_rig.capture.openers import Opener
from splitknit_rig.capture.session import SessionSettings

PARTS = ("card", "phantom", "ball", "finger_1", "finger_2")
"""Folders of the photographs, in the order in which they are taken."""


def read_photographs(
    folders: Mapping[str, Path], rig: Rig
) -> tuple[dict[str, Taken], tuple[Array, Array], dict[str, str]]:
    """Read the capture folders of `PARTS`. Returns the captures, the card's exposure series, and
    hashes of all files. Raises BadInput if a folder is not a capture, or comes from another camera.

    The series is values (J, N) of the card at J exposures, as fractions of full scale, and time
    times gain (J,); empty if the card's photographs cannot be used.
    """
    captures: dict[str, Taken] = {}
    hashes: dict[str, str] = {}
    for part, folder in folders.items():
        try:
            # a dark LED on card and ball is an answer
            capture = read_capture(folder, may_be_dark=part in ("card", "ball"))
            captures[part] = capture
        except BadExposure as error:
            captures[part] = error
            continue
        rows, columns = capture.rig.camera.image_size
        require(
            (rows, columns) == rig.camera.image_size,
            f"{folder} has images of {rows} x {columns} pixels, but the rig's camera has"
            f" {rig.camera.image_size[0]} x {rig.camera.image_size[1]}; give the rig that took"
            " them.",
        )
        hashes |= {f"{part}/{name}": digest for name, digest in capture.hashes.items()}
    own: dict[str, str] = {}
    captures |= {part: _parallel(captures[part]) for part in PARTS[:3]}
    card = captures["card"]
    series: tuple[Array, Array] | None = np.empty((0, 0)), np.empty(0)
    if isinstance(card, Capture):
        series = exposure_series(folders["card"], card, own)
    require(
        series is not None,
        f"{folders['card']} has no {DOCUMENT}: dark level and linearity need an exposure series of"
        " the card (docs/reference/capture-format.md).",
    )
    assert series is not None
    hashes |= {f"card/{name}": digest for name, digest in own.items()}
    return captures, series, hashes


def _parallel(capture: Taken) -> Taken:
    """The capture without the crossed series of the same LEDs as the parallel one."""
    if not isinstance(capture, Capture):
        return capture
    bands = dict(capture.bands)
    if "white_crossed" in bands and bands["white_crossed"].leds == bands["white"].leds:
        del bands["white_crossed"]
    return replace(capture, bands=bands)


def answers_of(
    taken: Mapping[str, Taken],
    series: tuple[Array, Array],
    rig: Rig,
    ball_mm: float,
    progress: Progress,
) -> list[Answer]:
    """Ask all questions of what :func:`read_photographs` returned."""
    progress("card", 0.5)
    plane = CardPlane(0.0, base_tilt_deg(rig))
    answers = answers_of_sensor(taken["card"], *series)
    answers += answers_of_card(taken["card"], rig, plane)
    progress("ball", 0.6)
    answers += answers_of_ball(taken["ball"], rig, ball_mm)
    progress("phantom", 0.65)
    answers += answers_of_phantom(taken["phantom"])
    progress("finger", 0.7)
    return answers + answers_of_finger(taken["finger_1"], taken["finger_2"])


def take_photographs(
    openers: Mapping[str, Opener], out: Path, lay: Callable[[str], None], progress: Progress
) -> dict[str, Path]:
    """Photograph card, phantom, ball and finger into folders of `out`; `lay` asks for each. The
    finger stays in place between its two captures. Raises BadInput if nothing can be captured."""
    for number, (part, opener) in enumerate(openers.items()):
        lay(part)
        find = part == "finger"
        how = CaptureOptions(
            SessionSettings(find_finger=find), material="skin" if find else "opaque", keep=True
        )

        def report(stage: str, fraction: float, part: str = part, number: int = number) -> None:
            progress(f"{part}: {stage}", 0.5 * (number + fraction) / len(openers))

        with opener(0, 0) as devices:
            for name in PARTS[3:] if find else (part,):
                try:
                    capture_to_folder(devices, out / name, how, subject={}, progress=report)
                except Refused:  # what was wrong shows in the answers
                    require((out / name).is_dir(), f"the {part} could not be photographed.")
            if part == "card":
                _take_series(devices, out / part)
    return {part: out / part for part in PARTS}


SERIES_FRACTIONS = (0.15, 0.3, 0.5, 0.7, 0.85, 1.0)
"""Exposures of the card's series, relative to the longest."""


def _take_series(devices: Opened, folder: Path) -> None:
    """Add the card's exposure series to its folder."""
    camera, lights = devices.camera, devices.lights
    white = read_capture(folder).bands["white"]
    brightest = int(np.argmax([np.percentile(image[::4, ::4], 99) for image in white.pixels]))
    longest = min(1.2 * float(white.exposure[brightest]), camera.exposures.longest_s)
    exposures = []
    try:
        for k, fraction in enumerate(SERIES_FRACTIONS):
            camera.lock(max(fraction * longest, camera.exposures.shortest_s), 1.0, "white")
            lights.on(white.leds[brightest][0])
            frame = camera.capture()
            write_image(folder / f"series_{k}.png", frame.pixels)
            entry = {"file": f"series_{k}.png", "exposure_s": frame.exposure_s, "gain": frame.gain}
            exposures.append(entry)
    finally:
        lights.off()
    document = {"format": "splitknit-radiometry", "version": 1, "exposures": exposures}
    (folder / DOCUMENT).write_text(json_text(document), encoding="utf-8")
