"""The ways to a surface that are compared, one row of the table each; all see the same finger in
the same mask."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any
from unittest import mock

import numpy as np
from ablation_light import in_grey, true_shares, twin_of, without_glare
from from_colours import direct_of_enhanced

from splitknit import pipeline
from splitknit.capture import Capture
from splitknit.errors import BadInput
from splitknit.finger.locate import Finger, find_finger
from splitknit.methods import photographs, thesis
from splitknit.model import FloatArray
from splitknit.observation.observe import observe
from splitknit.presets import PipelineSettings, preset_settings
from splitknit.reconstruction import Reconstruction
from splitknit.settings import override
from splitknit_simulator.accuracy import compare

FIGURES = (
    "ridge_correlation",
    "ridge_gain",
    "ridge_rms_um",
    "ridge_good_area",
    "normals_mean_deg",
    "surface_rms_mm",
)


@dataclass(frozen=True, slots=True)
class Row:
    """One way to a surface."""

    group: str
    words: str
    preset: str = "metric"
    change: Mapping[str, Any] = field(default_factory=dict)
    """Settings, beside the preset's."""
    fraction: str = ""
    """What of the white light is let through instead of the network's grey output: that of the
    twin's truth by this name, or of the ``network`` that is given the colours; empty: nothing is
    changed."""
    glare: str = "in"
    """``in``, or ``truth``: taken out of the white images, as the twin knows it."""
    grey: bool = False


THESIS = "thesis's chain (`snk`)"
CONTRAST = "CLAHE of `snk`"
CELLS = {"cells": "cells of 64 px", "tiles": "64 x 64 tiles"}
CLAHE: dict[str, dict[str, Any]] = {
    f"{grey}_{cells}_{clip}": {
        "grey": grey,
        "tiles": 64 if cells == "tiles" else 0,
        "clip_limit": float(clip),
    }
    for grey, cells, clip in (
        ("linear", "cells", 3),
        ("linear", "tiles", 3),
        ("srgb", "cells", 2),
        ("srgb", "cells", 3),
        ("srgb", "cells", 4),
        ("srgb", "tiles", 3),
    )
}
"""Contrast enhancement in linear light or in its sRGB code, in cells of 64 px or 64 x 64 tiles, by
the limit."""
NEAR = "near lights, blur left in"
GREY = "blur inverted, images in grey"
COLOUR = "blur inverted, images in colour (`metric`)"
LIGHTS = {
    "all": ("all light", ""),
    "network": ("direct light by the network", ""),
    "colours": ("direct light by the network, from the colours", "network"),
    "direct": ("true direct light", "direct"),
    "direct_matt": ("true direct light without its glare", "direct without glare"),
    "matt": ("glare truly out", "all but glare"),
}
GLARES = {"in": "glare in", "truth": "glare truly out (white)"}


def _rows() -> dict[str, Row]:
    rows = {
        "ea-split": Row(
            "photometric stereo, split but not knitted (`ea-split`)", "all light", "ea-split"
        )
    }
    for clahe in (False, True):
        for light, (words, fraction) in LIGHTS.items():
            # where the twin gives the light, it does so in the network's place
            change = {
                "enhance.clahe": clahe,
                "direct.method": "none" if light == "all" else "network",
            }
            text = f"CLAHE {'on' if clahe else 'off'}, {words}"
            rows[f"snk_{'clahe' if clahe else 'plain'}_{light}"] = Row(
                THESIS, text, "snk", change, fraction
            )
    by_shading = {"metric.relief": "shading"}
    for glare, words in GLARES.items():
        rows[f"near_{glare}"] = Row(NEAR, words, change={"skin.invert_blur": False}, glare=glare)
        rows[f"grey_{glare}"] = Row(GREY, words, change=by_shading, glare=glare, grey=True)
    rows["shading"] = Row(COLOUR, "blur of blue light inverted", change=by_shading)
    rows["metric"] = Row(COLOUR, "glare and blur by networks, as shipped")
    return rows


def _contrast_rows() -> dict[str, Row]:
    rows = {}
    for name, change in CLAHE.items():
        grey, cells, clip = name.split("_")
        of_cells = {f"enhance.cells.{key}": value for key, value in change.items()}
        words = (
            f"{'linear light' if grey == 'linear' else 'sRGB code'}, {CELLS[cells]}, limit {clip}"
        )
        rows[f"clahe_{name}"] = Row(CONTRAST, words, "snk", of_cells)
        if cells == "cells" and clip == "3":
            no_network = of_cells | {"direct.method": "none"}
            rows[f"clahe_{name}_all"] = Row(CONTRAST, f"{words}, all light", "snk", no_network)
    return rows


