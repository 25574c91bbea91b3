"""Minutiae by vote (Zheng) against plain ones: recall and precision by the simulator's truth.

    python validation/published/voted_truth.py --population POP --store STORE --work DIR

POP is a simulated population, STORE a batch of it with the cases `ea` and `metric`. Minutiae of
pictures are kept in DIR. Right index of S01 to S10, session 1; half a millimetre inside the print,
where the slant is below 60 deg. The share of the votes was chosen on other fingers (S15 to S17).
Writes ``voted.json`` beside this script. Scores between two sessions: ``voted.py``.
"""

from __future__ import annotations

import argparse
import json
import pickle
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from voted import PICTURES, pictures_of, vote

sys.path.append(str(Path(__file__).resolve().parents[1] / "prints"))
from agreement_compare import agreed, counts
from agreement_measure import against_truth
from agreement_truth import read_truth

from splitknit.finger.locate import find_finger
from splitknit.io.capture import read_capture
from splitknit.io.images import decode_image
from splitknit.presets import preset_settings
from splitknit_match.batch.chunks import read_chunk
from splitknit_match.batch.reading import stored_places
from splitknit_match.batch.store import Store
from splitknit_match.matching.minutiae import extract
from splitknit_match.matching.minutiae_record import PPI, Minutiae
from splitknit_match.prints.print_map import plane_map, resample

FINGERS = [(f"S{k:02d}", 1, "right_index") for k in range(1, 11)]
SHARES = (0.15, 0.25, 0.35, 0.5, 0.6, 0.7)


def minutiae_of(capture: Path, kept: Path) -> dict[str, list[Minutiae]]:
    """Minutiae of every picture of every set, by the picture, from the disk where they are there."""
    if not kept.is_file():
        found: dict[str, list[Minutiae]] = {name: [] for name in PICTURES}
        for name, picture in pictures_of(read_capture(capture)):
            found[name].append(extract(picture))
        kept.write_bytes(pickle.dumps(found))
    return dict(pickle.loads(kept.read_bytes()))


def ways(lists: dict[str, list[Minutiae]]) -> dict[str, Minutiae]:
    """Minutiae of a capture in every way of voting that is compared."""
    every = [one for name in PICTURES for one in lists[name]]
    found = {f"vote of all pictures, {share:g}": vote(every, share) for share in SHARES}
    found |= {f"vote of {name}": vote(lists[name]) for name in PICTURES}
    return found | {"vote of the first set alone": vote([lists[name][0] for name in PICTURES])}


def plain(store: Path, case: str, name: str) -> Minutiae:
    """Minutiae of a reconstruction's relief print."""
    place = stored_places(Store(store).files("features", case))[name]
    data = read_chunk(place.file, ["print"]).column("print").to_pylist()[place.row]
    return extract(decode_image(data, "print")[..., 0])


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in ("population", "store", "work"):
        parser.add_argument(f"--{name}", type=Path, required=True)
    options = parser.parse_args()
    options.work.mkdir(parents=True, exist_ok=True)
    rows: dict[str, list[Any]] = {}
    for finger in FINGERS:
        name = f"{finger[0]}/session_{finger[1]}/{finger[2]}"
        found = ways(minutiae_of(options.population / name, options.work / f"{name.replace('/', '-')}.pickle"))
        found |= {f"{case}, relief print": plain(options.store, case, name) for case in ("ea", "metric")}
        capture = read_capture(options.population / name)
        seen, pitch = find_finger(capture, preset_settings("zheng")), capture.rig.camera.pitch_mm
        print_map = plane_map(pitch, seen.upright.input_from_upright, seen.upright.size, PPI)
        _, weight = resample(seen.mask.astype(np.float32), seen.mask, pitch, print_map)
        made: Any = SimpleNamespace(map=print_map, weight=weight)
        truth = read_truth(options.population, *finger)
        for way, one in found.items():
            record = against_truth(one, made, truth)
            rows.setdefault(way, []).append(counts(record, margin_px=10.0, slant=(0.0, 60.0)))
        print(name, flush=True)
    document = {"captures": [f"{one[0]}/session_1/{one[2]}" for one in FINGERS]}
    document |= {"agreement": {way: agreed(found) for way, found in rows.items()}}
    Path(__file__).with_name("voted.json").write_text(json.dumps(document, indent=1) + "\n", encoding="ascii")


if __name__ == "__main__":
    main()
