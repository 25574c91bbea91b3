"""``splitknit profile``: a surface cut between two points, as a table, a picture and parameters of roughness."""

from __future__ import annotations

import re
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated, Any

from splitknit.cli.verb import Outcome, Verb
from splitknit.errors import require
from splitknit.verbs import AnyPath, Help, Job, Positive, Progress, path

Columns = dict[str, Any]  # columns of the table, (N,) each
_NUMBER = r"[-+]?(?:\d{1,5}\.?\d{0,9}|\.\d{1,9})"
_LEFT, _TOP, _WIDE, _TALL = 90, 30, 900, 260


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
    out: Annotated[AnyPath, Help("folder for profile.csv and profile.png", "DIR")] = "profile"
    # fmt: on

    def run(self, progress: Progress) -> dict[str, Any]:
        """Cut it, and write the table and the picture."""
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
            write_file(folder / "profile.png", _drawn(columns))
        return {"out": str(self.out), "cutoff_mm": self.cutoff, "step_mm": step_mm, **found, **cut.figures}


def _drawn(columns: Columns) -> bytes:
    """Both curves as PNG, height above roughness."""
    import cv2
    import numpy as np

    from splitknit.report.charts import axis_over

    picture = np.full((2 * (_TALL + 2 * _TOP), _LEFT + _WIDE + 20), 255, np.uint8)
    x = axis_over("mm from the first point", columns["along_mm"], pad=0.0)

    def write(text: str, place: Any, dx: int, dy: int) -> None:
        at, font = (int(place[0]) + dx, int(place[1]) + dy), cv2.FONT_HERSHEY_SIMPLEX
        cv2.putText(picture, text, at, font, 0.45, (0,), 1, cv2.LINE_AA)

    for top, name in ((_TOP, "height_um"), (3 * _TOP + _TALL, "roughness_um")):
        known = np.isfinite(columns[name])
        y = axis_over(name.replace("_um", ", um"), columns[name][known])

        def point(along: Any, value: Any, top: int = top, y: Any = y) -> Any:
            return np.stack([_LEFT + _WIDE * x.place(along), top + _TALL * (1.0 - y.place(value))], axis=-1)

        for mark, words in y.marks:
            ends = np.rint(point(np.array([x.low, x.high]), mark + np.zeros(2))).astype(np.int32)
            cv2.polylines(picture, [ends], isClosed=False, color=(220,))
            write(words, ends[0], -60, 4)
        for mark, words in x.marks:
            write(words, point(mark, y.low), -8, 18)
        write(f"{y.label}, over {x.label}", (_LEFT, top), 0, -8)
        curve = np.rint(point(columns["along_mm"][known], columns[name][known])).astype(np.int32)
        cv2.polylines(picture, [curve], isClosed=False, color=(0,), thickness=1, lineType=cv2.LINE_AA)
    return bytes(cv2.imencode(".png", picture)[1])


def _show(facts: dict[str, Any], job: ProfileJob) -> Outcome:
    few = f" ({facts['sampling_lengths']} sampling lengths, ISO 4288 wants 5)" if facts["sampling_lengths"] < 5 else ""
    ra, rz, rq = (f"{facts[name]:.3g} um" for name in ("Ra_um", "Rz_um", "Rq_um"))
    over = f"cut-off {facts['cutoff_mm']:g} mm{few}, over {facts['flat_mm']:.2f} mm"
    written = f"Written to {Path(job.out)}: profile.csv, profile.png."
    return facts, [f"Ra {ra}, Rz {rz}, Rq {rq}, {over}.", written]


PROFILE = Verb(ProfileJob, _show)
