"""Searches through millions, on reconstructions: is the right finger among the best 500, and what does a key hide?

    python validation/match/shards.py recall --work FOLDER --store STORE [--fingers 10000000]
    python validation/match/shards.py prints|bits --work FOLDER --store STORE
    python validation/match/shards.py keys --work FOLDER --store STORE
    python validation/match/shards.py known --work FOLDER

write their parts of ``shards.json`` here. STORE is of ``splitknit batch``: reconstructions by ``metric``, of which the
first session is the gallery and the later ones are probes. The number of variants whose bits are compared was chosen on
true surfaces of the subjects S01 to S05; reported are the others (``--first 6``).

**Distractors** are not reconstructions: ten million cannot be made. 10,000 ridge fields are drawn
(``field_fingers.py``, seed 7400, half of them mirrored), seen through the outlines of reconstructions of S01 to S05,
and coded; a distractor is one of these codes, `NEAR` of it, and else a normal deviate of their covariance (a smoothed
bootstrap), so that they keep classes and correlations of the fields. Their similarities to probes are reported beside
those of the fields and of other fingers' reconstructions, to judge by. FOLDER keeps fields, distractors and shards
(5 GB of ten million) for the next run.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from code_tails import wilson
from codes import finger_of, impostor_codes, split
from field_fingers import load_fields, make_fields
from numpy.typing import NDArray
from pressed_prints import finger, press

from splitknit.io.prints import read_print_png
from splitknit.model import FloatArray
from splitknit_match.batch.store import Store
from splitknit_match.gallery.key import Key
from splitknit_match.gallery.shards import ROWS_A_SHARD, Shards, write_shards
from splitknit_match.matching.code import (
    COLUMNS,
    ROWS,
    SCALE,
    STEP_MM,
    ProbeSettings,
    code_model,
    code_of,
    code_size,
    probe_codes,
)
from splitknit_match.matching.renewable import BITS, RenewableCode
from splitknit_match.matching.ridge_band import print_band
from splitknit_match.matching.template import Template, make_template, unpack

RESULT = Path(__file__).with_name("shards.json")
FIELDS, NEAR = 7400, 0.9
KEY = Key(bytes(range(32)), raw=True)
RANKS = (1, 50, 500)
MORE = ProbeSettings(turn_deg=20.0, right_mm=4.0, down_mm=4.0)
"""For prints, whose uppermost skin is not the finger's; chosen on 16 simulated presses of other seeds (from 97,000)."""
DESIGNED_ON = 5
"""Subjects whose true surfaces choices were made on."""
CHUNK = 50_000
KNOWN_AMONG, PROBED, ALIKE = 10_000, 300, 0.25
"""Fingers in stolen shards, and of these linked; standard deviation of how far logarithms of eigenvalues are apart."""
BINS = 30


def reconstructions(store: Path) -> dict[str, Template]:
    """Templates of `metric`, by ``S01/session_1/right_index``; failures to acquire are left out, and counted."""
    table = Store(store).features("metric", ["capture", "template"]).to_pydict()
    found = zip(table["capture"], table["template"], strict=True)
    return {name: unpack(payload) for name, payload in found if payload}


def bases(work: Path, outlines: Sequence[Template], fields: int) -> NDArray[np.int8]:
    """(2 fields, K) codes of drawn fields."""
    make_fields(work, FIELDS, fields)
    return impostor_codes(load_fields(work, FIELDS, 2 * fields), list(outlines))


def distractors(base: NDArray[np.int8], count: int, work: Path) -> Path:
    """File of (count, K) codes like those of `base`, perhaps with others behind: the first of many are those of few."""
    file = work / f"distractors-{hashlib.sha256(np.ascontiguousarray(base).data).hexdigest()[:12]}-{count}.i8"
    if file.is_file():
        return file
    part = file.with_suffix(".part")
    many = np.memmap(part, np.int8, "w+", shape=(count, code_size()))
    directions = base / np.linalg.norm(base.astype(np.float32), axis=1, keepdims=True)
    mean = directions.mean(axis=0)
    root = np.linalg.cholesky(np.cov(directions.T) + 1e-9 * np.eye(code_size())).T.astype(np.float32)
    for start in range(0, count, CHUNK):
        rng = np.random.default_rng([FIELDS, start])
        drawn = rng.standard_normal((CHUNK, code_size()), dtype=np.float32) @ root
        near = directions[rng.integers(len(directions), size=CHUNK)]
        mixed = mean + NEAR * (near - mean) + np.sqrt(1 - NEAR**2) * drawn
        mixed *= SCALE / np.linalg.norm(mixed, axis=1, keepdims=True)
        many[start : start + CHUNK] = np.clip(np.rint(mixed), -127, 127)[: count - start]
    many.flush()
    part.rename(file)
    return file


