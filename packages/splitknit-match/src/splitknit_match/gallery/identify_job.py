"""A gallery and a finger in, candidates out: what :func:`splitknit_match.identify` and ``splitknit identify`` do."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING, Annotated, Literal

from splitknit.errors import require
from splitknit.verbs import (
    FINGER,
    KEY_FILE,
    AnyPath,
    Help,
    HowReconstructed,
    InputPpi,
    Job,
    Natural,
    Progress,
    Settings,
    check,
    function_of,
)
from splitknit_match.matching.match_job import TAKES, Finger, ResolutionPpi

if TYPE_CHECKING:
    from splitknit_match.gallery.file import Key
    from splitknit_match.gallery.identify import Identification

    GivenKey = Key | AnyPath | None
else:
    GivenKey = AnyPath | None


@dataclass(frozen=True, slots=True)
class IdentifyJob(Job):
    """Find a finger in a gallery, or check whose it is said to be.

    A gallery that keeps minutiae is searched by minutiae, one that keeps ridges by ridges.

    Returns
    -------
    Identification
        ``candidates``, best first, and ``decision``; that nobody is found is not an error.

    Raises
    ------
    BadInput
        If a file cannot be used, the gallery's templates were made otherwise, the claimed person or finger is not in
        it, or the rate was not measured.

    Examples
    --------
    >>> import splitknit_match
    >>> splitknit_match.identify("people.skg", "captures/unknown", top=3).candidates  # doctest: +SKIP
    """

    # fmt: off
    gallery: Annotated[AnyPath, Help("file of the gallery", "GALLERY", positional=True, secret=True)]
    probe: Annotated[Finger, Help(FINGER, "PROBE", positional=True, takes=TAKES)]
    key: Annotated[GivenKey, KEY_FILE] = None
    _: KW_ONLY
    top: Annotated[Natural, Help("candidates that are reported", "N")] = 10
    person: Annotated[str | None, Help("verification: whose finger it is said to be", "NAME")] = None
    finger: Annotated[str | None, Help("which finger it is; others are left out", "FINGER")] = None
    fmr: Annotated[float, Help("false match rate of one comparison at which is decided (default: 1e-4)", "RATE")] = 1e-4
    merge: Annotated[Literal["person", "finger", "none"], Help(
        "one candidate for each person (default), each finger, or each enrolled capture")] = "person"
    input_ppi: InputPpi = None
    resolution_ppi: ResolutionPpi = None
    preset: HowReconstructed = "metric"
    settings: Settings = None
    # fmt: on

    def __post_init__(self) -> None:
        check(self)
        require(self.top >= 1, f"`top` must be at least 1, but it is {self.top}.")
        require(0 < self.fmr < 1, f"`fmr` must lie between 0 and 1, but it is {self.fmr:g}.")

    def run(self, progress: Progress) -> Identification:
        """Search for it."""
        from splitknit_match.gallery.identify import identify_finger

        return identify_finger(self, progress)


identify = function_of(IdentifyJob)
