"""Dask clusters of this computer, for tests."""

import pytest


def local_cluster(workers, **options):
    """A cluster of workers of one thread, whose ports and dashboard only this computer reaches."""
    distributed = pytest.importorskip("distributed")
    return distributed.LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
        silence_logs="CRITICAL",
        **options,
    )
