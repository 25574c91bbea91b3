"""What ``splitknit import`` does with a point cloud or a mesh: a result folder comes out."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from splitknit.errors import naming, require
from splitknit.verbs import path, refuse_given

if TYPE_CHECKING:
    from splitknit.cli.import_photos import ImportJob
    from splitknit.cli.verb import Outcome
    from splitknit.verbs import Progress


def import_cloud(job: ImportJob, progress: Progress) -> Outcome:
    """Lay a cloud on a grid, and write it as a result."""
    from splitknit.io.clouds import read_cloud
    from splitknit.io.provenance import file_hash
    from splitknit.io.targets import check_target
    from splitknit.methods.cloud import CloudView, result_of_cloud
    from splitknit.report.result import write_results

    file, out, pitch, given = path(job.files[0]), path(job.out), job.pitch_mm, job.photographs
    job.refuse_photographs(("material", "tip_direction_deg"), "does not go with a point cloud.")
    refuse_given(job, ("input_ppi",), "does not go with a point cloud.")
    require(pitch is None or 1e-4 <= pitch <= 10.0, f"`pitch_mm` must be millimetres from 0.0001 to 10, not {pitch}.")
    require(job.overwrite or not out.exists(), f"'{out}' exists; give `overwrite`, or another `out`.")
    check_target(out, "height.npz", "an earlier result", keep=file)
    view = CloudView(job.up, pitch, given.tip_direction_deg, given.material or "skin")
    progress("reading", 0.1)
    cloud = read_cloud(file, job.unit)
    progress("surface", 0.4)
    result = naming(file, lambda: result_of_cloud(cloud, view))
    progress("writing", 0.7)
    result = replace(result, hashes={file.name: file_hash(file)})
    facts = write_results(result, None, out)
    about, (rows, columns) = result.facts["cloud"], result.mask.shape
    return {**facts, "out": str(out)}, [
        f"{about['points']:,} points ({about['format']}, {about['grid']}) are {columns} x {rows} pixels of "
        f"{1000 * result.pitch_mm:.1f} um, {result.mask.sum() * result.pitch_mm**2:.0f} mm2, seen against "
        f"{' '.join(f'{one:g}' for one in about['towards_viewer'])} ({about['found_by']}); written to {out}.",
        *(f"Please note: {note}" for note in result.warnings),
        f"Next: splitknit print {out} --out PRINT, splitknit view {out}",
    ]
