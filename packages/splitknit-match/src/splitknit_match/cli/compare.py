"""``splitknit compare A B``: how two measurements of one surface differ."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import Annotated, Any, Literal

from splitknit.cli.verb import Outcome, Verb
from splitknit.verbs import AnyPath, Help, Job, Progress, path


@dataclass(frozen=True, slots=True)
class CompareJob(Job):
    """How two measurements of one finger differ, laid on each other."""

    # fmt: off
    a: Annotated[AnyPath, Help("result folder, or its height.npz: what is tested", "A", positional=True)]
    b: Annotated[AnyPath, Help("the same of the reference", "B", positional=True)]
    _: KW_ONLY
    out: Annotated[AnyPath, Help("folder to write the report into", "R")]
    protocol: Annotated[Literal["powder-5", "powder-10", "powder-20", "cast", "gel"] | None, Help(
        "what B is (powder: its mean thickness in um): that protocol's simulated error is reported as well; skin on a "
        "gel or of a cast may have shifted (`elastic`)")] = None
    elastic: Annotated[bool, Help("let the skin shift smoothly; waves up to 2.5 mm alone")] = False
    repeat: Annotated[AnyPath | None, Help(
        "a second reference, coated or pressed anew: measures B's own error", "B2")] = None
    # fmt: on

    def run(self, progress: Progress) -> dict[str, Any]:
        """Compare, and write the report."""
        from splitknit import read_result
        from splitknit.io.targets import check_target
        from splitknit_match.evaluation.pair import compare_results
        from splitknit_match.evaluation.pair_page import FORMAT, write_comparison

        out, one, other = path(self.out), path(self.a), path(self.b)
        check_target(out, "report.json", "an earlier comparison", form=FORMAT)
        fit: Literal["elastic", "rigid"] = "elastic" if self.elastic or self.protocol in {"gel", "cast"} else "rigid"
        progress("reading", 0.0)
        a, b = read_result(one), read_result(other)
        again = None if self.repeat is None else read_result(path(self.repeat))
        progress("comparing", 0.2)
        pair = compare_results(a, b, fit=fit)
        progress("B's own error", 0.6)
        repeat = None if again is None else compare_results(b, again, fit=fit)
        progress("report", 0.9)
        return write_comparison(pair, out, (one, other), self.protocol, repeat)


def _show(facts: dict[str, Any], job: CompareJob) -> Outcome:
    from splitknit_match.evaluation.pair_page import headline

    notes = [f"Please note: {note}" for note in facts["notes"]]
    page = f"Open {path(job.out) / 'report.html'} in a browser."
    return {"out": str(job.out), **facts}, [*headline(facts), *notes, page]


COMPARE = Verb(CompareJob, _show)
