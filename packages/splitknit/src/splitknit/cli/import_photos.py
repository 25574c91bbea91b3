"""``splitknit import``: photographs and light directions in, a capture folder out; a view of several fingers, a capture
folder of each. Prints are read by what is registered for them.
"""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from splitknit.cli.verb import Outcome, Verb
from splitknit.errors import require
from splitknit.jobs import OF_PHOTOGRAPHS, Photographs
from splitknit.registry import GONE, IMPORTS, MATCH, extension
from splitknit.verbs import AnyPath, Help, InputPpi, Job, Overwrite, Progress, path, refuse_given

if TYPE_CHECKING:
    from splitknit.model import Capture

_OF_RIGS = "white and near-infrared photographs of a rig"
_PRINTS = "prints of other systems"
_SURFACES = (".ply", ".xyz", ".obj", ".stl")


@dataclass(frozen=True, slots=True)
class ImportJob(Job):
    """Turn photographs and light directions into a capture folder (`folder`), or prints of other systems into PNG."""

    # fmt: off
    files: Annotated[tuple[AnyPath, ...], Help(
        "WSQ, ISO 19794-4, ANSI/NIST-ITL, PNG, TIFF, JPEG, BMP: each print becomes a PNG with its resolution; ISO "
        "19794-2, ANSI 378: the minutiae of each finger become an ISO 19794-2 file; match, enroll, identify take all "
        "of them as they are",
        "FILE", positional=True, group=_PRINTS)] = ()
    _: KW_ONLY
    photographs: Annotated[Photographs, Help("photographs")] = field(default_factory=Photographs)
    nir: Annotated[AnyPath | None, Help(
        "near-infrared photographs: a folder, or a pattern as for `folder`; their lights are the NIR LEDs of a rig "
        "file, else lights.txt in that folder", "DIR", group=_OF_RIGS)] = None
    keep: Annotated[bool, Help(
        "keep a hand of `fingers` that the tips contradict", also=("--force",), group=_OF_RIGS)] = False
    out: Annotated[AnyPath, Help("folder to write", "DIR")]
    fingers: Annotated[str | None, Help(
        "`folder`, or the capture folder FILE, show several fingers side by side: each becomes a capture in DIR; left,"
        " right: index to little finger of that hand; auto: the hand follows from their tips; else names from left to "
        "right, such as right_middle,right_index", "WHICH")] = None
    overwrite: Overwrite = False
    input_ppi: Annotated[InputPpi, Help(InputPpi.__metadata__[0].text, "N", group=_PRINTS)] = None
    # fmt: on

    def run(self, progress: Progress) -> Outcome:
        """Find what kind of input it is, and import it."""
        images = self.photographs.folder
        both = images is not None and bool(self.files)
        require(not both, "photographs (`folder` DIR) and prints (FILE ...) are imported one after the other.")
        fault = "name photographs (`folder` DIR `lights` FILE)"
        require(images is not None or bool(self.files), f"{fault} or files of prints to import.")
        if self.fingers is not None:
            require(len(self.files) < 2, "`fingers` takes one capture, or `folder` of one.")
            self._check_rig_captures()
            return _import_fingers(self, progress)
        cloud = next((file for file in self.files if path(file).suffix.lower() in _SURFACES), None)
        require(cloud is None, f"'{cloud}' is a surface: {GONE['import --unit']}")
        if images is None:
            found: Outcome = extension(IMPORTS, "prints", "the import of prints", MATCH)(self, progress)
            return found
        self._check_rig_captures()
        return _import_photos(self, progress)

    def _check_rig_captures(self) -> None:
        """Refuse options that lack their partner."""
        require(self.fingers is not None or not self.keep, "`keep` goes with `fingers`.")
        self.photographs.check_alone()

    def of_finger(self) -> Photographs:
        """The photographs, with what the other options say of them: a finger is skin."""
        skin = (self.nir, self.fingers) != (None, None)
        material = self.photographs.material or ("skin" if skin else None)
        return replace(self.photographs, nir=self.nir, material=material)

    def refuse_photographs(self, why: str) -> None:
        """Refuse what is known of photographs."""
        names = (*OF_PHOTOGRAPHS, "tip_direction_deg", "light_frame", "px_per_mm", "ridge_period_mm")
        refuse_given(self.photographs, names, why)


