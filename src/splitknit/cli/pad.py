"""``splitknit pad CAPTURE``: is it live skin?"""

from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path
from typing import Any

from splitknit.cli.verb import Outcome, Progress, add_preset, new_verb


def add_pad(verbs: Any) -> None:
    """Add the verb."""
    verb = new_verb(verbs, "pad", "detect presentation attacks: was live skin photographed, or a copy", _run)
    verb.add_argument("capture", type=Path, metavar="CAPTURE", help="capture folder (with capture.json)")
    add_preset(verb)


def add_refusal(verb: argparse.ArgumentParser) -> None:
    """Add ``--pad``."""
    verb.add_argument("--pad", action="store_true", help="refuse captures that are no live skin (presentation attacks)")


def refuse_attacks(options: argparse.Namespace, paths: list[Path], progress: Any) -> None:
    """With ``--pad``, raise BadInput where a capture is no live skin."""
    from splitknit.errors import require

    require(not options.pad or bool(paths), "--pad goes with captures that are named.")
    for path in paths if options.pad else ():
        facts = _presented(path, options.preset, progress)
        score = f"probability {facts['probability']:.2g}"
        require(facts["live"], f"'{path}' is no live skin ({score}); leave out --pad to take it anyway.")


def _run(options: argparse.Namespace) -> Outcome:
    """Judge a capture."""
    with Progress(options) as progress:
        facts = _presented(options.capture, options.preset, progress.update)
    unlike = [name for name, value in sorted(facts["suspicion"].items(), key=lambda one: -one[1]) if value > 1.0]
    verdict = "Live skin" if facts["live"] else "No live skin (presentation attack)"
    return facts, [
        f"{verdict}: probability {facts['probability']:.3g}, live from {facts['threshold']:.3g}.",
        f"Unlike live skin: {', '.join(unlike) or 'nothing'}.",
        f"Please note: {facts['basis']}",
    ]


def _presented(path: Path, preset: str, progress: Any) -> dict[str, Any]:
    """Facts about what a capture folder shows."""
    from splitknit.errors import naming, require
    from splitknit.io.capture import read_capture
    from splitknit.pad import BASIS, judge, pad_features, pad_images
    from splitknit.pipeline import reconstruct  # verbs import what they need

    require((path / "capture.json").is_file(), f"'{path}' is no capture folder (capture.json), which attacks show in.")
    capture = read_capture(path)

    def judged() -> dict[str, Any]:
        found = pad_features(pad_images(capture), reconstruct(capture, preset, progress=progress))
        return {"capture": str(path), **asdict(judge(found)), "features": found, "basis": BASIS}

    return naming(path, judged)
