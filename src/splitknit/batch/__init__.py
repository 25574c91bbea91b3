"""Whole populations: reconstructed and matched in parallel, resumable, into one store of Parquet files."""

from splitknit.batch.engine import run_batch
from splitknit.batch.execution import Cluster
from splitknit.batch.export import to_scores
from splitknit.batch.settings import BatchSettings, Case, preset_cases
from splitknit.batch.store import Store

__all__ = ["BatchSettings", "Case", "Cluster", "Store", "preset_cases", "run_batch", "to_scores"]
