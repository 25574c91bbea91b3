"""Figures 3.1, 3.20, 3.22, 5.6 and 5.9 as figures that can be measured, on whole views of the
population.

- 3.1: power by spatial frequency, in all directions together, of the true shape and relief, and of
  white and NIR images
- 3.20: what n = 2 to 7 scales of shapelets leave of the shape in the relief
- 3.22: error of the shape by photometric stereo under NIR and under white light
- 5.6: bars of SnK and EA, of the rates in ``cases.csv``, beside the thesis's
- 5.9: error of SnK, PR and EA in bands of spatial frequency; and as a picture, with patches, of one
  finger

The thesis shows 3.20, 3.22 and 5.9 as pictures of one finger. Each capture's figures are kept as a
file.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import scipy.fft
from compared import each, keep
from numpy.typing import NDArray
from plots import bars_figure, lines_figure, save
from scales import SCALES

from splitknit.capture import Capture
from splitknit.imaging.geometry import high_passed
from splitknit.io.capture import read_capture
from splitknit.io.images import write_image
from splitknit.io.pictures import upright_frame
from splitknit.observation.observe import observe
from splitknit.pipeline import located, reconstruct
from splitknit.reconstruction import Reconstruction
from splitknit.report.figures import small_fields, view_from_above
from splitknit_simulator.accuracy import Comparison, compare, read_truth
from tables import Row, write_csv

CASES = ("snk", "pr", "ea")
BANDS = {"shape": (0.0, 2.0), "between": (2.0, 10.0), "ridges": (10.0, 1000.0)}
"""Cycles per cm: the shape has 0.7, ridges have 23."""
BIN_PER_CM = 0.5
FREQUENCIES = np.arange(1, 121) * BIN_PER_CM
"""Cycles per cm: middles of the bins of :data:`BIN_PER_CM` in which power is summed."""
DIFFERENCES = (
    ("3.20 n = 5 power beside the ridges, %", "3.20 n = 3 power beside the ridges, %"),
    ("3.20 n = 3 ridge correlation", "3.20 n = 4 ridge correlation"),
    ("3.22 NIR: shape error, um", "3.22 white: shape error, um"),
    ("3.22 NIR: shape error, um", "3.22 white, enhanced: shape error, um"),
    ("5.9 pr: error between, um", "5.9 snk: error between, um"),
    ("5.9 snk: error between, um", "5.9 truth: ridges, um"),
    ("5.9 ea: ridge correlation", "5.9 snk: ridge correlation"),
    ("5.9 ea: ridge correlation", "5.9 pr: ridge correlation"),
)
"""Figures of a finger that claims 14, 15, 25, 26 and 29 compare: the first less the second."""
PROFILE_STEP_MM = 0.05
RESAMPLES = 1000

Values = NDArray[Any]
Results = Mapping[str, Reconstruction]


def run(  # noqa: PLR0917
    population: Path, chosen: Sequence[str], out: Path, scratch: Path, seed: int, jobs: int
) -> Row:
    """Write ``figures.csv``, ``figure_spectra.csv`` and the plots of the captures `chosen`; return
    the facts."""
    each(partial(_keep, population, scratch), chosen, jobs)
    records = [json.loads(_file(scratch, name).read_text(encoding="utf-8")) for name in chosen]
    known = [row for row in records if row]
    write_csv(out / "figures.csv", summary(known, seed))
    if known:
        _draw(known, out)
        first_name = next(name for name, row in zip(chosen, records, strict=True) if row)
        capture = read_capture(population / first_name)
        finger, truth = located(capture, "snk"), read_truth(capture)
        results = {case: reconstruct(finger, case) for case in CASES}
        write_image(out / "figure-5-9-surfaces.png", surfaces(results, truth["height_mm"]))
        write_image(out / "figure-3-22-shapes.png", shapes(results, truth["shape_mm"]))
    if (out / "cases.csv").is_file():
        with (out / "cases.csv").open(encoding="utf-8", newline="") as stream:
            save(bars_figure(accuracies(list(csv.DictReader(stream)))), out / "figure-5-6.svg")
    return {"captures": len(known), "failures": len(records) - len(known)}


def choose(names: Sequence[str], seed: int) -> list[str]:
    """One capture of every finger, in an order drawn by seed."""
    rng = np.random.default_rng([seed, 31])
    first: dict[str, str] = {}
    for name in (names[k] for k in rng.permutation(len(names))):
        subject, _, finger = name.split("/")
        first.setdefault(f"{subject}/{finger}", name)
    return list(first.values())


def measure(capture: Capture) -> Row:
    """All figures of one capture.

    Raises
    ------
    BadInput
        If it shows no finger, or has no truth.
    """
    truth, finger = read_truth(capture), located(capture, "snk")
    results = {case: reconstruct(finger, case) for case in CASES}
    against = {case: compare(result, truth) for case, result in results.items()}
    row: Row = {"spectra": _spectra(capture, results["snk"], truth)}
    for count in SCALES:
        result = reconstruct(finger, "pr-split", {"shapelets.scales": count})
        seen = compare(result, truth)
        slow = bands(result.ridge_mm, seen.surface, result)
        row[f"3.20 n = {count} ridge correlation"] = seen.figures["ridge_correlation"]
        row[f"3.20 n = {count} power beside the ridges, %"] = _percent_beside(slow)
    nir, white, enhanced = results["snk"].shape_mm, results["ea"].height_mm, results["pr"].height_mm
    for words, surface, case in (
        ("NIR", nir, "snk"),
        ("white", white, "ea"),
        ("white, enhanced", enhanced, "pr"),
    ):
        error = bands(surface - truth["shape_mm"], against[case].surface, results[case])
        row[f"3.22 {words}: shape error, um"] = error["shape"]
    for case, result in results.items():
        error = bands(result.height_mm - truth["height_mm"], against[case].surface, result)
        row |= {f"5.9 {case}: error {band}, um": error[band] for band in BANDS}
        row[f"5.9 {case}: ridge correlation"] = _ridge(against[case])
    true = bands(np.asarray(truth["height_mm"]), against["snk"].surface, results["snk"])
    row |= {f"5.9 truth: {band}, um": true[band] for band in BANDS}
    row["profiles"] = _profiles(results, truth)
    return row


def _ridge(seen: Comparison) -> float:
    return float(seen.figures["height_band_correlation"])


def bands(
    values: NDArray[Any], where: NDArray[np.bool_], result: Reconstruction
) -> dict[str, float]:
    """Rms by band in um, on a surface and freed from its mean plane: a camera does not know it."""
    inside = result.mask & np.isfinite(values)
    filled = np.where(inside, values, 0.0).astype(np.float64)
    y, x = np.nonzero(where & inside)
    plane = np.stack([np.ones(y.size), y, x], axis=1)
    least = np.linalg.lstsq(plane, filled[y, x], rcond=None)[0]
    rows, columns = np.indices(filled.shape)
    flat = np.where(inside, filled - (least[0] + least[1] * rows + least[2] * columns), 0.0).astype(
        np.float32
    )
    above = {0.0: flat}
    for frequency in (2.0, 10.0):
        # half the amplitude
        sigma_mm = 10.0 * np.sqrt(2.0 * np.log(2.0)) / (2.0 * np.pi * frequency)
        above[frequency] = high_passed(flat, inside, float(sigma_mm / result.pitch_mm))
    parts = {
        "shape": above[0.0] - above[2.0],
        "between": above[2.0] - above[10.0],
        "ridges": above[10.0],
    }
    return {
        band: 1000.0 * float(np.sqrt(np.mean(part[y, x].astype(np.float64) ** 2)))
        for band, part in parts.items()
    }


def _percent_beside(bands: Mapping[str, float]) -> float:
    power = {band: value**2 for band, value in bands.items()}
    return 100.0 * (power["shape"] + power["between"]) / sum(power.values())


def _spectra(
    capture: Capture, result: Reconstruction, truth: Mapping[str, NDArray[Any]]
) -> dict[str, list[float]]:
    """Power of a square as wide as the finger, of 1 at most, in bins around :data:`FREQUENCIES`."""
    fields = {
        "true shape": np.asarray(truth["shape_mm"], dtype=np.float64),
        "true relief": np.asarray(truth["height_mm"], dtype=np.float64) - truth["shape_mm"],
    }
    for name in ("white", "nir"):
        fields[f"{name} images"] = _brightness(capture, name)
    rows = np.flatnonzero(result.mask.any(axis=1))
    middle = int(rows[rows.size // 2])
    columns = np.flatnonzero(result.mask[middle])
    half = min(columns.size // 2, middle - int(rows[0]), int(rows[-1]) - middle)
    square = np.s_[
        middle - half : middle + half, int(columns.mean()) - half : int(columns.mean()) + half
    ]
    return {
        name: _power(field[square], result.mask[square], result.pitch_mm)
        for name, field in fields.items()
    }


def _brightness(capture: Capture, name: str) -> Values:
    """Logarithm of the mean image of a band."""
    grey = observe(capture).bands[name].grey.astype(np.float64).mean(axis=0)
    return np.asarray(np.log(np.maximum(grey, 1e-3 * float(grey.max()))))


def _power(field: Values, mask: NDArray[np.bool_], pitch_mm: float) -> list[float]:
    inside = mask & np.isfinite(field)
    window = np.where(inside, np.outer(np.hanning(field.shape[0]), np.hanning(field.shape[1])), 0.0)
    values = np.where(inside, field, 0.0)
    values = window * (values - np.sum(window * values) / np.sum(window))
    count = scipy.fft.next_fast_len(
        max(3 * max(field.shape), int(np.ceil(20.0 / (BIN_PER_CM * pitch_mm))))
    )
    power = np.abs(scipy.fft.fft2(values, s=(count, count))) ** 2
    waves = np.fft.fftfreq(count, 0.1 * pitch_mm)
    number = (
        np.round(np.hypot(waves[:, None], waves[None, :]) / BIN_PER_CM).astype(np.int64).ravel()
    )
    total = np.bincount(number, weights=power.ravel(), minlength=FREQUENCIES.size + 1)[
        1 : FREQUENCIES.size + 1
    ]
    return [float(value) for value in total / max(float(total.max()), 1e-30)]


def _profiles(
    results: Mapping[str, Reconstruction], truth: Mapping[str, NDArray[Any]]
) -> dict[str, list[float]]:
    """Heights along the finger's middle in mm, freed from their mean: the side views of figures
    5.9 and 3.22."""
    mask = results["snk"].mask
    column = int(np.median(np.nonzero(mask)[1]))
    along = np.flatnonzero(mask[:, column] & np.isfinite(truth["height_mm"][:, column]))
    along = along[:: max(1, round(PROFILE_STEP_MM / results["snk"].pitch_mm))]
    heights = {
        "truth": truth["height_mm"],
        **{case: result.height_mm for case, result in results.items()},
        "true shape": truth["shape_mm"],
        "NIR": results["snk"].shape_mm,
    }
    fields = {
        name: np.asarray(field[along, column], dtype=np.float64) for name, field in heights.items()
    }
    profiles = {name: (values - np.nanmean(values)).tolist() for name, values in fields.items()}
    return {"mm": (along * results["snk"].pitch_mm).tolist(), **profiles}


def summary(records: Sequence[Row], seed: int) -> list[Row]:
    """Mean of each figure over captures, with an interval of 95 % drawn by finger."""
    rng = np.random.default_rng([seed, 59])
    picks = rng.integers(0, max(len(records), 1), (RESAMPLES, len(records)))
    values = {
        f"3.1 {name}: {words}": [of(np.array(row["spectra"][name])) for row in records]
        for name in (records[0]["spectra"] if records else ())
        for words, of in (
            ("peak, cycles per cm", _peak),
            ("power above 10 cycles per cm, %", _above),
        )
    }
    names = [
        name for name in (records[0] if records else ()) if name not in ("spectra", "profiles")
    ]
    values |= {name: [row[name] for row in records] for name in names}
    values |= {
        f"{first} less {second.split(' ', 1)[1]}": [row[first] - row[second] for row in records]
        for first, second in DIFFERENCES
        if {first, second} <= set(names)
    }
    rows = []
    for name, each_one in values.items():
        figure, what = name.split(" ", 1)
        known = np.array(each_one, dtype=np.float64)
        low, high = (float(end) for end in np.quantile(known[picks].mean(axis=1), (0.025, 0.975)))
        mean = {"mean": float(known.mean()), "low": low, "high": high}
        rows.append({"figure": figure, "what": what, **mean, "captures": known.size})
    return rows


def _peak(power: Values) -> float:
    return float(FREQUENCIES[np.argmax(power)])


def _above(power: Values) -> float:
    """Percent of the power."""
    return 100.0 * float(power[BANDS["between"][1] <= FREQUENCIES].sum() / power.sum())


def _draw(records: Sequence[Row], out: Path) -> None:
    """Figures 3.1, 3.20, 3.22 and 5.9 as curves, and the spectra as a table."""
    spectra = {
        name: np.mean([row["spectra"][name] for row in records], axis=0)
        for name in records[0]["spectra"]
    }
    columns = {"cycles_per_cm": FREQUENCIES, **spectra}
    bins = np.stack(list(columns.values()), axis=1).tolist()
    rows = [dict(zip(columns, values, strict=True)) for values in bins]
    write_csv(out / "figure_spectra.csv", rows)
    scales = {
        words: [
            factor * np.mean([row[f"3.20 n = {count} {key}"] for row in records])
            for count in SCALES
        ]
        for words, key, factor in (
            ("ridge correlation", "ridge correlation", 1.0),
            ("power beside the ridges", "power beside the ridges, %", 0.01),
        )
    }
    profiles = records[0]["profiles"]
    sides = {
        "3-22": {"true shape": "true shape", "NIR": "NIR", "white": "ea", "enhanced": "pr"},
        "5-9": {name: name for name in ("truth", *CASES)},
    }
    logarithmic = {"xscale": "log", "yscale": "log", "ylim": (1e-7, 2.0)}
    logarithmic |= {"title": "Power by spatial frequency"}
    ridges = {"title": "Ridges and what else is in the relief", "ylim": (0, 1)}
    along = {"title": "Side view along the middle of one finger"}
    drawn = {
        "3-1": (spectra, FREQUENCIES, "cycles per cm", "power", logarithmic),
        "3-20": (scales, SCALES, "scales of shapelets", "fraction, correlation", ridges),
    }
    for figure, names in sides.items():
        heights = {name: profiles[key] for name, key in names.items()}
        drawn[figure] = (heights, profiles["mm"], "mm along the finger", "height, mm", along)
    for figure, (curves, x, x_label, y_label, axes) in drawn.items():
        lines = [(name, x, np.asarray(values, np.float64)) for name, values in curves.items()]
        save(lines_figure(lines, x_label, y_label, **axes), out / f"figure-{figure}.svg")


OF_5_6 = (
    ("ridges, FAR 0.1 %", "relief", "0.001", (78.8, 90.5)),
    ("ridges, FAR 1 %", "relief", "0.01", (93.0, 95.0)),
    ("normals, FAR 1 %", "normals", "0.01", (86.0, 92.0)),
)
"""Label, attribute, FAR, and the thesis's EA and SnK."""


