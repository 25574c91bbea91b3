"""``splitknit batch``: reconstruct and compare a whole population."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from splitknit.cli.verb import Outcome, Progress, add_device, fraction, natural, new_verb
from splitknit.errors import BadInput, require


def add_batch(verbs: Any) -> None:
    """Add the verb."""
    verb = new_verb(verbs, "batch", "reconstruct and compare a whole population, or what of it is missing", _run)
    verb.add_argument(
        "population", metavar="POPULATION", help="folder of 'splitknit simulate population' or an enrolment, or its URL"
    )
    verb.add_argument(
        "--out",
        required=True,
        metavar="STORE",
        help="folder of the results, or its URL (s3://BUCKET/PLACE); may be there",
    )
    verb.add_argument("--cases", metavar="LIST", help="presets with commas (default: metric,snk,pr,ea)")
    verb.add_argument(
        "--case",
        action="append",
        default=[],
        metavar="NAME=PRESET:STAGE.FIELD=VALUE,...",
        help="a case of your own: a preset with settings changed; may be repeated",
    )
    verb.add_argument(
        "--matchers",
        default="ridge",
        metavar="LIST",
        help="ridge (default), thesis, minutiae, voted, minutiae3d, surface-code, tetrahedra, with commas; or none",
    )
    verb.add_argument(
        "--impostors",
        type=fraction,
        default=1.0,
        metavar="FRACTION",
        help="of the comparisons of two fingers (default: 1)",
    )
    verb.add_argument("--seed", type=natural, default=0, metavar="N", help="which of them (default: 0)")
    verb.add_argument(
        "--no-surfaces",
        action="store_true",
        help="keep no surfaces, which only the matcher thesis needs: a tenth of the disk",
    )
    verb.add_argument("--csv", type=Path, metavar="DIR", help="folder of score files (default: csv in STORE)")
    verb.add_argument("--jobs", type=natural, default=2, metavar="N", help="processes (default: 2)")
    add_device(verb)
    verb.add_argument("--cluster", metavar="tls://HOST:PORT", help="Dask scheduler whose workers do it instead")
    verb.add_argument("--cluster-ca", type=Path, metavar="FILE", help="CA of the cluster's certificates")
    verb.add_argument("--cluster-cert", type=Path, metavar="FILE", help="certificate of this computer")
    verb.add_argument("--cluster-key", type=Path, metavar="FILE", help="key of that certificate")
    verb.add_argument(
        "--insecure-cluster",
        action="store_true",
        help="allow tcp:// to another computer: anyone who reaches the cluster's ports can run code on it",
    )


def _run(options: argparse.Namespace) -> Outcome:
    from splitknit.batch.engine import run_batch
    from splitknit.batch.settings import BatchSettings, preset_cases

    cluster = _cluster(options)
    cases = tuple(_case(text) for text in options.case)
    if options.cases is not None:
        cases = (*preset_cases(tuple(_names(options.cases, "--cases", "such as metric,ea"))), *cases)
    named = () if options.matchers == "none" else _names(options.matchers, "--matchers", "such as ridge, or none")
    settings = BatchSettings(
        cases=cases or preset_cases(),
        matchers=tuple(named),
        impostors=options.impostors,
        seed=options.seed,
        surfaces=not options.no_surfaces,
    )
    with Progress(options) as progress:
        facts = run_batch(
            options.population,
            options.out,
            settings,
            jobs=options.jobs,
            cluster=cluster,
            csv=options.csv,
            device=options.device,
            progress=progress.update,
        )
    return facts, _words(facts)


def _cluster(options: argparse.Namespace) -> Any:
    from splitknit.batch.execution import Cluster

    files = (options.cluster_ca, options.cluster_cert, options.cluster_key)
    if options.cluster is None:
        unused = options.insecure_cluster or any(file is not None for file in files)
        require(not unused, "certificates and --insecure-cluster are of a cluster; name it with --cluster.")
        return None
    return Cluster(options.cluster, *files, insecure=options.insecure_cluster)


def _names(text: str, option: str, such: str) -> list[str]:
    names = [name.strip() for name in text.split(",") if name.strip()]
    require(len(names) > 0, f"{option} needs a name at least, {such}, but it is '{text}'.")
    return names


def _case(text: str) -> Any:
    """Read ``NAME=PRESET:STAGE.FIELD=VALUE,...``; commas inside brackets belong to a value."""
    from splitknit.batch.settings import Case
    from splitknit.cli.options import parse_assignment

    name, equals, rest = text.partition("=")
    preset, _, changes = rest.partition(":")
    if not equals or not preset.strip():
        raise BadInput(f"--case '{text}' is not of the form NAME=PRESET:STAGE.FIELD=VALUE,...")
    parts: list[str] = []
    for part in changes.split(","):
        if parts and parts[-1].count("[") > parts[-1].count("]"):
            parts[-1] += "," + part
        elif part.strip():
            parts.append(part)
    return Case(name.strip(), preset.strip(), dict(parse_assignment(part) for part in parts))


def _words(facts: dict[str, Any]) -> list[str]:
    waiting = facts["planned"] - facts["captures"]
    lines = [
        f"{facts['reconstructed']} reconstructions made now, {facts['found']} were there: {facts['captures']} captures "
        f"in {len(facts['cases'])} cases ({', '.join(facts['cases'])}) in {facts['out']}."
    ]
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
