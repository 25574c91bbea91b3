"""A surface cut between two points, as a table and parameters of roughness."""

from __future__ import annotations

from pathlib import Path

from splitknit.arguments import AnyPath, PlanePoint, Positive, Report, checked
from splitknit.errors import require


@checked
def profile(
    result: AnyPath,
    start: PlanePoint,
    end: PlanePoint,
    *,
    cutoff: Positive = 0.8,
    out: AnyPath = Path("profile"),
) -> Report:
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
    Report
        Facts ``Ra_um``, ``Rz_um``, ``Rq_um`` and others, by what ``profile.csv`` was made.

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
    rise_mm, range_mm = float(cut.height_mm[-1] - cut.height_mm[0]), float(np.ptp(cut.height_mm))
    facts = {"out": str(out), "cutoff_mm": cutoff, "step_mm": step_mm, **figures, **cut.figures}
    facts["height_range_mm"] = range_mm
    lengths = figures["sampling_lengths"]
    few = f" ({lengths} sampling lengths, ISO 4288 wants 5)" if lengths < 5 else ""
    ra, rz, rq = (_length(figures[name] / 1000.0) for name in ("Ra_um", "Rz_um", "Rq_um"))
    heights = f"{_length(rise_mm)} from end to end, {_length(range_mm)} from lowest to highest"
    lines = (
        f"Height {heights}, over {cut.figures['flat_mm']:.2f} mm.",
        f"Ra {ra}, Rz {rz}, Rq {rq}, cut-off {cutoff:g} mm{few}.",
        f"Written to {out}: profile.csv.",
    )
    return Report(facts, lines)


def _length(length_mm: float) -> str:
    """A length in the unit in which it is read easily."""
    return f"{1000.0 * length_mm:.3g} um" if abs(length_mm) < 1.0 else f"{length_mm:.3g} mm"
