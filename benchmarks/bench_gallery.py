"""A gallery of very many fingers: what opening, the check of its root, and reading cost; processor time, one thread.

    python benchmarks/bench_gallery.py [--fingers 100000]

The contents are noise of the usual sizes but for the templates, which are short: none of this reads them.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from splitknit_match.gallery.entry import Entry, NewCapture
from splitknit_match.gallery.gallery import Gallery
from splitknit_match.gallery.key import Key
from splitknit_match.matching.code import CODE_VERSION, code_size


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fingers", type=int, default=100_000)
    options = parser.parse_args()
    for name, key in (("plain", None), ("encrypted", Key(bytes(32), raw=True))):
        with tempfile.TemporaryDirectory() as folder:
            measure(name, Path(folder, "gallery"), key, options.fingers)


def measure(name: str, path: Path, key: Key | None, fingers: int) -> None:
    code, template = os.urandom(code_size()), os.urandom(500)

    def capture(number: int) -> NewCapture:
        entry = Entry(f"P{number}", "right_index", "1", "result", "0" * 64)
        return NewCapture(entry, template, code, CODE_VERSION)

    with Gallery.create(path, "5e" * 32, key) as gallery:
        gallery.add(map(capture, range(fingers)))
    with Gallery.open(path, key) as gallery:
        for what, act in (
            ("open, compare rows and root", lambda: gallery.without_code(CODE_VERSION)),
            ("find no row without code again", lambda: gallery.without_code(CODE_VERSION)),
            ("read all codes", lambda: gallery.codes(CODE_VERSION)),
            ("read all entries", gallery.entries),
            ("add one", lambda: gallery.add([capture(fingers)])),
            ("remove one", lambda: gallery.remove([1])),
        ):
            print(f"{name}, {fingers} fingers: {what}: {1000 * seconds(act):.0f} ms")


def seconds(act: Callable[[], object]) -> float:
    start = time.process_time()
    act()
    return time.process_time() - start


if __name__ == "__main__":
    main()
