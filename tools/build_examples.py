"""Run every example and write ``docs/guide/examples.md``: what each shows, its output and its
pictures.

    make examples

Each example of ``examples/`` runs with ``--out FOLDER`` where it draws pictures. The page states
from which source each section was made (SHA-256), so that ``tests/test_examples.py`` notices an
example that was changed and not run again.
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import cv2

ROOT = Path(__file__).resolve().parents[1]
PAGE, PICTURES = ROOT / "docs" / "guide" / "examples.md", ROOT / "docs" / "images" / "examples"
ORDER = ("twin", "reconstruct", "prints", "match", "evaluate")
"""First on the page; the others follow by name."""
WIDEST_PX, MAX_BYTES = 1200, 200_000
HEAD = """# Examples, executed

Every section was made by running the file it names (`make examples` runs all of them again and \
rewrites this page):
what it is about, what it printed, and the pictures it drew. Each runs without arguments; \
`--help` lists what can be
changed.
"""


@dataclass(frozen=True)
class Done:
    """An example that ran."""

    name: str
    title: str
    words: str
    output: str
    pictures: tuple[Path, ...]
    sha256: str


def run(example: Path, folder: Path) -> Done:
    """Run one example; its pictures go to `folder`."""
    source = example.read_text(encoding="utf-8")
    title, _, words = plain(ast.get_docstring(ast.parse(source)) or "").partition("\n\n")
    title = " ".join(title.split())
    command = [sys.executable, str(example)]
    if "folder for pictures" in source:
        command += ["--out", str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=folder)
    if done.returncode != 0:
        raise SystemExit(f"{example.name} failed:\n{done.stderr}")
    pictures = tuple(sorted(path for path in folder.iterdir() if path.suffix in (".png", ".svg")))
    return Done(example.stem, title, words, done.stdout.rstrip(), pictures, digest(example))


def digest(example: Path) -> str:
    """SHA-256 of the source."""
    return hashlib.sha256(example.read_bytes()).hexdigest()


def plain(words: str) -> str:
    """A docstring without its commands and roles, as Markdown."""
    kept = [line for line in words.strip().splitlines() if "python examples/" not in line]
    text = "\n".join(line.strip() for line in kept).replace("``", "`").replace("::\n", ".\n")
    return text.strip()


def keep(picture: Path, name: str) -> str:
    """Put a picture into the documentation, small, and return its path from there."""
    if picture.suffix == ".svg":
        target = PICTURES / f"{name}-{picture.name}"
        shutil.copyfile(picture, target)
        return Path(os.path.relpath(target, PAGE.parent)).as_posix()
    image = cv2.imread(str(picture))
    if image.shape[1] > WIDEST_PX:
        fraction = WIDEST_PX / image.shape[1]
        image = cv2.resize(image, None, fx=fraction, fy=fraction, interpolation=cv2.INTER_AREA)
    quality = 88
    while (
        len(data := cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes())
        > MAX_BYTES
    ):
        quality -= 6
    target = PICTURES / f"{name}-{picture.stem}.jpg"
    target.write_bytes(data)
    return Path(os.path.relpath(target, PAGE.parent)).as_posix()


def section(example: Done) -> str:
    """One example, as Markdown."""
    short = example.name.removeprefix("plot_").replace("_", "-")
    pictures = "\n\n".join(
        f"![{path.stem.replace('-', ' ')}]({keep(path, short)})" for path in example.pictures
    )
    parts = [
        f"## {example.title.rstrip('.')}",
        f"<!-- {example.name}.py {example.sha256} -->",
        example.words,
        f"[examples/{example.name}.py](../../examples/{example.name}.py) prints:",
        f"```\n{example.output}\n```",
        pictures,
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def ordered(examples: list[Path]) -> list[Path]:
    """The main path first."""
    first = [f"plot_{name}" for name in ORDER]
    return sorted(
        examples,
        key=lambda path: (first.index(path.stem) if path.stem in first else len(first), path.stem),
    )


def main() -> None:
    """Run."""
    argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    ).parse_args()
    examples, done = ordered(sorted((ROOT / "examples").glob("plot_*.py"))), []
    with tempfile.TemporaryDirectory() as scratch:
        for example in examples:
            folder = Path(scratch) / example.stem
            folder.mkdir()
            sys.stdout.write(f"{example.name}\n")
            done.append(run(example, folder))
        shutil.rmtree(PICTURES, ignore_errors=True)
        PICTURES.mkdir(parents=True)
        page = "\n".join([HEAD, *(section(example) for example in done)])
    PAGE.write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main()
