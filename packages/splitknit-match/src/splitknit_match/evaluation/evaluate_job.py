"""Score files in, error rates with their intervals out: what :func:`splitknit_match.evaluate` does."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from splitknit.verbs import AnyPath, Help, Job, Progress, function_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from splitknit_match.evaluation.intervals import BootstrapSettings
    from splitknit_match.evaluation.study import Evaluation

    Files = AnyPath | Sequence[AnyPath]
    Bootstrap = BootstrapSettings | None
else:
    Files = tuple[AnyPath, ...]
    Bootstrap = object

Dissimilarity = Annotated[bool, Help("the scores are distances: lower is more similar")]
Cluster = Annotated[Literal["auto", "plain", "finger", "subject"], Help(
    "what the bootstrap draws for the intervals in the first place (default: fingers where they are named, else "
    "subjects, else comparisons); the others are reported as well")]  # fmt: skip
Average = Annotated[bool, Help(
    "give the figures of scores averaged over sessions as well", option="--average-sessions")]  # fmt: skip


@dataclass(frozen=True, slots=True)
class EvaluateJob(Job):
    """Error rates with their intervals from score files.

    Returns
    -------
    Evaluation
        ``results``: of every system and variant ``eer``, ``gar_at(far)``, ``auc``, each with its confidence interval;
        ``differences`` between systems; ``notes``.

    Raises
    ------
    BadInput
        If a file cannot be used.

    Examples
    --------
    >>> import splitknit_match
    >>> splitknit_match.evaluate("scores.csv").results[0].eer.value  # doctest: +SKIP
    """

    # fmt: off
    files: Annotated[Files, Help(
        "score files, one a system: CSV with genuine and impostor comparisons, see ``docs/guide/evaluation.md``",
        takes="path, or several")]
    _: KW_ONLY
    dissimilarity: Dissimilarity = False
    cluster: Cluster = "auto"
    average: Average = False
    fuse: Annotated[Literal["linear", "minmax", "llr", "trained", "all"] | None, Help(
        "whether the systems' fusion is one more: of z-scores (``linear``), of min-max scores, of log-likelihood "
        "ratios (``llr``), by logistic regression (``trained``), or the first three with intervals by subject "
        "(``all``)")] = None
    bootstrap: Annotated[Bootstrap, Help(
        "of :class:`splitknit_match.evaluation.intervals.BootstrapSettings`", takes="BootstrapSettings")] = None
    # fmt: on

    def run(self, progress: Progress) -> Evaluation:
        """Evaluate them."""
        from splitknit_match.evaluation.intervals import BootstrapSettings
        from splitknit_match.evaluation.study import EvaluationSettings, evaluate_scores

        bootstrap = self.bootstrap or BootstrapSettings()
        settings = EvaluationSettings(self.dissimilarity, self.cluster, self.average, self.fuse, bootstrap)
        files: Any = self.files  # one or several were given, and are paths now
        return evaluate_scores([Path(file) for file in files], settings, progress=progress)


evaluate = function_of(EvaluateJob)
