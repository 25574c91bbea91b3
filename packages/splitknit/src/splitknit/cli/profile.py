"""``splitknit profile``: a surface cut between two points, as a table and parameters of roughness."""

from __future__ import annotations

import re
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated, Any

from splitknit.cli.verb import Outcome, Verb
from splitknit.errors import require
from splitknit.verbs import AnyPath, Help, Job, Positive, Progress, path

_NUMBER = r"[-+]?(?:\d{1,5}\.?\d{0,9}|\.\d{1,9})"


def _place(text: str) -> tuple[float, float]:
    found = re.fullmatch(rf"({_NUMBER}),({_NUMBER})", text)
    require(found is not None, f"'{text}' must be X,Y in mm, such as -3,0.5")
    assert found is not None
    return float(found[1]), float(found[2])


@dataclass(frozen=True, slots=True)
class ProfileJob(Job):
    """Cut a surface between two points, and measure its roughness there."""

    # fmt: off
    result: Annotated[AnyPath, Help("folder of a result", positional=True)]
    start: Annotated[tuple[float, float], Help(
        "one end in mm from the image's middle, x right, y up, as a section in report.html states it", "X0,Y0",
        positional=True, read=_place)]
    end: Annotated[tuple[float, float], Help("the other end", "X1,Y1", positional=True, read=_place)]
    _: KW_ONLY
    cutoff: Annotated[Positive, Help("wavelength that divides roughness from form (ISO 4288)", "MM")] = 0.8
    out: Annotated[AnyPath, Help("folder for profile.csv", "DIR")] = "profile"
    # fmt: on

    def run(self, progress: Progress) -> dict[str, Any]:
        """Cut it, and write the table."""
        import numpy as np

        from splitknit.imaging.roughness import profile_roughness
        from splitknit.io.atomic import atomic_folder, write_file
        from splitknit.io.csv_table import csv_text
        from splitknit.io.results import read_result
        from splitknit.report.surface import section, surface_in

        surface = surface_in(read_result(path(self.result)))
        require(surface.unit.known, f"{self.result} has heights in pixels; reconstruct it with `px_per_mm`.")
        cut = section(surface, self.start, self.end)
        step_mm = float(cut.along_mm[1])
        rough, found = profile_roughness(cut.height_mm, step_mm, self.cutoff)
        columns = {"along_mm": cut.along_mm, "x_mm": cut.x_mm, "y_mm": cut.y_mm}
        columns |= {"height_um": 1000.0 * cut.height_mm, "roughness_um": rough}
        rows = np.column_stack(list(columns.values())).tolist()
        cells = [["" if np.isnan(value) else f"{value:.4f}" for value in row] for row in rows]
        with atomic_folder(path(self.out)) as folder:
            write_file(folder / "profile.csv", csv_text([columns, *cells]).encode("ascii"))
        return {"out": str(self.out), "cutoff_mm": self.cutoff, "step_mm": step_mm, **found, **cut.figures}


def _show(facts: dict[str, Any], job: ProfileJob) -> Outcome:
    few = f" ({facts['sampling_lengths']} sampling lengths, ISO 4288 wants 5)" if facts["sampling_lengths"] < 5 else ""
    ra, rz, rq = (f"{facts[name]:.3g} um" for name in ("Ra_um", "Rz_um", "Rq_um"))
    over = f"cut-off {facts['cutoff_mm']:g} mm{few}, over {facts['flat_mm']:.2f} mm"
    written = f"Written to {Path(job.out)}: profile.csv."
    return facts, [f"Ra {ra}, Rz {rz}, Rq {rq}, {over}.", written]


PROFILE = Verb(ProfileJob, _show)