def sharded(
    work: Path, base: NDArray[np.int8], size: int, own: NDArray[np.int8], key: Key
) -> tuple[Shards, NDArray[np.int64]]:
    """Shards of so many distractors and a gallery's codes, and the rows of these, in files of their own."""
    file = distractors(base, size, work)
    codes = np.memmap(file, np.int8, "r+", shape=(size + len(own), code_size()))
    codes[size:] = own
    mine = 100 * ROWS_A_SHARD + np.arange(len(own))
    folder = work / f"{file.stem}-{key.secret.hex()[-6:]}"
    write_shards(folder, np.concatenate([np.arange(size), mine]), codes, key)
    return Shards(folder, key), mine


def recall(work: Path, gallery: dict[str, Template], probes: dict[str, Template], *, sizes: Sequence[int],
           base: NDArray[np.int8], settings: ProbeSettings | None = None) -> dict[str, Any]:  # fmt: skip
    """How often the right finger is among the best of so many distractors and the gallery."""
    names = list(gallery)
    own = np.stack([code_of(gallery[name]) for name in names])
    owners = [finger_of(name) for name in probes]
    found: dict[str, Any] = {"probes": len(probes), "fingers": len(set(owners)), "gallery": len(names), "sizes": {}}
    for size in sizes:
        shards, mine = sharded(work, base, size, own, KEY)
        started = time.process_time()
        ranks = ranks_in(shards, probes, mine[[names.index(owner) for owner in owners]], settings)
        cpu_s = (time.process_time() - started) / max(1, len(probes))
        found["sizes"][str(size)] = {
            "within": {str(k): by_finger(np.array(ranks) <= k, owners) for k in RANKS},
            "missed": [name for name, rank in zip(probes, ranks, strict=True) if rank > max(RANKS)],
            "cpu_s_a_search": round(cpu_s, 4),
        }
        print(size, found["sizes"][str(size)], flush=True)
    few = list(probes.values())[:: max(1, len(probes) // 30)]
    other = np.concatenate([similarities(one, own[[names.index(n) for n in names if n != finger_of(name)]])
                            for name, one in list(probes.items())[:: max(1, len(probes) // 30)]])  # fmt: skip
    sample = np.fromfile(distractors(base, 20_000, work), np.int8).reshape(-1, code_size())[:20_000]
    kinds = {"distractors": np.concatenate([similarities(one, sample) for one in few]),
             "fields": np.concatenate([similarities(one, base) for one in few]), "others": other}  # fmt: skip
    found["similarity_quantiles_50_99_99.9"] = {
        kind: np.quantile(values, [0.5, 0.99, 0.999]).round(3).tolist() for kind, values in kinds.items()
    }
    return found


def ranks_in(
    shards: Shards, probes: dict[str, Template], rows: NDArray[np.int64], settings: ProbeSettings | None = None
) -> list[int]:
    """Rank of the right row of each probe; one more than is looked for where it is not found."""
    ranks = []
    for template, row in zip(probes.values(), rows.tolist(), strict=True):
        place = np.flatnonzero(shards.search(template, max(RANKS), settings).rows == row)
        ranks.append(int(place[0]) + 1 if len(place) else max(RANKS) + 1)
    return ranks


def similarities(probe: Template, codes: NDArray[np.int8]) -> FloatArray:
    """(N,) of the unkeyed codes."""
    return np.asarray((probe_codes(probe) @ codes.T.astype(np.float32)).max(axis=0))


def by_finger(hits: NDArray[np.bool_], owners: Sequence[str]) -> list[float]:
    """Fraction of the probes, and its interval of 95 %: a bootstrap by finger, or (of fractions of 1) Wilson's for as
    many trials as fingers."""
    fingers = sorted(set(owners))
    sums = np.array([[hits[[one == name for one in owners]].sum(), owners.count(name)] for name in fingers])
    if hits.all():
        low, high = wilson(len(fingers), len(fingers))
    else:
        chosen = np.random.default_rng(0).integers(len(fingers), size=(4000, len(fingers)))
        drawn = sums[chosen].sum(axis=1)
        low, high = np.quantile(drawn[:, 0] / drawn[:, 1], [0.025, 0.975])
    return [round(float(value), 4) for value in (hits.mean(), low, high)]


def flat_prints(fingers: int) -> dict[str, tuple[dict[str, Template], dict[str, Template]]]:
    """Galleries and probes of flat prints: simulated presses, and real ones (FVC2002 DB1_B), which served for no
    choice."""
    folder = Path(os.environ.get("SPLITKNIT_DATA", RESULT.parents[3] / "shared" / "data")) / "fvc2002_db1b"
    real = [(one.stem.split("_"), read_print_png(one).image) for one in sorted(folder.glob("*.png"))]
    files = {"simulated": [], "real": [(f"{who}/session_{number}/x", image) for (who, number), image in real]}
    for number in range(fingers):
        master = finger(95_000 + number)
        files["simulated"] += [(f"{number}/session_{k + 1}/x", press(master, k)) for k in range(4)]
    made = {kind: {name: make_template(print_band(image)) for name, image in images} for kind, images in files.items()}
    full = {kind: {name: one for name, one in some.items() if not one.empty} for kind, some in made.items()}
    return {kind: split(some) for kind, some in full.items() if some}


def prints(work: Path, base: NDArray[np.int8], size: int, fingers: int) -> dict[str, Any]:
    """The same on flat prints."""
    found = {}
    for kind, (gallery, probes) in flat_prints(fingers).items():
        found[kind] = recall(work, gallery, probes, sizes=[size], base=base)
        found[f"{kind}, more variants"] = recall(work, gallery, probes, sizes=[size], base=base, settings=MORE)
    return found


def learned_rotation(directions: FloatArray, seed: int, rounds: int = 50) -> FloatArray:
    """(K, K) whose signs lose least of centred `directions` (N, K).

    Gong and Lazebnik 2011, Iterative quantization: a Procrustean approach to learning binary codes.
    """
    start = np.random.default_rng(seed).standard_normal((directions.shape[1],) * 2)
    rotation = np.linalg.qr(start)[0].astype(np.float32)
    for _ in range(rounds):
        left, _, right = np.linalg.svd(np.sign(directions @ rotation).T @ directions)
        rotation = (left @ right).T
    return rotation


def bits(work: Path, base: NDArray[np.int8], sets: dict[str, tuple[dict[str, Template], dict[str, Template]]],
         size: int) -> dict[str, Any]:  # fmt: skip
    """Ranks by bits alone, of a key and learned on the drawn fields, beside those of the numbers they are made of."""
    directions = base / norm(base)[:, None]
    mean = directions.mean(axis=0).astype(np.float32)
    away = (directions - mean).astype(np.float32)
    learned = np.concatenate([learned_rotation(away, seed) for seed in range(3)], axis=1)[:, :BITS]
    keyed = RenewableCode(KEY.secret)
    found: dict[str, Any] = {}
    for kind, (gallery, probes) in sets.items():
        names, owners = list(gallery), [finger_of(name) for name in probes]
        file = distractors(base, size, work)
        codes = np.fromfile(file, np.int8).reshape(-1, code_size())[:size]
        codes = np.concatenate([codes, np.stack([code_of(gallery[name]) for name in names])])
        fine = (codes / norm(codes)[:, None]).astype(np.float32)
        stored = {"keyed": keyed.stored(codes)[0], "learned": np.packbits((fine - mean) @ learned > 0, axis=1)}
        for settings in (ProbeSettings(), MORE):
            ranks: dict[str, list[int]] = {}
            for owner, probe in zip(owners, probes.values(), strict=True):
                variants, row = probe_codes(probe, settings) * np.float32(SCALE), size + names.index(owner)
                best = np.max([(fine @ part.T).max(axis=1) for part in np.array_split(variants, 9)], axis=0)
                ranks.setdefault("numbers", []).append(rank_of(best, row))
                few = variants[settings.coarse()]
                seen = {"keyed": keyed.probe(few)[0], "learned": np.packbits((few - mean) @ learned > 0, axis=1)}
                for name, words in stored.items():
                    away_by = np.min([np.bitwise_count(one ^ words).sum(axis=1) for one in seen[name]], axis=0)
                    ranks.setdefault(name, []).append(rank_of(-away_by.astype(np.int64), row))
            found[f"{kind}, {settings.count} variants"] = {
                name: by_finger(np.array(some) <= max(RANKS), owners) for name, some in ranks.items()
            }
            print(kind, settings.count, found[f"{kind}, {settings.count} variants"], flush=True)
    return found


def d_sys(mated: NDArray[np.float64], others: NDArray[np.float64]) -> float:
    """Linkability of two systems, 0 to 1: of scores of one finger and of different ones across them.

    Gomez-Barrero et al. 2018, General framework to evaluate unlinkability in biometric template protection systems
    (ISO/IEC 30136), equal priors; histograms of `BINS` bins with as many scores in each.
    """
    edges = np.quantile(np.concatenate([mated, others]), np.linspace(0, 1, BINS + 1))
    edges = np.unique(edges)
    edges[0], edges[-1] = -np.inf, np.inf
    one, two = (np.histogram(scores, edges)[0] / len(scores) for scores in (mated, others))
    local = np.clip(2 * one / np.maximum(one + two, 1e-300) - 1, 0, None)
    return float((one * local).sum())


def keys(work: Path, gallery: dict[str, Template], probes: dict[str, Template], base: NDArray[np.int8], size: int,
         *, pairs: int) -> dict[str, Any]:  # fmt: skip
    """What a key costs, and what two files under two keys have in common."""
    names = list(gallery)
    own = np.stack([code_of(gallery[name]) for name in names])
    again = np.stack([code_of(template) for template in probes.values()])
    mine = np.array([names.index(finger_of(name)) for name in probes])
    owners = [finger_of(name) for name in probes]
    links: dict[str, Any] = {}
    for what, first, place in (("other capture", again, mine), ("same code", own, np.arange(len(own)))):
        kinds: dict[str, list[list[NDArray[np.float64]]]] = {}
        strange = (place + 1 + np.random.default_rng(1).integers(len(own) - 1, size=len(place))) % len(own)
        for pair in range(pairs):
            one, two = RenewableCode(b"one %d" % pair).stored(first), RenewableCode(b"two %d" % pair).stored(own)
            same_key = RenewableCode(b"one %d" % pair).stored(own)
            for name, other in (("two keys", two), ("one key", same_key)):
                for score, values in scores(one, other).items():
                    kinds.setdefault(f"{name}, {score}", [[], []])
                    for side, chosen in enumerate((place, strange)):
                        kinds[f"{name}, {score}"][side].append(values(chosen))
        pooled = np.concatenate([np.concatenate(side) for side in kinds["two keys, numbers"]])
        pooled = np.random.default_rng(2).permutation(pooled)
        links[what] = {
            name: round(d_sys(*(np.concatenate(side) for side in sides)), 4) for name, sides in kinds.items()
        }
        links[what]["chance"] = round(d_sys(*np.split(pooled, 2)), 4)  # of a system that links nothing
        links[what]["scores"] = pairs * len(place)
    plain_codes = np.fromfile(distractors(base, size, work), np.int8).reshape(-1, code_size())[:size]
    found = [similarities(one, np.concatenate([own, plain_codes])) for one in probes.values()]
    plain = [rank_of(values, row) for values, row in zip(found, mine.tolist(), strict=True)]
    keyed = []
    for number in range(3):
        shards, rows = sharded(work, base, size, own, Key(bytes([number] * 32), raw=True))
        keyed.append(ranks_in(shards, probes, rows[mine]))
    return {
        "d_sys": links, "fingers": len(set(owners)), "probes": len(probes), "distractors": size,
        "plain_within": {str(k): by_finger(np.array(plain) <= k, owners) for k in RANKS},
        "keyed_within": [{str(k): by_finger(np.array(ranks) <= k, owners) for k in RANKS} for ranks in keyed],
    }  # fmt: skip


def known(work: Path, fields: int, draws: int) -> dict[str, Any]:
    """How many fingers a thief of shards links who knows the codes of k of them, and no key.

    The thief estimates the orthogonal matrix: of the k pairs alone (Procrustes), or with what is known of all fingers
    as well, as anyone can simulate a population. Its covariance and that of the stolen codes have the same eigenvalues,
    so that only coordinates of similar eigenvalues can belong together. Then a code (the very one in the shards, or of
    another capture) is compared with all that were stolen, of fingers that the thief does not know.

    The fingers are drawn ridge fields: the first 10,000 are in the shards, the others are the thief's population.
    Captures are seen through drawn outlines; another capture has another outline, and half the model's noise.
    """
    make_fields(work, FIELDS, fields)
    complete = load_fields(work, FIELDS, fields)
    inside = complete[:KNOWN_AMONG]
    rng = np.random.default_rng(FIELDS)
    noise = rng.normal(0, 0.5, inside.shape).astype(np.float32) * np.sqrt(code_model().noise)
    own, again, others = (unit(seen(part, rng)) for part in (inside, inside + noise, complete[KNOWN_AMONG:]))
    fine = unit(RenewableCode(KEY.secret).stored(np.clip(np.rint(own * SCALE), -127, 127).astype(np.int8))[1])
    (values_c, axes_c), (values_f, axes_f) = (np.linalg.eigh(np.cov(part.T)) for part in (others, fine))
    apart = np.log(values_f)[:, None] - np.log(values_c)[None]
    weight = np.exp(-(apart**2) / (2 * ALIKE**2)) / np.sqrt(np.outer(values_f, values_c))
    found: dict[str, Any] = {
        "fingers": len(own),
        "population": len(others),
        "draws": draws,
        "probes": PROBED,
        "first": {},
    }
    # who knows no finger: one axis for each eigenvalue, signs by the third moments
    skew = [
        np.mean(part**3, axis=0)
        for part in ((fine - fine.mean(axis=0)) @ axes_f, (others - others.mean(axis=0)) @ axes_c)
    ]
    turned_fine = (fine - fine.mean(axis=0)) @ (axes_f * np.sign(skew[0] * skew[1]))
    for kind, probes in (("same code", own), ("other capture", again)):
        probed = rng.choice(len(own), draws * PROBED, replace=False)
        products = (probes[probed] - others.mean(axis=0)) @ axes_c @ turned_fine.T
        ranks = 1 + (products > products[np.arange(len(probed)), probed][:, None]).sum(axis=1)
        found[f"none known, {kind}"] = {str(k): round(float((ranks <= k).mean()), 4) for k in (1, 100)}
        print(kind, found[f"none known, {kind}"], flush=True)
    for count in (3, 5, 10, 20, 30, 50, 100, 192):
        hits: dict[str, list[float]] = {}
        for _ in range(draws):
            mine, probed = np.split(rng.choice(len(own), count + PROBED, replace=False), [count])
            pairs = fine[mine].T @ own[mine]
            left, _, right = np.linalg.svd(pairs)
            ways = {"pairs alone": left[:, :count] @ right[:count]}
            turned = (fine[mine] - fine.mean(axis=0)) @ axes_f, (own[mine] - others.mean(axis=0)) @ axes_c
            left, _, right = np.linalg.svd(weight * (turned[0].T @ turned[1]))
            ways["with a population"] = axes_f @ left @ right @ axes_c.T
            for way, matrix in ways.items():
                for kind, probes in (("same code", own), ("other capture", again)):
                    products = probes[probed] @ matrix.T @ fine.T
                    products[:, mine] = -1.0
                    right_one = products[np.arange(PROBED), probed]
                    hits.setdefault(f"{way}, {kind}", []).append(float((products.max(axis=1) <= right_one).mean()))
        found["first"][str(count)] = {name: round(float(np.mean(values)), 3) for name, values in hits.items()}
        print(count, found["first"][str(count)], flush=True)
    return found


def seen(fields: FloatArray, rng: np.random.Generator) -> NDArray[np.int8]:
    """(N, K) codes of complete fields through outlines that are drawn: a round tip, and sides and an end that vary."""
    right = np.tile(np.arange(COLUMNS) - (COLUMNS - 1) / 2, ROWS) * STEP_MM
    down = np.repeat(1.0 + np.arange(ROWS), COLUMNS) * STEP_MM
    found = []
    for start in range(0, len(fields), 250):
        part = fields[start : start + 250]
        half, end, middle = (rng.normal(mean, sd, (len(part), 1)) for mean, sd in ((7.5, 0.7), (17, 2), (0, 1)))
        round_tip = ((right - middle) / half) ** 2 + np.clip((6 - down) / 6, 0, None) ** 2 < 1
        z = code_model().latent(part, (round_tip & (down < end)).astype(np.float32))
        found.append(SCALE * z / np.linalg.norm(z, axis=1, keepdims=True))
    return np.asarray(np.clip(np.rint(np.concatenate(found)), -127, 127), dtype=np.int8)


def unit(codes: NDArray[np.int8]) -> NDArray[np.float64]:
    """(N, K) of length one."""
    return codes / norm(codes)[:, None]


def scores(one: Any, two: Any) -> dict[str, Any]:
    """By which somebody might link files: functions of the places in the second, one for each row of the first."""
    bits, fine = (np.unpackbits(one[0], axis=1), one[1].astype(np.float64)), (np.unpackbits(two[0], axis=1), two[1])
    return {
        "bits": lambda at: (bits[0] != fine[0][at]).sum(axis=1) + np.random.default_rng(0).uniform(0, 1, len(at)),
        "numbers": lambda at: np.einsum("nk,nk->n", bits[1], fine[1][at].astype(np.float64)),
        "lengths": lambda at: np.abs(norm(bits[1]) - norm(fine[1][at])),
        "sorted numbers": lambda at: norm(np.sort(bits[1], axis=1) - np.sort(fine[1][at].astype(np.float64), axis=1)),
    }


def norm(values: NDArray[Any]) -> NDArray[np.float64]:
    """(N,) lengths."""
    return np.asarray(np.linalg.norm(values.astype(np.float64), axis=1))


def rank_of(values: NDArray[Any], row: int) -> int:
    """Rank of the right one by its value, the highest first."""
    return 1 + int((values > values[row]).sum())


def main(arguments: Sequence[str] | None = None) -> None:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("recall", "prints", "keys", "known", "bits"))
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--store", type=Path, default=None, help="for all but `known`")
    parser.add_argument("--first", type=int, default=DESIGNED_ON + 1, help="subject that is reported (default: 6)")
    parser.add_argument("--fields", type=int, default=5000, help="drawn, behind the distractors")
    parser.add_argument("--fingers", type=int, default=100_000, help="distractors, at most")
    parser.add_argument("--pairs", type=int, default=100, help="of keys")
    parser.add_argument("--out", type=Path, default=RESULT)
    options = parser.parse_args(arguments)
    cv2.setNumThreads(1)
    options.work.mkdir(parents=True, exist_ok=True)
    if options.what == "known":
        write(options.out, {"known": known(options.work, 14_000, draws=5)})
        return
    templates = reconstructions(options.store)
    gallery, probes = split(templates)
    outlines = [one for name, one in gallery.items() if int(name[1:3]) <= DESIGNED_ON]
    probes = {name: one for name, one in probes.items() if int(name[1:3]) >= options.first}
    base = bases(options.work, outlines, options.fields)
    if options.what == "recall":
        sizes = [size for size in (10_000, 100_000, 1_000_000, 10_000_000) if size <= options.fingers]
        found = recall(options.work, gallery, probes, sizes=sizes or [options.fingers], base=base)
    elif options.what == "prints":
        found = prints(options.work, base, options.fingers, fingers=24)
    elif options.what == "bits":
        found = bits(options.work, base, flat_prints(24), options.fingers)
    else:
        found = keys(options.work, gallery, probes, base, options.fingers, pairs=options.pairs)
    write(options.out, {options.what: found})


def write(file: Path, found: dict[str, Any]) -> None:
    """Put a part into the results."""
    earlier = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}
    file.write_text(json.dumps(earlier | found, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
