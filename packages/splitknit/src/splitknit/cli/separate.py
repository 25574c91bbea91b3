"""``splitknit separate``: what is said of separated light."""

from __future__ import annotations

from typing import Any

from splitknit.cli.verb import Outcome, Verb
from splitknit.separation.job import SeparateJob


def _show(facts: dict[str, Any], job: SeparateJob) -> Outcome:
    notes = [f"Please note: {warning}" for warning in facts["warnings"]]
    if facts["method"] == "polarised":
        return facts, [
            f"{facts['images']} pairs of photographs separated: {100 * facts['specular_share']:.0f} % of the light "
            "through parallel films is specular in the median.",
            f"Written to {job.out}: specular_K.png and diffuse_K.png of each light, specular.png of all.",
            *notes,
        ]
    direct = f"{100 * facts['direct_share']:.0f} % of the light is direct in the median"
    lines = [f"{len(facts['images'])} images separated by {facts['method']}: {direct}."]
    lines.append(f"Written to {job.out}: {', '.join(facts['files'])}.")
    return facts, [*lines, *notes]


SEPARATE = Verb(SeparateJob, _show)
