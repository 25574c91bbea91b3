"""A search through shards by many processes or the workers of a cluster: each scans some, and the best are merged."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from splitknit.batch.execution import run_tasks
from splitknit.errors import require
from splitknit.gallery.shards import Found, Hits, Probe, Shards, merged, rescored_count, scan_shard
from splitknit.matching.code import ProbeSettings
from splitknit.matching.template import Template


@dataclass(frozen=True, slots=True)
class _Scan:
    """One shard to scan."""

    file: Path
    probe: Probe
    count: int


def _scan(task: _Scan) -> Found:
    return scan_shard(task.file, task.probe, task.count)


def search_shards(
    shards: Shards,
    template: Template,
    k: int = 500,
    settings: ProbeSettings | None = None,
    *,
    jobs: int = 1,
    client: Any = None,
) -> Hits:
    """As :meth:`splitknit.gallery.shards.Shards.search`, whose result this is, with the shards shared out to `jobs`
    processes, or to the workers of `client` (:func:`splitknit.batch.execution.connected`), which find the files under
    the same names. A worker is given the transformed probe, never the key. Raises BadInput if the probe is a failure to
    acquire, k is less than 1, a shard cannot be read, or the cluster is lost.
    """
    require(k >= 1, f"k must be at least 1, but it is {k}.")
    probe, count = shards.probe(template, settings), rescored_count(len(shards))
    tasks = [_Scan(file.resolve(), probe, count) for file in shards.files]
    return merged(list(run_tasks(_scan, tasks, jobs, client)), k, len(shards))