def accuracies(rows: Sequence[Mapping[str, str]]) -> list[Any]:
    """Bars of figure 5.6: rates of ``cases.csv`` in percent, judged as the thesis with whole
    views."""
    judged = ("gate", "averaged", "whole")
    groups = []
    for label, attribute, far, theirs in OF_5_6:
        bars: list[Any] = []
        for case in ("ea", "snk"):
            wanted = (case, "thesis", attribute, *judged)
            keys = ("case", "matcher", "attribute", "gate", "sessions", "kept")
            row = next((row for row in rows if tuple(row[key] for key in keys) == wanted), {})
            value, ends = row.get(f"gar@{far}"), None
            if value:
                ends = tuple(
                    100.0 * float(row[f"gar@{far}_{end}_finger"]) for end in ("low", "high")
                )
            bars.append((case, 100.0 * float(value or "nan"), ends))
        bars += [
            (f"{case}, thesis", value, None)
            for case, value in zip(("ea", "snk"), theirs, strict=True)
        ]
        groups.append((label, bars))
    return groups


PATCH_MM = 5.0
PATCH_PX = 220


def surfaces(results: Results, true: Values) -> NDArray[np.uint8]:
    """Figure 5.9 of one finger: truth, SnK, PR and EA from the front, and below zoomed ridges of
    each."""
    heights = {"truth": true, **{case: result.height_mm for case, result in results.items()}}
    return _side_by_side(results["snk"], heights, {**heights, "snk": results["snk"].ridge_mm})


