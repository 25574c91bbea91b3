"""Two fingers in, a comparison out."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from splitknit.arguments import (
    AnyPath,
    Preset,
    Progress,
    Report,
    ResolutionPpi,
    Ridges,
    Settings,
    checked,
    refuse_given,
    silent,
)
from splitknit.errors import BadInput, require
from splitknit_match.threads import one_blas_thread

if TYPE_CHECKING:  # a comparison of templates loads neither
    import numpy as np
    from numpy.typing import NDArray

    from splitknit import Capture, Reconstruction
    from splitknit_match.matching.results import Match, TemplateMade
    from splitknit_match.matching.ridge import Prepared

    Finger = Reconstruction | Capture | NDArray[np.generic] | bytes | Prepared | AnyPath
else:
    Finger = AnyPath
    Match = Prepared = TemplateMade = Any

Method = Literal["auto", "ridge", "fusion", "thesis", "thesis-code", "minutiae"] | str


@checked
def match(
    a: Finger,
    b: Finger,
    method: Method = "auto",
    preset: Preset = "metric",
    settings: Settings = None,
    *,
    fmr: float | None = None,
    decision: AnyPath | None = None,
    template: AnyPath | None = None,
    mask: AnyPath | None = None,
    box: str | None = None,
    resolution_ppi: float | None = None,
    ridges: Ridges = None,
    progress: Progress = silent,
) -> Match:
    """Report how similar two fingers are.

    Parameters
    ----------
    a, b : path, array (H, W) uint8, bytes of a template, Reconstruction or Capture
        See :func:`match_or_make_template`.
    method : {"auto", "ridge", "fusion", "thesis", "thesis-code", "minutiae"}, optional
        Or your own: an entry point of ``splitknit.matchers``, or ``module:function``, called with
        two prints (H, W) uint8 at 500 ppi, ridges dark; it returns the similarity.
    preset : str, optional
        How captures are reconstructed.
    settings : mapping, optional
        From ``stage.field`` to a value: changed settings.
    fmr : float, optional
        False match rate at which is decided; by default 1e-4, or the smallest that the method's
        rates can state.
    decision : path, optional
        False match rates of your own prints, as ``splitknit evaluate --calibrate`` writes them.
    template : path, optional
        Write the template of `a` (.skt).
    mask : path, optional
        Of a photograph: an image of its size, white on the finger.
    box : str, optional
        Of a photograph: ``X,Y,W,H`` of the part in which the finger lies.
    resolution_ppi : float, optional
        Pixels per inch of arrays; where none is an array, of the files.
    ridges : {"dark", "light"}, optional
        Of arrays (by default dark); where none is an array, of the files (by default as they show
        it; where they do not, both readings are compared).
    progress : called with the name of a stage and the fraction done, optional

    Returns
    -------
    Match
        ``similarity`` (the method's score; higher is more similar), ``fmr`` (false match rate at
        this similarity, where it was measured) with ``fmr_basis``, ``decision`` (``match``,
        ``fmr``, ``threshold``), ``alignment`` and others.

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
    from splitknit.settings import override
    from splitknit_match.matching.inputs import (
        Pixels,
        Side,
        held,
        is_photo,
        read_side,
        with_print,
    )
    from splitknit_match.matching.methods import (
        auto_method,
        check_method,
        check_rate,
        check_template_file,
        compare_sides,
        write_template_file,
    )
    from splitknit_match.matching.score import read_own_rates
    from splitknit_match.matching.surface import MatchingSettings
    from splitknit_match.prints.photo_finger import PhotoFinger

    one_blas_thread()
    check_rate(fmr)
    check_method(method)
    fingers = held(a, resolution_ppi, ridges), held(b, resolution_ppi, ridges)
    thesis = override(MatchingSettings(), settings or {}).thesis
    own = None if decision is None else read_own_rates(Path(decision))
    target = None if template is None else Path(template)
    check_template_file(target, *fingers)
    where = PhotoFinger(mask, box)
    # beside an array it is the array's
    arrays = any(isinstance(each, Pixels) for each in fingers)
    file_ppi = None if arrays else resolution_ppi
    photos = [(file_ppi is not None or where.chosen) and is_photo(finger) for finger in fingers]
    chosen = int(photos[1] and not photos[0])  # whose finger `mask` and `box` choose

    def read(number: int) -> Side:
        return read_side(
            fingers[number], preset, silent if number else progress,
            # beside a print it is the photograph's
            file_ppi if photos[number] or not any(photos) else None,
            ridges=None if arrays else ridges,
            where=where if number == chosen else None,
        )  # fmt: skip

    if all(
        isinstance(finger, Path) and finger.is_file() and finger.suffix != ".skt"
        for finger in fingers
    ):
        from concurrent.futures import ThreadPoolExecutor  # 20 ms, more than templates take

        with ThreadPoolExecutor(2) as pool:
            left, right = pool.map(read, range(2))
    else:
        left, right = read(0), read(1)
    sides = left, right
    # two surfaces are compared as they are
    if method == "fusion" or any(side.surface is None for side in sides):
        sides = with_print(left), with_print(right)
    by = auto_method(*sides) if method == "auto" else method
    if own is not None and own.method != by:
        raise BadInput(f"'{decision}' is for the method {own.method}, but {by} compares these.")
    progress("comparing", 0.9)
    result = compare_sides(by, *sides, fmr=fmr, own=own, thesis=thesis)
    progress("done", 1.0)
    written = write_template_file(target, sides[0])
    return replace(result, template=written)


