"""``splitknit separate``: options in, files and facts out."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from splitknit.cli.verb import Outcome, Progress, natural, new_verb


def add_separate(verbs: Any) -> None:
    """Add ``splitknit separate``."""
    verb = new_verb(
        verbs, "separate", "split images under fine patterns into direct and global light, or polarised ones", _run
    )
    verb.add_argument(
        "folders",
        type=Path,
        nargs="+",
        metavar="FOLDER",
        help="folder of images, with or without separation.json; or 'polarised PARALLEL CROSSED', two folders of the "
        "same photographs through parallel and crossed films: specular and diffuse light",
    )
    verb.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder to write the results into")
    verb.add_argument(
        "--method",
        choices=("checkerboard", "symmetry", "sinusoid", "occluder", "single"),
        help="how the light was patterned (default: what separation.json states, else checkerboard); symmetry: "
        "checkerboards without noise, an odd number of equal steps a period each way",
    )
    verb.add_argument("--alpha", type=float, help="fraction of the pattern that is lit (default: 0.5)")
    verb.add_argument("--dark", type=float, help="brightness of its unlit part (default: 0)")
    verb.add_argument(
        "--patterns",
        metavar="WHERE",
        help="folder of state images, white = lit, or 'estimate' to find the states in the images: no bias by noise",
    )
    verb.add_argument("--encoding", choices=("linear", "srgb"), help="of the images (default: linear)")
    verb.add_argument(
        "--check-px",
        type=float,
        help="side of a check on the images: for one image, and for noisy checkerboards on skin (whose states are "
        "found in the images unless --patterns gives them)",
    )
    verb.add_argument("--block", type=natural, help="side of a block of the result, for one image")


def _run(options: argparse.Namespace) -> Outcome:
    from splitknit.errors import require  # verbs import what they need
    from splitknit.separation.folder import separate_polarised_folders, separate_to_folder

    names = ("method", "alpha", "dark", "patterns", "encoding", "check_px", "block")
    if len(options.folders) > 1:
        plain = all(getattr(options, name) is None for name in names if name != "encoding")
        require(
            len(options.folders) == 3 and str(options.folders[0]) == "polarised" and plain,
            "name one folder of images under patterns, or 'polarised PARALLEL CROSSED', with --out and --encoding "
            "alone.",
        )
        with Progress(options) as progress:
            _, parallel, crossed = options.folders
            facts = separate_polarised_folders(
                parallel, crossed, options.out, encoding=options.encoding, progress=progress.update
            )
        lines = [
            f"{facts['images']} pairs of photographs separated: {100 * facts['specular_share']:.0f} % of the light "
            "through parallel films is specular in the median.",
            f"Written to {options.out}: specular_K.png and diffuse_K.png of each light, specular.png of all.",
        ]
        return facts, [*lines, *(f"Please note: {warning}" for warning in facts["warnings"])]
    with Progress(options) as progress:
        facts = separate_to_folder(
            options.folders[0],
            options.out,
            changes={name: getattr(options, name) for name in names},
            progress=progress.update,
        )
    lines = [
        f"{len(facts['images'])} images separated by {facts['method']}: "
        f"{100 * facts['direct_share']:.0f} % of the light is direct in the median.",
        f"Written to {options.out}: {', '.join(facts['files'])}.",
    ]
    if facts["against_white"] is not None:
        error = facts["against_white"]["median_error"]
        lines.append(f"Direct and global light add up to the white image within {100 * error:.1f} % in the median.")
    lines += [f"Please note: {warning}" for warning in facts["warnings"]]
    return facts, lines
