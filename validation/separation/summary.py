"""The figures of ``checkerboard.json`` as Markdown tables."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    return ["", *("| " + " | ".join(row) + " |" for row in (head, ["---"] * len(head), *rows))]


def _percent(values: Sequence[float], digits: int = 1) -> str:
    return ", ".join(f"{100 * value:+.{digits}f} %" for value in values)


def _centred(row: dict[str, Any], place: str) -> str:
    rms, mean, level = (row[f"{place}_{what}"] for what in ("rms", "mean", "db"))
    return f"{100 * rms:.2f} %, {100 * mean:+.2f} %, {_level(level)}"


def _level(decibels: dict[str, float]) -> str:
    """With the peak of the white image, then of the true part itself."""
    return f"{decibels['white_peak']:.1f} / {decibels['own_peak']:.1f}"


def _ranges(rows: Sequence[dict[str, Any]], part: str) -> list[str]:
    """Least to greatest PSNR over the surfaces by check size and way: white peak, then own peak."""
    ways = list(dict.fromkeys((row["shifts"], row["method"]) for row in rows))
    lines = []
    for check in sorted({row["check_mm"] for row in rows}):
        cells = [f"{check}"]
        for way in ways:
            group = [row[part] for row in rows if (row["check_mm"], row["shifts"], row["method"]) == (check, *way)]
            levels = [[row[peak] for row in group] for peak in ("white_peak", "own_peak")]
            cells.append(" / ".join(f"{min(values):.1f} to {max(values):.1f}" for values in levels))
        lines.append(cells)
    return _table(("check mm", *(f"{shifts}: {method}" for shifts, method in ways)), lines)


def _noise_ranges(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Least to greatest figures over the surfaces, of the way's bias over surfaces and channels."""
    lines = []
    for method in dict.fromkeys(row["method"] for row in rows):
        group = [row for row in rows if row["method"] == method]
        levels = [
            f"{min(values):.1f} to {max(values):.1f}"
            for part in ("direct_db", "noise_free_db")
            for values in ([row[part]["own_peak"] for row in group],)
        ]
        biases = [
            f"{100 * min(values):+.1f} to {100 * max(values):+.1f} %"
            for part in ("bias_by_noise", "bias")
            for values in ([value for row in group for value in row[part]],)
        ]
        lines.append([method, *levels, *biases])
    return _table(("way", "dB", "dB without noise", "mean error by noise", "mean error in all"), lines)


def summary(results: dict[str, Any]) -> str:
    """One table a part. PSNR in dB: peak of the white image / of the true part itself (99.9th percentiles)."""
    lines = _ranges(results["noise_free"], "direct_db") + _ranges(results["noise_free"], "global_db")
    lines += _noise_ranges(results["noise"])
    lines += _table(
        ("surface", "check mm", "images", "method", "direct", "global", "mean error"),
        [
            (
                r["surface"],
                f"{r['check_mm']}",
                f"{r['shifts']}",
                r["method"],
                *(_level(r[key]) for key in ("direct_db", "global_db")),
                _percent([r["mean_error"]], 2),
            )
            for r in results["noise_free"]
        ],
    )
    lines += _table(
        ("surface", "method", "direct", "without noise", "bias by noise R, G, B", "bias against the truth"),
        [
            (
                r["surface"],
                r["method"],
                _level(r["direct_db"]),
                _level(r["noise_free_db"]),
                _percent(r["bias_by_noise"]),
                _percent(r["bias"]),
            )
            for r in results["noise"]
        ],
    )
    lines += _table(
        ("surface", "check mm", "direct / glare R, G, B"),
        [
            (r["surface"], f"{r['check_mm']}", ", ".join(f"{v:.2f}" for v in r["direct_over_glare"]))
            for r in results["ratio"]
        ],
    )
    lines += _table(
        ("surface", "check mm", "centred at the LED: rms, mean, PSNR", "in the axis"),
        [
            (
                r["surface"],
                f"{r['check_mm']}",
                *(_centred(r, place) for place in ("led", "coaxial")),
            )
            for r in results["centred"]
        ],
    )
    worst = max(r["largest_error"] for r in results["ideal"])
    return "\n".join([*lines, "", f"Opaque skin: largest error {worst:.1e} of the brightest pixel."])
