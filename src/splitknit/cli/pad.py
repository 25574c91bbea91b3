"""``splitknit pad CAPTURE``: is it skin?"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from splitknit.cli.verb import Outcome, Progress, add_preset, new_verb

BASIS = "The model was fitted to simulated attacks only; nobody has measured it on real ones."


def add_pad(verbs: Any) -> None:
    """Add the verb."""
    verb = new_verb(verbs, "pad", "detect presentation attacks: is what was photographed live skin or a copy", _run)
    verb.add_argument("capture", type=Path, metavar="CAPTURE", help="capture folder (with capture.json)")
    add_preset(verb)


def _run(options: argparse.Namespace) -> Outcome:
    """Judge a capture."""
    with Progress(options) as progress:
        facts = presented(options.capture, options.preset, progress.update)
    suspicious = sorted((-value, name) for name, value in facts["suspicion"].items() if value > 1.0)
    verdict = "Live skin" if facts["live"] else "No live skin (presentation attack)"
    lines = [
        f"{verdict}: probability of live skin {facts['probability']:.3g}, decided at {facts['threshold']:.3g}.",
        f"Unlike live skin: {', '.join(name for _, name in suspicious) or 'nothing'}.",
        f"Please note: {BASIS}",
    ]
    return facts, lines


def presented(path: Path, preset: str, progress: Any) -> dict[str, Any]:
    """Facts about what was presented to the camera in a capture folder."""
    from splitknit.errors import naming, require
    from splitknit.io.capture import read_capture
    from splitknit.pad import features, judge, photographs
    from splitknit.pipeline import reconstruct

    require((path / "capture.json").is_file(), f"'{path}' is no capture folder (capture.json); attacks show in those.")
    progress("reading", 0.0)
    capture = read_capture(path)

    def judged() -> dict[str, Any]:
        found = features(photographs(capture), reconstruct(capture, preset, progress=progress))
        decided = judge(found)
        return {
            "capture": str(path),
            "probability": decided.probability,
            "live": decided.live,
            "threshold": decided.threshold,
            "suspicion": decided.suspicion,
            "features": found,
            "basis": BASIS,
        }

    return naming(path, judged)


def add_refusal(verb: argparse.ArgumentParser) -> None:
    """Add ``--pad``."""
    verb.add_argument("--pad", action="store_true", help="refuse captures that are no live skin (presentation attacks)")


def refuse_attacks(options: argparse.Namespace, paths: list[Path], progress: Any) -> None:
    """With ``--pad``, raise BadInput where a capture is no live skin."""
    from splitknit.errors import require

    require(not options.pad or bool(paths), "--pad goes with captures that are named.")
    for path in paths if options.pad else ():
        facts = presented(path, options.preset, progress)
        verdict = (
            f"'{path}' is no live skin (probability {facts['probability']:.2g}); leave out --pad to take it anyway."
        )
        require(facts["live"], verdict)
