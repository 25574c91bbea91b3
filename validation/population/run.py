"""Is the simulated population like people? Classes and sizes as drawn, prints as impostors,
outlines as similar.

    pip install nbis-py==0.1.3
    python validation/population/run.py                 # all parts, ten minutes of one core
    python validation/population/run.py --parts sizes   # only some: sizes, impostors, outlines

writes ``results.json`` beside this file; parts that are not run stay as they are there. The
outlines are those of the surfaces that the camera sees, without light and noise.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit_match.evaluation.rates import roc
from splitknit_simulator.finger.finger import SimulatedFinger, finger_surface
from splitknit_simulator.finger.master_print import MasterPrint, ink_print
from splitknit_simulator.population.people import (
    ARCHES,
    DIGITS,
    FINGERS,
    LENGTH_MM,
    PERIOD_DIGIT,
    PERIOD_MM,
    RADIAL,
    TENTED,
    TWIN,
    WHORLS,
    WIDTH_MM,
    Person,
)
from splitknit_simulator.population.sessions import (
    PopulationSettings,
    draw_impression,
    finger_of_today,
)

HERE = Path(__file__).resolve().parent
PROFILE_MM = np.arange(1.0, 16.1, 1.0)
"""Distances from the tip, along the finger, at which an outline is measured."""
SIDEWAYS_MM = np.linspace(-1.0, 1.0, 9)
"""Lateral search of the overlap."""


def class_fractions(side: str, digit: str) -> dict[str, float]:
    """Fraction of every class among the prints of a digit; they sum to one."""
    k = DIGITS.index(digit)
    arch, whorl = ARCHES[side][k], WHORLS[side][k]
    radial, ulnar = ("left_loop", "right_loop") if side == "right" else ("right_loop", "left_loop")
    loop = 1.0 - arch - whorl
    return {
        "arch": arch * (1.0 - TENTED),
        "tented_arch": arch * TENTED,
        radial: loop * RADIAL[k],
        ulnar: loop * (1.0 - RADIAL[k]),
        "whorl": whorl * (1.0 - TWIN),
        "twin_loop": whorl * TWIN,
    }


def people(seed: int, count: int) -> Iterator[Person]:
    settings = PopulationSettings(seed=seed)
    return (settings.person(number) for number in range(1, count + 1))


def sizes(count: int = 2000) -> dict[str, Any]:
    """Breadths, lengths, ridge periods and classes of many people, against what was asked for."""
    everybody = list(people(0, count))
    result: dict[str, Any] = {"people": count, "digits": {}, "classes": {}}
    for k, digit in enumerate(DIGITS):
        table = {}
        for sex in ("man", "woman"):
            fingers = [p.fingers[f"right_{digit}"].finger for p in everybody if p.sex == sex]
            table[sex] = {
                "width_mm": _mean_sd([finger.shape.width_mm for finger in fingers]),
                "length_mm": _mean_sd([finger.shape.length_mm for finger in fingers]),
                "period_mm": _mean_sd([finger.print_settings.period_mm for finger in fingers], 4),
            }
        asked = (WIDTH_MM[k], LENGTH_MM[k], PERIOD_MM * PERIOD_DIGIT[k])
        result["digits"][digit] = {
            "asked_mean_of_sexes": [round(value, 4) for value in asked],
            **table,
        }
    worst = 0.0
    for name in FINGERS:
        side, digit = name.split("_")
        drawn = [p.fingers[name].finger.pattern for p in everybody]
        row = {}
        for pattern, fraction in class_fractions(side, digit).items():
            drawn_fraction = drawn.count(pattern) / count
            worst = max(
                worst,
                abs(drawn_fraction - fraction)
                / max(np.sqrt(fraction * (1 - fraction) / count), 1e-9),
            )
            row[pattern] = [round(fraction, 4), round(drawn_fraction, 4)]
        result["classes"][name] = row
    result["classes_worst_deviation_in_sd"] = round(float(worst), 2)
    whorls = np.array(
        [
            [p.fingers[f].finger.pattern in ("whorl", "twin_loop") for f in FINGERS]
            for p in everybody
        ]
    )
    result["people_without_whorls"] = round(float((~whorls.any(axis=1)).mean()), 3)
    result["people_with_whorls_only"] = round(float(whorls.all(axis=1).mean()), 3)
    widths = np.array([[p.fingers[f].finger.shape.width_mm for f in FINGERS] for p in everybody])
    result["width_correlation_index_ring"] = round(
        float(np.corrcoef(widths[:, 1], widths[:, 3])[0, 1]), 3
    )
    result["width_correlation_index_left_right"] = round(
        float(np.corrcoef(widths[:, 1], widths[:, 6])[0, 1]), 3
    )
    return result


def _mean_sd(values: Any, digits: int = 2) -> list[float]:
    return [round(float(np.mean(values)), digits), round(float(np.std(values)), digits)]


def matched(files: Sequence[bytes], labels: Sequence[str]) -> dict[str, Any]:
    """Score all pairs; pairs of one label are genuine."""
    import nbis  # a tool of this part alone

    extractor = nbis.new_nbis_extractor(
        nbis.NbisExtractorSettings(
            min_quality=0.0,
            get_center=False,
            check_fingerprint=False,
            compute_nfiq2=False,
            ppi=500.0,
        )
    )
    templates = [extractor.extract_minutiae(file) for file in files]
    impostor, genuine = [], []
    for i, j in itertools.combinations(range(len(files)), 2):
        (genuine if labels[i] == labels[j] else impostor).append(templates[i].compare(templates[j]))
    counts = [len(template.get()) for template in templates]
    result: dict[str, Any] = {
        "prints": len(files),
        "minutiae_median": float(np.median(counts)),
        "impostor": _distribution(impostor),
    }
    if genuine:
        result["genuine"] = _distribution(genuine)
    return result


def _distribution(scores: Sequence[int]) -> dict[str, float]:
    values = np.asarray(scores)
    return {
        "pairs": len(values),
        "median": float(np.median(values)),
        "p95": float(np.percentile(values, 95)),
        "p99": float(np.percentile(values, 99)),
        "max": float(values.max()),
    }


def impostors(draws: int = 5) -> dict[str, Any]:
    """Scores of NIST's mindtct and bozorth3 between 40 prints: of four people, and of forty, for
    some populations."""
    result: dict[str, Any] = {
        "matcher": "mindtct + bozorth3 (nbis-py 0.1.3), 500 ppi, all minutiae"
    }
    for seed in range(draws):
        families = [own for person in people(seed, 4) for own in person.fingers.values()]
        impostors = [
            person.fingers[FINGERS[person.number % len(FINGERS)]] for person in people(seed, 40)
        ]
        for name, fingers in (("four_people", families), ("forty_people", impostors)):
            images = [
                np.pad(ink_print(own.finger.master()), 20, constant_values=255) for own in fingers
            ]
            files = [cv2.imencode(".png", image)[1].tobytes() for image in images]
            result[f"{name}_{seed}"] = matched(files, [str(k) for k in range(len(files))])
    data = Path(os.environ.get("SPLITKNIT_DATA", HERE.parents[2] / "shared" / "data"))
    real = sorted((data / "fvc2002_db1b").glob("*.png"))
    if real:
        result["real_fvc2002_db1b"] = matched(
            [file.read_bytes() for file in real], [file.stem[:3] for file in real]
        )
    return result


def outlines(subjects: int = 17, sessions: int = 4) -> dict[str, Any]:
    """How well breadth, length of the tip and whole outline alone distinguish fingers."""
    settings = PopulationSettings(scale=0.2)
    fingers, edges = [], []
    for person in people(0, subjects):
        for name in FINGERS:
            for session in range(1, sessions + 1):
                fingers.append(f"{person.number} {name}")
                edges.append(_edges(settings, person, name, session))
    outline = np.stack(edges)  # (N, 2, 16) left and right edge, mm
    width = np.median(outline[:, 1, 7:] - outline[:, 0, 7:], axis=1)
    tip = (outline[:, 1, 2] - outline[:, 0, 2]) / width  # how pointed it is
    first, second = np.triu_indices(len(fingers), 1)
    names = np.array(fingers)
    genuine = names[first] == names[second]
    overlap = _overlap(outline, first, second)
    scores = {
        "width": -np.abs(width[first] - width[second]),
        "width_and_tip": -np.hypot(
            (width[first] - width[second]) / width.std(), (tip[first] - tip[second]) / tip.std()
        ),
        "overlap": overlap,
    }
    people_of = np.array([name.split()[0] for name in fingers])
    others = ~genuine & (people_of[first] != people_of[second])
    index = np.array([name.endswith("right_index") for name in fingers])
    by_person = [width[index & (people_of == person)] for person in dict.fromkeys(people_of)]
    within = (
        float(np.sqrt(np.mean([values.var(ddof=1) for values in by_person])))
        if sessions > 1
        else None
    )
    return {
        "captures": len(fingers),
        "width_mm": _mean_sd(width),
        "right_index_width_sd_between_people_mm": round(
            float(np.std([values.mean() for values in by_person])), 3
        ),
        "right_index_width_sd_between_sessions_mm": None if within is None else round(within, 3),
        "strangers_within_0.5_mm": round(
            float((np.abs(width[first] - width[second])[others] < 0.5).mean()), 3
        ),
        "genuine_overlap_above_0.9": round(float((overlap[genuine] > 0.9).mean()), 4),
        "impostor_overlap_above_0.9": round(float((overlap[~genuine] > 0.9).mean()), 4),
        "separation": {
            name: {
                "eer": round(roc(score[genuine], score[~genuine]).equal_error().value, 4),
                "d_prime": round(roc(score[genuine], score[~genuine]).d_prime(), 2),
            }
            for name, score in scores.items()
        },
    }


def _edges(
    settings: PopulationSettings, person: Person, name: str, session: int
) -> NDArray[np.float64]:
    """(2, 16) left and right edge of the upright outline, mm from the middle line, at distances
    from the tip."""
    own = person.fingers[name]
    rig = settings.rig()
    impression = draw_impression(
        own, settings.sessions, rig.camera, (settings.seed, person.number, session)
    )
    pose = replace(impression.pose(), yaw_rad=0.0, x_mm=0.0)  # the thesis turns outlines upright
    today = finger_of_today(own.finger, impression)
    surface = finger_surface(
        replace(today, printed=_smooth_skin(today)), pose, rig.camera, workers=1
    )
    pitch = surface.camera.pitch_mm
    rows = np.nonzero(surface.mask.any(axis=1))[0]
    left = np.argmax(surface.mask, axis=1) * pitch
    right = (surface.mask.shape[1] - np.argmax(surface.mask[:, ::-1], axis=1)) * pitch
    at = (np.arange(surface.mask.shape[0]) - rows[0] + 0.5) * pitch
    lines = np.stack([np.interp(PROFILE_MM, at[rows], side[rows]) for side in (left, right)])
    return np.asarray(lines - np.median(lines.mean(axis=0)[7:]))


def _smooth_skin(finger: SimulatedFinger) -> MasterPrint:
    """A print without ridges: the outline does not need them."""
    u = np.arange(-22.0, 22.1, 1.0)
    v = np.arange(44.0, -25.0, -1.0)
    return MasterPrint(
        finger.pattern,
        finger.seed,
        np.ones((v.size, u.size), np.float32),
        np.zeros((v.size, u.size), np.float32),
        u,
        v,
        0.43,
        (),
        (),
        np.zeros((0, 3)),
    )


def _overlap(outline: NDArray[Any], first: NDArray[Any], second: NDArray[Any]) -> NDArray[Any]:
    """Intersection over union of upright outlines, tips together, the best of some lateral
    shifts."""
    best = np.zeros(first.size)
    for begin in range(0, first.size, 50_000):
        part = slice(begin, begin + 50_000)
        a, b = outline[first[part]], outline[second[part]]
        for shift in SIDEWAYS_MM:
            both = np.minimum(a[:, 1], b[:, 1] + shift) - np.maximum(a[:, 0], b[:, 0] + shift)
            both = np.maximum(both, 0.0).sum(axis=1)
            either = (a[:, 1] - a[:, 0] + b[:, 1] - b[:, 0]).sum(axis=1) - both
            best[part] = np.maximum(best[part], both / either)
    return best


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--parts", default="sizes,impostors,outlines")
    options = parser.parse_args()
    file = HERE / "results.json"
    parts = {"sizes": sizes, "impostors": impostors, "outlines": outlines}
    results = json.loads(file.read_text()) if file.is_file() else {}
    for part in options.parts.split(","):
        results[part] = parts[part]()
        file.write_text(json.dumps(results, indent=1) + "\n")
        print(part, json.dumps(results[part], indent=1))


if __name__ == "__main__":
    main()
