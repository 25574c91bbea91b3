"""Quality of a print as a report tells it: NFIQ 2, our own figures and score, and what to do in words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput
from splitknit.prints import PrintQuality

MOST_SENTENCES = 3
LEAST_WORTH = 0.7
"""A figure that is worth less is spoken of."""
FULL_WORTH = 0.95
"""Of the ridges' height: from here on, soft edges are the finger's own."""


def nfiq2_of(pictures: Mapping[str, NDArray[np.uint8]], ppi: float) -> dict[str, int | None] | None:
    """NFIQ 2 of ``print.png`` and ``enhanced.png``, None where it sees no print; None without the package for it."""
    from splitknit.matching.minutiae import NFIQ2_FAILED, nfiq2  # noqa: PLC0415 - large, and not everywhere

    try:
        found = {name: nfiq2(pictures[f"{name}.png"], ppi) for name in ("print", "enhanced")}
    except BadInput:
        return None
    return {name: None if value == NFIQ2_FAILED else value for name, value in found.items()}


def quality_facts(found: PrintQuality, nfiq2: dict[str, int | None] | None) -> dict[str, Any]:
    """What ``report.json`` holds under ``quality``: plain numbers and sentences."""

    def rounded(values: Mapping[str, float | None]) -> dict[str, float | None]:
        return {name: None if value is None else round(value, 3) for name, value in values.items()}

    return {
        "nfiq2": nfiq2,
        "ours": round(found.score, 1),
        "figures": rounded(asdict(found.figures)),
        "worth": rounded(found.worth),
        "advice": list(advice(found)),
    }


def advice(found: PrintQuality) -> tuple[str, ...]:
    """What is wrong with a print and what to do, at most three sentences, the worst first; empty if nothing is.

    Every figure that is worth less than 0.7 may speak; figures with one remedy speak once, through the worst of them.
    """
    spoken: dict[str, None] = {}
    causes: set[str] = set()
    for name, worth in sorted(found.worth.items(), key=lambda item: item[1]):
        cause = _CAUSES[name]
        if cause == "soft" and found.worth.get("ridge_height_um", 0.0) >= FULL_WORTH:
            continue  # defocus lowers ridges as well; soft but high ones grew that way
        if worth < LEAST_WORTH and cause not in causes and len(spoken) < MOST_SENTENCES:
            causes.add(cause)
            spoken[_sentence(cause, name, found)] = None
    return tuple(spoken)


_CAUSES = {
    "ridge_height_um": "weak",
    "ridge_share": "lost",
    "gap_share": "gaps",
    "coherence": "noise",
    "plausible_share": "noise",
    "sharpness": "soft",
    "ridge_area_mm2": "partial",
    "ridge_length_mm": "partial",
    "centre_offset_mm": "beside",
}


def _sentence(cause: str, name: str, found: PrintQuality) -> str:
    figures = found.figures
    lost = 100 * (1 - figures.ridge_share)
    noise = "directions of ridges disagree" if name == "coherence" else "distances of ridges are not plausible"
    sentences = {
        "weak": f"Ridges are weak ({figures.ridge_height_um or 0:.0f} um), missing over {lost:.0f} % of the area: dry, "
        "worn, wet or out of focus; moisten the finger if it is dry, dry it if it is wet, check the focus, and capture "
        "again.",
        "lost": f"Ridges are missing over {lost:.0f} % of the finger's area; check focus and exposure, clean finger "
        "and lens, and capture again.",
        "gaps": f"{100 * figures.gap_share:.0f} % of the skin between ridges shows none: glare, a crease, a scar, "
        "water, dirt or blur; wipe the finger and the lens, check the focus, and capture again.",
        "noise": f"The picture is noisy or the finger dusty ({noise}); wipe it, lengthen the exposure, keep the finger "
        "still, and capture again.",
        "soft": "The ridges' edges are soft; focus the camera on the finger, keep it still, and capture again.",
        "partial": f"Only {figures.ridge_length_mm:.0f} mm of ridges ({figures.ridge_area_mm2:.0f} mm2) are in view; "
        "push the finger further in, its pad to the camera, and capture again.",
        "beside": f"The ridges lie {figures.centre_offset_mm:.0f} mm beside the finger's middle; turn its pad to the "
        "camera and capture again.",
    }
    return sentences[cause]
