"""Whole populations: reconstructed and matched in parallel, resumable, into one store of Parquet files."""
