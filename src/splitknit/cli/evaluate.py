"""The command line of ``splitknit evaluate``: how well scores separate genuine from impostor pairs."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from splitknit.cli.gallery_options import add_key
from splitknit.cli.verb import Outcome, Progress, natural, new_verb
from splitknit.errors import require

_METHODS = ("linear", "minmax", "llr", "trained")


def add_evaluate(verbs: Any) -> None:
    """Add ``splitknit evaluate``."""
    verb = new_verb(verbs, "evaluate", "error rates of anybody's scores, with confidence intervals", _run)
    source = verb.add_mutually_exclusive_group()
    source.add_argument(
        "--scores",
        type=Path,
        nargs="+",
        action="extend",
        metavar="FILE",
        help="CSV files with the columns label (1 genuine, 0 impostor) and score (blank = failure to acquire), and "
        "if known finger_a, finger_b, subject_a, subject_b, session_a, session_b; several files, or a column "
        "system, are compared",
    )
    source.add_argument(
        "--gallery",
        type=Path,
        metavar="GALLERY",
        help="instead: compare all sessions of a gallery with each other; scores.csv is written as well",
    )
    add_key(verb)
    verb.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder to write the report into")
    verb.add_argument("--dissimilarity", action="store_true", help="the scores are distances: lower is more similar")
    verb.add_argument(
        "--cluster",
        choices=("auto", "plain", "finger", "subject"),
        default="auto",
        help="what the bootstrap draws for the intervals in the first place (default: fingers where they are "
        "named, else subjects, else comparisons); the others are reported as well",
    )
    verb.add_argument("--replicates", type=natural, default=1000, metavar="N", help="of the bootstrap (default: 1000)")
    verb.add_argument("--seed", type=natural, default=0, help="of the bootstrap (default: 0)")
    verb.add_argument(
        "--exclude",
        type=Path,
        metavar="FILE",
        help="CSV list of fingers (columns finger, and if wanted subject, session, reason); figures are given with "
        "and without them",
    )
    verb.add_argument(
        "--average-sessions", action="store_true", help="give the figures of scores averaged over sessions as well"
    )
    verb.add_argument(
        "--fuse",
        nargs="+",
        metavar="FILE",
        help="score files of other traits (prints, finger vein, face ...), in place of --scores: each alone, and fused "
        "after min-max and z-score normalisation and as log-likelihood ratios, cross-validated by subject, with "
        f"intervals by subject; or, beside --scores, one of {', '.join(_METHODS)}: one more system",
    )


def _run(options: argparse.Namespace) -> Outcome:
    """Evaluate, write, and report what came out."""
    from splitknit.evaluation.intervals import BootstrapSettings
    from splitknit.evaluation.study import EvaluationSettings, evaluate_scores
    from splitknit.io.targets import check_target
    from splitknit.report.evaluation import FORMAT, interval, write_evaluation

    files, fuse = _sources(options)
    settings = EvaluationSettings(
        dissimilarity=options.dissimilarity,
        cluster=options.cluster,
        average=options.average_sessions,
        fuse=fuse,
        bootstrap=BootstrapSettings(replicates=options.replicates, seed=options.seed),
    )
    check_target(options.out, "report.json", "an earlier evaluation", form=FORMAT)
    with Progress(options) as progress:
        gallery = _gallery(options, progress) if options.gallery is not None else None
        require(gallery is not None or options.key_file is None, "--key-file is for --gallery.")
        found = evaluate_scores(
            files, settings,
            exclusions=options.exclude, gallery=gallery, progress=progress.update,
        )  # fmt: skip
        progress.update("report", 1.0)
        facts = write_evaluation(found, options.out)
    lines = []
    for name, one in facts["systems"].items():
        counts = one["comparisons"]
        lines.append(f"{name}: {counts['genuine']} genuine and {counts['impostor']} impostor comparisons.")
        lines.append(f"  EER {interval(one['eer'])}")
        lines += [f"  GAR at FAR {100 * float(far):g} %: {interval(gar)}" for far, gar in one["gar_at_far"].items()]
    lines += [f"Please note: {note}" for note in facts["notes"]]
    lines.append(f"Open {options.out / 'report.html'} in a browser.")
    return {"out": str(options.out), **facts}, lines


def _sources(options: argparse.Namespace) -> tuple[list[Path], Any]:
    """Files to evaluate, and how they are fused."""
    given = options.scores or ([] if options.gallery is None else [options.gallery])
    if options.fuse is None or (len(options.fuse) == 1 and options.fuse[0] in _METHODS):
        require(bool(given), "name what is evaluated: --scores FILE, --gallery GALLERY or --fuse FILE FILE.")
        return given, options.fuse and options.fuse[0]
    require(
        not given,
        f"--fuse takes score files in place of --scores and --gallery, or beside them one of {', '.join(_METHODS)}, "
        f"but not '{' '.join(options.fuse)}'.",
    )
    return [Path(name) for name in options.fuse], "all"


def _gallery(options: argparse.Namespace, progress: Progress) -> Any:
    from splitknit.evaluation.gallery_scores import gallery_scores
    from splitknit.gallery.key import key_of

    require(not options.dissimilarity, "--dissimilarity is for --scores; a gallery's scores are similarities.")
    return gallery_scores(options.gallery, key=key_of(options.key_file), progress=progress.update)