CONTRAST_ROWS = _contrast_rows()
"""What ``--clahe`` measures, and nothing else does."""
ROWS = _rows() | CONTRAST_ROWS
PAIRS: tuple[tuple[str, str, str], ...] = (
    ("`snk` against `ea-split`", "snk_clahe_network", "ea-split"),
    (
        "split and knit without CLAHE and direct light against `ea-split`",
        "snk_plain_all",
        "ea-split",
    ),
    ("CLAHE, all light", "snk_clahe_all", "snk_plain_all"),
    ("direct light by the network, CLAHE off", "snk_plain_network", "snk_plain_all"),
    ("direct light by the network, CLAHE on", "snk_clahe_network", "snk_clahe_all"),
    (
        "direct light by the network, from the colours, CLAHE off",
        "snk_plain_colours",
        "snk_plain_all",
    ),
    (
        "direct light by the network, from the colours, CLAHE on",
        "snk_clahe_colours",
        "snk_clahe_all",
    ),
    ("true direct light, CLAHE off", "snk_plain_direct", "snk_plain_all"),
    ("true direct light, CLAHE on", "snk_clahe_direct", "snk_clahe_all"),
    ("true direct light without its glare, CLAHE off", "snk_plain_direct_matt", "snk_plain_all"),
    ("glare truly out, CLAHE off", "snk_plain_matt", "snk_plain_all"),
    ("glare truly out, CLAHE on", "snk_clahe_matt", "snk_clahe_all"),
    ("near lights: glare truly out", "near_truth", "near_in"),
    ("blur inverted (grey), glare in", "grey_in", "near_in"),
    ("blur inverted (grey): glare truly out", "grey_truth", "grey_in"),
    ("`metric` by shading against glare and blur left in", "shading", "near_in"),
    ("`metric` by networks against `metric` by shading", "metric", "shading"),
    ("sRGB code instead of linear light", "clahe_srgb_cells_3", "clahe_linear_cells_3"),
    ("the same without the network", "clahe_srgb_cells_3_all", "clahe_linear_cells_3_all"),
    (
        "64 x 64 tiles instead of cells, linear light",
        "clahe_linear_tiles_3",
        "clahe_linear_cells_3",
    ),
    ("64 x 64 tiles instead of cells, sRGB code", "clahe_srgb_tiles_3", "clahe_srgb_cells_3"),
    ("limit 4 instead of 2, sRGB code", "clahe_srgb_cells_4", "clahe_srgb_cells_2"),
    (
        "network instead of all light, linear light",
        "clahe_linear_cells_3",
        "clahe_linear_cells_3_all",
    ),
    ("network instead of all light, sRGB code", "clahe_srgb_cells_3", "clahe_srgb_cells_3_all"),
)
"""Words, row, and the row that it is compared with, finger by finger."""


CHECK_MM = 0.42
"""Of the true direct light."""


class Bench:
    """One finger; what several rows need is made once."""

    def __init__(self, seed: int, scale: float = 0.5) -> None:
        """Photograph the finger and find it in the images as they are."""
        self.twin = twin_of(seed, scale)
        self.finger = find_finger(observe(self.twin.capture), preset_settings("metric"))

    def figures(self, name: str) -> dict[str, Any]:
        """Of one row, or why there are none."""
        try:
            result = self.reconstructed(ROWS[name])
            figures = compare(result, self.twin.truth).figures
        except BadInput as error:
            return {"refused": str(error)}
        return {key: float(figures[key]) for key in FIGURES}

    def reconstructed(self, row: Row) -> Reconstruction:
        capture = self._capture(row)
        settings = override(preset_settings(row.preset), row.change)
        if not row.fraction:
            return reconstruct(capture, self.finger, settings)
        fraction = self._coloured if row.fraction == "network" else self._fractions[row.fraction]
        fraction = fraction[(slice(None), *self.finger.window)]
        with mock.patch.object(
            thesis, "direct_light", lambda visible, _network: visible * fraction
        ):
            return reconstruct(capture, self.finger, settings)

    def _capture(self, row: Row) -> Capture:
        capture = in_grey(self.twin.capture) if row.grey else self.twin.capture
        if row.glare == "truth":
            capture = without_glare(
                capture, "white", self.twin.truth["glare_white"].astype(np.float32)
            )
        return capture

    @cached_property
    def _fractions(self) -> dict[str, FloatArray]:
        return true_shares(self.twin, CHECK_MM)

    @cached_property
    def _coloured(self) -> FloatArray:
        """(L, H, W) fraction of direct light in the grey images, as the network finds it in the
        linear colours."""
        capture, window = self.twin.capture, self.finger.window
        light = observe(capture).white.at(1, window).stack
        light = np.maximum(light, np.float32(0.0)) * self.finger.wider[window]
        fraction = np.ones((light.shape[1], *capture.shape), dtype=np.float32)
        fraction[(slice(None), *window)] = direct_of_enhanced(
            np.ones_like(light[0]), light.swapaxes(0, 1), "direct"
        )
        return fraction


def reconstruct(capture: Capture, finger: Finger, settings: PipelineSettings) -> Reconstruction:
    """As :func:`splitknit.reconstruct`, of a finger that has been found."""
    with (
        mock.patch.object(
            photographs,
            "locate_finger",
            lambda capture, _: (observe(capture).without_films(), finger),
        ),
        mock.patch.object(
            photographs, "diagnose", lambda capture, finger, **_: (capture, finger, ())
        ),
    ):
        return pipeline.reconstruct(capture, settings=settings)
