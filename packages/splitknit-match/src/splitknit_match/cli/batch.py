"""``splitknit batch``: reconstruct and compare a whole population."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import Annotated, Any

from splitknit import BadInput
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
    csv: Annotated[AnyPath | None, Help("folder of score files (default: csv in STORE)", "DIR")] = None
    jobs: Annotated[Natural, Help("processes", "N")] = 2
    device: Device = "cpu"
    cluster: Annotated[str | None, Help("Dask scheduler whose workers do it instead", "tls://HOST:PORT")] = None
    cluster_ca: Annotated[AnyPath | None, Help("CA of the cluster's certificates", "FILE")] = None
    cluster_cert: Annotated[AnyPath | None, Help("certificate of this computer", "FILE")] = None
    cluster_key: Annotated[AnyPath | None, Help("key of that certificate", "FILE")] = None
    insecure_cluster: Annotated[bool, Help(
        "allow tcp:// to another computer: anyone who reaches the cluster's ports can run code on it")] = False
    # fmt: on

    def run(self, progress: Progress) -> dict[str, Any]:
        """Do what is missing."""
        from splitknit_match.batch.engine import run_batch  # verbs import what they need
        from splitknit_match.batch.settings import BatchSettings, preset_cases

        cluster, cases = self._cluster(), tuple(_case(text) for text in self.case)
        if self.cases is not None:
            cases = (*preset_cases(tuple(_names(self.cases, "`cases`", "such as metric,ea"))), *cases)
        none = self.matchers == "none"
        settings = BatchSettings(
            cases=cases or preset_cases(),
            matchers=() if none else tuple(_names(self.matchers, "`matchers`", "such as ridge, or none")),
            impostors=self.impostors,
            seed=self.seed,
            surfaces=self.surfaces,
        )
        return run_batch(
            path(self.population), path(self.out), settings,
            jobs=self.jobs, cluster=cluster, csv=path(self.csv), device=self.device, progress=progress,
        )  # fmt: skip

    def _cluster(self) -> Any:
        from splitknit_match.batch.execution import Cluster

        files = (path(self.cluster_ca), path(self.cluster_cert), path(self.cluster_key))
        if self.cluster is None:
            unused = self.insecure_cluster or any(file is not None for file in files)
            require(not unused, "certificates and `insecure_cluster` are of a cluster; name it with `cluster`.")
            return None
        return Cluster(self.cluster, *files, insecure=self.insecure_cluster)


def _names(text: str, option: str, such: str) -> list[str]:
    names = [name.strip() for name in text.split(",") if name.strip()]
    require(len(names) > 0, f"{option} needs a name at least, {such}, but it is '{text}'.")
    return names


def _case(text: str) -> Any:
    """Read ``NAME=PRESET:STAGE.FIELD=VALUE,...``; commas inside brackets belong to a value."""
    from splitknit.cli.options import parse_assignment
    from splitknit_match.batch.settings import Case

    name, equals, rest = text.partition("=")
    preset, _, changes = rest.partition(":")
    if not equals or not preset.strip():
        raise BadInput(f"`case` '{text}' is not of the form NAME=PRESET:STAGE.FIELD=VALUE,...")
    parts: list[str] = []
    for part in changes.split(","):
        if parts and parts[-1].count("[") > parts[-1].count("]"):
            parts[-1] += "," + part
        elif part.strip():
            parts.append(part)
    return Case(name.strip(), preset.strip(), dict(parse_assignment(part) for part in parts))


def _words(facts: dict[str, Any]) -> list[str]:
    waiting = facts["planned"] - facts["captures"]
    made = f"{facts['reconstructed']} reconstructions made now, {facts['found']} were there"
    cases = f"{len(facts['cases'])} cases ({', '.join(facts['cases'])})"
    lines = [f"{made}: {facts['captures']} captures in {cases} in {facts['out']}."]
    if waiting:
        lines.append(f"{waiting} captures of the plan are not there yet; run the same again when they are.")
    failures = facts["failures"]
    if failures:
        lines.append(f"{len(failures)} failures to acquire now; the first: {failures[0]}")
    for one in facts["scores"]:
        each = one["ms_per_comparison"]
        speed = f" ({each:.1f} ms each on one core)" if each is not None else ""
        lines.append(f"{one['case']}, {one['matcher']}: {one['compared']} comparisons made now{speed}.")
    if facts["csv"]:
        lines.append(f"Score files for 'splitknit evaluate --scores': {', '.join(facts['csv'])}.")
    return lines


BATCH = Verb(BatchJob, lambda facts, job: (facts, _words(facts)))
