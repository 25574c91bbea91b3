"""The figures of ``checkerboard.json`` as Markdown tables."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    return ["", *("| " + " | ".join(row) + " |" for row in (head, ["---"] * len(head), *rows))]


def _percent(values: Sequence[float], digits: int = 1) -> str:
    return ", ".join(f"{100 * value:+.{digits}f} %" for value in values)


def _centred(row: dict[str, Any], place: str) -> str:
    rms, mean, level = (row[f"{place}_{what}"] for what in ("rms", "mean", "psnr_db"))
    return f"{100 * rms:.2f} %, {100 * mean:+.2f} %, {level:.1f} dB"


def summary(results: dict[str, Any]) -> str:
    """One table a part."""
    lines = _table(
        ("surface", "check mm", "images", "method", "direct dB", "in units of white", "global dB", "mean error"),
        [
            (
                r["surface"],
                f"{r['check_mm']}",
                f"{r['shifts']}",
                r["method"],
                *(f"{r[key]:.1f}" for key in ("direct_psnr_db", "in_units_of_white_db", "global_psnr_db")),
                _percent([r["mean_error"]], 2),
            )
            for r in results["noise_free"]
        ],
    )
    lines += _table(
        ("surface", "method", "dB", "without noise", "bias by noise R, G, B", "bias against the truth"),
        [
            (
                r["surface"],
                r["method"],
                f"{r['psnr_db']:.1f}",
                f"{r['noise_free_psnr_db']:.1f}",
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
        ("surface", "check mm", "centred at the LED: rms, mean, dB", "in the axis"),
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
