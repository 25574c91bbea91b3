"""1:N search: codes of up to ten million fingers in shards, then the ridges of the best 500; time and memory, one core.

    OPENBLAS_NUM_THREADS=1 python benchmarks/bench_search.py [--fingers 100000,1000000,10000000] [--rounds 5]

For TIMING ONLY the shards hold the codes of a few simulated fingers with noise added, and every candidate's template is
one of theirs (a fresh unpacking each time, as from a gallery on disk). How often a search finds the right finger is
measured by ``validation/match/shards.py``, and by ``validation/match/codes.py`` for codes alone. Ten million take
5 GB of disk.
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.model import default_rig
from splitknit_match.gallery.key import Key
from splitknit_match.gallery.shards import Shards, rescored_count, write_shards
from splitknit_match.matching.code import ProbeSettings, code_field, code_of, code_size, probe_codes
from splitknit_match.matching.ridge import Prepared, ridge_match
from splitknit_match.matching.ridge_band import ridge_band
from splitknit_match.matching.search import SearchSettings, glance, nearest_codes
from splitknit_match.matching.template import Template, make_template, pack, unpack
from splitknit_simulator.finger.finger import FingerPose, draw_finger, finger_surface
from timing import machine, print_table, race

SCALE = 0.15
IN_MEMORY = 100_000
"""Fingers of the index in memory, which galleries without shards are searched by."""
KEY = Key(bytes(range(32)), raw=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fingers", default="100000,1000000,10000000", help="sizes of shards, with commas")
    parser.add_argument("--people", type=int, default=6, help="simulated fingers behind all codes")
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    probe, *others = drawn(options.people + 1)
    stored = [pack(template) for template in others]
    print(f"1:N, {machine()}, one thread; codes of {code_size()} bytes")
    in_memory(probe, others, options.rounds)
    for number, count in enumerate(map(int, options.fingers.split(","))):
        with tempfile.TemporaryDirectory() as folder:
            in_shards(probe, others, stored, Path(folder), count=count, rounds=options.rounds, first=number == 0)


def drawn(people: int) -> list[Template]:
    """A probe, and fingers the first of which is the same."""
    camera = default_rig(SCALE).camera
    templates = []
    for seed in range(people):
        finger, pose = draw_finger(max(seed, 1)), FingerPose(insertion_mm=26.0, roll_rad=0.1 if seed == 0 else 0.0)
        seen = finger_surface(finger, pose, camera)
        templates.append(
            make_template(ridge_band(seen.height_mm - seen.shape_mm, seen.mask, camera.pitch_mm, seen.shape_mm))
        )
    return templates


def noisy_codes(others: list[Template], many: NDArray[np.int8]) -> None:
    """Fill in codes like those of the fingers; the one in the middle is the first finger's."""
    rng = np.random.default_rng(0)
    codes = np.stack([code_of(template) for template in others]).astype(np.float32)
    for first in range(0, len(many), 10_000):
        part = many[first : first + 10_000]
        noise = rng.standard_normal(part.shape, dtype=np.float32)
        part[...] = np.clip(np.rint(0.5 * codes[rng.integers(len(codes), size=len(part))] + 22 * noise), -127, 127)
    many[len(many) // 2] = code_of(others[0])


def in_memory(probe: Template, others: list[Template], rounds: int) -> None:
    many = np.empty((IN_MEMORY, code_size()), dtype=np.int8)
    noisy_codes(others, many)
    variants, count = probe_codes(probe), SearchSettings().candidates
    assert nearest_codes(many, variants, 1)[0] == [IN_MEMORY // 2]
    show(
        f"{IN_MEMORY} codes in memory",
        {
            "code of a gallery finger": lambda: code_of(others[0]),
            "its ridge field alone": lambda: code_field(others[0]),
            f"codes of a probe ({len(variants)} variants)": lambda: probe_codes(probe),
            "all codes compared with them": lambda: nearest_codes(many, variants, count),
            "search by codes, from the template": lambda: nearest_codes(many, probe_codes(probe), count),
        },
        rounds,
    )
    print(f"Memory: codes {many.nbytes / 1e6:.1f} MB.")


def in_shards(
    probe: Template, others: list[Template], stored: list[bytes], folder: Path, *, count: int, rounds: int, first: bool
) -> None:
    many = np.memmap(folder / "codes.i8", np.int8, "w+", shape=(count, code_size()))
    noisy_codes(others, many)
    started = time.process_time()
    write_shards(folder / "shards", np.arange(count), many, KEY)
    written_s = time.process_time() - started
    del many
    (folder / "codes.i8").unlink()
    shards, settings, variants = Shards(folder / "shards", KEY), SearchSettings(), ProbeSettings()
    top = rescored_count(count)
    hits = shards.search(probe, settings.shortlist)
    assert hits.rows[0] == count // 2

    side = Prepared(probe)
    side.value  # noqa: B018 - made when first used

    def ridges() -> float:
        worth = {}
        for row, variant in zip(hits.rows.tolist(), hits.variant.tolist(), strict=True):
            number = 0 if row == count // 2 else 1 + row % (len(stored) - 1)
            worth[row] = glance(side, Prepared(unpack(stored[number])), variants, variant), number
        best = sorted(worth, key=lambda row: (-worth[row][0], row))[: settings.candidates]
        return max(ridge_match(side, Prepared(unpack(stored[worth[row][1]]))).similarity for row in best)

    work: dict[str, Callable[[], object]] = {
        "codes of the probe": lambda: probe_codes(probe, variants),
        f"search of the shards, {top} rescored, the best {settings.shortlist}": lambda: shards.search(
            probe, settings.shortlist
        ),
    }
    if first:  # they cost the same however many fingers there are
        work[f"a glance at the ridges of {settings.shortlist}, {settings.candidates} compared"] = ridges
    used = show(f"{count} fingers in {len(shards.files)} shards", work, rounds)
    size = sum(file.stat().st_size for file in shards.files)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    scan_s = list(used.values())[1]
    print(f"Shards {size / 1e9:.2f} GB, written in {1e6 * written_s / count:.1f} us a finger (CPU). Memory: at most")
    print(f"{peak / 1e9:.2f} GB of this process so far, mapped pages and the writing of the shards included.")
    paper_s = 1e8 / 8 * scan_s / count
    print(f"Scan: {1e9 * scan_s / count:.2f} ns a finger. On paper, 10^8 on eight workers: {paper_s:.2f} s")
    print(f"of each, 26.4 GB of shards in all, {24 * top * 28 / 1e6:.0f} MB of candidates to merge (24 shards).")


def show(title: str, work: dict[str, Callable[[], object]], rounds: int) -> dict[str, float]:
    rows = race(work, rounds)
    used = {row.name: cpu_s(work[row.name], rounds) for row in rows}
    print_table(title, [replace(row, result=row.name) for row in rows], lambda name: f"{used[name]:.4f}", "CPU s")
    return used


def cpu_s(run: Callable[[], object], rounds: int) -> float:
    """Least processor time of a run: what a core takes that nobody else uses, or somewhat more."""
    found = []
    for _ in range(rounds):
        start = time.process_time()
        run()
        found.append(time.process_time() - start)
    return min(found)


if __name__ == "__main__":
    main()
