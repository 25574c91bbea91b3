"""A folder that calibrates a rig's light: a capture of a white card, and what else of the camera was photographed.

The folder is a capture folder (``capture.json``, ``rig.json``, the card under every LED, ambient images). A file
``radiometry.json`` beside them names more; all but its first two fields are optional::

    {
      "format": "splitknit-radiometry", "version": 1,
      "dark": ["dark_0.png", "dark_1.png"],     lens covered; one or several
      "exposures": [                            one scene that does not change, four exposures at least
        {"file": "step_0.png", "exposure_s": 0.001},
        {"file": "step_1.png", "exposure_s": 0.002, "gain": 1.0}
      ]
    }

Paths stay inside the folder. All images have the size, colour and depth of the card's.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from splitknit.calibration.sensor import MIN_EXPOSURES
from splitknit.errors import require
from splitknit.io.fields import Fields, inside, read_json

DOCUMENT = "radiometry.json"
FORMAT, VERSION = "splitknit-radiometry", 1
_KNOWN = {"format", "version", "dark", "exposures"}


@dataclass(frozen=True, slots=True)
class Exposure:
    """One image of the series."""

    file: Path
    exposure: float
    """Time times gain."""


@dataclass(frozen=True, slots=True)
class RadiometryPlan:
    """What ``radiometry.json`` names."""

    dark: tuple[Path, ...] = ()
    exposures: tuple[Exposure, ...] = ()
    document: Path | None = None


def read_radiometry_plan(folder: Path) -> RadiometryPlan:
    """Read ``radiometry.json``; an empty plan where there is none.

    Raises
    ------
    BadInput
        Naming the file and the field.
    """
    file = folder / DOCUMENT
    if not file.is_file():
        return RadiometryPlan()
    document, _ = read_json(file)
    fields = Fields(document, str(file))
    fields.format(FORMAT, VERSION)
    unknown = sorted(set(fields.keys()) - _KNOWN)
    require(not unknown, f"{file}: the field '{unknown[0] if unknown else ''}' is not known; correct or remove it.")
    dark: list[Path] = []
    if fields.has("dark"):
        given = fields.get("dark")
        names = given if isinstance(given, list) else [given]
        require(len(names) > 0, f"{file}: dark names no file; name one, or remove the field.")
        dark = [inside(folder, name, str(file), f"dark[{k}]") for k, name in enumerate(names)]
    exposures = []
    if fields.has("exposures"):
        for k, item in enumerate(fields.items("exposures")):
            entry = Fields(item, str(file), f"exposures[{k}]")
            time = entry.number("exposure_s", 1e-9, 1e6) * entry.number("gain", 1e-6, 1e6, 1.0)
            exposures.append(Exposure(inside(folder, entry.get("file"), str(file), entry.path("file")), time))
        require(
            len(exposures) >= MIN_EXPOSURES,
            f"{file}: exposures names {len(exposures)} images, but at least {MIN_EXPOSURES} different ones are needed.",
        )
    files = [*dark, *(one.file for one in exposures)]
    for k, path in enumerate(files):
        require(files.index(path) == k, f"{file} names {path.name} twice; every image serves once.")
    return RadiometryPlan(tuple(dark), tuple(exposures), file)
