"""Shards that are shared out: to processes, and to workers of a cluster one of which is killed."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import numpy as np
import pytest
from batch_stores import waves

from splitknit.batch.shards import search_shards
from splitknit.gallery.key import Key
from splitknit.gallery.shards import Hits, Shards, write_shards
from splitknit.matching.code import code_of, code_size
from splitknit.matching.template import Template, unpack

KEY = Key(bytes(range(32)), raw=True)


@pytest.fixture(scope="module")
def shards(tmp_path_factory: pytest.TempPathFactory) -> Shards:
    """Twelve of 500 codes each."""
    codes = np.random.default_rng(0).normal(0, 26, (6000, code_size())).round().clip(-127, 127).astype(np.int8)
    codes[4321] = code_of(probe())
    folder = tmp_path_factory.mktemp("shards")
    write_shards(folder, np.arange(6000), codes, KEY, rows_a_shard=500)
    return Shards(folder, KEY)


def probe() -> Template:
    return unpack(waves("right_index", 1))


def same(one: Hits, other: Hits) -> bool:
    return one.rows.tolist() == other.rows.tolist() and one.similarity.tolist() == other.similarity.tolist()


def test_shared_out_the_result_is_the_same(shards: Shards) -> None:
    expected = shards.search(probe(), 700)
    assert expected.rows[0] == 4321
    assert same(search_shards(shards, probe(), 700), expected)


@pytest.mark.slow
def test_of_three_workers_of_a_cluster_one_is_killed(shards: Shards) -> None:
    distributed = pytest.importorskip("distributed")
    expected = shards.search(probe(), 700)
    with distributed.LocalCluster(
        n_workers=3, threads_per_worker=1, dashboard_address="127.0.0.1:0", silence_logs="CRITICAL"
    ) as cluster:
        pids = [worker.pid for worker in cluster.workers.values()]
        client = cluster.get_client()
        assert same(search_shards(shards, probe(), 700, client=client), expected)
        done: list[object] = []

        class Killing:
            """A client one of whose workers is killed when half of the shards are given out."""

            loop, nthreads = client.loop, client.nthreads

            def submit(self, *arguments: object, **named: object) -> object:
                if len(done) == 6:
                    os.kill(pids[0], signal.SIGKILL)
                done.append(arguments)
                return client.submit(*arguments, **named)

        assert same(search_shards(shards, probe(), 700, client=Killing()), expected)
        assert len(done) == 12
        client.close()


def test_a_shard_that_is_gone(shards: Shards, tmp_path: Path) -> None:
    lost = Shards(shards.files[0].parent, KEY)
    lost.files = (*lost.files, tmp_path / "codes-000099.skc")
    with pytest.raises(ValueError, match="does not exist"):
        search_shards(lost, probe())
