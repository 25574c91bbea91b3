"""Photographs of many people, as the thesis's authors have them, become a population for
``splitknit batch``.

    splitknit calibrate lights --table examples/thesis_tips.csv --px-per-cm 757 \\
        --image-size 2200,3200 --led-height-cm 14 --led-radius-cm 5 --led-centre-px 1575,1174 \\
        --keep --out rig.json
    python validation/thesis/people.py TREE \\
        --images '{subject}/{session}/{finger}/white_{light}.jpg' \\
        --nir '{subject}/{session}/{finger}/ir_{light}.jpg' \\
        --lights rig.json --out people [--dry-run]

Captures with missing, doubled or unreadable files are named and left out; the same command goes on
where it stopped.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from splitknit.errors import BadInput, require
from splitknit.folders import capture_of
from splitknit.io.capture import write_capture
from splitknit.io.enrolment import (
    FINGERS,
    PLAN_FILE,
    PlannedCapture,
    open_enrolment,
    plan_enrolment,
)
from splitknit.io.photograph_files import some_of
from splitknit.io.photographs import GivenPhotographs
from splitknit.io.photos import SUFFIXES

_SIDE = "right|left|r|l"
_DIGIT = "thumb|index|fore|middle|ring|little|pinky|small|10|[1-9]"
_FIELDS = {
    "subject": r"[^/]+?",
    "session": r"[a-z]*[ _-]?\d+(?:[.-]\d+)*",
    "hand": _SIDE,
    "finger": rf"(?:(?:{_SIDE})[ _.-]*)?(?:{_DIGIT})(?:[ _.-]*finger)?(?:[ _.-]*(?:{_SIDE}))?",
    "light": r"\d{1,6}",
}
_KNOWN = ", ".join(f"{{{name}}}" for name in _FIELDS)
_MAX_NAME = 300
_Key = tuple[str, str, str]


@dataclass(frozen=True, slots=True)
class PhotographTree:
    """What a folder of photographs of many people holds."""

    captures: tuple[tuple[PlannedCapture, tuple[Path, ...]], ...]
    """Complete ones, in the order of an enrolment: paths of white and NIR photographs with
    ``{light}``."""
    plan: dict[str, Any]  # ``subjects``, ``sessions`` and ``fingers`` of the enrolment
    # what is missing, doubled or not understood, a sentence each; those captures are left out
    faults: tuple[str, ...]


def read_tree(root: Path, patterns: Sequence[str]) -> PhotographTree:
    """Find the captures below a folder by patterns of the files' paths; no photograph is opened.

    A pattern, of the white photographs and of the near-infrared ones where there are any, is a path
    below `root` with ``{subject}``, ``{session}``, ``{finger}`` and ``{light}`` for what varies;
    ``{hand}`` where it stands apart from the finger, ``{session}`` may be absent. Fingers are named
    (``right_index``, ``Left Thumb``, ``R2``) or have their numbers of ISO 19794 (1 right thumb to
    10 left little). Subjects and sessions keep the numbers in their names where these are small,
    else they are counted in the order of their names. Raises BadInput if a pattern lacks a field,
    or nothing below `root` fits.
    """
    require(root.is_dir(), f"{root} is not a folder; name the one of all people's photographs.")
    paths = (path.relative_to(root) for path in root.rglob("*") if path.is_file())
    names = sorted(
        path.as_posix() for path in paths if not any(part.startswith(".") for part in path.parts)
    )
    series = [_photographs(names, pattern) for pattern in patterns]
    for files_of, pattern in zip(series, patterns, strict=True):
        require(
            len(files_of) > 0,
            f"none of {len(names)} files below {root} fits the pattern {pattern!a}.",
        )
    keys = sorted(set[_Key]().union(*series))
    subjects, sessions = _numbers({key[0] for key in keys}), _numbers({key[1] for key in keys})
    known = tuple(name for name in FINGERS if name in map(_finger_of, (key[2] for key in keys)))
    require(
        len(known) > 0, f"{keys[0][2]!a} is not a known finger; right_index, R2 and 2 would be."
    )
    lights = [{number for files in files_of.values() for number in files} for files_of in series]
    complete: dict[PlannedCapture, tuple[Path, ...]] = {}
    faults, taken = [], dict[PlannedCapture, str]()
    for key in keys:
        finger, source = _finger_of(key[2]), " ".join(filter(None, key))
        if finger is None:
            faults.append(f"{source}: no finger is known by that name.")
            continue
        place = PlannedCapture(f"S{subjects[key[0]]:02d}", sessions[key[1]], finger)
        wrong = [f"is also {taken[place]}"] if place in taken else []
        taken.setdefault(place, source)
        have = [files_of.get(key, {}) for files_of in series]
        for band, wanted, there in zip(("white", "NIR"), lights, have, strict=False):
            twice = [name for files in there.values() for name in files[1:]]
            lacking = [str(light) for light in sorted(wanted - set(there))]
            wrong += [f"lacks {band} {some_of(lacking)}"] if lacking else []
            wrong += [f"has a second file for a {band} light, {some_of(twice)}"] if twice else []
        if wrong:
            faults.append(f"{place.words} ({source}) {' and '.join(wrong)}.")
        else:
            first = [next(iter(there.values()))[0] for there in have]
            complete[place] = tuple(
                root / _of_lights(*pair) for pair in zip(first, patterns, strict=True)
            )
    people, days = range(1, max(subjects.values()) + 1), range(1, max(sessions.values()) + 1)
    planned = [
        PlannedCapture(f"S{who:02d}", day, name) for day in days for who in people for name in known
    ]
    absent = [place.words for place in planned if place not in taken]
    faults += [f"nothing is there of {some_of(absent)}."] if absent else []
    used = {
        name
        for files_of in series
        for by_light in files_of.values()
        for files in by_light.values()
        for name in files
    }
    left = [name for name in names if name not in used and Path(name).name != "lights.txt"]
    faults += [f"{len(left)} files fit no pattern: {some_of(left)}."] if left else []
    captures = tuple((place, complete[place]) for place in planned if place in complete)
    plan = {"subjects": len(people), "sessions": len(days), "fingers": known}
    return PhotographTree(captures, plan, tuple(faults))


def _form(pattern: str) -> re.Pattern[str]:
    """The expression of a pattern of paths. Raises BadInput if a field is missing or unknown."""
    parts = re.split(r"\{(\w+)\}", pattern)
    fields = parts[1::2]
    wrong = [f"has a field {{{name}}}" for name in fields if name not in _FIELDS]
    wrong += [f"lacks {{{name}}}" for name in ("subject", "finger", "light") if name not in fields]
    wrong += (
        []
        if "{light}" in pattern.rsplit("/", 1)[-1]
        else ["has {light} elsewhere than in the file's name"]
    )
    require(
        not wrong, f"the pattern {pattern!a} {wrong[0] if wrong else ''}; its fields are {_KNOWN}."
    )
    text = ""
    for k, part in enumerate(parts):
        again = part in parts[1:k:2]
        text += (
            re.escape(part)
            if k % 2 == 0
            else f"(?P={part})"
            if again
            else f"(?P<{part}>{_FIELDS[part]})"
        )
    return re.compile(text, flags=re.IGNORECASE)


def _photographs(names: Iterable[str], pattern: str) -> dict[_Key, dict[int, list[str]]]:
    """Files by finger and session, and by light."""
    form = _form(pattern)
    photographs: dict[_Key, dict[int, list[str]]] = defaultdict(lambda: defaultdict(list))
    for name in names:
        match = (
            form.fullmatch(name)
            if len(name) <= _MAX_NAME and Path(name).suffix.lower() in SUFFIXES
            else None
        )
        if match:
            parts = {"session": "", "hand": "", **match.groupdict()}
            finger = f"{parts['hand']} {parts['finger']}".strip()
            photographs[parts["subject"], parts["session"], finger][int(parts["light"])].append(
                name
            )
    return photographs


def _of_lights(name: str, pattern: str) -> str:
    """The path of a photograph with ``{light}`` in the place of its number."""
    match = _form(pattern).fullmatch(name)
    return (
        name
        if match is None
        else f"{name[: match.start('light')]}{{light}}{name[match.end('light') :]}"
    )


def _finger_of(text: str) -> str | None:
    """``right_index`` of what a folder calls it; None where it is not a finger."""
    match = re.fullmatch(
        rf"({_SIDE})?[ _.-]*({_DIGIT})(?:[ _.-]*finger)?[ _.-]*({_SIDE})?", text.lower()
    )
    side, digit = ((match[1] or match[3] or "")[:1], match[2]) if match else ("", "")
    if digit.isdecimal():
        return FINGERS[int(digit) - 1 + 5 * (side == "l")] if not side or int(digit) <= 5 else None
    digit = {"fore": "index", "pinky": "little", "small": "little"}.get(digit, digit)
    return f"{'left' if side == 'l' else 'right'}_{digit}" if side else None


def _numbers(names: Iterable[str]) -> dict[str, int]:
    """A number for each name: the last one in it where all differ and at most half are absent, else
    in order."""
    parts = {name: [int(digits) for digits in re.findall(r"\d+", name)] for name in names}
    own = {
        name: numbers[-1]
        for name, numbers in parts.items()
        if numbers and 1 <= numbers[-1] <= 2 * len(parts)
    }
    order = sorted(parts, key=lambda name: (re.sub(r"\d+", "", name), parts[name], name))
    return (
        own
        if len(set(own.values())) == len(parts)
        else {name: k for k, name in enumerate(order, start=1)}
    )


def import_people(
    tree: PhotographTree, out: Path, photographs: dict[str, Any], *, dry_run: bool = False
) -> tuple[list[str], list[str]]:
    """Write a population of the captures of a tree, or what of it is missing; return what was
    written, and faults. `photographs`: what is known of them. BadInput if `out` holds other people.
    """
    enrolment = plan_enrolment(out, **tree.plan)
    require(
        not (out / PLAN_FILE).is_file() or plan_enrolment(out).plan == enrolment.plan,
        f"'{out}' is a population of other people, sessions or fingers than this tree; name another"
        " folder.",
    )
    written, faults = [], list(tree.faults)
    for place, (images, *nir) in tree.captures:
        if enrolment.finished(place):
            continue
        words = f"{place.folder}: {images}"
        if dry_run:
            written.append(words)
            continue
        try:
            source = GivenPhotographs(
                images, nir=nir[0] if nir else None, material="skin", **photographs
            )
            capture, _ = capture_of(source)
        except BadInput as error:
            faults.append(f"{place.words}: {error}")
            continue
        open_enrolment(out, **tree.plan)
        capture = replace(
            capture, subject={"id": place.subject, "finger": place.finger, "session": place.session}
        )
        write_capture(capture, enrolment.path(place))
        written.append(words)
    return written, faults


def main(arguments: Sequence[str] | None = None) -> int:
    """Import what the command line names."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("tree", type=Path, help="folder of everybody's photographs")
    parser.add_argument(
        "--images", required=True, help="pattern of white photographs' paths below it"
    )
    parser.add_argument("--nir", help="pattern of near-infrared photographs' paths")
    parser.add_argument("--lights", type=Path, help="rig file, or list of lights")
    parser.add_argument("--px-per-mm", type=float, help="scale, with a list of lights")
    parser.add_argument("--out", type=Path, required=True, help="population to write")
    parser.add_argument("--dry-run", action="store_true", help="say what goes where, write nothing")
    options = parser.parse_args(arguments)
    try:
        tree = read_tree(
            options.tree, [pattern for pattern in (options.images, options.nir) if pattern]
        )
        known = {"lights": options.lights, "px_per_mm": options.px_per_mm}
        written, faults = import_people(tree, options.out, known, dry_run=options.dry_run)
    except BadInput as error:
        sys.exit(str(error))
    print("\n".join(written if options.dry_run else []))
    print(
        f"{len(tree.captures)} complete captures, {len(written)}"
        f" {'would be ' if options.dry_run else ''}written."
    )
    print("\n".join(f"Please note: {fault}" for fault in faults))
    return 0 if written or not faults or options.out.exists() else 2


if __name__ == "__main__":
    sys.exit(main())
