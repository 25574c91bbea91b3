"""Both readings of the thesis's "normals": of the integrated surface, and as photometric stereo measured them.

The text does not say which. The same captures of a population, four fingers of each person, are reconstructed by each
case, and compared by local binary patterns of either field of normals.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from compared import Way, captures_of, compare_pairs, each, kept_images, read_images
from trials import Pairs, Table, Trial

from splitknit import __version__
from splitknit.evaluation.protocol import comparisons
from splitknit.io.capture import read_capture
from splitknit.io.provenance import settings_hash
from splitknit.matching.features import lbp_features
from splitknit.matching.surface import surface_images
from splitknit.matching.thesis import NORMALS, FingerImages
from splitknit.model import surface_of
from splitknit.pipeline import reconstruct
from splitknit.presets import preset_settings

CASES = ("snk", "pr", "ea")
MEASURED = tuple(f"measured_{name}" for name in NORMALS)
WAYS = (
    Way("of the surface", lbp_features, "normals", NORMALS),
    Way("measured", lbp_features, "measured normals", MEASURED),
)


def normals_table(population: Path, scratch: Path, fingers: Sequence[str], jobs: int) -> Table:
    """Trials of each case and reading, all pairs. Images and comparisons are kept in `scratch`."""
    names = [path.parent.relative_to(population).as_posix() for path in population.glob("S*/session_*/*/capture.json")]
    captures = captures_of([name for name in names if name.split("/")[2] in fingers])
    every = comparisons(captures.finger.tolist(), captures.session.tolist())
    pairs = Pairs(captures, every.a, every.b)
    trials: list[Trial] = []
    for case in CASES:
        place = scratch / settings_hash([preset_settings(case), __version__, str(population)])[:12]
        each(partial(_keep, population, place, case), captures.names.tolist(), jobs)
        found = compare_pairs(pairs, partial(_read, place), WAYS, place / "scores", jobs)
        trials += [replace(trial, case=case) for trial in found]
    return Table(pairs, tuple(trials), ())


def _keep(population: Path, place: Path, case: str, name: str) -> None:
    def images() -> FingerImages:
        result = reconstruct(read_capture(population / name), case)
        surface, measured = surface_of(result), result.normals_measured
        assert measured is not None  # the thesis's cases measure normals
        found, other = surface_images(surface), surface_images(replace(surface, normals=measured))
        channels = {key: found.channels[key] for key in NORMALS}
        channels |= {to: other.channels[key] for key, to in zip(NORMALS, MEASURED, strict=True)}
        return replace(found, channels=channels)

    kept_images(_file(place, name), images)


def _read(place: Path, name: str) -> FingerImages | None:
    return read_images(_file(place, name))


def _file(place: Path, name: str) -> Path:
    return place / "images" / (name.replace("/", "_") + ".npz")
