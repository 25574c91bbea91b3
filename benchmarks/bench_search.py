"""1:N search: codes of 100,000 fingers, a glance at the best, the comparison of a few; time and memory, one thread.

    OPENBLAS_NUM_THREADS=1 python benchmarks/bench_search.py [--fingers 100000] [--rounds 5]

For TIMING ONLY the gallery is made of the codes of a few simulated fingers with noise added, and every candidate's
template is one of theirs (a fresh unpacking each time, as from a gallery on disk). How often a search finds the right
finger is measured by ``validation/match/codes.py``.
"""

from __future__ import annotations

import argparse
import resource
import time
from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np

from splitknit.matching.code import code_model, code_of, code_size, probe_codes, ridge_field
from splitknit.matching.ridge import Prepared
from splitknit.matching.ridge_band import ridge_band
from splitknit.matching.search import CodeIndex, SearchSettings, identify
from splitknit.matching.template import make_template, pack, unpack
from splitknit.model import default_rig
from splitknit.simulator.finger.finger import Pose, draw_finger, finger_surface
from timing import machine, print_table, race

SCALE = 0.15


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fingers", type=int, default=100_000)
    parser.add_argument("--people", type=int, default=6, help="simulated fingers behind all codes")
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    camera = default_rig(SCALE).camera
    templates = []
    for seed in range(options.people + 1):
        finger, pose = draw_finger(max(seed, 1)), Pose(insertion_mm=26.0, roll_rad=0.1 if seed == 0 else 0.0)
        seen = finger_surface(finger, pose, camera)
        templates.append(
            make_template(ridge_band(seen.height_mm - seen.shape_mm, seen.mask, camera.pitch_mm, seen.shape_mm))
        )
    probe, others = templates[0], templates[1:]
    stored = [pack(template) for template in others]
    start = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    rng = np.random.default_rng(0)
    codes = np.stack([code_of(template) for template in others]).astype(np.float32)
    many = np.empty((options.fingers, code_size()), dtype=np.int8)
    for first in range(0, options.fingers, 10_000):
        part = many[first : first + 10_000]
        noisy = 0.5 * codes[rng.integers(len(codes), size=len(part))] + rng.normal(0, 22, part.shape)
        part[...] = np.clip(np.rint(noisy), -127, 127)
    many[options.fingers // 2] = code_of(others[0])
    index = CodeIndex([f"{n:06d}" for n in range(options.fingers)], many)
    del many, noisy, part
    right = f"{options.fingers // 2:06d}"

    def fetch(identity: str) -> Prepared:
        number = int(identity)
        return Prepared(unpack(stored[0 if identity == right else 1 + number % (len(stored) - 1)]))

    variants = probe_codes(probe)
    settings = SearchSettings()

    def whole() -> str:
        return identify(probe, fetch, index, settings=settings)[0].id

    assert whole() == right

    work = {
        "code of a gallery finger": lambda: code_of(others[0]),
        "its ridge field alone": lambda: ridge_field(others[0]),
        f"codes of a probe ({len(variants)} variants)": lambda: probe_codes(probe),
        f"{options.fingers} codes compared": lambda: index.nearest(variants, settings.candidates),
        "search by codes, from the template": lambda: index.search(probe, settings.candidates),
        f"whole search, {settings.candidates} candidates, {settings.finalists} finalists": whole,
    }
    rows = race(work, options.rounds)
    model = sum(part.nbytes for part in (code_model().loading, code_model().weighted, code_model().precision))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    print(f"1:N among {options.fingers} fingers, {machine()}, one thread; codes of {code_size()} bytes")
    print(
        f"Memory: codes {index.nbytes / 1e6:.1f} MB, model {model / 1e6:.1f} MB; ids and all else raise the process by"
    )
    print(f"{(peak - start) / 1e3:.0f} MB at its peak (making the noisy codes included).")
    used = {row.name: cpu_s(work[row.name], options.rounds) for row in rows}
    print_table(
        "1:N search", [replace(row, result=row.name) for row in rows], lambda name: f"{used[name]:.4f}", "CPU s"
    )


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
