"""``splitknit identify GALLERY PROBE``: who is it?"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from splitknit.cli.gallery_options import add_gallery, count
from splitknit.cli.match import add_raw, basis_words, one_in
from splitknit.cli.pad import add_refusal, refuse_attacks
from splitknit.cli.verb import (
    FINGERS,
    Outcome,
    Progress,
    add_input_ppi,
    add_preset,
    add_settings,
    from_options,
    natural,
    new_verb,
)

if TYPE_CHECKING:
    from splitknit.gallery.identify import Identification


def add_identify(verbs: Any) -> None:
    """Add the verb."""
    verb = new_verb(verbs, "identify", "find a finger in a gallery, or check whose it is said to be", _run)
    add_gallery(verb)
    verb.add_argument("probe", type=Path, metavar="PROBE", help=FINGERS)
    verb.add_argument("--top", type=natural, default=10, metavar="N", help="candidates that are reported (default: 10)")
    verb.add_argument("--person", metavar="NAME", help="verification: whose finger it is said to be")
    verb.add_argument("--finger", metavar="FINGER", help="which finger it is; others are left out")
    verb.add_argument(
        "--fmr",
        type=float,
        default=1e-4,
        metavar="RATE",
        help="false match rate of one comparison at which is decided (default: 1e-4)",
    )
    verb.add_argument(
        "--merge",
        choices=("person", "finger", "none"),
        default="person",
        help="one candidate for each person (default), each finger, or each enrolled capture",
    )
    verb.add_argument(
        "--search",
        choices=("auto", "exhaustive", "codes"),
        default="auto",
        help="compare all ridges, or only of those that short codes choose (default: auto, by the gallery's size)",
    )
    verb.add_argument(
        "--shards",
        type=Path,
        metavar="DIR",
        help="compare the codes that 'splitknit gallery index --shards' keeps here, with the gallery's key",
    )
    add_raw(verb)
    add_refusal(verb)
    add_input_ppi(verb)
    add_preset(verb)
    add_settings(verb)


def _run(options: argparse.Namespace) -> Outcome:
    from splitknit.cli.options import read_changes
    from splitknit.gallery.identify import IdentifySettings, Question, identify_file
    from splitknit.gallery.key import key_of  # verbs import what they need
    from splitknit.io.provenance import known_json
    from splitknit.settings import override

    settings = override(IdentifySettings(), read_changes(options.settings, options.assignments))
    question = from_options(Question, options)
    key = key_of(options.key_file)
    with Progress(options) as progress:
        refuse_attacks(options, [options.probe], progress.update)
        found = identify_file(
            options.gallery, options.probe, question, settings,
            key=key, preset=options.preset, progress=progress.update, input_ppi=options.input_ppi,
            shards=options.shards,
        )  # fmt: skip
    return known_json(found), _words(found, options.raw)


def _words(found: Identification, raw: bool) -> list[str]:
    lines, basis, decision = [_verdict(found)], found.fmr_basis, found.decision
    for one in found.candidates:
        who = f"{one.person}, {one.finger.replace('_', ' ')}, session {one.session}"
        rate = "not known" if basis is None or one.fmr is None else one_in(one.fmr, basis)
        score = f", score {one.similarity:.5g}" if raw or basis is None else ""
        lines.append(f"{one.rank:>3}. {who}: estimated false match rate {rate}{score}")
    if found.candidates and basis is not None:
        lines.append(f"Rates were measured on {basis_words(basis)}.")
    if raw and decision is not None:
        lines.append(f"A match has a score of {decision.threshold:.5g} or more.")
    searched = found.searched
    how = {"fusion": "by ridges and minutiae", "minutiae": "by minutiae"}.get(searched.compared_by, "ridge by ridge")
    whose = ""
    if searched.people is not None and searched.fingers is not None:
        whose = f" ({count(searched.fingers, 'finger')} of {count(searched.people, 'person', 'people')})"
    lines.append(
        f"Searched: {count(searched.captures, 'capture')}{whose}, {searched.compared} compared {how}"
        + (" (chosen by their codes)." if searched.method in ("codes", "shards") else ".")
    )
    if found.candidates and decision is not None:
        lines.append(
            f"Among {count(searched.captures, 'capture')} of other fingers "
            f"{found.candidates[0].expected_false_matches:.2g} are to be expected as similar as the first candidate, "
            f"and {decision.expected_false_matches:.2g} beyond the limit."
        )
    if searched.without_code:
        lines.append(
            f"Please note: {searched.without_code} captures had no code of this version, or none in the shards; "
            "'splitknit gallery index' keeps them for the next search."
        )
    if searched.note:
        lines.append(f"Please note: {searched.note}")
    if searched.failures:
        lines.append(f"Please note: {searched.failures} failures to acquire in the gallery match nobody.")
    return lines


def _verdict(found: Identification) -> str:
    decision = found.decision
    if not found.probe.acquired:
        lacks = "too few minutiae" if found.by == "minutiae" else "no ridges"
        return f"No match: {found.probe.path} holds {lacks} (failure to acquire)."
    if found.searched.captures == 0:
        return "No match: there is nothing to compare with."
    if decision is None:
        return "No decision: with other settings than the shipped ones false match rates are not known."
    at = f"decided at a false match rate of {one_in(decision.fmr)} a comparison"
    if found.mode == "verification":
        return f"{'Verified' if decision.match else 'Not verified'}: {found.person} ({at})."
    if not decision.match:
        return f"No match: nobody is similar enough ({at})."
    best = found.candidates[0]
    return f"Match: {best.person}, {best.finger.replace('_', ' ')} ({at})."
