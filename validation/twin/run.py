"""The fast twin against the reference: random walks in the volume below the skin's true ridges.

    python validation/twin/run.py            # about ten minutes of one core; a run that was stopped goes on
    python validation/twin/run.py --smoke    # one small case of each kind, into validation/out; two minutes at most

Needs the group ``reference`` and libllvm19. Every case lands in ``validation/out/twin`` under a hash of the sources it
depends on; ``results.json`` holds all of them and the ranges that follow.
``docs/experiments/simulator-reference.md`` reads them.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))

from measure import Ridges, compare_finger, compare_glare, compare_ridges
from ranges import ranges_of

import splitknit_simulator
from splitknit.errors import BadInput

HERE = Path(__file__).resolve().parent
OUT = HERE.parent / "out" / "twin"
CHANNELS = ("blue", "green", "red", "nir")
ROUGHNESSES = (0.18, 0.25, 0.35)


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="The fast twin against the reference.")
    parser.add_argument("--smoke", action="store_true", help="one small case of each kind")
    parser.add_argument("--last-first", action="store_true", help="the other way round: a second process beside one")
    parser.add_argument("--only-collect", action="store_true", help="write results.json from the cases done so far")
    parser.add_argument("--code", help="with --only-collect: first 12 digits of the hash of the code that measured")
    parser.add_argument("--out", type=Path, help="where the results go; validation/twin/results.json by default")
    options = parser.parse_args(arguments)
    out = options.out or (OUT / "smoke.json" if options.smoke else HERE / "results.json")
    code = options.code or source_hash()
    folder = OUT / code[:12]
    folder.mkdir(parents=True, exist_ok=True)
    results: dict[str, list[dict[str, Any]]] = {}
    try:
        work_list = list(smoke() if options.smoke else cases())
        for kind, name, work in reversed(work_list) if options.last_first else work_list:
            path = folder / f"{kind}-{name}.json"
            if not path.exists():
                if options.only_collect:
                    continue
                print(kind, name, flush=True)
                partial = path.with_suffix(".part")
                partial.write_text(json.dumps(work(), indent=1))
                partial.replace(path)
            results.setdefault(kind, []).append(json.loads(path.read_text()))
    except BadInput as error:
        print(error, file=sys.stderr)
        return 2
    finished: dict[str, Any] = {"source_sha256": code, **results}
    if not options.smoke:
        finished["ranges"] = ranges_of(results.get("ridges", []))
    out.write_text(json.dumps(_rounded(finished), indent=1) + "\n")
    print(f"wrote {out}")
    return 0


def cases() -> Iterator[tuple[str, str, Callable[[], Any]]]:
    """Kind, name and work of every case; those that matter most come first."""
    ridges = list(ridge_cases())
    yield from (_ridges(case) for case in ridges[:7])
    for depth_um in (75.0, 40.0):
        for roughness in ROUGHNESSES:
            work = lambda d=depth_um, r=roughness: compare_glare(d, r)  # noqa: E731
            yield "glare", f"{depth_um:g}um-{roughness:g}", work
    for boundary, channels in (("diffuse", CHANNELS), ("smooth", CHANNELS[:1])):
        for channel in channels:
            chosen = [(channel, 64 if boundary == "diffuse" else 32)]
            yield "finger", f"{boundary}-{channel}", lambda c=chosen, b=boundary: compare_finger(c, b)[0]
    yield from (_ridges(case) for case in ridges[7:])


def ridge_cases() -> Iterator[Ridges]:
    """Channels at 75 um, then other depths, other scattering, other prints; smooth boundaries cost most."""
    for boundary, channels, samples in (
        ("diffuse", CHANNELS, (128, 256, 256, 256)),
        ("smooth", CHANNELS[:3], (128,) * 3),
    ):
        for channel, count in zip(channels, samples, strict=True):
            yield Ridges(boundary, channel, samples=count)
    changes: tuple[dict[str, float], ...] = (
        {"depth_um": 40.0}, {"depth_um": 90.0}, {"factor": 0.5}, {"factor": 2.0}, {"factor": 0.7}, {"factor": 1.4},
        {"depth_um": 60.0},
    )  # fmt: skip
    for channels in (CHANNELS[:2], CHANNELS[2:]):
        for change in changes:
            for channel in channels:
                yield Ridges("diffuse", channel, samples=128, **change)
                if channel in CHANNELS[:2]:
                    yield Ridges("smooth", channel, samples=64, **change)
    for seed in (6, 7):
        for boundary, samples in (("diffuse", 128), ("smooth", 64)):
            yield Ridges(boundary, "blue", print_seed=seed, samples=samples)
    yield Ridges("smooth", "nir", samples=64)


def _ridges(case: Ridges) -> tuple[str, str, Callable[[], Any]]:
    return "ridges", case.name(), lambda: compare_ridges(case)


def smoke() -> Iterator[tuple[str, str, Callable[[], Any]]]:
    """One small case of each kind."""
    for boundary in ("diffuse", "smooth"):
        case = Ridges(boundary, "blue", samples=8)
        yield "ridges", "smoke-" + boundary, lambda case=case: compare_ridges(case, crop_px=32)
    yield "glare", "smoke", lambda: compare_glare(75.0, 0.25, samples=16, crop_px=32)


def source_hash() -> str:
    """Hash of the twin's sources and of the scripts beside this one that measure."""
    digest = hashlib.sha256()
    package = Path(splitknit_simulator.__file__).parent
    names = ("renderer", "lighting", "skin", "master_print", "ridges", "finger", "shape")
    files = [path for path in sorted(package.rglob("*.py")) if path.stem.startswith(names)]
    own = ("compare", "measure", "patches", "reference", "reference_scene")
    for path in (*files, *(HERE / f"{name}.py" for name in own)):
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def _rounded(value: Any) -> Any:
    """Six significant digits are enough, and make the file readable."""
    if isinstance(value, float):
        return float(f"{value:.5g}")
    if isinstance(value, dict):
        return {key: _rounded(one) for key, one in value.items()}
    return [_rounded(one) for one in value] if isinstance(value, list) else value


if __name__ == "__main__":
    sys.exit(main())
