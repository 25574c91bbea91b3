"""Minutiae of one capture, plain and voted, against the true ones of the simulator."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "prints"))

from agreement_measure import against_truth
from agreement_truth import Truth, read_truth

from splitknit.finger.locate import Finger, find_finger
from splitknit.io.capture import read_capture
from splitknit.io.png import decode_png
from splitknit.presets import preset_settings
from splitknit_match.batch.chunks import read_chunk
from splitknit_match.batch.reading import stored_places
from splitknit_match.batch.store import Store
from splitknit_match.matching.minutiae import extract
from splitknit_match.matching.minutiae_record import Minutiae, pack_minutiae, unpack_minutiae
from splitknit_match.matching.voted_minutiae import left_out_pictures
from splitknit_match.prints.print_map import plane_map, resample

PPI = 500.0


def name_of(capture: tuple[str, int, str]) -> str:
    """Of a capture's folder in its population."""
    return f"{capture[0]}/session_{capture[1]}/{capture[2]}"


def lists_of(population: Path, capture: tuple[str, int, str], **options: Any) -> dict[str, list[str]]:
    """Packed minutiae (hex) of every picture of every set, by the picture."""
    read = read_capture(population / name_of(capture))
    found: dict[str, list[str]] = {}
    for one in left_out_pictures(read, preset_settings("zheng"), **options):
        found.setdefault(one.picture, []).append(pack_minutiae(extract(one.print_image)).hex())
    return found


def plain_of(store: Path, case: str, capture: tuple[str, int, str]) -> Minutiae | None:
    """Minutiae of a reconstruction's relief print; None where the store lacks it."""
    place = stored_places(Store(store).files("features", case)).get(name_of(capture))
    data = None if place is None else read_chunk(place.file, ["print"])["print"][place.row]
    return extract(decode_png(data, "print")[..., 0]) if data else None


class Judge:
    """The truth of one capture on its print's frame."""

    def __init__(self, population: Path, capture: tuple[str, int, str]) -> None:
        """Read the truth and find the finger."""
        read = read_capture(population / name_of(capture))
        finger: Finger = find_finger(read, preset_settings("zheng"))
        pitch = read.rig.camera.pitch_mm
        print_map = plane_map(pitch, finger.upright.input_from_upright, finger.upright.size, PPI)
        _, weight = resample(finger.mask.astype(np.float32), finger.mask, pitch, print_map)
        self.made: Any = SimpleNamespace(map=print_map, weight=weight)
        self.truth: Truth = read_truth(population, *capture)

    def record(self, minutiae: Minutiae) -> dict[str, Any]:
        """As in validation/prints."""
        return against_truth(minutiae, self.made, self.truth)


def unpacked(lists: dict[str, list[str]], pictures: tuple[str, ...]) -> list[Minutiae]:
    """Lists of minutiae of some pictures of all sets."""
    return [unpack_minutiae(bytes.fromhex(data)) for name in pictures for data in lists.get(name, [])]
