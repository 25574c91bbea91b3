"""``splitknit export``, and the import of prints: what is said of fingers for other systems."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from splitknit.cli.verb import Outcome, Verb, count
from splitknit.verbs import refuse_given
from splitknit_match.prints.export_job import ExportJob

if TYPE_CHECKING:
    from splitknit.cli.import_photos import ImportJob
    from splitknit.model import Progress


def _show(facts: dict[str, Any], job: ExportJob) -> Outcome:
    return facts, export_words(facts)


EXPORT = Verb(ExportJob, _show)


def import_prints(job: ImportJob, progress: Progress) -> Outcome:
    """Write the prints of other systems: a part of ``splitknit import``."""
    from splitknit_match.prints.export import import_records  # verbs import what they need

    refuse_given(job, ("nir", "keep", "overwrite"), "goes with `folder`.")
    job.refuse_photographs("goes with `folder`.")
    facts = import_records(job.files, job.out, job.input_ppi, progress)
    return facts, export_words(facts)


def export_words(facts: dict[str, Any]) -> list[str]:
    """For people, of an export or an import."""
    files = facts["files"]
    minutiae = [one["minutiae"] for one in files if "minutiae" in one]
    mean = f", {sum(minutiae) / len(minutiae):.0f} minutiae in the mean" if minutiae else ""
    first = f" ({files[0]['file']}{' ...' if len(files) > 1 else ''})"
    lines = [f"Wrote {count(len(files), 'file')} and export.json to {facts['out']}{first}{mean}."]
    if "vertices" in files[0]:
        lines.append(f"{files[0]['vertices']:,} vertices, {files[0]['faces']:,} triangles, in mm.")
    if "relief_roughness" in files[0]:
        rough = files[0]["relief_roughness"]
        heights = f"Sa {rough['Sa_um']:.1f} um, Sq {rough['Sq_um']:.1f} um, Sz {rough['Sz_um']:.0f} um"
        lines.append(f"Relief: {heights}, Sdr {rough['Sdr_percent']:.1f} %.")
    lines += [f"Please note: {one['file']}: {one['note']}" for one in files if "note" in one]
    failed = facts["failures_to_acquire"]
    if failed:
        failures = f"{count(len(failed), 'file')} without minutiae (failure to acquire)"
        lines.append(f"Please note: {failures}: {failed[0]} ...")
    return lines
