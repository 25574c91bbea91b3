"""What the page says about a result in words and numbers."""

from __future__ import annotations

from typing import Any

import numpy as np

from splitknit.apps.viewer.catalogue import Entry
from splitknit.apps.viewer.prints import print_of
from splitknit.apps.viewer.surface import Surface
from splitknit.apps.viewer.tiles import TILE, filled_tiles, strides
from splitknit.errors import BadInput

_TURNING = dict.fromkeys(
    (0x061C, 0x200E, 0x200F, *range(0x202A, 0x202F), *range(0x2066, 0x206A)), "\N{REPLACEMENT CHARACTER}"
)


def shown(text: str) -> str:
    """Return a name as the page shows it: no mark in it turns the text around it to the left."""
    return text.translate(_TURNING)


def listed(entry: Entry) -> dict[str, Any]:
    """One line of the list."""
    subject = _mapping(_mapping(entry.report.get("capture")).get("subject"))
    return {
        "key": entry.key,
        "name": shown(entry.name),
        "preset": _text(entry.report.get("preset")),
        "subject": _text(subject.get("id")),
        "finger": _text(subject.get("finger")).replace("_", " "),
        "session": _text(subject.get("session")),
        "warnings": len(_sequence(entry.report.get("warnings"))),
        "thumb": (entry.folder / "preview.png").is_file(),
    }


def describe(entry: Entry, surface: Surface) -> dict[str, Any]:
    """All that the page needs of a result before it asks for pieces of it."""
    levels = strides(surface)
    return {
        **listed(entry),
        "pitch_mm": surface.pitch_mm,
        "points": surface.count,
        "low_mm": surface.low_mm,
        "high_mm": surface.high_mm,
        "highest_relief_mm": surface.highest_relief_mm,
        "relief_range_um": _relief_range_um(surface),
        "input_size": surface.size,
        "turn": surface.turn.tolist(),
        "tile": TILE,
        "strides": levels,
        "tiles": {str(stride): filled_tiles(surface, stride) for stride in levels},
        "pictures": [name for name in ("normals.png", "albedo.png") if (entry.folder / name).is_file()],
        "print": _print(entry),
        "photos": _photos(entry),
        "facts": _facts(entry, surface),
        "notes": [_text(note) for note in _sequence(entry.report.get("warnings"))],
    }


def _relief_range_um(surface: Surface) -> float:
    """Relief that nearly all of the skin keeps within: the ends of the colour scale."""
    step = max(1, round(0.1 / surface.pitch_mm))
    relief = np.abs(surface.ridge_mm[::step, ::step][surface.mask[::step, ::step]])
    widest = float(np.percentile(relief, 98)) if relief.size else 0.0
    return max(1.0, float(np.ceil(1000.0 * widest)))


def _print(entry: Entry) -> dict[str, Any] | None:
    try:
        file = print_of(entry.folder)
    except BadInput:
        return None
    return {"rows": file.image.shape[0], "columns": file.image.shape[1], "ppi": file.resolution_ppi or 500.0}


def _photos(entry: Entry) -> list[dict[str, Any]]:
    if entry.capture is None:
        return []
    from splitknit.apps.viewer.photos import photos_of  # noqa: PLC0415 - the first view waits for no image library

    try:
        return [{"name": shown(p.name), "band": p.band, "number": p.number} for p in photos_of(entry.capture)]
    except BadInput:
        return []


def _facts(entry: Entry, surface: Surface) -> list[tuple[str, str]]:
    report = entry.report
    about, software = _mapping(report.get("capture")), _mapping(report.get("software"))
    count = f"{surface.count:,}".replace(",", "\N{NO-BREAK SPACE}")
    size = [high - low for low, high in zip(surface.low_mm, surface.high_mm, strict=True)]
    facts = [
        ("Preset", _text(report.get("preset"))),
        ("Size", f"{size[0]:.1f} x {size[1]:.1f} x {size[2]:.1f} mm (across, along, deep)"),
        ("Skin in projection", f"{surface.count * surface.pitch_mm**2:.0f} mm²"),
        ("Values", f"{count} heights, one every {1000 * surface.pitch_mm:.1f} µm"),
        ("Material", _text(about.get("material"))),
        ("Finger", " ".join(part for part in (listed(entry)["subject"], listed(entry)["finger"]) if part)),
        ("Session", listed(entry)["session"]),
        ("Captured", _text(about.get("captured_at"))),
        ("Reconstructed", _text(report.get("written_at"))),
        ("Software", f"{_text(software.get('name'))} {_text(software.get('version'))}".strip()),
    ]
    return [(name, value) for name, value in facts if value]


def _mapping(value: Any) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}


def _sequence(value: Any) -> list[Any]:
    return value if isinstance(value, list) else []


def _text(value: Any) -> str:
    return shown(str(value)[:300]) if isinstance(value, (str, int, float)) and not isinstance(value, bool) else ""
