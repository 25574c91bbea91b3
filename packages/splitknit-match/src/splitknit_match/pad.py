"""Presentation attacks: was live skin photographed, or a copy, or is that unknown?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from splitknit.arguments import AnyPath, Preset, Progress, Report, checked, silent
from splitknit.errors import BadInput, require
from splitknit.findings import Finding, Severity


@checked
def pad(capture: AnyPath, *, preset: Preset = "metric", progress: Progress = silent) -> Report:
    """Detect presentation attacks: was live skin photographed, or a copy, or is that unknown.

    Parameters
    ----------
    capture
        Capture folder (with capture.json).
    preset
        How it is reconstructed.

    Returns
    -------
    Report
        ``answer``: ``live``, ``attack`` or ``unknown``.

    Raises
    ------
    BadInput
        If `capture` is no capture folder.

    Examples
    --------
    >>> pad("capture").facts["answer"]  # doctest: +SKIP
    'live'
    """
    facts = _presented(Path(capture), preset, progress)
    suspected = sorted((facts["suspicion"] or {}).items(), key=lambda item: -item[1])
    unlike = [name for name, value in suspected if value > 1.0]
    words = {
        "live": "Live skin",
        "attack": "Presentation attack",
        "unknown": f"Unknown: {facts['reason']}",
    }
    lines = [words[facts["answer"]].rstrip(".") + "."]
    if facts["probability"] is not None:
        distance = f"distance to what the model was fitted to {facts['distance']:.2f}"
        live = f"Probability of live skin {facts['probability']:.3g}"
        lines.append(f"{live}; {distance}, covered up to {facts['covered']:.2f}.")
        lines.append(f"Unlike live skin: {', '.join(unlike) or 'nothing'}.")
    notes = [f"Please note: {finding['message']}" for finding in facts["findings"]]
    return Report(facts, (*lines, *notes))


def refuse_attacks(
    wanted: bool, paths: Sequence[Any], preset: str, progress: Progress
) -> tuple[str | None, tuple[Finding, ...]]:
    """Where it is `wanted`, raise BadInput if a capture is an attack; ``live``, ``unknown`` if one
    is, or None; and findings of those that are unknown."""
    require(not wanted or paths, "`pad` goes with captures that are named.")
    unknown = []
    for capture in paths if wanted else ():
        facts = _presented(Path(capture), preset, progress)
        attack = facts["answer"] == "attack"
        require(
            not attack,
            f"'{capture}' is suspected to be a presentation attack; leave out `pad` to take it"
            " anyway.",
        )
        if facts["answer"] == "unknown":
            words = f"whether '{capture}' is live skin is unknown: {facts['reason']}"
            unknown.append(
                Finding("unknown-liveness", words, Severity.DOUBT, files=(str(capture),))
            )
    answer = ("unknown" if unknown else "live") if wanted else None
    return answer, tuple(unknown)


def _presented(folder: Path, preset: str, progress: Progress) -> dict[str, Any]:
    from splitknit import read_capture, reconstruct
    from splitknit.errors import BadExposure
    from splitknit.pad import BASIS, Presentation, judge, not_covered, pad_features, pad_images

    no_capture = f"'{folder}' is not a capture folder (capture.json), which attacks show in."
    require((folder / "capture.json").is_file(), no_capture)
    features: dict[str, float] = {}
    # as a screen's own light has it; other refusals on reading are of files
    kind: type[BadInput] = BadExposure
    try:
        capture = read_capture(folder)
        kind = BadInput  # no finger, or too little of one
        features = pad_features(
            pad_images(capture), reconstruct(capture, preset, progress=progress)
        )
        missing = not_covered(capture)
        presentation = Presentation("unknown", f"{missing}.") if missing else judge(features)
    except BadInput as error:
        if not isinstance(error, kind):
            raise
        presentation = Presentation(
            "unknown", f"it cannot be reconstructed ({str(error).rstrip('.')})."
        )
    return {
        "capture": str(folder),
        **asdict(presentation),
        "features": features,
        "findings": [Finding("simulated-attacks", BASIS).facts],
    }
