"""A surface cut between two points, as a table and parameters of roughness."""

from __future__ import annotations

from pathlib import Path

from splitknit.arguments import AnyPath, PlanePoint, Positive, Report, checked
from splitknit.errors import require

STEEP_WALLS = (
    "That height is a lower limit: {} of the section are steeper than 70 deg, where shadow hides"
    " how high a wall is."
)


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
        Folder for profile.csv and profile.svg.

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
    from splitknit.report.surface import section, section_svg, surface_in

    surface = surface_in(read_result(Path(result)))
    text = surface.unit.text
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
        write_file(folder / "profile.svg", section_svg(cut).encode("utf-8"))
    cut_facts = cut.figures
    facts = {"out": str(out), "cutoff_mm": cutoff, "step_mm": step_mm, **figures, **cut_facts}
    lengths = figures["sampling_lengths"]
    few = f" ({lengths} sampling lengths, ISO 4288 wants 5)" if lengths < 5 else ""
    ra, rz, rq = (text(figures[name] / 1000.0) for name in ("Ra_um", "Rz_um", "Rq_um"))
    rise, flat, steep = (
        text(cut_facts[name]) for name in ("height_difference_mm", "flat_mm", "steep_mm")
    )
    height = text(cut_facts["height_range_mm"], cut_facts["height_range_sd_mm"])
    lines = (
        f"Height {rise} from end to end, {height} from lowest to highest, over {flat}.",
        *([STEEP_WALLS.format(steep)] if cut_facts["steep_mm"] else []),
        f"Ra {ra}, Rz {rz}, Rq {rq}, cut-off {cutoff:g} mm{few}.",
        f"Written to {out}: profile.csv, profile.svg.",
    )
    return Report(facts, lines)