def _import_fingers(job: ImportJob, progress: Progress) -> Outcome:
    """Cut a view of several fingers into a capture folder of each."""
    from splitknit.finger.hand import fingers_apart  # verbs import what they need
    from splitknit.io.capture import read_capture, write_capture
    from splitknit.io.targets import check_capture

    assert job.fingers is not None
    names = job.fingers if job.fingers in ("auto", "left", "right") else job.fingers.split(",")
    progress("reading", 0.1)
    out, taken = path(job.out), job.of_finger()
    if taken.folder is None:
        capture, notes = read_capture(job.files[0]), list[str]()
    else:
        capture, notes = taken.read()
    progress("fingers", 0.5)
    found = {out / name: one for name, one in fingers_apart(capture, names, keep=job.keep).items()}
    for place in found:
        check_capture(place, overwrite=job.overwrite, keep=path(taken.folder or job.files[0]))
    for place, one in found.items():
        write_capture(one, place, overwrite=job.overwrite)
    facts = {"out": str(out), "fingers": {place.name: list(one.shape) for place, one in found.items()}}
    lines = [f"{one.shape[1]} x {one.shape[0]} pixels written to {place}." for place, one in found.items()]
    lines += [f"Please note: {note}" for note in notes]
    return {**facts, "notes": notes}, [*lines, f"Next: splitknit reconstruct {next(iter(found))} --out RESULT"]


def _import_photos(job: ImportJob, progress: Progress) -> Outcome:
    from splitknit.io.capture import write_capture
    from splitknit.io.targets import check_capture

    taken, out = job.of_finger(), path(job.out)
    for folder in (path(one) for one in (taken.folder, taken.crossed) if one is not None):
        keep = folder.parent if "{light}" in folder.name else folder
        check_capture(out, overwrite=job.overwrite, keep=keep)
    progress("reading", 0.1)
    capture, notes = taken.read()
    progress("writing", 0.7)
    write_capture(capture, out, overwrite=job.overwrite)
    return _told(capture, notes, out)


def _told(capture: Capture, notes: list[str], out: Path) -> Outcome:
    band, camera = capture.bands["white"], capture.rig.camera
    count, rows, columns, channels = band.pixels.shape
    facts: dict[str, Any] = {
        "out": str(out),
        "images": count,
        "polarised": "white_crossed" in capture.bands,
        "image_size": [rows, columns],
        "channels": channels,
        "encoding": capture.encoding,
        "material": capture.material,
        "px_per_mm": camera.px_per_mm if camera.scale_known else None,
        "mask": capture.mask is not None,
        "notes": notes,
        "nir": len(capture.bands["nir"].leds) if "nir" in capture.bands else 0,
    }
    kind = "colour" if channels == 3 else "grey"
    if facts["polarised"]:
        kind = f"parallel and {count} crossed {kind}"
    scale = f"{camera.px_per_mm:g} px/mm" if camera.scale_known else "scale unknown"
    covered = "no mask" if capture.mask is None else f"the mask covers {100 * capture.mask.mean():.0f} %"
    kind += f" and {facts['nir']} near-infrared" if facts["nir"] else ""
    how = f"{capture.encoding}, {capture.material}, {scale}, {covered}"
    lines = [f"{count} {kind} photographs of {columns} x {rows} pixels ({how}) written to {out}."]
    lines += [f"Please note: {note}" for note in notes]
    lines.append(f"Next: splitknit reconstruct {out} --out RESULT")
    return facts, lines


IMPORT = Verb(ImportJob)