@checked
def make_template(
    finger: Finger,
    template: AnyPath | None = None,
    preset: Preset = "metric",
    settings: Settings = None,
    *,
    mask: AnyPath | None = None,
    box: str | None = None,
    resolution_ppi: float | None = None,
    ridges: Ridges = None,
    progress: Progress = silent,
) -> TemplateMade:
    """Make the template of one finger, and write it where a file is named.

    Parameters
    ----------
    finger : path, array (H, W) uint8, bytes of a template, Reconstruction or Capture
    template : path, optional
        File to write (.skt).
    preset, settings, mask, box, resolution_ppi, ridges, progress : optional
        As of :func:`match`.

    Returns
    -------
    TemplateMade
        ``payload``: what a `.skt` file holds, which `match`, `identify` and `enroll` take.

    Raises
    ------
    BadInput
        If the finger cannot be read, or `template` names a file that is not a template.

    Examples
    --------
    >>> import splitknit_match
    >>> template = splitknit_match.make_template("print.png").payload  # doctest: +SKIP
    """
    from splitknit.settings import override
    from splitknit_match.matching.inputs import held, read_side, undoubted, with_print
    from splitknit_match.matching.methods import (
        check_template_file,
        compared_side,
        template_findings,
        write_template_file,
    )
    from splitknit_match.matching.results import TemplateMade
    from splitknit_match.matching.surface import MatchingSettings
    from splitknit_match.matching.template import VERSION
    from splitknit_match.prints.photo_finger import PhotoFinger
    from splitknit_match.records.templates import encode_template

    one_blas_thread()
    override(MatchingSettings(), settings or {})  # refuses unknown ones
    source = held(finger, resolution_ppi, ridges)
    target = None if template is None else Path(template)
    check_template_file(target, source)
    where = PhotoFinger(mask, box)
    side = with_print(
        read_side(source, preset, progress, resolution_ppi, ridges=ridges, where=where)
    )
    progress("done", 1.0)
    written = write_template_file(target, side)
    payload = encode_template(undoubted(side).payload, VERSION)
    return TemplateMade(compared_side(side), written, payload, template_findings(side))


def prepare(template: bytes) -> Prepared:
    """Make a template ready to be compared more than once by :func:`match`.

    Parameters
    ----------
    template : bytes
        What a `.skt` file of ridges holds.

    Returns
    -------
    Prepared

    Raises
    ------
    BadInput
        If the template is damaged, or holds minutiae.

    Examples
    --------
    >>> import splitknit_match
    >>> finger = splitknit_match.prepare(template)  # doctest: +SKIP
    >>> [splitknit_match.match(finger, other).answer for other in others]  # doctest: +SKIP
    """
    from splitknit_match.matching.inputs import held
    from splitknit_match.matching.ridge import Prepared
    from splitknit_match.matching.template import unpack

    payload = held(template)
    if not isinstance(payload, bytes):
        raise BadInput("`template` must be bytes, what a `.skt` file holds.")
    return Prepared(unpack(payload))


@checked
def match_or_make_template(
    a: AnyPath,
    b: AnyPath | None = None,
    *,
    method: Method = "auto",
    preset: Preset = "metric",
    fmr: float | None = None,
    decision: AnyPath | None = None,
    template: AnyPath | None = None,
    resolution_ppi: ResolutionPpi = None,
    ridges: Ridges = None,
    mask: AnyPath | None = None,
    box: str | None = None,
    raw: bool = False,
    settings: Settings = None,
    progress: Progress = silent,
) -> Match | TemplateMade | Report:
    """Report how similar two fingers are.

    Parameters
    ----------
    a
        Capture folder, result folder, template (.skt), print (PNG, TIFF, JPEG, BMP, WSQ, ISO
        19794-4, ANSI/NIST-ITL) or record of minutiae (ISO 19794-2, ANSI 378), or photograph of a
        finger in colour.
    b
        The same; not needed for `template`.
    method
        auto (the default: fusion of two prints, minutiae where one holds minutiae only, else
        ridge), ridge, fusion (of ridges and minutiae of two prints), thesis (local binary patterns;
        needs captures or results), thesis-code (as the author's program has them), minutiae (of
        records and prints), or your own MODULE:FUNCTION.
    preset
        How captures are reconstructed.
    fmr
        False match rate at which is decided (default: 1e-4, or the smallest that the method's rates
        can state).
    decision
        False match rates of your own prints, as 'splitknit evaluate --calibrate' writes them.
    template
        Write the template of A (.skt).
    mask
        The finger of a photograph: an image of its size, white on the finger; of two, A's.
    box
        The part X,Y,W,H of a photograph in which the finger lies, pixels from its upper left; of
        two, A's.
    raw
        Print the method's own scores too (--json always has them).

    Returns
    -------
    Match, or TemplateMade where there is no `b`

    Raises
    ------
    BadInput
        As :func:`match`.

    Examples
    --------
    >>> match_or_make_template("capture", template="finger.skt").template.bytes  # doctest: +SKIP
    14321
    """
    finger: dict[str, Any] = {
        "resolution_ppi": resolution_ppi,
        "ridges": ridges,
        "mask": mask,
        "box": box,
        "template": template,
    }
    how: dict[str, Any] = {"preset": preset, "settings": settings, "progress": progress}
    if b is None:
        require(
            template is not None, "name a second finger to compare with, or `template` to write."
        )
        refuse_given("is of a comparison; name a second finger.", fmr=fmr, decision=decision)
        return make_template(a, **finger, **how)
    comparison = match(a, b, method, fmr=fmr, decision=decision, **finger, **how)
    if not raw:
        return comparison
    from splitknit_match.matching.results import match_lines

    return Report(comparison.facts, tuple(match_lines(comparison, scores=True)))
