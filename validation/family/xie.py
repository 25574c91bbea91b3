"""Does a two-layer model of skin give better normals than Lambert's? Xie's case on the twin, on itself, on photographs.

    python validation/family/xie.py            # some five minutes of one core; xie.json
    python validation/family/xie.py --smoke    # one tiny finger, to validation/out/family
    python validation/family/xie_report.py     # its tables, validation/family/tables/xie_*.csv

Fingers of the twin, skins drawn from its ranges, photographed with glare and again without, in the true
mask. The model's settings were chosen on fingers of other seeds (``trials`` of the results). One JSON a finger lands in
``validation/out/family`` under a hash of the code, so that a run that was stopped goes on where it was.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))

import numpy as np
from numpy.typing import NDArray
from xie_itself import on_itself
from xie_photographs import on_photographs
from xie_ways import Scene, error_deg, figures, trials, ways

import splitknit
from splitknit.imaging.band import linear_channels
from splitknit.model import Capture
from splitknit.photometric.hanrahan_krueger import hanrahan_krueger
from splitknit.photometric.lambertian import lambertian
from splitknit_simulator.light.skin import SkinRanges
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.twin import simulate_capture

Array = NDArray[Any]
HERE = Path(__file__).resolve().parent
OUT = HERE.parent / "out" / "family"
CHANNELS = ("grey", "red", "green", "blue")
PLAIN = ("lambertian", "layers")
ALL = ("fresnel", "layers free", "lambertian robust", "layers robust", "lambertian near", "layers near")
GLARE = {"glare": SkinRanges(), "no glare": SkinRanges(glare=(0.0, 0.0))}
MARGIN_PX = 4


def source_hash() -> str:
    """SHA-256 of the code that is compared (what the twin shows is held by tests of its own)."""
    package = Path(splitknit.__file__).parent
    folders = ("photometric", "integration")
    files = [file for folder in folders for file in sorted((package / folder).rglob("*.py"))]
    digest = hashlib.sha256()
    own = [HERE / f"{name}.py" for name in ("xie", "xie_itself", "xie_photographs", "xie_skin", "xie_ways")]
    for file in [*files, *own, package / "accuracy.py"]:
        digest.update(file.read_bytes())
    return digest.hexdigest()


def photographed(seed: int, scale: float, glare: str) -> tuple[Capture, Mapping[str, Array]]:
    """A finger of the twin."""
    return simulate_capture(seed, settings=TwinSettings(scale=scale, skin=GLARE[glare]))


def scenes(capture: Capture, truth: Mapping[str, Array], channels: Sequence[str]) -> dict[str, Scene]:
    """The white band's images in each channel, in a window around the true mask."""
    mask = np.asarray(truth["mask"], dtype=bool)
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    window = tuple(
        slice(max(int(at[0]) - MARGIN_PX, 0), min(int(at[-1]) + 1 + MARGIN_PX, size))
        for at, size in zip((rows, columns), mask.shape, strict=True)
    )
    band = capture.bands["white"]
    stacks = np.maximum(linear_channels(band, capture.encoding, channels, window), np.float32(0))
    near = {name: np.asarray(truth[name])[window] for name in ("height_mm", "shape_mm", "mask", "normals")}
    rig = capture.rig.select(band.leds)
    return {name: Scene(stacks[k], rig, mask[window], near, window) for k, name in enumerate(channels)}


def measured(seed: int, scale: float) -> dict[str, Any]:
    """Figures of one finger by glare, channel and way."""
    found: dict[str, Any] = {"seed": seed}
    known = ways()
    for glare in GLARE:
        capture, truth = photographed(seed, scale, glare)
        for channel, scene in scenes(capture, truth, CHANNELS).items():
            wanted = PLAIN + (ALL if channel == "grey" else ())
            found[f"{glare}, {channel}"] = {name: figures(scene, known[name](scene)[0]) for name in wanted}
    return found


def tried(seed: int, scale: float) -> dict[str, Any]:
    """Mean error of the normals in grey, of every third pixel, by glare and trial."""
    found: dict[str, Any] = {"seed": seed}
    for glare in GLARE:
        scene = scenes(*photographed(seed, scale, glare), ("grey",))["grey"]
        some = (slice(None, None, 3), slice(None, None, 3))
        stack, mask, truth = scene.stack[:, *some], scene.mask[some], scene.truth["normals"][some]
        plain = lambertian(stack, scene.lights, mask)[0]
        errors = {"lambertian": float(error_deg(plain, truth)[mask].mean())}
        for name, settings in trials().items():
            normals = hanrahan_krueger(stack, scene.lights, mask, settings)[0]
            errors[name] = float(error_deg(normals, truth)[mask].mean())
        found[glare] = errors
    return found


def kept(name: str, folder: Path, make: Any) -> Any:
    """The result on disk, or what `make` gives, put there."""
    path = folder / f"{name}.json"
    if not path.exists():
        print(name, flush=True)
        partial = path.with_suffix(".part")
        partial.write_text(json.dumps(make(), default=float))
        partial.replace(path)
    return json.loads(path.read_text())


def rounded(value: Any) -> Any:
    """Numbers to five digits."""
    if isinstance(value, dict):
        return {key: rounded(each) for key, each in value.items()}
    if isinstance(value, list):
        return [rounded(each) for each in value]
    return float(f"{value:.5g}") if isinstance(value, float) else value


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--fingers", type=int, default=12)
    parser.add_argument("--first-seed", type=int, default=1000)
    parser.add_argument("--trial-fingers", type=int, default=4)
    parser.add_argument("--first-trial-seed", type=int, default=5000)
    parser.add_argument("--scale", type=float, default=0.2)
    parser.add_argument("--smoke", action="store_true", help="one tiny finger of each kind")
    parser.add_argument("--out", type=Path, default=None)
    chosen = parser.parse_args(arguments)
    if chosen.smoke:
        chosen = replace_all(chosen, fingers=1, trial_fingers=1, scale=0.1)
    seeds = range(chosen.first_seed, chosen.first_seed + chosen.fingers)
    trial_seeds = range(chosen.first_trial_seed, chosen.first_trial_seed + chosen.trial_fingers)
    if set(seeds) & set(trial_seeds):
        print("the fingers of the trials must be others than those reported.", file=sys.stderr)
        return 2
    code = source_hash()
    folder = OUT / f"xie-{code[:12]}-{chosen.scale:g}"
    folder.mkdir(parents=True, exist_ok=True)
    results = {
        "format": "splitknit-xie",
        "version": 1,
        "source_sha256": code,
        "scale": chosen.scale,
        "trials": [kept(f"trial-{s}", folder, lambda s=s: tried(s, chosen.scale)) for s in trial_seeds],
        "itself": kept("itself", folder, lambda: on_itself(chosen.first_seed, chosen.scale)),
        "photographs": kept("photographs", folder, lambda: on_photographs(smoke=chosen.smoke)),
        "fingers": [kept(f"finger-{s}", folder, lambda s=s: measured(s, chosen.scale)) for s in seeds],
    }
    out = chosen.out or (OUT / "xie-smoke.json" if chosen.smoke else HERE / "xie.json")
    out.write_text(json.dumps(rounded(results), indent=1, allow_nan=False) + "\n", encoding="ascii")
    print(f"wrote {out}")
    return 0


def replace_all(options: argparse.Namespace, **changes: Any) -> argparse.Namespace:
    """Options with some changed."""
    return argparse.Namespace(**(vars(options) | changes))


if __name__ == "__main__":
    sys.exit(main())
