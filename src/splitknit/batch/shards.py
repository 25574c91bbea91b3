"""A search through shards by many processes or the workers of a cluster: each scans some, and the best are merged."""

from __future__ import annotations

from functools import partial
from typing import Any

from splitknit.batch.execution import run_tasks
from splitknit.errors import require
from splitknit.gallery.shards import Hits, Shards, merged, rescored_count, scan_shard
from splitknit.matching.code import ProbeSettings
from splitknit.matching.template import Template


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
    scan, files = partial(scan_shard, probe=probe, count=count), [file.resolve() for file in shards.files]
    return merged(list(run_tasks(scan, files, jobs, client)), k, len(shards))
