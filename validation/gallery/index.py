"""What a search by the index of minutiae loses and takes, among 10,000 captures of real ridges.

    python validation/gallery/index.py [--cache FILE]          # about 8 minutes of one core

writes ``tables/index.csv`` and ``tables/index.json`` (times) beside this file. Probes and their
mates: FVC 2000, 2002, 2004, presses 1 to 8 of five fingers on each of seven sensors; pairs one and
three presses apart that match (method fusion, false match rate of 1 in 10,000). The others in the
gallery are halves of two prints of other sensors, joined. A pair is lost where its mate is not
among the given number that are compared in full; interval of Clopper and Pearson, and by fingers
drawn anew. Constants of the index were chosen on the same prints. Times: of `Gallery.identify` with
every fifth press of the first four sensors, a template; the gallery holds the others (present), or
none of theirs.
"""

from __future__ import annotations

import argparse
import json
import os
import pickle
import tempfile
import time
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from scipy.stats import binomtest

from splitknit.io.csv_table import csv_text
from splitknit_match.gallery.file import Entry, NewCapture
from splitknit_match.gallery.gallery import Gallery
from splitknit_match.gallery.identify import TEMPLATES_HASH
from splitknit_match.gallery.minutia_index import MinutiaIndex
from splitknit_match.matching.fusion import fused_match
from splitknit_match.matching.inputs import print_template
from splitknit_match.matching.methods import fmr_table
from splitknit_match.matching.minutia_pairs import pair_minutiae
from splitknit_match.matching.ridge import Prepared
from splitknit_match.matching.template import Template, pack, print_size, unpack
from splitknit_match.records.minutiae_record import Minutiae
from splitknit_match.records.pictures import read_print_png

HERE = Path(__file__).resolve().parent
PPI = {
    "fvc2002_db1b": 500, "fvc/fvc2000_db2b": 500, "fvc/fvc2002_db2b": 569, "fvc/fvc2004_db1b": 500,
    "fvc/fvc2004_db2b": 500, "fvc/fvc2004_db3b": 512, "fvc/fvc2000_db3b": 500,
}  # fmt: skip
FOLDS = tuple(PPI)[:4], tuple(PPI)[4:]
GALLERY_SIZE = 10_000
CANDIDATES = 50
COMPARED = (1, 2, 6, 14, 30, CANDIDATES)
MATCHING_SUPPORT = 9.0


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cache", type=Path, default=Path("/tmp/splitknit_fvc_templates.pkl"))
    payloads = templates(parser.parse_args().cache)
    prints = {name: unpack(payload) for name, payload in payloads.items()}
    ready = {name: Prepared(template) for name, template in prints.items()}
    limit = fmr_table("fusion").threshold(1e-4)
    ranks: list[tuple[str, int]] = []
    support: dict[bool, list[float]] = {True: [], False: []}
    for fold in (0, 1):
        names = sorted(name for name in prints if name.rpartition("/")[0] in FOLDS[fold])
        others = [prints[name] for name in prints if name.rpartition("/")[0] in FOLDS[1 - fold]]
        gallery = [
            *(payloads[name] for name in names),
            *map(pack, joined(others, GALLERY_SIZE - len(names))),
        ]
        started = time.process_time()
        index = MinutiaIndex(dict(enumerate(gallery)), HERE, {})
        built, started = time.process_time() - started, time.process_time()
        for n, name in enumerate(names):
            own = [k for k, mate_name in enumerate(names) if mate_name[:-2] == name[:-2]]
            mates = [own[(own.index(n) + step) % len(own)] for step in (1, 3)]
            order = [
                row
                for row in index.nearest(ready[name].cylinders, 2 * CANDIDATES)
                if row not in own or row in mates
            ]
            for mate in mates:
                if fused_match(ready[name], ready[names[mate]]).similarity >= limit:
                    before = [row for row in order if row not in mates or row == mate]
                    support[True].append(most(ready[name], ready[names[mate]]))
                    ranks.append(
                        (name[:-2], before.index(mate) if mate in before else GALLERY_SIZE)
                    )
            others = [row for row in order if row not in own][:CANDIDATES]
            support[False] += [most(ready[name], Prepared(unpack(gallery[row]))) for row in others]
        seconds = time.process_time() - started
        print(
            f"built in {built:.1f} s, {len(names)} searches with their comparisons {seconds:.1f} s"
        )
        if fold == 0:
            times(names, gallery)
    sure = sum(value >= MATCHING_SUPPORT for value in support[True]), len(support[True])
    print(
        f"support of {MATCHING_SUPPORT}: {sure} matching pairs; of {len(support[False])} others"
        f" {max(support[False]):.1f} at most"
    )
    write(ranks)


def most(a: Prepared, b: Prepared) -> float:
    """Support of the best alignment by minutiae."""
    assert a.cylinders is not None and b.cylinders is not None
    return max(
        (alignment.support for alignment in pair_minutiae(a.cylinders, b.cylinders)), default=0.0
    )


