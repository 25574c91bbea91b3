"""Fingers in, records, images and meshes for other systems out."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import Annotated, Any, Literal

from splitknit.errors import require
from splitknit.verbs import AnyPath, Help, HowReconstructed, InputPpi, Job, Progress, check

PrintFormat = Literal[
    "iso-19794-2", "ansi-378", "ansi-378-2009", "iso-19794-4", "iso-39794-4", "wsq", "png", "tiff", "stl", "obj", "glb",
    "lp",
]  # fmt: skip


def _owner(text: str) -> int:
    try:
        return int(text, 0)
    except ValueError as error:
        raise ValueError(f"'{text}' must be a number such as 0x0103") from error


@dataclass(frozen=True, slots=True)
class ExportJob(Job):
    """Write fingers as records, images and meshes that other systems read.

    Returns
    -------
    dict
        The facts of ``export.json``, and ``out``.

    Raises
    ------
    BadInput
        Naming the source at fault; nothing is written.
    """

    # fmt: off
    sources: Annotated[tuple[AnyPath, ...], Help(
        "prints (PNG, TIFF, JPEG, BMP, WSQ, ISO 19794-4, ANSI/NIST-ITL), records of minutiae (ISO 19794-2, ANSI 378), "
        "captures, results and folders of 'splitknit print'", "SOURCE", positional=True)]
    _: KW_ONLY
    to: Annotated[PrintFormat | None, Help(
        "minutiae: iso-19794-2 (of 2005), ansi-378 (of 2004), ansi-378-2009; pictures: iso-19794-4 (of 2005), "
        "iso-39794-4 (of 2019, with the print's quality), wsq, png, tiff; surfaces of captures and results: stl, obj "
        "(mm; obj and glb need the extra mesh), glb (metres); the lights of captures, for RTI: lp")]
    out: Annotated[AnyPath, Help("folder to write, one file a finger", "DIR")]
    finger: Annotated[str | None, Help(
        "such as right_index, for all sources (default: as they state)", "FINGER")] = None
    impression: Annotated[str | None, Help(
        "such as live_rolled or nonlive_plain (default: as they state, else contactless for surfaces, live_plain for "
        "prints)", "TYPE")] = None
    compression: Annotated[Literal["none", "png", "wsq", "jp2"], Help(
        "of iso-19794-4 and iso-39794-4 (default: none; jp2: JPEG 2000 without loss; wsq loses a little)")] = "none"
    owner: Annotated[int, Help(
        "IBIA's number of who makes the records (default: 0x0103, not registered)", "NUMBER", read=_owner)] = 0x0103
    minutiae: Annotated[Literal["phase", "mindtct"], Help(
        "how they are found: by the phase of the ridges (default), or by NIST's mindtct (extra minutiae)")] = "phase"
    input_ppi: InputPpi = None
    preset: HowReconstructed = "metric"
    # fmt: on

    def __post_init__(self) -> None:
        check(self)
        require(0 < self.owner <= 65535, f"`owner` must lie between 1 and 65535, but it is {self.owner}.")

    def run(self, progress: Progress) -> dict[str, Any]:
        """Write them."""
        from splitknit_match.prints.export import export_records

        return export_records(self, progress)
