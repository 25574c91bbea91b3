"""The benchmark ``whole-1``: simulated fingers that anybody can make again, pairs, and score files.

    python validation/thesis/benchmark.py --out DIR                 # small: ten minutes of a core
    python validation/thesis/benchmark.py --out DIR --size whole    # a night of two cores
    splitknit evaluate --scores DIR/store/csv/*.csv my_scores.csv --out report

``DIR/people`` holds the captures, ``DIR/prints`` the prints by `metric`, ``DIR/pairs.csv`` what is
compared, with no score yet, and ``DIR/store/csv`` the score files of the first systems.
BENCHMARK.md is the card: the protocol, what is simulated, and what it does not prove.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import shlex
import subprocess
import sys
import tarfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from report import read
from splitknit.io.capture import read_capture
from splitknit.io.provenance import json_text
from splitknit_match.batch.store import Store, write_table
from splitknit_simulator.accuracy import read_truth
from tables import Row, write_csv

HERE = Path(__file__).resolve().parent
SEED = 4171
SIZES = {
    "small": "--subjects 3 --sessions 2"
    " --fingers right_thumb,right_index,right_middle,right_ring,right_little",
    "whole": "--subjects 17 --sessions 4",
}
POPULATION = (
    f"simulate population --seed {SEED} --scale 0.25"
    " --set sessions.partial_share=0 --set sessions.roll_sd_deg=2"
)
SYSTEMS = (
    f"batch --cases snk,pr,ea,ea-split,metric --matchers thesis,ridge,minutiae --impostors 1"
    f" --seed {SEED}"
)
FACTS = HERE / "tables" / "benchmark_small.csv"
TOLERANCE = 1e-3
"""Of a capture's facts, relative: other machines round otherwise, other seeds differ by tenths."""
KEPT = ("capture", "subject", "finger", "session", "acquired", "failure", "area_mm2")
"""Columns of a store's captures that rates follow from."""


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--size", choices=SIZES, default="small")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--freeze", action="store_true", help="write the facts of the captures")
    parser.add_argument(
        "--pack",
        nargs=2,
        type=Path,
        metavar=("POPULATION", "STORE"),
        help="make nothing: what these folders' rates follow from as the file --out",
    )
    options = parser.parse_args(arguments)
    if options.pack:
        pack(options.pack[0], Store(options.pack[1]), options.out)
        return 0
    people, store = options.out / "people", options.out / "store"
    for verb in (
        f"{POPULATION} {SIZES[options.size]} --workers {options.jobs} --out",
        f"{SYSTEMS} --jobs {options.jobs} {shlex.quote(str(people))} --out",
    ):
        place = people if verb.startswith("simulate") else store
        command = [sys.executable, "-m", "splitknit", *shlex.split(verb), str(place)]
        subprocess.run(command, check=True)
    facts = [facts_of(people, name) for name in names_of(people)]
    if options.freeze:
        write_csv(FACTS, facts)
    known = {row["capture"]: row for row in read(FACTS)}
    differing = differing_from(known, facts)
    frozen = len({row["capture"] for row in facts} & set(known))
    print(f"{len(facts)} captures, {frozen} of them frozen; {len(differing)} of these differ.")
    print("\n".join(differing))
    write_prints(Store(store), options.out / "prints")
    write_pairs(store / "csv" / "metric_ridge.csv", options.out / "pairs.csv")
    pack(people, Store(store), options.out / "scores.tar.xz")
    return int(bool(differing))


def names_of(people: Path) -> list[str]:
    """Captures of a population, ``S01/session_1/right_index``."""
    files = people.glob("*/session_*/*/impression.json")
    return sorted(file.parent.relative_to(people).as_posix() for file in files)


def facts_of(people: Path, name: str) -> Row:
    """What tells one capture from another whatever the machine."""
    capture = read_capture(people / name)
    height = read_truth(capture)["height_mm"]
    facts: Row = {"capture": name, "rig": hashlib.sha256(rig_text(people / name)).hexdigest()[:16]}
    facts |= {"height_mm": float(np.nanmean(height)), "height_sd_mm": float(np.nanstd(height))}
    return facts | {
        band: float(capture.bands[band].pixels.mean(dtype=np.float64)) for band in ("white", "nir")
    }


def rig_text(folder: Path) -> bytes:
    """A capture's rig as canonical text, numbers to nine digits."""
    document = json.loads((folder / "rig.json").read_text(encoding="utf-8"))
    rounded = json.loads(json.dumps(document), parse_float=lambda text: f"{float(text):.9g}")
    return json_text({key: rounded[key] for key in ("camera", "leds")}).encode()


def differing_from(known: Mapping[str, Row], facts: Sequence[Row]) -> list[str]:
    """Captures that are known and have other facts."""
    return [
        row["capture"]
        for row in facts
        if (first := known.get(row["capture"]))
        and (
            row["rig"] != first["rig"]
            or any(
                abs(row[key] - float(first[key])) > TOLERANCE * abs(float(first[key]))
                for key in ("height_mm", "height_sd_mm", "white", "nir")
            )
        )
    ]


def write_prints(store: Store, out: Path) -> None:
    """Prints of `metric` at 500 pixels an inch as PNG files, named as captures with ``_``."""
    out.mkdir(exist_ok=True)
    for name, place in store.places("features", "metric").items():
        (out / f"{name.replace('/', '_')}.png").write_bytes(place.value("print"))


def write_pairs(scores: Path, out: Path) -> None:
    """The comparisons of a score file without their scores, with the captures' names."""
    rows = []
    for row in read(scores):
        names = {
            side: row[f"finger_{side}"].replace("/", f"/session_{row[f'session_{side}']}/")
            for side in ("a", "b")
        }
        ids = {name: row[name] for name in row if name.startswith(("finger", "subject", "session"))}
        rows.append({"label": row["label"], "score": None, **names, **ids})
    write_csv(out, rows)


def pack(people: Path, store: Store, out: Path) -> None:
    """What every rate follows from as one file: ``run.py`` takes the folders that it unpacks to."""
    with tarfile.open(out, "w:xz") as archive:
        for file in [people / "population.json", *sorted(people.rglob("impression.json"))]:
            archive.add(file, Path("people") / file.relative_to(people))
        scores = sorted((store.folder / "scores").rglob("*.npz"))
        for file in [store.folder / "store.json", *scores]:
            archive.add(file, Path("store") / file.relative_to(store.folder))
        for case in sorted(path.name for path in (store.folder / "features").iterdir()):
            table = store.features(case, list(KEPT))
            rows = [dict(zip(table, row, strict=True)) for row in zip(*table.values(), strict=True)]
            file = out.with_name("features.npz")
            write_table(file, rows, {"case": case})
            archive.add(file, f"store/features/{case}/all.npz")
            file.unlink()


if __name__ == "__main__":
    sys.exit(main())
