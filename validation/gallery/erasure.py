"""What stays of removed captures on an ext4 disk: a gallery on a disk image, removals, and a search of all its blocks.

    sudo python validation/gallery/erasure.py [--out validation/gallery/erasure.json]

For each kind of gallery and of disk an image is made (``mkfs.ext4``) and mounted; captures of noise are enrolled, some
are replaced, coded and removed, each change in a program of its own; then the image is unmounted and searched for the
bytes that were stored for them, also where no file lies any more. Two controls show that the search can find: the same
with journals that are only unlinked, and a disk that keeps data in its own journal (``data=journal``). Needs root (loop
devices) and says so where it is not.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from splitknit.io.atomic import atomic_file
from splitknit_match.gallery.entry import Entry, NewCapture
from splitknit_match.gallery.gallery import Gallery
from splitknit_match.gallery.key import Key

IMAGE_BYTES = 48 * 2**20
PIECE = 16
KEY = Key(bytes(range(32)), raw=True)
CASES = (
    # name, key at first, key at last, mount option, what is done to the program
    ("plain", None, None, "", ""),
    ("encrypted", KEY, KEY, "", ""),
    ("plain, then encrypted", None, KEY, "", ""),
    ("plain, writers killed", None, None, "", "killed"),
    ("encrypted, writers killed", KEY, KEY, "", "killed"),
    ("plain, control: journals only unlinked", None, None, "", "unlinked"),
    ("plain, disk with data=journal", None, None, "data=journal", ""),
    ("encrypted, disk with data=journal", KEY, KEY, "data=journal", ""),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=None)
    parser.add_argument("--step", nargs=4, default=None, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.step is not None:
        step(*options.step)
        return
    if os.geteuid() != 0:
        sys.exit("loop devices cannot be mounted here without root; run this with sudo.")
    found = []
    for case in CASES:
        found.append(measured(*case))
        print(json.dumps(found[-1]))
    if options.out is not None:
        with atomic_file(options.out) as stream:
            stream.write((json.dumps(found, indent=1) + "\n").encode("ascii"))


def measured(name: str, first: Key | None, last: Key | None, option: str, broken: str) -> dict[str, object]:
    with tempfile.TemporaryDirectory() as scratch:
        image, disk = Path(scratch, "image"), Path(scratch, "disk")
        disk.mkdir()
        with image.open("wb") as stream:
            stream.truncate(IMAGE_BYTES)
        run("mkfs.ext4", "-q", "-F", "-E", "lazy_itable_init=0,lazy_journal_init=0", str(image))
        mounted = subprocess.run(
            ["mount", "-o", ",".join(["loop", *([option] if option else [])]), str(image), str(disk)],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        if mounted.returncode != 0:
            sys.exit(f"loop devices cannot be mounted here: {mounted.stderr.strip()}")
        try:
            removed, kept = worked(disk, first, last, broken)
        finally:
            run("umount", str(disk))
        data = image.read_bytes()
    left = {what: sum(piece in data for piece in pieces) for what, pieces in removed.items()}
    return {
        "case": name,
        "pieces_searched": {what: len(pieces) for what, pieces in removed.items()},
        "pieces_left": left,
        "pieces_of_kept_captures_found": f"{sum(piece in data for piece in kept)} of {len(kept)}",
    }


def worked(disk: Path, first: Key | None, last: Key | None, broken: str) -> tuple[dict[str, list[bytes]], list[bytes]]:
    """Enrol, change and remove; pieces of what was stored and is gone, and of what is still stored."""
    path = disk / "people.skg"
    (disk / "tmp").mkdir()
    Gallery.create(path, "5e" * 32, first).close()
    stored: dict[bytes, str] = {}

    def changed(what: str, number: int) -> None:
        key = first if what != "remove" or last is first else last
        command = [sys.executable, __file__, "--step", str(path), what, str(number), f"{int(key is not None)}{broken}"]
        # SQLite's temporary files, if it made any, would lie on the disk as well
        environment = os.environ | {"SQLITE_TMPDIR": str(disk / "tmp"), "TMPDIR": str(disk / "tmp")}
        if broken == "killed":
            with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE) as program:
                assert program.stdout is not None
                program.stdout.readline()  # it is about to begin
                time.sleep(random.Random(number).uniform(0, 0.01))
                program.send_signal(signal.SIGKILL)
        subprocess.run(command, env=environment, check=True, stdout=subprocess.DEVNULL)
        stored.update(cells(path))
        os.sync()

    for number in range(12):
        changed("add", number)
    for number in (2, 5):
        changed("replace", number)
    changed("code", 3)
    if last is not first:
        with Gallery.open(path) as gallery:
            gallery.rekey(last)
    for number in (1, 3, 5, 6, 9, 11):
        changed("remove", number)
    now = set(cells(path))
    removed: dict[str, list[bytes]] = {what: [] for what in ("entry", "code", "template", "images")}
    for piece, what in stored.items():
        if piece not in now:
            removed[what].append(piece)
    return removed, sorted(now)


def cells(path: Path) -> dict[bytes, str]:
    """Pieces of all that is stored, with their kind."""
    raw = sqlite3.connect(f"file:{path}?mode=ro", uri=True)
    queries = {"entry": "entry FROM finger", "code": "code FROM finger WHERE code IS NOT NULL"}
    queries |= {"template": "content FROM template", "images": "content FROM images"}
    found = {}
    for what, query in queries.items():
        for (cell,) in raw.execute(f"SELECT {query}"):
            sealed = cell[-224:-PIECE] if what == "entry" else cell  # a plain entry is mostly words that others share
            for start in range(0, len(sealed) - PIECE, 16 if what == "entry" else 500):
                found[bytes(sealed[start : start + PIECE])] = what
    raw.close()
    return {piece: what for piece, what in found.items() if len(set(piece)) > 4}


def step(path: str, what: str, number: str, how: str) -> None:
    """One change, in a program of its own."""
    if how.endswith("unlinked"):
        from splitknit_match.gallery import rows as gallery_rows

        def unlinked(database: sqlite3.Connection, path: Path) -> None:
            Path(f"{path}-journal").unlink(missing_ok=True)

        gallery_rows.wipe_journal = unlinked  # type: ignore[assignment]
    rng = random.Random(f"{what} {number}")
    entry = Entry(f"P{number}", "right_index", "1", "result", rng.randbytes(32).hex(), images="thumbnail")
    with Gallery.open(path, KEY if how.startswith("1") else None) as gallery:
        print("ready", flush=True)
        rows = [one.row for one in gallery.entries(entry.person)]
        if what in ("add", "replace"):
            one = NewCapture(entry, rng.randbytes(9000), rng.randbytes(700), 1, rng.randbytes(20_000))
            gallery.add([one], replace=True)
        elif what == "code":
            gallery.set_codes({row: rng.randbytes(700) for row in rows}, 2)
        else:
            gallery.remove(rows)


def run(*command: str) -> None:
    subprocess.run(command, check=True, capture_output=True)


if __name__ == "__main__":
    main()
