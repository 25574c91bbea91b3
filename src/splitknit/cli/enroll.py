"""``splitknit enroll GALLERY SOURCE...``: fingers into a gallery."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from splitknit.cli.gallery_options import add_gallery, count
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
    refuse_given,
)

if TYPE_CHECKING:
    from splitknit.gallery.enrol import EnrolledCapture
from splitknit.errors import require


def add_enroll(verbs: Any) -> None:
    """Add the verb."""
    verb = new_verb(verbs, "enroll", "put fingers into a gallery, which is made where there is none", _run)
    add_gallery(verb)
    what = f"{FINGERS}; several are sessions of one finger"
    verb.add_argument("sources", type=Path, metavar="SOURCE", nargs="*", help=what)
    verb.add_argument("--person", metavar="NAME", help="whose finger it is")
    verb.add_argument("--finger", metavar="FINGER", help="which, such as right_index")
    verb.add_argument("--session", metavar="S", help="which session (default: the next number)")
    verb.add_argument(
        "--population",
        type=Path,
        metavar="FOLDER",
        help="instead of sources: a whole enrolment, FOLDER/S01/session_1/right_index (or right_index.png) and so on; "
        "resumable",
    )
    verb.add_argument("--workers", type=natural, metavar="N", help="processes for a population (default: 1)")
    verb.add_argument(
        "--keep-images",
        choices=("none", "thumbnail", "raw"),
        default="none",
        help="what is kept beside the template: nothing (default), a small print, or the source's files",
    )
    verb.add_argument("--replace", action="store_true", help="let a capture take the place of one of the same names")
    verb.add_argument("--with-time", action="store_true", help="keep the time of enrolment as well")
    add_refusal(verb)
    add_input_ppi(verb)
    add_preset(verb)
    add_settings(verb)


def _run(options: argparse.Namespace) -> Outcome:
    from splitknit.cli.options import read_changes
    from splitknit.gallery.enrol import Enrolling, enroll_files  # verbs import what they need
    from splitknit.gallery.key import key_of
    from splitknit.io.provenance import known_json
    from splitknit.matching.surface import MatchingSettings
    from splitknit.settings import override

    matching = override(MatchingSettings(), read_changes(options.settings, options.assignments))
    settings = from_options(Enrolling, options, matching=matching, keep=options.keep_images)
    key = key_of(options.key_file)
    with Progress(options) as progress:
        refuse_attacks(options, options.sources, progress.update)
        if options.population is not None:
            facts, lines = _population(options, settings, key, progress)
        else:
            require(options.workers is None, "--workers is for --population.")
            if options.person is None or options.finger is None:
                require(False, "name whose finger it is: --person NAME --finger right_index (or --population FOLDER).")
            found = enroll_files(
                options.gallery, options.sources, options.person, options.finger, options.session,
                settings=settings, key=key, progress=progress.update,
            )  # fmt: skip
            facts = {**known_json(found.content), "enrolled": known_json(found.enrolled)}
            lines = [_words(one) for one in found.enrolled]
    locked = ", encrypted" if facts["encrypted"] else ""
    lines.append(
        f"{facts['gallery']} holds {count(facts['captures'], 'capture')} of {count(facts['fingers'], 'finger')} of "
        f"{count(facts['people'], 'person', 'people')}{locked}."
    )
    return facts, lines


def _population(options: argparse.Namespace, settings: Any, key: Any, progress: Progress) -> Outcome:
    from splitknit.batch.enrol import enroll_population

    refuse_given(options, ("person", "finger", "session"), "does not go with --population, whose folders have names.")
    require(not options.sources, "name sources or a --population, not both.")
    facts = enroll_population(
        options.gallery, options.population, settings,
        key=key, workers=1 if options.workers is None else options.workers, progress=progress.update,
    )  # fmt: skip
    failed = facts["failures_to_acquire"]
    lines = [f"{count(facts['new'], 'capture')} enrolled, {facts['known']} of {facts['found']} were there already."]
    if failed:
        lines.append(
            f"Please note: {count(len(failed), 'failure')} to acquire, kept as such "
            f"(first: {failed[0]['path']}: {failed[0]['reason'].rstrip('.')})."
        )
    return facts, lines


def _words(one: EnrolledCapture) -> str:
    who = f"{one.person}, {one.finger.replace('_', ' ')}, session {one.session}"
    if not one.new:
        return f"{who} was enrolled from the same source already."
    if not one.acquired:
        lacks = "too few ridges or minutiae (failure to acquire)"
        return f"Please note: {who} holds {lacks}; it is kept as such and will match nobody."
    kept = {"none": "", "thumbnail": ", with a small print", "raw": ", with its images"}[one.images]
    held = f"{one.area_mm2:.0f} mm² of skin" if one.area_mm2 else "minutiae"
    return f"Enrolled {who}: {held}, {one.template_bytes / 1000:.1f} kB{kept}."
