"""Codes for 1:N search: learn them, and measure how often a search finds the right finger.

    python validation/match/codes.py learn --work FOLDER
    python validation/match/codes.py test --work FOLDER --population POPULATION
    python validation/match/codes.py stages --work FOLDER --population POPULATION

`learn` writes ``packages/splitknit-match/src/splitknit_match/matching/code_model.npz`` and its card
``code_model.json``; `test` (codes alone, and what follows for larger galleries) and `stages` (the whole search) write
their parts of ``codes.json`` here. FOLDER keeps simulated fingers, made where they are not there yet (half an hour of
one core). Seeds: 7001 for outlines and for choices, 7100 and 7300 to learn, 7400 for impostors, the population's own
(680) to test: its true surfaces, the first 20 mm of each finger; the first session is the gallery, the later ones are
probes.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from code_fingers import load, make
from code_learning import factor_model, offset, within
from code_tails import hit_rates, tail_probability, wilson
from field_fingers import load_fields, make_fields
from flat_fingers import load_flat, make_flat
from numpy.typing import NDArray

from splitknit.finger.orientation import find_upright
from splitknit.io.atomic import atomic_file
from splitknit.io.npz import read_npz
from splitknit.model import FloatArray, Surface
from splitknit_match.matching.code import (
    CODE_VERSION,
    SCALE,
    FactorModel,
    code_field,
    code_model,
    code_of,
    probe_codes,
    sampled,
)
from splitknit_match.matching.ridge import Prepared, ridge_match
from splitknit_match.matching.search import SearchSettings, glance, nearest_codes
from splitknit_match.matching.surface import MatchingSettings, surface_template
from splitknit_match.matching.template import Template, pack, unpack

MODEL = (
    Path(__file__).resolve().parents[2]
    / "packages"
    / "splitknit-match"
    / "src"
    / "splitknit_match"
    / "matching"
    / "code_model.npz"
)
RESULT = Path(__file__).with_name("codes.json")
OUTLINES, FLAT, FIELDS, IMPOSTORS = 7001, 7100, 7300, 7400
SIZE, TEMPER = 192, 4.0
PHALANGE_MM = 20.0
RANKS = (1, 5, 10, 20, 50, 100)
FINALISTS = 3


def learn(work: Path) -> None:
    """Learn the model and write it with its card."""
    make(work, OUTLINES, 100, 3)
    make_flat(work, FLAT, 1000, 2, [template.valid for template in load(work, OUTLINES, 50)[0]])
    make_fields(work, FIELDS, 4000)
    noise = within(load_flat(work, FLAT, 300)[0], np.random.default_rng(0))
    complete = load_fields(work, FIELDS, 4000)
    plain = factor_model(complete, noise, SIZE, TEMPER)
    model = FactorModel(plain.mean + offset(load(work, OUTLINES, 100)[0], complete), plain.loading, plain.noise)
    np.savez_compressed(
        MODEL,
        version=np.array(CODE_VERSION),
        mean=model.mean,
        loading=model.loading.astype(np.float16),
        noise=model.noise,
    )
    card = {
        "what": "factor model of ridge fields behind the codes of 1:N search (splitknit_match.matching.code)",
        "command": "python validation/match/codes.py learn --work FOLDER",
        "code_version": CODE_VERSION,
        "latent_numbers": SIZE,
        "learned_on": "simulated fingers only; no person's",
        "fields": {"seed": FIELDS, "fingers": 4000, "mirrored": True},
        "mean": {"seed": OUTLINES, "fingers": 100, "impressions": 3},
        "noise": {"seed": FLAT, "fingers": 300, "impressions": 2, "temper": TEMPER},
        "chosen_on": {"seed": OUTLINES, "fingers": 100, "impressions": 3},
    }
    MODEL.with_suffix(".json").write_text(json.dumps(card, indent=1) + "\n", encoding="utf-8")


def population(folder: Path, work: Path, subjects: int) -> dict[str, Template]:
    """Templates of the true surfaces of the captures of the first subjects, by ``S01/session_1/right_index``."""
    cache = work / f"{folder.name}.npz"
    known: dict[str, NDArray[np.uint8]] = {}
    if cache.is_file():
        with np.load(cache) as arrays:
            known = {name: arrays[name] for name in arrays.files}
    before = len(known)
    for file in sorted(folder.glob("S*/session_*/[rl]*/truth.npz")):
        name = "/".join(file.parts[-4:-1])
        if name in known or int(name[1:3]) > subjects:
            continue
        camera = json.loads((file.parent / "rig.json").read_text(encoding="utf-8"))["camera"]
        arrays = read_npz(file)
        mask = arrays["mask"].copy()
        mask[int(np.argmax(mask.any(axis=1))) + round(PHALANGE_MM * camera["px_per_mm"]) :] = False
        upright = find_upright(mask)
        surface = Surface(
            arrays["height_mm"] - arrays["shape_mm"], arrays["shape_mm"], np.zeros((*mask.shape, 3), np.float32), mask,
            1.0 / camera["px_per_mm"], upright.input_from_upright, upright.size,
        )  # fmt: skip
        known[name] = np.frombuffer(pack(surface_template(surface, MatchingSettings())), dtype=np.uint8)
    if len(known) > before:
        with atomic_file(cache) as part:
            np.savez(part, **known)
    return {name: unpack(known[name].tobytes()) for name in sorted(known) if int(name[1:3]) <= subjects}


def finger_of(name: str) -> str:
    """``S01/right_index``."""
    subject, _, finger = name.split("/")
    return f"{subject}/{finger}"


def split(templates: dict[str, Template]) -> tuple[dict[str, Template], dict[str, Template]]:
    """Gallery by finger (first session) and probes by capture (later sessions, fingers of the gallery)."""
    gallery = {finger_of(name): template for name, template in templates.items() if "/session_1/" in name}
    probes = {
        name: template
        for name, template in templates.items()
        if "/session_1/" not in name and finger_of(name) in gallery
    }
    return gallery, probes


def impostor_codes(channels: FloatArray, outlines: list[Template]) -> NDArray[np.int8]:
    """(N, K) codes of complete fields, each seen through one of the outlines in turn."""
    still = np.zeros(1)
    weights = np.concatenate([sampled(code_field(template), still, still, still)[1] for template in outlines])
    found = []
    for start in range(0, len(channels), 250):
        part = channels[start : start + 250]
        z = code_model().latent(part, weights[(start + np.arange(len(part))) % len(weights)])
        found.append(SCALE * z / np.linalg.norm(z, axis=1, keepdims=True))
    return np.asarray(np.clip(np.rint(np.concatenate(found)), -127, 127), dtype=np.int8)


def test(work: Path, folder: Path, subjects: int) -> dict[str, Any]:
    """Codes alone: hits among all that were simulated, and what follows for larger galleries."""
    make_fields(work, IMPOSTORS, 5000)
    gallery, probes = split(population(folder, work, subjects))
    outlines = [template for template in load(work, OUTLINES, 100)[0][::3] if not template.empty]
    names = list(gallery)
    own = np.stack([code_of(gallery[name]) for name in names])
    grown = [laid.template for laid in load_flat(work, FLAT, 1000)[0][600:1200:2]]
    # fields as drawn differ from those of surfaces, on average: impostors are to be like surfaces
    difference = offset(load(work, OUTLINES, 100)[0], load_fields(work, FIELDS, 4000))
    impostors = {
        "fields": impostor_codes(load_fields(work, IMPOSTORS, 10_000) + difference, outlines),
        "grown": np.stack([code_of(template) for template in grown]),
        "surfaces": np.stack([code_of(template) for template in outlines]),
    }
    seen: dict[str, list[NDArray[np.float32]]] = {"population": [], **{kind: [] for kind in impostors}}
    chances, owners, ranks, failed = [], [], [], []
    for name, template in probes.items():
        if template.empty:
            failed.append(name)
            continue
        variants = probe_codes(template)
        mine = names.index(finger_of(name))
        scores = (variants @ own.T.astype(np.float32)).max(axis=0)
        others = np.delete(scores, mine)
        far = {kind: (variants @ codes.T.astype(np.float32)).max(axis=0) for kind, codes in impostors.items()}
        for kind, values in (far | {"population": others}).items():
            seen[kind].append(values)
        everyone = np.concatenate([others, far["fields"]])
        chances.append(tail_probability(everyone, float(scores[mine])))
        ranks.append(1 + int((everyone >= scores[mine]).sum()))
        owners.append(finger_of(name))
        if ranks[-1] > 10:
            failed.append(
                f"{name}: rank {ranks[-1]}, {template.area_mm2:.0f} mm² against {gallery[owners[-1]].area_mm2:.0f}"
            )
    size = len(names) + len(impostors["fields"])
    counted = {str(k): rate(np.array(ranks) <= k) for k in RANKS}
    return {
        "probes": len(ranks), "fingers": len(set(owners)), "gallery": size,
        "strangers_of": {kind: len(codes) for kind, codes in impostors.items()},
        "hit_within_rank": counted,
        "expected_within_rank": {
            str(n): hit_rates(np.array(chances), owners, n, RANKS) for n in (size, 10_000, 100_000, 1_000_000)
        },
        "worst": failed,
        "impostor_quantiles_50_99_99.9": {
            kind: np.quantile(np.concatenate(values), [0.5, 0.99, 0.999]).round(3).tolist()
            for kind, values in seen.items()
        },
    }  # fmt: skip


def stages(work: Path, folder: Path, subjects: int, share: int) -> dict[str, Any]:
    """The whole search, in a gallery of templates: the population's, other surfaces, and ridges grown flat."""
    gallery, probes = split(population(folder, work, subjects))
    everyone = dict(gallery)
    everyone |= {f"surface {n}": t for n, t in enumerate(load(work, OUTLINES, 100)[0][::3])}
    everyone |= {f"grown {n}": laid.template for n, laid in enumerate(load_flat(work, FLAT, 1000)[0][::2])}
    names, codes = list(everyone), np.stack([code_of(template) for template in everyone.values()])
    prepared = {name: Prepared(template) for name, template in everyone.items()}
    first, by_code, missed = [], [], []
    settings = SearchSettings()
    for name in list(probes)[::share]:
        if probes[name].empty:
            continue
        variants, probe = probe_codes(probes[name]), Prepared(probes[name])
        best = [names[place] for place in nearest_codes(codes, variants, settings.candidates)[0]]
        laid = {one: int(np.argmax(variants @ codes[names.index(one)].astype(np.float32))) for one in best}
        finalists = sorted(best, key=lambda one: -glance(probe, prepared[one], settings.probe, laid[one]))[:FINALISTS]
        score, found = max((ridge_match(probe, prepared[one]).similarity, one) for one in finalists)
        by_code.append(finger_of(name) in best)
        first.append(found == finger_of(name))
        if not first[-1]:
            missed.append(f"{name}: in the codes' best {by_code[-1]}, found {found} {score:.2f}")
    return {
        "gallery": len(everyone), "probes": len(first), "candidates": settings.candidates,
        "finalists": FINALISTS, "codes_hit": rate(np.array(by_code)), "rank_1": rate(np.array(first)),
        "missed": missed,
    }  # fmt: skip


def rate(hits: NDArray[np.bool_]) -> list[float]:
    """Fraction, and its interval of 95 % (Wilson)."""
    low, high = wilson(int(hits.sum()), len(hits))
    return [round(float(value), 4) for value in (hits.mean(), low, high)]


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("learn", "test", "stages"))
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--population", type=Path)
    parser.add_argument("--subjects", type=int, default=17, help="of the population")
    parser.add_argument("--share", type=int, default=1, help="stages: every so manieth probe")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    if options.what == "learn":
        learn(options.work)
        return
    if options.population is None:
        parser.error("name the folder of the population with --population")
    if options.what == "test":
        found = test(options.work, options.population, options.subjects)
    else:
        found = stages(options.work, options.population, options.subjects, options.share)
    known = json.loads(RESULT.read_text(encoding="utf-8")) if RESULT.is_file() else {}
    RESULT.write_text(json.dumps(known | {options.what: found}, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    print(json.dumps(found, indent=1, ensure_ascii=False))


if __name__ == "__main__":
    main()
