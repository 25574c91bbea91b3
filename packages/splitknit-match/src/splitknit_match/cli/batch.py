"""``splitknit batch``: reconstruct and compare a whole population."""

from __future__ import annotations

import re
from dataclasses import KW_ONLY, dataclass
from typing import Annotated, Any

from splitknit.cli.verb import Verb
from splitknit.errors import require
from splitknit.verbs import AnyPath, Device, Fraction, Help, Job, Natural, Progress, path


@dataclass(frozen=True, slots=True)
class BatchJob(Job):
    """Reconstruct and compare a whole population, or what of it is missing."""

    # fmt: off
    population: Annotated[AnyPath, Help(
        "folder of 'splitknit simulate population' or an enrolment", "POPULATION", positional=True)]
    _: KW_ONLY
    out: Annotated[AnyPath, Help("folder of the results; may be there", "STORE")]
    cases: Annotated[str | None, Help("presets with commas (default: metric,snk,pr,ea)", "LIST")] = None
    case: Annotated[tuple[str, ...], Help(
        "a case of your own: a preset with settings changed; may be repeated",
        "NAME=PRESET:STAGE.FIELD=VALUE,...")] = ()
    matchers: Annotated[str, Help(
        "ridge (default), thesis, thesis-code, minutiae, with commas; or none", "LIST")] = "ridge"
    impostors: Annotated[Fraction, Help("of the comparisons of two fingers", "FRACTION")] = 1.0
    seed: Annotated[Natural, Help("which of them", "N")] = 0
    surfaces: Annotated[bool, Help(
        "keep no surfaces, which only the matcher thesis needs: a tenth of the disk")] = True
    jobs: Annotated[Natural, Help("processes at most, if memory allows", "N")] = 2
    device: Device = "cpu"
    scheduler: Annotated[str | None, Help(
        "Dask scheduler whose workers do it instead", "tls://HOST:PORT")] = None
    # fmt: on

    def run(self, progress: Progress) -> dict[str, Any]:
        """Do what is missing."""
        from splitknit_match.batch.cases import preset_cases  # verbs import what they need
        from splitknit_match.batch.engine import run_batch

        cases = tuple(_case(text) for text in self.case)
        if self.cases is not None:
            presets = _names(self.cases, "`cases`", "such as metric,ea")
            cases = (*preset_cases(tuple(presets)), *cases)
        matchers = _names(self.matchers, "`matchers`", "such as ridge, or none")
        return run_batch(
            path(self.population),
            path(self.out),
            cases=cases or preset_cases(),
            matchers=[] if matchers == ["none"] else matchers,
            impostors=self.impostors,
            seed=self.seed,
            surfaces=self.surfaces,
            jobs=self.jobs,
            scheduler=self.scheduler,
            device=self.device,
            progress=progress,
        )


def _names(text: str, option: str, such: str) -> list[str]:
    names = [name.strip() for name in text.split(",") if name.strip()]
    require(names, f"{option} needs a name at least, {such}, but it is '{text}'.")
    return names


def _case(text: str) -> Any:
    """Read ``NAME=PRESET:STAGE.FIELD=VALUE,...``; commas inside brackets belong to a value."""
    from splitknit.cli.options import parse_assignment
    from splitknit_match.batch.cases import Case

    name, _, rest = text.partition("=")
    preset, _, changes = rest.partition(":")
    fault = f"`case` '{text}' is not of the form NAME=PRESET:STAGE.FIELD=VALUE,..."
    require(preset.strip(), fault)
    assignments = re.findall(r"(?:\[[^\]]*\]|[^,\[])+", changes)
    parts = [parse_assignment(part) for part in assignments if part.strip()]
    return Case(name.strip(), preset.strip(), dict(parts))


def _words(facts: dict[str, Any]) -> list[str]:
    made = f"{facts['reconstructed']} reconstructions made now, {facts['found']} were there"
    cases = f"{len(facts['cases'])} cases ({', '.join(facts['cases'])})"
    lines = [f"{made}: {facts['captures']} captures in {cases} in {facts['out']}."]
    if waiting := facts["planned"] - facts["captures"]:
        lines.append(f"{waiting} captures of the plan are not there yet; run the same again when they are.")
    if failures := facts["failures"]:
        lines.append(f"{len(failures)} failures to acquire now; the first: {failures[0]}")
    for scores in facts["scores"]:
        each = scores["ms_per_comparison"]
        speed = "" if each is None else f" ({each:.1f} ms each on one core)"
        made = f"{scores['compared']} comparisons made now"
        lines.append(f"{scores['case']}, {scores['matcher']}: {made}{speed}.")
    if facts["csv"]:
        lines.append(f"Score files for 'splitknit evaluate --scores': {', '.join(facts['csv'])}.")
    return lines


BATCH = Verb(BatchJob, lambda facts, job: (facts, _words(facts)))
