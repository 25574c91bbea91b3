"""How often a search of 1,000 captures names somebody else, and how often it misses the finger:
FPIR and FNIR.

    python validation/gallery/rates.py [--cache FILE]          # about 4 minutes of one core

writes ``tables/rates.csv`` beside this file. Prints: those of ``index.py``. Each of two folds of
sensors has two galleries of 1,000: the first press of every second finger, and halves of prints of
the other fold's fingers, joined. Presses 2 to 8 are probes, whole, and as a square of 6 mm about
the middle of their ridges: in the gallery that has the finger (present), and in the other (absent),
searched as `identify` does by default. Left out are 45 of 245 windows with fewer than three
minutiae, which are compared with all (40 s each). A stated FPIR is the mean number of false matches
that the answer reports (captures times rate). Intervals: Clopper and Pearson, 95 %; presses of a
finger are not independent. Of the probe's sensor are only the few first presses.
"""

from __future__ import annotations

import argparse
import os
import pickle
import tempfile
from pathlib import Path

import cv2
import numpy as np
from index import FOLDS, HERE, PPI, joined, templates
from scipy.stats import binomtest

from splitknit.io.csv_table import csv_text
from splitknit_match.gallery.file import Entry, NewCapture
from splitknit_match.gallery.gallery import Gallery
from splitknit_match.gallery.identify import TEMPLATES_HASH
from splitknit_match.matching.inputs import print_template
from splitknit_match.matching.ridge import Prepared
from splitknit_match.matching.template import pack, unpack
from splitknit_match.records.pictures import read_print_png

GALLERY_SIZE = 1000
WINDOW_MM = 6.0
"""Side of the windows that are cut from prints."""
FMR = 1e-4


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cache", type=Path, default=Path("/tmp/splitknit_fvc_templates.pkl"))
    cache = parser.parse_args().cache
    payloads = templates(cache)
    cut = windows(cache.with_name("splitknit_fvc_windows.pkl"))
    prints = {name: unpack(payload) for name, payload in payloads.items()}
    counts: dict[tuple[str, str], list[tuple[bool, bool, float]]] = {}
    for fold in (0, 1):
        names = sorted(name for name in prints if name.rpartition("/")[0] in FOLDS[fold])
        others = [prints[name] for name in prints if name.rpartition("/")[0] in FOLDS[1 - fold]]
        fingers = sorted({name[:-2] for name in names})
        fill = [pack(template) for template in joined(others, GALLERY_SIZE)]
        with tempfile.TemporaryDirectory() as folder:
            galleries = []
            for half in (0, 1):
                held = [(name, payloads[f"{name}_1"]) for name in fingers[half::2]]
                held += [
                    (f"other {n}", payload)
                    for n, payload in enumerate(fill[: GALLERY_SIZE - len(held)])
                ]
                file = Path(folder) / f"{half}.skg"
                captures = (
                    NewCapture(
                        Entry(person, "right_index", "1", "template", "", unpack(payload).area_mm2),
                        payload,
                    )
                    for person, payload in held
                )
                galleries.append(Gallery(file))
                galleries[-1].add(captures, TEMPLATES_HASH)
            for name in (name for name in names if name[-1] != "1"):
                own = fingers.index(name[:-2]) % 2
                for kind, probe in (("whole", payloads[name]), ("6 mm", cut[name])):
                    if Prepared(unpack(probe)).cylinders is None:
                        continue
                    for case, gallery in (
                        ("present", galleries[own]),
                        ("absent", galleries[1 - own]),
                    ):
                        answer = gallery.identify(probe, fmr=FMR)
                        matched = answer.answer == "match"
                        right = matched and answer.candidates[0].person == name[:-2]
                        stated = (
                            0.0
                            if answer.decision is None
                            else answer.decision.expected_false_matches
                        )
                        counts.setdefault((kind, case), []).append((matched, right, stated))
            print(f"{len(names)} presses of fold {fold} were searched", flush=True)
    write(counts)


def windows(cache: Path) -> dict[str, bytes]:
    """Templates of squares about the middle of each print's ridges, made once."""
    if cache.exists():
        return dict(pickle.loads(cache.read_bytes()))
    root = Path(os.environ.get("SPLITKNIT_DATA", HERE.parents[2] / "shared" / "data"))
    payloads = {}
    for name, ppi in PPI.items():
        for file in sorted((root / name).glob("*_[2-8].png")):
            image = read_print_png(file).image
            detail = image.astype(np.float32) - cv2.GaussianBlur(
                image.astype(np.float32), (0, 0), 6
            )
            spread = cv2.GaussianBlur(detail * detail, (0, 0), 12)
            side = round(WINDOW_MM * ppi / 25.4)
            start = [
                int(np.clip(round(part.mean() - side / 2), 0, length - side))
                for part, length in zip(
                    np.nonzero(spread > 0.25 * np.quantile(spread, 0.95)), image.shape, strict=True
                )
            ]
            part = np.ascontiguousarray(
                image[start[0] : start[0] + side, start[1] : start[1] + side]
            )
            payloads[f"{name}/{file.stem}"] = pack(print_template(part, float(ppi)))
    cache.write_bytes(pickle.dumps(payloads))
    return payloads


def write(counts: dict[tuple[str, str], list[tuple[bool, bool, float]]]) -> None:
    """Write FPIR of absent fingers; of present ones FNIR, and how often somebody else was named."""
    rows: list[list[object]] = [
        ["probe", "finger", "fmr", "rate", "searches", "count", "low", "high", "stated"]
    ]
    for (kind, case), answers in counts.items():
        n = len(answers)
        wrong = sum(matched and not right for matched, right, _ in answers)
        missed = sum(not right for _, right, _ in answers)
        stated = float(np.mean([expected for *_, expected in answers]))
        for rate, count in [("FPIR", wrong)] + ([("FNIR", missed)] if case == "present" else []):
            low, high = binomtest(count, n).proportion_ci(method="exact")
            expectation = f"{stated:.3g}" if rate == "FPIR" else ""
            rows.append([kind, case, FMR, rate, n, count, f"{low:.4f}", f"{high:.4f}", expectation])
            print(*rows[-1])
    (HERE / "tables" / "rates.csv").write_text(csv_text(rows), encoding="utf-8")


if __name__ == "__main__":
    main()
