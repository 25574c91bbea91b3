"""Two fingers in, a comparison out: what :func:`splitknit_match.match` and ``splitknit match`` do."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass, replace
from typing import TYPE_CHECKING, Annotated, Literal

from splitknit.verbs import FINGER, AnyPath, Help, HowReconstructed, InputPpi, Job, Progress, Settings, function_of
from splitknit_match.prints.photo_finger import PhotoBox, PhotoMask

if TYPE_CHECKING:  # a comparison of templates loads neither
    import numpy as np
    from numpy.typing import NDArray

    from splitknit import Capture, Reconstruction
    from splitknit_match.matching.methods import Match, TemplateMade

    Finger = Reconstruction | Capture | NDArray[np.uint8] | bytes | AnyPath
else:
    Finger = AnyPath


TAKES = "path, array, bytes of a template, Reconstruction or Capture"
ResolutionPpi = Annotated[
    float | None, Help("pixels per inch of prints that come as arrays (H, W) uint8, ridges dark", python_only=True)
]


@dataclass(frozen=True, slots=True)
class MatchJob(Job):
    """Report how similar two fingers are.

    Returns
    -------
    Match
        ``similarity`` (the method's score; higher is more similar), ``fmr`` (false match rate at this similarity, where
        it was measured) with ``fmr_basis``, ``decision`` (``match``, ``fmr``, ``threshold``), ``alignment`` and the
        rest of what ``splitknit match`` prints as JSON, as attributes.

    Raises
    ------
    BadInput
        If an input cannot be used by the method, or `fmr` is below what was measured.

    Examples
    --------
    >>> import splitknit_match
    >>> splitknit_match.match("capture", "print.png").answer  # doctest: +SKIP
    'match'
    """

    # fmt: off
    a: Annotated[Finger, Help(FINGER, "A", positional=True, takes=TAKES)]
    b: Annotated[Finger, Help("the same; not needed for `template`", "B", positional=True, takes=TAKES)]
    method: Annotated[
        Literal["auto", "ridge", "fusion", "thesis", "thesis-code", "minutiae"],
        Help(
            "auto (the default: fusion of two prints, minutiae where one holds minutiae only, else ridge), ridge, "
            "fusion (of ridges and minutiae of two prints), thesis (local binary patterns; needs captures or results), "
            "thesis-code (as the author's program has them), "
            "minutiae (of the prints, compared by NIST's bozorth3; needs the extra minutiae, on x86-64 Linux)"
        ),
    ] = "auto"
    preset: HowReconstructed = "metric"
    settings: Settings = None
    _: KW_ONLY
    fmr: Annotated[float | None, Help(
        "false match rate at which is decided (default: 1e-4, or the smallest that the method's rates can state)",
        "RATE")] = None
    decision: Annotated[AnyPath | None, Help(
        "false match rates of your own prints, as 'splitknit evaluate --calibrate' writes them", "FILE")] = None
    template: Annotated[AnyPath | None, Help("write the template of A (.skt)", "FILE")] = None
    input_ppi: InputPpi = None
    mask: PhotoMask = None
    box: PhotoBox = None
    resolution_ppi: ResolutionPpi = None
    # fmt: on

    def run(self, progress: Progress) -> Match:
        """Compare them."""
        from splitknit_match.matching.inputs import held
        from splitknit_match.matching.methods import match_fingers  # a job is read without what does the work

        a, b = (held(one, self.resolution_ppi) for one in (self.a, self.b))
        return match_fingers(replace(self, a=a, b=b), progress)  # type: ignore[arg-type]


@dataclass(frozen=True, slots=True)
class MakeTemplateJob(Job):
    """Make the template of one finger, and write it where a file is named.

    Returns
    -------
    TemplateMade
        ``payload``: the template as bytes, which `match`, `identify` and `enroll` take.

    Raises
    ------
    BadInput
        If the finger cannot be read, or `template` names a file that is not a template.
    """

    a: Annotated[Finger, Help(FINGER, "A", positional=True, takes=TAKES)]
    template: Annotated[AnyPath | None, Help("file to write (.skt)", "FILE")] = None
    preset: HowReconstructed = "metric"
    settings: Settings = None
    _: KW_ONLY
    input_ppi: InputPpi = None
    mask: PhotoMask = None
    box: PhotoBox = None
    resolution_ppi: ResolutionPpi = None

    def run(self, progress: Progress) -> TemplateMade:
        """Make it."""
        from splitknit_match.matching.inputs import held
        from splitknit_match.matching.methods import make_template_file

        return make_template_file(replace(self, a=held(self.a, self.resolution_ppi)), progress)  # type: ignore[arg-type]


match, make_template = function_of(MatchJob), function_of(MakeTemplateJob)
