"""A photograph of skin, or photographs through polarising films, in; two kinds of light out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from splitknit.arguments import AnyPath, Encoding, Progress, checked, silent, text_of
from splitknit.errors import require


@dataclass(frozen=True, slots=True)
class Separated:
    """What :func:`separate` wrote."""

    facts: dict[str, Any]
    """Those of ``report.json``, and ``out``."""

    def __str__(self) -> str:
        facts = self.facts
        notes = [f"Please note: {finding['message']}" for finding in facts["findings"]]
        if facts["method"] == "polarised":
            share = f"{100 * facts['specular_share']:.0f} % of the light through parallel films"
            return text_of(
                [
                    f"{facts['images']} pairs of photographs separated: {share} is specular "
                    "in the median.",
                    f"Written to {facts['out']}: specular_K.png and diffuse_K.png of each light, "
                    "specular.png of all.",
                    *notes,
                ]
            )
        return text_of(
            [
                f"{100 * facts['direct_share']:.0f} % of the light is direct in the median.",
                f"Written to {facts['out']}: {', '.join(facts['files'])}.",
                *notes,
            ]
        )


@checked
def separate(
    photographs: Sequence[AnyPath],
    *,
    out: AnyPath,
    encoding: Encoding | None = None,
    progress: Progress = silent,
) -> Separated:
    """Split a photograph of skin into direct and global light, or polarised ones.

    Parameters
    ----------
    photographs
        Photograph, or folder of one (and `mask`, white where a result is wanted), which the network
        of the thesis separates, best at 14 to 38 pixels/mm; or 'polarised PARALLEL CROSSED', two
        folders of the same photographs through parallel and crossed films: specular and diffuse
        light.
    out
        Folder to write the results into.
    encoding
        Of the photographs (default: what their files say, sRGB for JPEG and 8 bits).

    Returns
    -------
    Separated

    Raises
    ------
    BadInput
        Naming the file or the folder at fault; nothing is written.

    Examples
    --------
    >>> separate(["finger.png"], out="light").facts["direct_share"]  # doctest: +SKIP
    0.62
    """
    from splitknit.separation.folder import separate_photograph, separate_polarised_folders

    places = [Path(place) for place in photographs]
    target = Path(out)
    if len(places) == 1:
        facts = separate_photograph(places[0], target, encoding=encoding, progress=progress)
        return Separated(facts)
    require(
        len(places) == 3 and str(places[0]) == "polarised",
        "name one photograph, or 'polarised PARALLEL CROSSED', two folders.",
    )
    facts = separate_polarised_folders(
        places[1], places[2], target, encoding=encoding, progress=progress
    )
    return Separated(facts)
