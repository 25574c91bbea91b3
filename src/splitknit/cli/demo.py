"""``splitknit demo``: a simulated finger, reconstructed twice and compared with the truth."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from splitknit.cli.verb import Outcome, Progress, natural, new_verb, scale


def add_demo(verbs: Any) -> None:
    """Add ``splitknit demo``."""
    verb = new_verb(verbs, "demo", "simulate a finger, reconstruct it, compare it with the truth", _run)
    verb.add_argument("--out", type=Path, default=Path("demo"), metavar="DIR", help="folder to write (default: demo)")
    verb.add_argument("--seed", type=natural, default=1, help="which finger (default: 1)")
    verb.add_argument(
        "--scale", type=scale, default=0.5, help="size of the images, 1 = 3200 x 2200 pixels (default: 0.5)"
    )


def _run(options: argparse.Namespace) -> Outcome:
    from splitknit.report.demo import demo  # verbs import what they need, so that --help is quick

    with Progress(options) as progress:
        facts = demo(options.out, seed=options.seed, scale=options.scale, progress=progress.update)
    figures = facts["comparison"]
    lines = [
        f"A simulated finger was photographed, reconstructed and compared with the truth in {facts['total_s']:.0f} s."
    ]
    for preset, figure in figures.items():
        lines.append(
            f"  {preset:7s} surface rms {figure['surface_rms_mm']:.3f} mm, "
            f"ridge correlation {figure['ridge_correlation']:.2f}, ridge gain {figure['ridge_gain']:.2f}"
        )
    lines += [f"Open {options.out / 'report.html'} in a browser. Also written:"]
    lines += [f"  {options.out / name}: {what}" for name, what in facts["written"].items()]
    return facts, lines
