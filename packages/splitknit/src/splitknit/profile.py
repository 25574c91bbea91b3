"""A surface cut between two points, as a table and parameters of roughness."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from splitknit.arguments import AnyPath, PlanePoint, Positive, checked, text_of
from splitknit.errors import require


@dataclass(frozen=True, slots=True)
class Profile:
    """Roughness of a surface along a line."""

    facts: dict[str, Any]
    """``Ra_um``, ``Rz_um``, ``Rq_um`` and others, by what ``profile.csv`` was made."""

    def __str__(self) -> str:
        facts = self.facts
        lengths = facts["sampling_lengths"]
        few = f" ({lengths} sampling lengths, ISO 4288 wants 5)" if lengths < 5 else ""
        ra, rz, rq = (f"{facts[name]:.3g} um" for name in ("Ra_um", "Rz_um", "Rq_um"))
        over = f"cut-off {facts['cutoff_mm']:g} mm{few}, over {facts['flat_mm']:.2f} mm"
        return text_of(
            [f"Ra {ra}, Rz {rz}, Rq {rq}, {over}.", f"Written to {facts['out']}: profile.csv."]
        )


@checked
def profile(
    result: AnyPath,
    start: PlanePoint,
    end: PlanePoint,
    *,
    cutoff: Positive = 0.8,
    out: AnyPath = Path("profile"),
) -> Profile:
    """Cut a surface between two points, and measure its roughness there.

    Parameters
    ----------
    result
        Folder of a result.
    start
        One end, X,Y in mm from the image's middle, x right, y up, as a section in report.html
        states it.
    end
        The other end, X,Y.
    cutoff
        Wavelength that divides roughness from form, in mm (ISO 4288).
    out
        Folder for profile.csv.

    Returns
    -------
    Profile

    Raises
    ------
    BadInput
        If `result` holds no surface of known scale, or the line leaves it.

    Examples
    --------
    >>> profile("result", (-3.0, 0.5), (3.0, 0.5)).facts["Ra_um"]  # doctest: +SKIP
    8.7
    """
    import numpy as np

    from splitknit.imaging.roughness import profile_roughness
    from splitknit.io.atomic import atomic_folder, write_file
    from splitknit.io.csv_table import csv_text
    from splitknit.io.results import read_result
    from splitknit.report.surface import section, surface_in

    surface = surface_in(read_result(Path(result)))
    require(surface.unit.known, f"{result} has heights in pixels; reconstruct it with `px_per_mm`.")
    cut = section(surface, start, end)
    step_mm = float(cut.along_mm[1])
    rough, figures = profile_roughness(cut.height_mm, step_mm, cutoff)
    columns = {"along_mm": cut.along_mm, "x_mm": cut.x_mm, "y_mm": cut.y_mm}
    columns |= {"height_um": 1000.0 * cut.height_mm, "roughness_um": rough}
    rows = np.column_stack(list(columns.values())).tolist()
    cells = [["" if np.isnan(value) else f"{value:.4f}" for value in row] for row in rows]
    with atomic_folder(Path(out)) as folder:
        write_file(folder / "profile.csv", csv_text([columns, *cells]).encode("ascii"))
    return Profile(
        {"out": str(out), "cutoff_mm": cutoff, "step_mm": step_mm, **figures, **cut.figures}
    )
