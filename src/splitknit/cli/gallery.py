"""``splitknit gallery list|info|remove|export|import|check|repair|index|rekey|migrate``."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

from splitknit.cli.gallery_options import add_gallery, count
from splitknit.cli.verb import Outcome, Progress, group, natural, new_verb
from splitknit.gallery import NEW_KEY_VARIABLE


def add_gallery_verbs(verbs: Any) -> None:
    """Add ``splitknit gallery`` and what follows it."""
    kinds = group(verbs, "gallery", "look into a gallery, remove from it, export, import, check and encrypt it")
    listed = _kind(kinds, "list", "list whose fingers are in it", _list)
    listed.add_argument("--person", metavar="NAME", help="of this person only")
    _kind(kinds, "info", "show numbers and sizes; needs no key", _info)
    removed = _kind(kinds, "remove", "remove a person or a finger, so that nothing of it remains in the file", _remove)
    removed.add_argument("--person", metavar="NAME", help="whose fingers")
    removed.add_argument("--finger", metavar="FINGER", help="this one only")
    removed.add_argument("--session", metavar="S", help="this one only")
    removed.add_argument("--row", type=natural, action="append", default=[], metavar="N", help="a row that is damaged")
    exported = _kind(kinds, "export", "write all of it, not encrypted, into a folder of templates and a table", _export)
    exported.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder to write")
    exported.add_argument("--images", action="store_true", help="write kept images as well")
    exported.add_argument("--person", metavar="NAME", help="all that is kept of this person, images and codes included")
    imported = _kind(
        kinds, "import", "put an exported folder into a gallery, which is made where there is none", _import
    )
    imported.add_argument("folder", type=Path, metavar="FOLDER", help="what 'splitknit gallery export' wrote")
    imported.add_argument("--replace", action="store_true", help="let captures take the place of others")
    checked = _kind(kinds, "check", "look for damage, and for rows that something else changed", _check)
    checked.add_argument("--shards", type=Path, metavar="DIR", help="compare the codes here with the gallery's as well")
    _kind(kinds, "repair", "take out rows that cannot be opened, and accept the others as they are", _repair)
    indexed = _kind(
        kinds, "index", "make the codes that a search through very many fingers needs, where they are missing", _index
    )
    indexed.add_argument(
        "--shards", type=Path, metavar="DIR", help="keep them here as well, for searches through millions"
    )
    indexed.add_argument(
        "--renew",
        action="store_true",
        help="transform all in --shards anew: a stolen copy cannot be compared with them",
    )
    changed = _kind(kinds, "rekey", "encrypt it, change its key, or take the encryption away", _rekey)
    changed.add_argument(
        "--new-key-file",
        type=Path,
        metavar="FILE",
        help=f"the new key: a passphrase, or 64 hexadecimal digits (or the variable {NEW_KEY_VARIABLE})",
    )
    changed.add_argument("--plain", action="store_true", help="take the encryption away")
    _kind(kinds, "migrate", "make a gallery of version 1 one of version 2, in place", _migrate)


def _kind(
    kinds: Any, name: str, does: str, run: Callable[[argparse.Namespace, Any], Outcome]
) -> argparse.ArgumentParser:
    def with_key(options: argparse.Namespace) -> Outcome:
        from splitknit.gallery.key import key_of  # verbs import what they need

        return run(options, key_of(options.key_file))

    verb = new_verb(kinds, name, does, with_key)
    add_gallery(verb)
    return verb


def _list(options: argparse.Namespace, key: Any) -> Outcome:
    from dataclasses import asdict

    from splitknit.gallery.manage import list_gallery  # verbs import what they need

    rows = list_gallery(options.gallery, options.person, key=key)
    lines = [f"{'row':>5}  {'person':24} {'finger':13} {'session':8} {'from':9} skin"]
    captures = []
    for one in rows:
        entry, acquired = one.entry, one.template_bytes > 0
        skin = f"{entry.area_mm2:.0f} mm²" if acquired else f"failure to acquire ({entry.failure or 'unknown'})"
        kept = f", with {entry.images} image" if entry.images else ""
        lines.append(f"{one.row:>5}  {entry.person:24} {entry.finger:13} {entry.session:8} {entry.kind:9} {skin}{kept}")
        facts = {"row": one.row, **asdict(entry), "acquired": acquired}
        captures.append(facts | {"images": entry.images or "none", "enrolled_at": entry.enrolled_at or None})
    return {"gallery": str(options.gallery), "captures": captures}, lines


def _info(options: argparse.Namespace, key: Any) -> Outcome:
    from splitknit.gallery.manage import gallery_info

    facts = gallery_info(options.gallery, key=key)
    locked = {None: "not encrypted", "raw": "encrypted, by a key of 32 bytes", "scrypt": "encrypted, by a passphrase"}
    lines = [f"{facts['gallery']}: a gallery of version {facts['version']}, {locked.get(facts['key'], 'encrypted')}."]
    known = facts["people"] is not None
    people = f" of {count(facts['fingers'], 'finger')} of {count(facts['people'], 'person', 'people')}" if known else ""
    lines.append(
        f"{count(facts['captures'], 'capture')}{people}, {facts['template_bytes'] / 1e6:.2f} MB of templates (version "
        f"{facts['template_version']}), {facts['file_bytes'] / 1e6:.2f} MB in all."
    )
    if facts["failures"]:
        lines.append(f"{facts['failures']} of them are failures to acquire.")
    lines.append(f"{facts['with_code']} have a search code, {facts['with_images']} have images.")
    return facts, lines


def _remove(options: argparse.Namespace, key: Any) -> Outcome:
    from splitknit.gallery.manage import remove_from_gallery

    facts = remove_from_gallery(
        options.gallery,
        person=options.person,
        finger=options.finger,
        session=options.session,
        rows=options.row,
        key=key,
    )
    return facts, [
        f"Removed {count(facts['removed'], 'capture')} from {facts['gallery']}; {facts['captures']} are left."
    ]


def _export(options: argparse.Namespace, key: Any) -> Outcome:
    from splitknit.gallery.manage import export_gallery

    facts = export_gallery(options.gallery, options.out, key=key, images=options.images, person=options.person)
    lines = [f"Wrote {count(facts['captures'], 'template')} and gallery.csv to {facts['out']}."]
    lines.append("Please note: they are personal data, and they are not encrypted there.")
    return facts, lines


def _import(options: argparse.Namespace, key: Any) -> Outcome:
    from splitknit.gallery.manage import import_gallery

    facts = import_gallery(options.gallery, options.folder, key=key, replace=options.replace)
    known = facts["found"] - facts["new"]
    return facts, [f"{facts['new']} captures came in, {known} were there already; {facts['captures']} are in it now."]


def _check(options: argparse.Namespace, key: Any) -> Outcome:
    from splitknit.gallery.manage import check_gallery

    facts = check_gallery(options.gallery, key=key, shards=options.shards)
    shards = "" if options.shards is None else f", and {options.shards} holds their codes"
    return facts, [f"{facts['gallery']} is sound: all {facts['captures']} captures can be opened{shards}."]


def _repair(options: argparse.Namespace, key: Any) -> Outcome:
    from splitknit.gallery.manage import repair_gallery

    facts = repair_gallery(options.gallery, key=key)
    rows = f" (rows {', '.join(map(str, facts['removed']))})" if facts["removed"] else ""
    return facts, [
        f"Took {count(len(facts['removed']), 'row')}{rows} out of {facts['gallery']}; {facts['captures']} others are "
        "accepted as they are."
    ]


def _migrate(options: argparse.Namespace, key: Any) -> Outcome:
    from splitknit.gallery.manage import migrate_gallery

    facts = migrate_gallery(options.gallery, key=key)
    return facts, [
        f"{facts['gallery']} ({count(facts['captures'], 'capture')}) is a gallery of version {facts['version']} now."
    ]


def _index(options: argparse.Namespace, key: Any) -> Outcome:
    from splitknit.gallery.manage import index_gallery

    with Progress(options) as progress:
        facts = index_gallery(
            options.gallery, key=key, shards=options.shards, renew=options.renew, progress=progress.update
        )
    lines = [f"Made {facts['coded']} codes of version {facts['code_version']}."]
    if facts["shards"] is not None:
        written = count(facts["shards"]["written"], "shard")
        lines.append(
            f"{facts['shards']['shards']} holds {count(facts['shards']['fingers'], 'code')}; wrote {written}, "
            f"{facts['shards']['kept']} were up to date."
        )
        if not facts["shards"]["keyed"]:
            lines.append("Please note: without a key anyone can undo the codes' transform.")
    return facts, lines


def _rekey(options: argparse.Namespace, key: Any) -> Outcome:
    from splitknit.gallery.key import key_of
    from splitknit.gallery.manage import rekey_gallery

    new = None if options.plain else key_of(options.new_key_file, NEW_KEY_VARIABLE)
    facts = rekey_gallery(options.gallery, key=key, new=new, plain=options.plain)
    state = "encrypted under the new key" if facts["encrypted"] else "not encrypted any more"
    return facts, [
        f"{facts['gallery']} ({count(facts['captures'], 'capture')}) is {state}. Copies made before are as they were."
    ]
