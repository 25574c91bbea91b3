"""Matching: a template, a comparison of templates, a pair by the thesis's matcher at full size,
minutiae of a print.

    python benchmarks/bench_match.py [--rounds 5]

Two impressions of one simulated finger, its true surface; nothing is reconstructed.
"""

from __future__ import annotations

import argparse
import importlib.util
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.finger.orientation import find_upright
from splitknit.finger.ridges import relief_print
from splitknit.nominal import default_rig
from splitknit_match.matching.minutiae_match import minutiae_match
from splitknit_match.matching.ridge import Prepared, ridge_match
from splitknit_match.matching.ridge_band import ridge_band
from splitknit_match.matching.template import Template, make_template, pack, unpack
from splitknit_match.matching.thesis import (
    FingerImages,
    ThesisSettings,
    finger_features,
    finger_images,
    thesis_match,
)
from splitknit_match.prints.minutiae import extract, nfiq2
from splitknit_match.prints.pressed import pressed_ridges
from splitknit_match.records.minutiae_record import pack_minutiae
from splitknit_simulator.finger.finger import FingerPose, draw_finger, finger_surface
from splitknit_simulator.surface import SimulatedSurface
from timing import machine, print_table, race

SURFACE = 0.5
BOX = (1528, 936)
"""The thesis's crop of a phalange, pixels."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    rounds = parser.parse_args().rounds
    cv2.setNumThreads(1)
    finger = draw_finger(1)
    camera = default_rig(SURFACE).camera
    master = finger.master()
    seen = [
        finger_surface(replace(finger, printed=master), pose, camera)
        for pose in (
            FingerPose(insertion_mm=26.0),
            FingerPose(insertion_mm=27.0, yaw_rad=0.1, roll_rad=0.1),
        )
    ]
    surfaces = [(s.height_mm - s.shape_mm, s.mask, camera.pitch_mm, s.shape_mm) for s in seen]
    print(
        f"Matching, surfaces of {' x '.join(map(str, seen[0].mask.shape))} pixels, {machine()}, one"
        " thread"
    )

    def template(k: int) -> Template:
        return make_template(ridge_band(*surfaces[k]))

    templates = [template(0), template(1)]
    stored = [pack(t) for t in templates]
    ready = [Prepared(t) for t in templates]
    warm(*ready)
    print(f"A template has {len(stored[0])} bytes for {templates[0].area_mm2:.0f} mm² of skin.")
    contenders = {
        "comparison, both sides prepared": lambda: ridge_match(*ready),
        "comparison, one side read and prepared anew": lambda: ridge_match(
            ready[0], Prepared(unpack(stored[1]))
        ),
        "comparison, the other side anew": lambda: ridge_match(
            Prepared(unpack(stored[0])), ready[1]
        ),
        "comparison, both sides anew": lambda: ridge_match(
            *(Prepared(unpack(payload)) for payload in stored)
        ),
        "template from a reconstruction": lambda: template(0),
    }
    print_table("Ridge templates", race(contenders, 4 * rounds))

    boxes = [
        full_size(
            finger_images(
                s.normals,
                s.normals,
                x[0],
                s.mask,
                camera.pitch_mm,
                input_from_upright=np.eye(3),
                upright_size=s.mask.shape,
            )
        )
        for s, x in zip(seen, surfaces, strict=True)
    ]
    settings = ThesisSettings(gate=0.0)
    known = finger_features(boxes[0], settings)

    def pair(features_known: bool, threads: int = 1) -> Any:
        cv2.setNumThreads(threads)
        comparison = thesis_match(*boxes, settings, known if features_known else None)
        cv2.setNumThreads(1)
        return comparison

    contenders = {
        "lbp": lambda: pair(False),
        "lbp, two threads": lambda: pair(False, 2),
        "lbp, features of one side known": lambda: pair(True),
        "the same, two threads": lambda: pair(True, 2),
    }
    print_table("The thesis's matcher, four channels of 1528 x 936", race(contenders, rounds))
    minutiae([print_of(s, camera.px_per_mm) for s in seen], rounds)


def minutiae(prints: list[NDArray[np.uint8]], rounds: int) -> None:
    """Minutiae of two relief prints, beside nbis-py as it comes."""
    if importlib.util.find_spec("nbis") is None:
        print("nbis-py is not installed: no minutiae.")
        return
    templates = [extract(picture) for picture in prints]
    packed_bytes = len(pack_minutiae(templates[0]))
    print(f"Minutiae: {templates[0].count} and {templates[1].count}; packed {packed_bytes} bytes")
    contenders = {
        "minutiae of a relief print": lambda: extract(prints[0]),
        "enhancement of a pressed print": lambda: pressed_ridges(prints[0]),
        "NFIQ 2 of a print": lambda: nfiq2(prints[0]),
        "comparison of minutiae": lambda: minutiae_match(*templates),
    }
    import nbis

    settings = nbis.NbisExtractorSettings(
        min_quality=0.0, get_center=False, check_fingerprint=False, compute_nfiq2=False, ppi=500.0
    )
    plain = nbis.new_nbis_extractor(settings)
    files = [cv2.imencode(".png", picture)[1].tobytes() for picture in prints]
    own = [plain.extract_minutiae(file) for file in files]
    contenders["nbis-py: minutiae of the same as PNG"] = lambda: plain.extract_minutiae(files[0])
    contenders["nbis-py: comparison, one direction"] = lambda: own[0].compare(own[1])
    size = " x ".join(map(str, prints[0].shape))
    print_table(f"Minutiae, prints of {size} at 500 ppi", race(contenders, 2 * rounds))


def warm(a: Prepared, b: Prepared) -> None:
    """Make what is kept between comparisons, whichever side it is on."""
    ridge_match(a, b)
    for side in (a, b):
        assert side.views.directions.ndim > side.views.ridges().ndim
        assert len(side.first.corner) <= len(side.patches.corner)
        assert side.key


def print_of(seen: SimulatedSurface, px_per_mm: float) -> NDArray[np.uint8]:
    """The relief print of a surface."""
    upright = find_upright(seen.mask)
    ridge = seen.height_mm - seen.shape_mm
    return relief_print(ridge, seen.mask, px_per_mm, upright.input_from_upright, upright.size)


def full_size(images: FingerImages) -> FingerImages:
    """The finger, stretched over the thesis's box at its scale."""
    channels = {name: cv2.resize(channel, BOX[::-1]) for name, channel in images.channels.items()}
    mask = cv2.resize(images.mask.astype(np.uint8), BOX[::-1]).astype(np.bool_)
    return FingerImages(channels, mask, 75.7)


if __name__ == "__main__":
    main()
