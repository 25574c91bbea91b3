"""The page of a sensor's shading: residuals on balls that were left out, and what physics says of the lights."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from splitknit.calibration.shading import ShadingFit
from splitknit.io.atomic import write_file
from splitknit.io.pictures import colour, data_uri
from splitknit.io.targets import check_file
from splitknit.photometric.shading import place_terms
from splitknit.report import template
from splitknit.report.charts import Axis, Curve, line_chart, round_marks

_MAP_PX = 900
_TITLE = "Calibration of shading"


def check_page(page: Path) -> None:
    """Refuse to replace a file that is no page of this kind. Raises BadInput."""
    check_file(page, "a page of a calibration of shading", lambda data: f"<title>{_TITLE}</title>".encode() in data)


def write_page(page: Path, fit: ShadingFit) -> None:
    """Write the page, which needs nothing else. Raises BadInput if it cannot be written."""
    shading, facts = fit.shading, fit.shading.facts
    azimuth = np.rad2deg(np.arctan2(shading.direction[:, 1], shading.direction[:, 0])) % 360.0
    elevation = np.rad2deg(np.arcsin(np.clip(shading.direction[:, 2], -1.0, 1.0)))
    residual = facts.get("physics_residual", [0.0] * len(azimuth))
    lights = [
        (
            k,
            f"{a:.0f}",
            f"{e:.0f}",
            "distant" if near < 1e-4 else f"{1 / near:.0f} mm",
            f"{room:.2f}",
            f"{100 * off:.1f} %",
        )
        for k, (a, e, near, room, off) in enumerate(
            zip(azimuth, elevation, shading.nearness, shading.ambient, residual, strict=True)
        )
    ]
    rows, columns = shading.image_size
    left, bottom = [0, 0, columns - 1, columns - 1], [rows - 1, 0, rows - 1, 0]
    terms = place_terms(shading.image_size, left, bottom, shading.fall_off.shape[1])
    edges = np.exp((shading.fall_off @ terms) - shading.fall_off[:, :1])
    chart = _slope_chart(fit) if len(fit.error_by_slope) else ""
    picture, limit = _residual_map(fit) if fit.cap_errors else ("", 0.0)
    html = template("shading.html").render(
        title=_TITLE, facts=facts, shading=shading, notes=fit.notes, lights=lights, chart=chart, map=picture,
        limit=limit, tried=facts.get("tried", ()), places=sum(fit.used), balls=[
            (f"{one[1]:.1f}", f"{one[2]:.1f}", "yes" if used else "no", f"{rms:.2f}", f"{gain:.3f}")
            for one, used, rms, gain in zip(fit.balls, fit.used, fit.cap_rms_um, fit.cap_gain, strict=True)
        ],
        fall_off=[(k, ", ".join(f"{value:.2f}" for value in row)) for k, row in enumerate(edges)],
    )  # fmt: skip
    write_file(page, html.encode("utf-8"))


def _slope_chart(fit: ShadingFit) -> str:
    slope, mean, rms = fit.error_by_slope.T
    top = 1.15 * float(np.max(rms))
    low = min(1.15 * float(np.min(mean)), -0.1 * top)
    x = Axis("slope of the ball", 0.0, float(slope[-1]), tuple((v, f"{v:g}") for v in round_marks(0.0, slope[-1], 6)))
    y = Axis("error of the slope", low, top, tuple((v, f"{v:g}") for v in round_marks(low, top, 6)))
    curves = [Curve("rms, a pixel", slope, rms), Curve("mean, along the slope", slope, mean)]
    return str(line_chart(curves, x, y))


def _residual_map(fit: ShadingFit) -> tuple[str, float]:
    """Errors of the heights of all caps where they lie in the image, and the limit of the colours in um."""
    rows, columns = fit.shading.image_size
    scale = min(1.0, _MAP_PX / max(rows, columns))
    picture = np.full((max(1, int(rows * scale)), max(1, int(columns * scale)), 3), 245, dtype=np.uint8)
    limit = float(np.percentile(np.abs(np.concatenate([one[:, 2] for one in fit.cap_errors])), 98)) or 1.0
    for cap in fit.cap_errors:
        step = max(1.0, np.sqrt(np.ptp(cap[:, 0]) * np.ptp(cap[:, 1]) * 0.785 / len(cap)) * scale)
        half = int(np.ceil(0.5 * step))
        paint = colour(cap[:, 2].astype(np.float32), -limit, limit, diverging=True)
        for (x, y, _), one in zip(cap, paint, strict=True):
            column, row = int(x * scale), int(y * scale)
            picture[max(row - half + 1, 0) : row + half, max(column - half + 1, 0) : column + half] = one
    return data_uri(picture), limit
