"""Settings as they are kept with a result: those that came later are named only where they are used."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from splitknit.recipe.presets import PipelineSettings

LATER = (
    "smooth",
    "lights",
    "normals.hanrahan_krueger",
    "shape.mirror",
    "motion.correct",
    "motion.correct_mm",
    "motion.most_mm",
    "motion.most_left",
    "motion.registration",
    "quality.specks",
)
"""Settings of later cases: at their defaults they change nothing, so the documents, hashes and files of earlier cases
stay what they were."""


def settings_document(settings: PipelineSettings) -> dict[str, Any]:
    """All settings by name, without the :data:`LATER` ones that have their defaults."""
    document, plain = asdict(settings), asdict(PipelineSettings())
    for name in LATER:
        *groups, last = name.split(".")
        here, there = document, plain
        for group in groups:
            here, there = here[group], there[group]
        if last in here and here[last] == there[last]:
            del here[last]
    return document
