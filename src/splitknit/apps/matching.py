"""Matching of files: captures, results, templates and prints in, similarity and alignment out."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from splitknit.apps.fmr_tables import fmr_table
from splitknit.apps.matching_inputs import (
    MatchingSettings,
    Progress,
    Side,
    naming,
    no_progress,
    read_side,
    surface_images,
)
from splitknit.apps.targets import check_file
from splitknit.errors import BadInput, require
from splitknit.io.templates import MAGIC, write_template
from splitknit.matching import VERSION, Template, pack, ridge_match, thesis_match
from splitknit.settings import override

SPACE_METHODS = ("minutiae3d", "surface-code", "tetrahedra")
"""Those that compare surfaces in space."""
METHODS = ("ridge", "thesis", "minutiae", "voted", *SPACE_METHODS)
_FMR_TABLE = "match_fmr.json"
"""Made by validation/match/impostors.py."""
_FMR_ROUNDING = 1e-5
"""Of the similarities in it: no rate comes out too low."""


def match_files(
    a: Path,
    b: Path | None,
    *,
    method: str = "ridge",
    template: Path | None = None,
    preset: str = "metric",
    settings: MatchingSettings | dict[str, Any] | None = None,
    progress: Progress = no_progress,
) -> dict[str, Any]:
    """Compare two fingers' files, or make the template of one; return facts for ``--json``.

    Parameters
    ----------
    a, b
        Capture folder, result folder, template (``.skt``) or 500-ppi print. Without `b` only the template is made.
    method
        ``ridge``, ``thesis``, ``minutiae``, ``voted``, ``minutiae3d``, ``surface-code`` or ``tetrahedra``.
    template
        File to write the template of `a` into.
    preset
        By which captures are reconstructed.

    Raises
    ------
    BadInput
        Naming the file at fault.
    """
    require(method in METHODS, f"method must be one of {', '.join(METHODS)}, but it is '{method}'.")
    require(b is not None or template is not None, "name a second finger to compare with, or --template to write.")
    chosen = settings if isinstance(settings, MatchingSettings) else override(MatchingSettings(), settings or {})
    if template is not None:
        check_file(template, "a template", lambda data: data.startswith(MAGIC))
        sources = [path.expanduser().resolve() for path in (a, b) if path is not None]
        require(
            template.expanduser().resolve() not in sources, f"'{template}' is one of the inputs; name another file."
        )
    first = read_side(a, preset, chosen, progress)
    facts: dict[str, Any] = {"method": method, "a": _facts(first)}
    if b is not None:
        second = read_side(b, preset, chosen, progress)
        facts["b"] = _facts(second)
        progress("comparing", 0.9)
        ways: dict[str, Callable[[Side, Side, MatchingSettings], dict[str, Any]]] = {
            "ridge": _by_ridges,
            "thesis": _by_thesis,
            "minutiae": _by_minutiae,
            "voted": partial(_by_votes, preset),
            **{name: partial(_in_space, name) for name in SPACE_METHODS},
        }
        found = ways[method](first, second, chosen)
        for name, side in zip("ab", found.pop("sides", ()), strict=False):
            facts[name] |= side
        facts |= found
    if template is not None:
        payload = pack(_template(first))
        write_template(template, payload, VERSION)
        facts["template"] = {"file": str(template), "bytes": template.stat().st_size, "version": VERSION}
    progress("done", 1.0)
    return facts


def _by_ridges(a: Side, b: Side, settings: MatchingSettings) -> dict[str, Any]:
    left, right = _template(a), _template(b)
    found = ridge_match(left, right, settings.ridge)
    return {
        "similarity": found.similarity,
        "fmr": false_match_rate(found.similarity) if found.compared and as_calibrated(settings) else None,
        "compared": found.compared,
        "overlap_mm2": found.overlap_mm2,
        "correlation": found.correlation,
        "alignment": {"rotation_deg": found.rotation_deg, "right_mm": found.right_mm, "up_mm": found.up_mm},
    }


def false_match_rate(similarity: float) -> float | None:
    """Rate at which other (simulated) fingers reach this similarity of the ridge matcher; None without a table.

    Never below one over the number of impostor comparisons that the table was measured on.
    """
    table = fmr_table(_FMR_TABLE)
    return None if table is None else table(similarity - _FMR_ROUNDING)


def similarity_at(fmr: float) -> float | None:
    """Smallest similarity (in steps of 1e-5) at which :func:`false_match_rate` is `fmr` or less; None without a table.

    Raises
    ------
    BadInput
        If the table was measured on too few comparisons to state such a rate.
    """
    table = fmr_table(_FMR_TABLE)
    if table is None:
        return None
    enough = table.fmr <= fmr
    require(
        bool(enough.any()),
        f"false match rates were measured on {table.impostors} comparisons, so that none below {table.fmr.min():.2g} "
        f"can be stated; ask for a larger one than {fmr:g}.",
    )
    step = int(np.ceil(table.similarity[np.argmax(enough)] / _FMR_ROUNDING)) + 1
    return step * _FMR_ROUNDING


def as_calibrated(settings: MatchingSettings) -> bool:
    """Whether scores mean what they meant when the table was measured."""
    plain = MatchingSettings()
    return (settings.band, settings.template, settings.ridge) == (plain.band, plain.template, plain.ridge)


def _by_thesis(a: Side, b: Side, settings: MatchingSettings) -> dict[str, Any]:
    images = []
    for side in (a, b):
        if side.surface is None:
            raise BadInput(
                f"{side.path} is a {side.kind}; the thesis's matcher needs a surface: name a capture or a result."
            )
        images.append(naming(side.path, partial(surface_images, side.surface)))
    found = thesis_match(images[0], images[1], settings.thesis)
    return {
        "similarity": found.similarity,
        "fmr": None,
        "compared": found.compared,
        "overlap": found.ratio,
        "dissimilarity": dict(found.dissimilarity),
        "distances": dict(found.distances),
        "alignment": {"right_mm": found.shift_px / images[0].px_per_mm},
    }


def _by_minutiae(a: Side, b: Side, settings: MatchingSettings) -> dict[str, Any]:
    from splitknit.apps.matching_minutiae import compare_minutiae  # noqa: PLC0415 - only where it is asked for

    return compare_minutiae(a, b)


def _by_votes(preset: str, a: Side, b: Side, settings: MatchingSettings) -> dict[str, Any]:
    from splitknit.apps.matching_voted import compare_voted  # noqa: PLC0415 - only where it is asked for

    return compare_voted(a, b, preset, settings)


def _in_space(method: str, a: Side, b: Side, settings: MatchingSettings) -> dict[str, Any]:
    from splitknit.apps.matching_space import compare_in_space  # noqa: PLC0415 - only where it is asked for

    return compare_in_space(a, b, method, settings)


def _template(side: Side) -> Template:
    assert side.template is not None
    return side.template


def _facts(side: Side) -> dict[str, Any]:
    template = _template(side)
    return {"path": str(side.path), "kind": side.kind, "area_mm2": template.area_mm2, "acquired": not template.empty}