def shapes(results: Results, true: Values) -> NDArray[np.uint8]:
    """Figure 3.22 of one finger: its true shape, and that by NIR, white and enhanced white
    light."""
    first = results["snk"]
    # ridges, which the shading would darken valleys by, are none of the shape
    smooth = replace(first, ridge_mm=np.zeros_like(first.ridge_mm))
    heights = {"white": results["ea"].height_mm, "enhanced": results["pr"].height_mm}
    return _side_by_side(smooth, {"truth": true, "NIR": first.shape_mm, **heights}, {})


def _side_by_side(
    first: Reconstruction, heights: Mapping[str, Values], ridges: Mapping[str, Values]
) -> NDArray[np.uint8]:
    """Each surface from the front, with zoomed ridges below where they are given."""
    columns = []
    for name, height in heights.items():
        whole = np.where(first.mask, height, np.nan).astype(np.float32)
        surface = replace(first, height_mm=whole, mask=np.isfinite(whole))
        view = view_from_above(small_fields(surface, upright_frame(surface, PATCH_PX)))
        column = np.full((PATCH_PX, PATCH_PX, 3), 247, np.uint8)
        left = (PATCH_PX - view.shape[1]) // 2
        column[: view.shape[0], left : left + view.shape[1]] = view
        if ridges:
            column = np.vstack([column, _patch(ridges[name], first)])
        columns.append(_labelled(column, name))
    return np.asarray(np.hstack(columns) & 0xF8)  # 32 shades: a quarter of the bytes


