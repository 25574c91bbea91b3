"""A finger in, a flat print out: as an object, or as a folder."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from splitknit import BadInput
from splitknit.io.photographs import PxPerMm, RidgePeriod, check_scale
from splitknit.verbs import AnyPath, Help, HowReconstructed, InputPpi, Job, Progress, check, function_of
from splitknit_match.matching.photo_finger import PhotoBox, PhotoMask

if TYPE_CHECKING:
    from splitknit import Capture, Reconstruction
    from splitknit_match.prints.make import Print

    Finger = Reconstruction | Capture | AnyPath
else:
    Finger = AnyPath


@dataclass(frozen=True, slots=True)
class PrintJob(Job):
    """Turn a finger in space into a flat print of 500 pixels per inch.

    Returns
    -------
    dict
        The facts of ``report.json``, and ``out``.

    Raises
    ------
    BadInput
        Naming the input at fault; nothing is written.
    """

    # fmt: off
    finger: Annotated[AnyPath, Help(
        "result folder, or capture folder (reconstructed first); or a print (PNG, TIFF, JPEG, BMP, WSQ, ISO 19794-4, "
        "ANSI/NIST-ITL), which is brought to 500 ppi, enhanced and searched for minutiae; or a photograph of a finger "
        "in colour, which is unrolled by a mean shape", "FINGER", positional=True)]
    _: KW_ONLY
    out: Annotated[AnyPath, Help("folder to write the print into", "DIR")]
    method: Annotated[Literal["relief", "unroll", "curvature", "photo", "specular", "rolled"] | None, Help(
        "unroll: the relief on the skin laid flat (the default); relief: seen straight from above (the thesis's); "
        "curvature: the shape index; photo: the photograph (needs a capture); specular: what the surface reflects "
        "(needs polarising films); rolled: around the finger, by front and its mirrors (needs a capture with mirrors)"
        )] = None
    surface: Annotated[Literal["plane", "free", "arc"] | None, Help(
        "where it is printed: the finger plane (default, except for unroll), or the skin laid flat: free (least "
        "distortion, default for unroll) or arc (row by row)")] = None
    ppi: Annotated[Literal[500, 1000], Help("pixels per inch")] = 500
    px_per_mm: PxPerMm = None
    ridge_period_mm: RidgePeriod = None
    input_ppi: InputPpi = None
    mask: PhotoMask = None
    box: PhotoBox = None
    preset: HowReconstructed = "metric"
    # fmt: on

    def __post_init__(self) -> None:
        check(self)
        check_scale(self.px_per_mm, self.ridge_period_mm)

    @property
    def path(self) -> Path:
        """Path of the finger."""
        return Path(self.finger)

    def run(self, progress: Progress) -> dict[str, Any]:
        """Make it and write all its files."""
        from splitknit_match.prints.folder import print_to_folder

        return print_to_folder(self, progress)


@dataclass(frozen=True, slots=True)
class MakePrintJob(Job):
    """Make the 2D print of a finger.

    Returns
    -------
    Print
        ``image`` (h, w) uint8, ridges dark, mirrored as ink on paper is.

    Raises
    ------
    BadInput
        If the input lacks what the method needs, or shows no ridges.

    Examples
    --------
    >>> import splitknit_match
    >>> splitknit_match.make_print("result").image.dtype  # doctest: +SKIP
    dtype('uint8')
    """

    # fmt: off
    finger: Annotated[Finger, Help(
        "what is printed; a capture is reconstructed first, by the preset ``metric``",
        takes="Reconstruction, Capture or path")]
    method: Annotated[Literal["relief", "unroll", "curvature", "photo", "specular", "rolled"], Help(
        "``photo`` needs a capture; ``rolled`` one with mirrors, as a path")] = "unroll"
    ppi: Annotated[float, Help("resolution in pixels per inch")] = 500.0
    # fmt: on

    def run(self, progress: Progress) -> Print:
        """Make it."""
        from splitknit import Capture, Reconstruction
        from splitknit_match.prints.make import make_print, make_rolled_print
        from splitknit_match.prints.sources import read_source, source_of, source_of_capture

        finger, photo = self.finger, self.method == "photo"
        if self.method == "rolled":
            from splitknit_match.prints.rolled import read_rolled

            if isinstance(finger, Capture | Reconstruction):
                raise BadInput("a rolled print needs the path of a capture folder.")
            source, rolled = read_rolled(Path(finger), "metric", progress)
            return make_rolled_print(rolled, source, "free", self.ppi)
        if isinstance(finger, Reconstruction):
            source = source_of(finger)
        elif isinstance(finger, Capture):
            source = source_of_capture(finger, photo=photo, surface=not photo)
        else:
            source = read_source(Path(finger), photo=photo, surface=not photo)
        return make_print(source, self.method, ppi=self.ppi)


make_print = function_of(MakePrintJob)
