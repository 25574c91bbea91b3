"""Searches with real prints: how often the first stage (codes) has the right finger among the best 100.

    python validation/match/real_search.py --work FOLDER [--cache FOLDER]

writes ``real_search.json``. Of each finger of the seven real sets (``fvc.py``: 101 to 105) five impressions are
enrolled and three searched. Distractors are 10,000 drawn ridge fields (``field_fingers.py``, seed 7400), with the mean
of the model, each seen through the outline of one of the enrolled prints. What a gallery of 100,000 would give is
extrapolated from their scores with the same probe (``code_tails.py``), not counted. Intervals of 95 % draw fingers.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from code_learning import mirrored
from code_tails import hit_rates, tail_probability
from codes import IMPOSTORS, impostor_codes
from field_fingers import load_fields, make_fields
from fvc import KNOWN, REAL, Job, made, prints

from splitknit_match.matching.code import code_model, code_of, probe_codes
from splitknit_match.matching.search import SearchSettings
from splitknit_match.matching.template import Template

OUT = Path(__file__).with_suffix(".json")
ENROLLED = 5
SIZES = (10_000, 100_000)
RANKS = (1, 10, 100)


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", type=Path, required=True, help="of the drawn fields")
    parser.add_argument("--cache", type=Path, default=Path("/tmp/splitknit_fvc"), help="as of fvc.py")
    parser.add_argument("--fields", type=int, default=10_000)
    parser.add_argument("--sets", nargs="+", choices=(*REAL, KNOWN), default=(*REAL, KNOWN))
    options = parser.parse_args()
    job = Job(options.cache, "1")
    enrolled: dict[str, list[Template]] = {}
    probes: list[tuple[str, str, Template]] = []
    for name in options.sets:
        for image, owner, impression in zip(*prints(name, job), strict=True):
            template = made(image, "template", job)
            if impression < ENROLLED:
                enrolled.setdefault(owner, []).append(template)
            else:
                probes.append((name, owner, template))
    outlines = [one for several in enrolled.values() for one in several if not one.empty]
    make_fields(options.work, IMPOSTORS, options.fields // 2)
    fields = load_fields(options.work, IMPOSTORS, options.fields // 2)
    fields = np.concatenate([fields, mirrored(fields)])
    drawn = impostor_codes(fields + (code_model().mean - fields.mean(axis=0)), outlines).astype(np.float32)
    gallery = {name: np.stack([code_of(one) for one in of if not one.empty]) for name, of in enrolled.items()}
    rows: list[tuple[str, str, float]] = []
    for name, owner, probe in probes:
        if probe.empty:
            rows.append((name, owner, 1.0))
            continue
        variants = probe_codes(probe, SearchSettings().variants_of(probe))
        mine = float((variants @ gallery[owner].T.astype(np.float32)).max())
        rows.append((name, owner, tail_probability((variants @ drawn.T).max(axis=0), mine)))
    facts: dict[str, Any] = {"distractors": len(drawn), "enrolled": ENROLLED, "sets": {}}
    for name in (*options.sets, "all"):
        part = [row for row in rows if name in ("all", row[0])]
        chances, owners = np.array([row[2] for row in part]), [row[1] for row in part]
        facts["sets"][name] = {str(size): hit_rates(chances, owners, size, RANKS) for size in SIZES}
        print(name, len(part), facts["sets"][name], flush=True)
    worst = sorted(((chance, owner) for _, owner, chance in rows), reverse=True)[:5]
    facts["worst"] = [f"{owner}: {chance:.1e} of impostors are before it" for chance, owner in worst]
    OUT.write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
