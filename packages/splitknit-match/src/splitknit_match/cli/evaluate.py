"""The command line of ``splitknit evaluate``: how well scores separate genuine from impostor pairs."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from splitknit.cli.verb import Outcome, Verb
from splitknit.errors import require
from splitknit.verbs import AnyPath, Help, Job, KeyFile, Natural, Progress, path

_METHODS = ("linear", "minmax", "trained")


@dataclass(frozen=True, slots=True)
class EvaluationJob(Job):
    """Error rates of anybody's scores, with confidence intervals."""

    # fmt: off
    _: KW_ONLY
    scores: Annotated[tuple[AnyPath, ...], Help(
        "CSV files with the columns label (1 genuine, 0 impostor) and score (blank = failure to acquire), and if known "
        "finger_a, finger_b, subject_a, subject_b, session_a, session_b; several files are "
        "compared", "FILE", nargs="+", either="source")] = ()
    gallery: Annotated[AnyPath | None, Help(
        "instead: compare all sessions of a gallery with each other; scores.csv is written as well",
        "GALLERY", either="source")] = None
    key_file: KeyFile = None
    out: Annotated[AnyPath, Help("folder to write the report into", "DIR")]
    dissimilarity: Annotated[bool, Help("the scores are distances: lower is more similar")] = False
    cluster: Annotated[Literal["auto", "plain", "finger", "subject"], Help(
        "what the bootstrap draws for the intervals (default: fingers where they are named, else subjects, else "
        "comparisons)")] = "auto"
    replicates: Annotated[Natural, Help("of the bootstrap", "N")] = 1000
    seed: Annotated[Natural, Help("of the bootstrap")] = 0
    average: Annotated[bool, Help(
        "give the figures of scores averaged over sessions as well", option="--average-sessions")] = False
    fuse: Annotated[tuple[str, ...], Help(
        "score files of other traits (prints, finger vein, face ...), in place of `scores`: each alone, and fused "
        "after min-max and z-score normalisation, cross-validated by subject, with intervals by subject; or, beside "
        "`scores`, one of linear, minmax, trained: one more system",
        "FILE", nargs="+")] = ()
    calibrate: Annotated[AnyPath | None, Help(
        "write the false match rates of one system here, for 'splitknit match --decision'", "FILE")] = None
    method: Annotated[Literal["fusion", "ridge", "minutiae"], Help(
        "with `calibrate` and `scores`: the method of 'splitknit match' that gave them")] = "fusion"
    least_mm2: Annotated[float, Help(
        "with `calibrate`: the smallest overlap among the prints compared; where less overlaps nothing is decided",
        "MM2")] = 100.0
    # fmt: on

    def run(self, progress: Progress) -> dict[str, Any]:
        """Evaluate, and write the report."""
        from splitknit.io.atomic import write_file
        from splitknit.io.provenance import json_text
        from splitknit.io.targets import check_file, check_target
        from splitknit_match.evaluation.evaluate import evaluate, evaluate_systems
        from splitknit_match.evaluation.intervals import BootstrapSettings
        from splitknit_match.evaluation.page import FORMAT, write_evaluation
        from splitknit_match.matching.score import DECISION_FORMAT, own_rates_document

        files, fuse = self._sources()
        bootstrap = BootstrapSettings(replicates=self.replicates, seed=self.seed)
        check_target(path(self.out), "report.json", "an earlier evaluation", form=FORMAT)
        check_file(path(self.calibrate), "a file of false match rates", form=DECISION_FORMAT)
        how: Any = {"cluster": self.cluster, "average": self.average, "fuse": fuse, "bootstrap": bootstrap}
        settings = {name: value for name, value in how.items() if name != "bootstrap"}
        settings["dissimilarity"] = self.dissimilarity
        method, tables = self.method, {}
        if self.gallery is None:
            require(self.key_file is None, "`key_file` is for `gallery`.")
            found = evaluate(files, dissimilarity=self.dissimilarity, progress=progress, **how)
        else:
            compared = self._gallery(progress)
            found = evaluate_systems([compared.scores], progress=progress, **how)
            inputs, notes = {str(self.gallery): compared.sha256}, (*compared.notes, *found.notes)
            found = replace(found, inputs_sha256=inputs, notes=notes)
            method, tables = compared.method, {"scores.csv": compared.table}
        progress("report", 1.0)
        if self.calibrate is not None:
            one = found.results[0].scores
            require(len(found.results) == 1, "`calibrate` takes the scores of one system; name one file.")
            require(not self.dissimilarity, "`calibrate` takes similarities, as 'splitknit match' gives them.")
            document = own_rates_document(one.impostor, f"scores of {one.name}", method, self.least_mm2)
            write_file(path(self.calibrate), json_text(document).encode())
        return write_evaluation(found, path(self.out), tables, settings)

    def _sources(self) -> tuple[list[Path], Any]:
        given = [path(one) for one in (self.scores or ([] if self.gallery is None else [self.gallery]))]
        if not self.fuse or (len(self.fuse) == 1 and self.fuse[0] in _METHODS):
            require(given, "name what is evaluated: `scores` FILE, `gallery` GALLERY or `fuse` FILE FILE.")
            return given, self.fuse[0] if self.fuse else None
        fault = "`fuse` takes score files in place of `scores` and `gallery`,"
        require(not given, f"{fault} or beside them one of {', '.join(_METHODS)}, but not '{' '.join(self.fuse)}'.")
        return [Path(name) for name in self.fuse], "all"

    def _gallery(self, progress: Progress) -> Any:
        from splitknit_match.evaluation.gallery_scores import gallery_scores
        from splitknit_match.gallery.file import key_of

        require(not self.dissimilarity, "`dissimilarity` is for `scores`; a gallery's scores are similarities.")
        assert self.gallery is not None
        return gallery_scores(path(self.gallery), key=key_of(self.key_file), progress=progress)


def _show(facts: dict[str, Any], job: EvaluationJob) -> Outcome:
    from splitknit_match.evaluation.page import interval

    lines = []
    for name, one in facts["systems"].items():
        counts = one["comparisons"]
        lines.append(f"{name}: {counts['genuine']} genuine and {counts['impostor']} impostor comparisons.")
        lines.append(f"  EER {interval(one['eer'])}")
        lines += [f"  GAR at FAR {100 * float(far):g} %: {interval(gar)}" for far, gar in one["gar_at_far"].items()]
    lines += [f"Please note: {note}" for note in facts["notes"]]
    lines.append(f"Open {path(job.out) / 'report.html'} in a browser.")
    return {"out": str(job.out), **facts}, lines


EVALUATE = Verb(EvaluationJob, _show)
