"""Verbs of evaluation: ``splitknit evaluate`` and ``compare``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from splitknit.arguments import SEVERAL, AnyPath, Natural, Progress, Report, checked, silent
from splitknit.errors import require
from splitknit.findings import worst_first
from splitknit_match.gallery.verbs import KeyFile

_FUSIONS = ("linear", "minmax", "trained")


@checked
def evaluate_files(
    *,
    scores: Annotated[Sequence[AnyPath], SEVERAL] = (),
    gallery: AnyPath | None = None,
    key_file: KeyFile = None,
    out: AnyPath,
    dissimilarity: bool = False,
    cluster: Literal["auto", "plain", "finger", "subject"] = "auto",
    replicates: Natural = 1000,
    seed: Natural = 0,
    average: Annotated[bool, Parameter("--average-sessions")] = False,
    fuse: Annotated[Sequence[str], SEVERAL] = (),
    calibrate: AnyPath | None = None,
    method: Literal["fusion", "ridge", "minutiae"] | str = "fusion",
    least_mm2: float = 100.0,
    progress: Progress = silent,
) -> Report:
    """Error rates of anybody's scores, with confidence intervals.

    Parameters
    ----------
    scores
        CSV files with the columns label (1 genuine, 0 impostor) and score (blank = failure to
        acquire), and if known finger_a, finger_b, subject_a, subject_b, session_a, session_b;
        several files are compared.
    gallery
        Instead: compare all sessions of a gallery with each other; scores.csv is written as well.
    out
        Folder to write the report into.
    dissimilarity
        The scores are distances: lower is more similar.
    cluster
        What the bootstrap draws for the intervals (default: fingers where they are named, else
        subjects, else comparisons).
    replicates
        Of the bootstrap.
    seed
        Of the bootstrap.
    average
        Give the figures of scores averaged over sessions as well.
    fuse
        Score files of other traits (prints, finger vein, face ...), in place of `scores`: each
        alone, and fused after min-max and z-score normalisation, cross-validated by subject, with
        intervals by subject; or, beside `scores`, one of linear, minmax, trained: one more system.
    calibrate
        Write the false match rates of one system here, for 'splitknit match --decision'.
    method
        With `calibrate` and `scores`: the method of 'splitknit match' that gave them.
    least_mm2
        With `calibrate`: the smallest overlap among the prints compared; where less overlaps
        nothing is decided.

    Returns
    -------
    Report
        The facts of ``report.json``, and ``out``.

    Raises
    ------
    BadInput
        Naming the file at fault; nothing is written.

    Examples
    --------
    >>> evaluate_files(scores=["scores.csv"], out="evaluation").facts["systems"]  # doctest: +SKIP
    """
    from splitknit.io.atomic import write_file
    from splitknit.io.provenance import json_text
    from splitknit.io.targets import check_file, check_target
    from splitknit_match.evaluation.evaluate import evaluate
    from splitknit_match.evaluation.intervals import BootstrapSettings
    from splitknit_match.evaluation.page import FORMAT, write_evaluation
    from splitknit_match.matching.score import DECISION_FORMAT, own_rates_document

    require(not scores or gallery is None, "name `scores` or a `gallery`, not both.")
    files, fusion = [Path(file) for file in scores], None
    if len(fuse) == 1 and fuse[0] in _FUSIONS:
        fusion = fuse[0]
    elif fuse:
        require(
            not files and gallery is None,
            "`fuse` takes score files in place of `scores` and `gallery`, or beside them one of "
            f"{', '.join(_FUSIONS)}, but not '{' '.join(fuse)}'.",
        )
        files, fusion = [Path(name) for name in fuse], "all"
    require(
        files or gallery is not None,
        "name what is evaluated: `scores` FILE, `gallery` GALLERY or `fuse` FILE FILE.",
    )
    bootstrap = BootstrapSettings(replicates=replicates, seed=seed)
    rates_file = None if calibrate is None else Path(calibrate)
    check_target(Path(out), "report.json", "an earlier evaluation", form=FORMAT)
    check_file(rates_file, "a file of false match rates", form=DECISION_FORMAT)
    settings: dict[str, Any] = {"cluster": cluster, "average": average, "fuse": fusion}
    tables = {}
    if gallery is None:
        require(key_file is None, "`key_file` is for `gallery`.")
        evaluation = evaluate(
            files, dissimilarity=dissimilarity, bootstrap=bootstrap, progress=progress, **settings
        )
        measured_by: str = method
    else:
        from splitknit_match.evaluation.gallery_scores import gallery_scores
        from splitknit_match.gallery.file import key_of, readable_gallery

        require(
            not dissimilarity,
            "`dissimilarity` is for `scores`; a gallery's scores are similarities.",
        )
        compared = gallery_scores(Path(gallery), key=key_of(key_file), progress=progress)
        evaluation = evaluate(compared.scores, bootstrap=bootstrap, progress=progress, **settings)
        evaluation = replace(
            evaluation,
            inputs_sha256={str(gallery): compared.sha256},
            findings=worst_first(
                [*compared.findings, *evaluation.findings, *readable_gallery(gallery, key_file)]
            ),
        )
        measured_by, tables = compared.method, {"scores.csv": compared.table}
    progress("report", 1.0)
    if rates_file is not None:
        require(
            len(evaluation.results) == 1,
            "`calibrate` takes the scores of one system; name one file.",
        )
        require(
            not dissimilarity, "`calibrate` takes similarities, as 'splitknit match' gives them."
        )
        system = evaluation.results[0].scores
        document = own_rates_document(
            system.impostor, f"scores of {system.name}", measured_by, least_mm2
        )
        write_file(rates_file, json_text(document).encode())
    facts = write_evaluation(
        evaluation, Path(out), tables, {**settings, "dissimilarity": dissimilarity}
    )
    return Report({"out": str(out), **facts}, tuple(_evaluation_lines(facts, Path(out))))


def _evaluation_lines(facts: Mapping[str, Any], out: Path) -> list[str]:
    from splitknit_match.evaluation.page import interval

    lines = []
    for name, system in facts["systems"].items():
        counts = system["comparisons"]
        lines.append(
            f"{name}: {counts['genuine']} genuine and {counts['impostor']} impostor comparisons."
        )
        lines.append(f"  EER {interval(system['eer'])}")
        rates = system["gar_at_far"].items()
        lines += [f"  GAR at FAR {100 * float(far):g} %: {interval(gar)}" for far, gar in rates]
    lines += [f"Please note: {finding['message']}" for finding in facts["findings"]]
    return [*lines, f"Open {out / 'report.html'} in a browser."]


@checked
def compare(
    a: AnyPath,
    b: AnyPath,
    *,
    out: AnyPath,
    protocol: Literal["powder-5", "powder-10", "powder-20", "cast", "gel"] | None = None,
    elastic: bool = False,
    repeat: AnyPath | None = None,
    progress: Progress = silent,
) -> Report:
    """How two measurements of one finger differ, laid on each other.

    Parameters
    ----------
    a
        Result folder, or its height.npz: what is tested.
    b
        The same of the reference.
    out
        Folder to write the report into.
    protocol
        What B is (powder: its mean thickness in um): that protocol's simulated error is reported as
        well; skin on a gel or of a cast may have shifted (`elastic`).
    elastic
        Let the skin shift smoothly; waves up to 2.5 mm alone.
    repeat
        A second reference, coated or pressed anew: measures B's own error.

    Returns
    -------
    Report
        The facts of ``report.json``, and ``out``.

    Raises
    ------
    BadInput
        Naming the file at fault; nothing is written.

    Examples
    --------
    >>> compare("result", "profilometer", out="comparison").facts["findings"]  # doctest: +SKIP
    """
    from splitknit import read_result
    from splitknit.io.targets import check_target
    from splitknit_match.evaluation.pair import compare_results
    from splitknit_match.evaluation.pair_page import FORMAT, headline, write_comparison

    check_target(Path(out), "report.json", "an earlier comparison", form=FORMAT)
    fit: Literal["elastic", "rigid"] = (
        "elastic" if elastic or protocol in {"gel", "cast"} else "rigid"
    )
    progress("reading", 0.0)
    tested, reference = read_result(Path(a)), read_result(Path(b))
    again = None if repeat is None else read_result(Path(repeat))
    progress("comparing", 0.2)
    pair = compare_results(tested, reference, fit=fit)
    progress("B's own error", 0.6)
    own = None if again is None else compare_results(reference, again, fit=fit)
    progress("report", 0.9)
    facts = write_comparison(pair, Path(out), (Path(a), Path(b)), protocol, own)
    notes = [f"Please note: {finding['message']}" for finding in facts["findings"]]
    page = f"Open {Path(out) / 'report.html'} in a browser."
    return Report({"out": str(out), **facts}, (*headline(facts), *notes, page))
