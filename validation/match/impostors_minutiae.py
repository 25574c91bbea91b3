"""False match rates of the minutiae route on relief prints: all pairs of many different simulated fingers.

    python validation/match/impostors_minutiae.py --fingers 250

writes the table that ``splitknit match --method minutiae`` reads, ``src/splitknit/matching/match_fmr_minutiae.json``.
The prints are those of the true surfaces, 500 ppi, one impression each, in poses drawn from the twin's ranges; each
print's minutiae are found once and kept in ``--cache``, so that a stopped run goes on where it was.
"""

from __future__ import annotations

import argparse
import itertools
import json
import tempfile
from pathlib import Path

import numpy as np
from drawn import drawn_surface

from splitknit.matching.minutiae import extract, minutiae_match
from splitknit.matching.minutiae_record import Minutiae, pack_minutiae, unpack_minutiae
from splitknit.matching.score import calibrate_scores
from splitknit.prints.ridges import surface_print

TABLE = Path(__file__).resolve().parents[2] / "src" / "splitknit" / "matching" / "match_fmr_minutiae.json"
SCALE = 0.27
"""Of the camera: 20 pixels a millimetre, the print's own resolution."""


def drawn(seed: int) -> Minutiae:
    """One finger, laid down once."""
    return extract(surface_print(drawn_surface(seed, SCALE)))


def kept(cache: Path, seed: int) -> Minutiae:
    """The minutiae of a finger, from the cache or made now."""
    file = cache / f"{seed}.bin"
    if not file.is_file():
        file.write_bytes(pack_minutiae(drawn(seed)))
    return unpack_minutiae(file.read_bytes())


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--fingers", type=int, default=250)
    parser.add_argument("--seed", type=int, default=60_000)
    parser.add_argument("--cache", type=Path, default=Path(tempfile.gettempdir()) / "splitknit-impostors")
    options = parser.parse_args()
    options.cache.mkdir(parents=True, exist_ok=True)
    sides = []
    for finger in range(options.fingers):
        sides.append(kept(options.cache, options.seed + finger))
        if finger % 20 == 19:
            print(f"{finger + 1} fingers", flush=True)
    acquired = [side for side in sides if side.acquired]
    scores = np.array([minutiae_match(a, b) for a, b in itertools.combinations(acquired, 2)])
    table = calibrate_scores(scores)
    facts = {
        "what": f"relief prints of {len(sides)} simulated fingers, all pairs, validation/match/impostors_minutiae.py",
        "seed": options.seed,
        "failures_to_acquire": len(sides) - len(acquired),
        "minutiae_median": float(np.median([side.count for side in sides])),
        "impostors": table.impostors,
        "similarity": table.similarity.tolist(),
        "fmr": [float(f"{rate:.3g}") for rate in table.fmr],
        "impostor_median": float(np.median(scores)),
        "impostor_largest": float(scores.max()),
    }
    TABLE.write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")
    print({key: value for key, value in facts.items() if key not in ("similarity", "fmr")})


if __name__ == "__main__":
    main()
