"""Images under fine patterns, or through polarising films, in; two kinds of light out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from splitknit.arguments import (
    AnyPath,
    Encoding,
    Progress,
    checked,
    count,
    refuse_given,
    silent,
    text_of,
)
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
        direct = f"{100 * facts['direct_share']:.0f} % of the light is direct in the median"
        images = count(len(facts["images"]), "image")
        return text_of(
            [
                f"{images} separated by {facts['method']}: {direct}.",
                f"Written to {facts['out']}: {', '.join(facts['files'])}.",
                *notes,
            ]
        )


@checked
def separate(
    folders: Sequence[AnyPath],
    *,
    out: AnyPath,
    method: Literal["checkerboard", "network"] = "checkerboard",
    alpha: float | None = None,
    dark: float | None = None,
    patterns: str | None = None,
    encoding: Encoding | None = None,
    check_px: float | None = None,
    progress: Progress = silent,
) -> Separated:
    """Split images under fine patterns into direct and global light, or polarised ones.

    Parameters
    ----------
    folders
        Folder of images under patterns; or 'polarised PARALLEL CROSSED', two folders of the same
        photographs through parallel and crossed films: specular and diffuse light.
    out
        Folder to write the results into.
    method
        checkerboard; or network: the folder holds one photograph of skin (and `black`, `mask`),
        which the network of the thesis separates, best at 14 to 38 pixels/mm.
    alpha
        Fraction of the pattern that is lit (default: 0.5).
    dark
        Brightness of its unlit part (default: 0).
    patterns
        Folder of state images, white = lit, or 'estimate' to find the states in the images: no bias
        by noise.
    encoding
        Of the images (default: linear; of one photograph what its file says: sRGB for JPEG and 8
        bits).
    check_px
        Side of a check on the images, for noisy checkerboards on skin (whose states are found in
        the images unless `patterns` gives them).

    Returns
    -------
    Separated

    Raises
    ------
    BadInput
        Naming the file or the folder at fault; nothing is written.

    Examples
    --------
    >>> separate(["images"], out="light").facts["direct_share"]  # doctest: +SKIP
    0.62
    """
    from splitknit.separation.folder import separate_polarised_folders, separate_to_folder

    places = [Path(folder) for folder in folders]
    target = Path(out)
    of_patterns = {"alpha": alpha, "dark": dark, "patterns": patterns, "check_px": check_px}
    if method == "network":
        refuse_given("is of patterns; `method` network takes none.", **of_patterns)
        require(len(places) == 1, "`method` network takes one folder, with one photograph.")
    if len(places) == 1:
        facts = separate_to_folder(
            places[0],
            target,
            method=method,
            alpha=0.5 if alpha is None else alpha,
            dark=0.0 if dark is None else dark,
            patterns=patterns,
            encoding=encoding,
            check_px=check_px,
            progress=progress,
        )
        return Separated(facts)
    require(
        len(places) == 3 and str(places[0]) == "polarised" and set(of_patterns.values()) == {None},
        "name one folder of images under patterns, or 'polarised PARALLEL CROSSED', with `out` and"
        " `encoding` alone.",
    )
    facts = separate_polarised_folders(
        places[1], places[2], target, encoding=encoding, progress=progress
    )
    return Separated(facts)
