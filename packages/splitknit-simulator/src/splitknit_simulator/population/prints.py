"""Ridges of real prints for a third of a population's fingers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from splitknit import file_hash, naming, require
from splitknit_simulator.finger.finger import SimulatedFinger
from splitknit_simulator.finger.master_print import MasterPrint
from splitknit_simulator.twin import master_of_print_file

FRACTION = 1 / 3  # fraction of the fingers with ridges of a real print, where there are prints enough
_SUFFIXES = (".png", ".tif", ".tiff", ".jpg", ".jpeg")


@dataclass(frozen=True, slots=True)
class RealPrint:
    """The print whose ridges a finger has."""

    file: str  # its name in the folder of prints
    sha256: str  # hash of the file
    mirrored: bool = False  # whether the finger is the one that would leave the mirror image

    def sound(self) -> bool:
        """Whether this, read from a file, can be what was written."""
        kinds = (type(self.file), type(self.sha256), type(self.mirrored))
        return kinds == (str, str, bool) and Path(self.file).name == self.file

    @property
    def words(self) -> str:
        """As a table has it."""
        return f"{self.file}{', mirrored' * self.mirrored}"


@dataclass(frozen=True, slots=True)
class RealPrints:
    """A folder of prints, and which finger has which."""

    folder: Path = Path()
    of_finger: Mapping[str, RealPrint] = field(default_factory=dict)
    """By the finger's name in the world, such as ``S01/right_index``."""

    def master(self, name: str, finger: SimulatedFinger) -> tuple[MasterPrint, str]:
        """The master print of a finger, and the real print that it is from: '' where it is drawn; BadInput if that
        changed.
        """
        if name not in self.of_finger:
            return finger.master(), ""
        one = self.of_finger[name]
        self.check(one)
        path = self.folder / one.file
        laid = partial(master_of_print_file, path, finger.seed, finger.print_settings, mirrored=one.mirrored)
        return naming(path, laid), one.words

    def check(self, one: RealPrint) -> None:
        """Refuse a file that is not what it was when the population was begun."""
        path = self.folder / one.file
        require(
            path.is_file() and file_hash(path) == one.sha256,
            f"'{path}' is not the print that the population was begun with; name the folder that holds it.",
        )


def choose_prints(
    folder: Path,
    seed: int,
    subjects: Sequence[str],
    fingers: Sequence[str],
    dealt: Mapping[str, RealPrint] | None = None,
) -> RealPrints:
    """Deal real prints out to a third of a population's fingers, as evenly over people as their number allows.

    Files of `folder` (PNG, TIFF or JPEG of 500 pixels an inch, tip up, ridges dark) are named
    ``FINGER_IMPRESSION.png``: what stands before the last underscore is one real finger, and it becomes one finger of
    the population, in all sessions, by the first of its impressions in the order of names. Where there are fewer real
    fingers than a third, their mirror images are others (no matcher mirrors); where these are too few as well, fewer
    fingers than a third have a real print's ridges.

    `dealt`: what was dealt out when the population was begun; then that is kept, and the files are compared. Raises
    BadInput if the folder holds no prints, one of those chosen shows no ridges, or one is not what it was.
    """
    if dealt is not None:
        require(len(dealt) > 0, "the population was begun without real prints; leave them out, or name another folder.")
        kept = RealPrints(folder, dealt)
        for one in dealt.values():
            kept.check(one)
        return kept
    firsts = _first_impressions(folder)
    wanted = max(1, round(FRACTION * len(subjects) * len(fingers)))
    rng = np.random.default_rng(np.random.SeedSequence([seed, 0xB0D4]))
    identities = [(firsts[k], mirrored) for mirrored in (False, True) for k in rng.permutation(len(firsts))][:wanted]
    for path, mirrored in identities:
        naming(path, partial(master_of_print_file, path, mirrored=mirrored))
    own = {subject: rng.permutation(len(fingers)) for subject in subjects}
    places = [
        f"{subjects[k]}/{fingers[own[subjects[k]][turn]]}"
        for turn in range(len(fingers))
        for k in rng.permutation(len(subjects))
    ]
    chosen = (RealPrint(path.name, file_hash(path), mirrored) for path, mirrored in identities)
    return RealPrints(folder, dict(zip(places, chosen, strict=False)))


def _first_impressions(folder: Path) -> list[Path]:
    """One file of each real finger, by name."""
    require(folder.is_dir(), f"'{folder}' is no folder of prints.")
    files = sorted(path for path in folder.iterdir() if path.suffix.lower() in _SUFFIXES and path.is_file())
    require(len(files) > 0, f"'{folder}' holds no prints (PNG, TIFF or JPEG).")
    firsts: dict[str, Path] = {}
    for path in files:
        firsts.setdefault(path.stem.rpartition("_")[0] or path.stem, path)
    return list(firsts.values())
