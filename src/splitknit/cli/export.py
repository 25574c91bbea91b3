"""``splitknit export SOURCE... --to FORMAT --out DIR``: fingers for other systems."""

from __future__ import annotations

import argparse
import datetime
from pathlib import Path
from typing import Any

from splitknit.cli.gallery_options import add_key, count
from splitknit.cli.verb import Outcome, Progress, add_input_ppi, add_preset, from_options, new_verb

TO = ("iso-19794-2", "ansi-378", "ansi-378-2009", "iso-19794-4", "ansi-nist-itl", "wsq", "png", "tiff")
SURFACES = ("stl", "obj", "glb", "x3p", "tmd", "ptm", "lp")


def add_export(verbs: Any) -> None:
    """Add the verb."""
    verb = new_verb(verbs, "export", "write fingers as records, images and meshes that other systems read", _run)
    verb.add_argument(
        "sources",
        type=Path,
        nargs="+",
        metavar="SOURCE",
        help="prints (PNG, TIFF, JPEG, BMP, WSQ, ISO 19794-4, ANSI/NIST-ITL), records of minutiae (ISO 19794-2, "
        "ANSI 378), captures, results, folders of 'splitknit print', templates (.skt) and galleries",
    )
    verb.add_argument(
        "--to",
        choices=(*TO, *SURFACES),
        required=True,
        help="minutiae: iso-19794-2 (of 2005), ansi-378 (of 2004), ansi-378-2009; pictures: iso-19794-4 (of 2005), "
        "ansi-nist-itl (Type-14), wsq, png, tiff; surfaces of captures and results, in mm: stl, obj, glb, x3p (extra "
        "x3p), tmd, and ptm, a relightable picture of them; the lights of captures, for RTI: lp",
    )
    verb.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder to write, one file a finger")
    verb.add_argument(
        "--finger", metavar="FINGER", help="such as right_index, for all sources (default: as they state)"
    )
    verb.add_argument(
        "--impression",
        metavar="TYPE",
        help="such as live_rolled or nonlive_plain (default: as they state, else contactless for surfaces, live_plain "
        "for prints)",
    )
    verb.add_argument(
        "--compression",
        choices=("none", "png", "wsq"),
        default="none",
        help="of iso-19794-4 and ansi-nist-itl (default: none; wsq loses a little)",
    )
    verb.add_argument(
        "--date", type=_date, metavar="YYYY-MM-DD", help="of the capture, which ansi-nist-itl and x3p state"
    )
    verb.add_argument(
        "--minutiae",
        choices=("phase", "mindtct"),
        default="phase",
        help="how they are found: by the phase of the ridges (default), or by NIST's mindtct (extra minutiae)",
    )
    add_input_ppi(verb)
    add_key(verb)
    add_preset(verb)


def _date(text: str) -> datetime.date:
    try:
        return datetime.date.fromisoformat(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"'{text}' must be a date such as 2026-01-31") from error


def _run(options: argparse.Namespace) -> Outcome:
    from splitknit.gallery.key import key_of  # verbs import what they need
    from splitknit.gallery.records import Exporting, export_records

    settings = from_options(Exporting, options)
    with Progress(options) as progress:
        facts = export_records(
            options.sources, options.out, settings, key=key_of(options.key_file), progress=progress.update
        )
    lines = export_words(facts)
    if any("person" in one for one in facts["files"]):
        lines.append("Please note: they are personal data, and they are not encrypted there.")
    return facts, lines


def export_words(facts: dict[str, Any]) -> list[str]:
    """For people, of an export or an import."""
    files = facts["files"]
    minutiae = [one["minutiae"] for one in files if "minutiae" in one]
    mean = f", {sum(minutiae) / len(minutiae):.0f} minutiae in the mean" if minutiae else ""
    first = f" ({files[0]['file']}{' ...' if len(files) > 1 else ''})"
    lines = [f"Wrote {count(len(files), 'file')} and export.json to {facts['out']}{first}{mean}."]
    if "vertices" in files[0]:
        lines.append(f"{files[0]['vertices']:,} vertices, {files[0]['faces']:,} triangles, in mm.")
    if "relief_roughness" in files[0]:
        rough = files[0]["relief_roughness"]
        lines.append(
            f"Relief: Sa {rough['Sa_um']:.1f} um, Sq {rough['Sq_um']:.1f} um, Sz {rough['Sz_um']:.0f} um, Sdr "
            f"{rough['Sdr_percent']:.1f} %."
        )
    failed = facts["failures_to_acquire"]
    if failed:
        lines.append(
            f"Please note: {count(len(failed), 'file')} without minutiae (failure to acquire): {failed[0]} ..."
        )
    return lines