def times(names: list[str], templates: list[bytes]) -> None:
    """Measure and write what a search takes."""
    facts: dict[str, object] = {"captures": len(templates)}
    with tempfile.TemporaryDirectory() as folder:
        probes = range(0, len(names), 5)
        for case, kept in (
            ("present", set(range(len(templates))) - set(probes)),
            ("absent", range(len(names), GALLERY_SIZE)),
        ):
            file = Path(folder) / f"{case}.skg"
            with Gallery(file) as gallery:
                captures = (
                    NewCapture(
                        Entry(
                            f"P{n}", "right_index", "1", "template", "", unpack(template).area_mm2
                        ),
                        template,
                    )
                    for n, template in enumerate(templates)
                    if n in kept
                )
                gallery.add(captures, TEMPLATES_HASH)
            # as a server has it: its memory holds nothing else
            with get_context("spawn").Pool(1) as alone:
                first_s, matches, taken = alone.apply(
                    search, (file, [templates[n] for n in probes])
                )
            facts[f"{case}_first_cpu_s"] = round(first_s, 1)
            facts |= {f"{case}_probes": len(taken), f"{case}_matches": matches}
            wall, cpu = 1000 * np.array(taken).T
            for name, values in (("wall", wall), ("cpu", cpu)):
                facts[f"{case}_{name}_ms"] = [
                    round(float(value), 1) for value in np.percentile(values, (0, 50, 95))
                ]
    print(json.dumps(facts))
    (HERE / "tables" / "index.json").write_text(
        json.dumps(facts, indent=1) + "\n", encoding="utf-8"
    )


def search(file: Path, probes: list[bytes]) -> tuple[float, int, list[tuple[float, float]]]:
    """Processor time of the first search, how many matched, and seconds of each by the clock and of
    the processor."""
    gallery = Gallery(file)
    started = time.process_time()
    gallery.identify(probes[0])
    first_s = time.process_time() - started
    taken = []
    matches = 0
    for probe in probes:
        before = time.perf_counter(), time.process_time()
        matches += gallery.identify(probe).answer == "match"
        taken.append((time.perf_counter() - before[0], time.process_time() - before[1]))
    return first_s, matches, taken


def templates(cache: Path) -> dict[str, bytes]:
    """Templates of all prints, made once."""
    if cache.exists():
        return dict(pickle.loads(cache.read_bytes()))
    root = Path(os.environ.get("SPLITKNIT_DATA", HERE.parents[2] / "shared" / "data"))
    payloads = {}
    for name, ppi in PPI.items():
        for file in sorted((root / name).glob("*_[1-8].png")):
            payloads[f"{name}/{file.stem}"] = pack(
                print_template(read_print_png(file).image, float(ppi))
            )
    cache.write_bytes(pickle.dumps(payloads))
    return payloads


def joined(prints: list[Template], count: int) -> list[Template]:
    """Templates whose upper half is one print's and whose lower half another's."""
    rng = np.random.default_rng(0)
    composites = []
    while len(composites) < count:
        a, b = (prints[n] for n in rng.integers(len(prints), size=2))
        if a is b or a.minutiae is None or b.minutiae is None:
            continue
        shape = tuple(np.maximum(a.valid.shape, b.valid.shape) + 2)
        level = np.zeros(shape, np.uint8)
        valid = np.zeros(shape, bool)
        half, parts = shape[0] // 2, []
        for source, upper in ((a, True), (b, False)):
            rows, columns = source.valid.shape
            down, right = (shape[0] - rows) // 2, (shape[1] - columns) // 2
            there = np.zeros(shape, bool)
            there[down : down + rows, right : right + columns] = source.valid
            there &= (np.arange(shape[0]) < half)[:, None] == upper
            moved = np.zeros(shape, np.uint8)
            moved[down : down + rows, right : right + columns] = source.level
            level[there], valid[there] = moved[there], True
            step = source.pitch_mm * 500 / 25.4
            # prints are mirrored
            x = source.minutiae.x_px + round((shape[1] - columns - right) * step)
            y = source.minutiae.y_px + round(down * step)
            kept = (y < half * step) == upper
            parts.append(
                (
                    x[kept],
                    y[kept],
                    source.minutiae.direction_rad[kept],
                    source.minutiae.type[kept],
                    source.minutiae.quality[kept],
                )
            )
        template = Template(level, valid, a.pitch_mm)
        if not template.empty:
            fields = [np.concatenate(part) for part in zip(*parts, strict=True)]
            size = print_size(template)
            inside = (
                (fields[0] >= 0) & (fields[0] < size[1]) & (fields[1] >= 0) & (fields[1] < size[0])
            )
            minutiae = Minutiae(*(part[inside] for part in fields), size)
            composites.append(Template(level, valid, a.pitch_mm, minutiae))
    return composites


def write(ranks: list[tuple[str, int]]) -> None:
    """Write the table of lost pairs."""
    owner = np.array([name for name, _ in ranks])
    place = np.array([rank for _, rank in ranks])
    fingers = np.unique(owner)
    rng = np.random.default_rng(0)
    rows: list[list[object]] = [
        [
            "captures",
            "compared",
            "matching_pairs",
            "lost",
            "low",
            "high",
            "low_by_finger",
            "high_by_finger",
        ]
    ]
    for compared in COMPARED:
        out = place >= compared
        lost = int(out.sum())
        n = len(out)
        sums = np.array(
            [[out[owner == finger].sum(), (owner == finger).sum()] for finger in fingers]
        )
        drawn = sums[rng.integers(len(fingers), size=(2000, len(fingers)))].sum(axis=1)
        ends = np.percentile(drawn[:, 0] / drawn[:, 1], (2.5, 97.5))
        low, high = binomtest(lost, n).proportion_ci(method="exact")
        rows.append(
            [GALLERY_SIZE, compared, n, lost, *(f"{value:.4f}" for value in (low, high, *ends))]
        )
        print(*rows[-1])
    (HERE / "tables" / "index.csv").write_text(csv_text(rows), encoding="utf-8")


if __name__ == "__main__":
    main()