def _patch(height_mm: NDArray[Any], result: Reconstruction) -> NDArray[np.uint8]:
    """A square in the finger's middle, lit from the upper left."""
    rows, columns = np.nonzero(result.mask)
    half = round(0.5 * PATCH_MM / result.pitch_mm)
    row, column = (int(np.median(part)) for part in (rows, columns))
    part = np.asarray(
        height_mm[row - half : row + half, column - half : column + half], dtype=np.float64
    )
    down, right = np.gradient(part - np.nanmean(part), result.pitch_mm)
    light = (1.0 + 0.8 * (down + right)) / np.sqrt(1.0 + down**2 + right**2)
    low, high = np.nanpercentile(light, (1.0, 99.0))
    shade = np.clip(255.0 * (np.nan_to_num(light) - low) / max(high - low, 1e-6), 0, 255).astype(
        np.uint8
    )
    return np.repeat(
        cv2.resize(shade, (PATCH_PX, PATCH_PX), interpolation=cv2.INTER_CUBIC)[..., None], 3, axis=2
    )


def _labelled(column: NDArray[np.uint8], name: str) -> NDArray[np.uint8]:
    framed = np.pad(column, ((34, 4), (4, 4), (0, 0)), constant_values=255)
    return cv2.putText(
        framed, name, (10, 24), cv2.FONT_HERSHEY_SIMPLEX, 0.8, (0, 0, 0), 2, cv2.LINE_AA
    )


def _keep(population: Path, scratch: Path, name: str) -> None:
    file = _file(scratch, name)
    if file.is_file():
        return
    try:
        row = measure(read_capture(population / name))
    except ValueError:  # a failure to acquire
        row = {}
    keep(file, lambda stream: stream.write(json.dumps(row).encode("ascii")))


def _file(scratch: Path, name: str) -> Path:
    return scratch / (name.replace("/", "_") + ".json")
