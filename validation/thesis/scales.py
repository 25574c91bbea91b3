"""Figure 3.21: the relief of case SnK with n = 2 to 7 scales of shapelets, compared by the thesis's
matcher.

Only the last step differs between the six, so that images are enhanced and separated once for each
capture: :func:`snk_images` lets all n share what comes before. It gives the same relief as
``splitknit reconstruct --preset snk --set shapelets.scales=n``
(tests/validation/test_thesis_experiments.py).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from functools import partial
from pathlib import Path

from compared import Read, Way, each, kept_images, read_images

from splitknit import __version__
from splitknit.capture import Capture
from splitknit.io.capture import read_capture
from splitknit.io.provenance import settings_hash
from splitknit.pipeline import located, reconstruct
from splitknit.presets import preset_settings
from splitknit.reconstruction import surface_of
from splitknit_match.matching.features import lbp_features
from splitknit_match.matching.surface import surface_images
from splitknit_match.matching.thesis import ATTRIBUTES, FingerImages

SCALES = (2, 3, 4, 5, 6, 7)
WAYS = [Way(f"n = {count}", lbp_features, "relief", (f"snk{count}",)) for count in SCALES]


def snk_images(capture: Capture) -> FingerImages:
    """Normals and relief of one capture by case SnK, and a relief ``snk2`` ... for each number of
    scales.

    Raises
    ------
    BadInput
        If it shows no finger.
    """
    finger = located(capture, "snk")
    images = surface_images(surface_of(reconstruct(finger, "snk")))
    channels = {name: images.channels[name] for name in (*ATTRIBUTES["normals"], "relief")}
    for count in SCALES:
        # as snk up to the relief, without its near-infrared shape
        result = reconstruct(finger, "pr-split", {"shapelets.scales": count})
        channels[f"snk{count}"] = surface_images(surface_of(result)).channels["relief"]
    return replace(images, channels=channels)


def keep_all(population: Path, names: Iterable[str], scratch: Path, jobs: int) -> tuple[Read, Path]:
    """Keep the images of captures in `scratch`, a folder of this population alone. Returns a reader
    and the folder."""
    settings = [preset_settings("snk"), preset_settings("pr-split"), SCALES, __version__]
    place = scratch / settings_hash(settings)[:12]
    each(partial(_keep, population, place), list(names), jobs)
    return partial(_read, place), place


def _keep(population: Path, place: Path, name: str) -> None:
    kept_images(_file(place, name), lambda: snk_images(read_capture(population / name)))


def _read(place: Path, name: str) -> FingerImages | None:
    return read_images(_file(place, name))


def _file(place: Path, name: str) -> Path:
    return place / (name.replace("/", "_") + ".npz")
