"""A result drawn with matplotlib (``Reconstruction.plot``)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from splitknit.errors import importing, require
from splitknit.finger.ridges import surface_print
from splitknit.io.pictures import normal_colours, on_paper, to_frame, upright_frame
from splitknit.model import Reconstruction
from splitknit.report.figures import relief_limits, upright_normals
from splitknit.report.result import PRINT_PPI, is_printed

PANELS = ("height", "relief", "normals", "print")
_LONGEST_PX = 1200
_PANEL_INCHES = (2.5, 4.6)
_INK = 250  # paper is brighter


def plot(result: Reconstruction, panels: Sequence[str] = (), ax: Any = None) -> Any:
    """Draw panels; see :meth:`splitknit.model.Reconstruction.plot`."""
    with importing(
        "plot() needs matplotlib, which is not installed: in the environment of splitknit, "
        "python -m pip install 'splitknit[plot]', or in its folder, make install EXTRAS=plot."
    ):
        import matplotlib  # noqa: F401 - before anything is drawn
    has = PANELS if is_printed(result) else PANELS[:-1]
    for panel in panels:
        require(panel in PANELS, f"there is no panel {panel!r}; panels are {', '.join(PANELS)}.")
        require(panel in has, "this result has no print: that needs a finger, and a known scale.")
    require(bool(result.mask.any()), "the mask is empty: there is nothing to plot.")
    names = tuple(panels) or has
    if ax is None:
        from matplotlib import pyplot  # with axes of the caller's, which may have no pyplot

        width, height = _PANEL_INCHES
        inches = (width * len(names), height)
        figure, rows = pyplot.subplots(1, len(names), figsize=inches, squeeze=False, layout="constrained")
        figure.suptitle(f"preset {result.preset}", fontsize="medium") if result.preset else None
        axes = rows[0]
    else:
        axes = np.atleast_1d(np.asarray(ax, dtype=object)).ravel()
        fault = f"{axes.size} axes are given for {len(names)} panels ({', '.join(names)})"
        require(axes.size == len(names), f"{fault}; name a panel for each.")
    for one, name in zip(axes, names, strict=True):
        _draw(one, result, name)
    return axes[0] if axes.size == 1 else axes


def _draw(ax: Any, result: Reconstruction, panel: str) -> None:
    """One panel, its colour bar and its scale bar."""
    ax.set_title(panel)
    ax.set_axis_off()
    frame = upright_frame(result, _LONGEST_PX)
    unit = result.unit
    side = frame.pitch_mm * unit.per_mm
    if panel == "print":
        picture, pitch = surface_print(result, PRINT_PPI), 25.4 / PRINT_PPI
        ax.imshow(picture, cmap="gray", vmin=0, vmax=255, extent=_extent(picture.shape, pitch))
        rows, columns = np.nonzero(picture < _INK)
        if rows.size:
            ax.set_xlim(pitch * columns.min(), pitch * (columns.max() + 1))
            ax.set_ylim(pitch * (rows.max() + 1), pitch * rows.min())
    elif panel == "normals":
        values, weight = to_frame(result.normals, result.mask, frame)
        turned = normal_colours(upright_normals(result, values))
        ax.imshow(on_paper(turned, weight), extent=_extent(frame.size, side))
    else:
        field = result.height_mm if panel == "height" else result.ridge_mm
        values, weight = to_frame(field, result.mask & np.isfinite(field), frame)
        shown = np.where(weight > 0.5, values, np.float32(np.nan))
        if panel == "height":
            shown -= np.float32(np.nanpercentile(shown, 99.9))
            shown = unit.heights(shown)
            limits, label = (float(np.nanpercentile(shown, 0.5)), 0.0), f"height, {unit.name}"
        else:
            shown, limits, label = unit.small_per_mm * shown, relief_limits(result), f"relief, {unit.small}"
        extent = _extent(frame.size, side)
        image = ax.imshow(shown, cmap="cividis", vmin=limits[0], vmax=limits[1], extent=extent)
        ax.figure.colorbar(image, ax=ax, location="bottom", label=label, shrink=0.8, pad=0.02)
    _scale_bar(ax, 0.35 * frame.size[1] * side, unit.name)


def _extent(size: tuple[int, ...], pitch: float) -> tuple[float, float, float, float]:
    """Left, right, bottom, top of an image, rows downwards from 0."""
    return 0.0, size[1] * pitch, size[0] * pitch, 0.0


def _scale_bar(ax: Any, longest: float, unit: str) -> None:
    """A bar of 1, 2 or 5 times a power of ten, below what is drawn."""
    from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar

    tens = 10.0 ** np.floor(np.log10(longest))
    length = max(step * tens for step in (1, 2, 5) if step * tens <= longest)
    bottom, top = ax.get_ylim()
    ax.set_ylim(bottom + 0.1 * (bottom - top), top)
    ax.add_artist(AnchoredSizeBar(ax.transData, length, f"{length:g} {unit}", "lower center", frameon=False, pad=0.1))
