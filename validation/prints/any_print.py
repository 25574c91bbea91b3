"""What is found out about real prints: whether their ridges are dark, their resolution, and whether
they are of several fingers.

    python validation/prints/any_print.py [--data ../shared/data]

writes ``tables/any_print.csv``, a row for each set of 40 prints. *white*: of the prints as they
are, and inverted, how many are turned, and of how many it is said to be in doubt. *doubted*: prints
whose resolution is in doubt as it is, and if half or twice of it is stated; *noted*: with a note or
a doubt, as it is and if 1.25 times of it is stated. *several*: prints that are refused as several
fingers' (none should be), and of nine sheets of two or three prints (side by side or stacked, with
a white, a grey or no gap) those that are not (*sheets_passed*). *period*: distance of
the ridges over 0.46 mm, 2.5 % and 97.5 %, by
:func:`splitknit_match.prints.from_file.ridge_period_px`, and of how many prints none is found.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from splitknit.io.csv_table import csv_text
from splitknit_match.prints.from_file import (
    USUAL_PERIOD_MM,
    prepared,
    resolution_doubt,
    ridge_period_px,
)
from splitknit_match.prints.minutiae import at_500_ppi
from splitknit_match.prints.pressed import pressed_ridges
from splitknit_match.records.pictures import PrintFile, read_print_png

PPI = {"fvc2002_db2b": 569.0, "fvc2004_db3b": 512.0}
TABLE = Path(__file__).parent / "tables" / "any_print.csv"


def codes_of(item: PrintFile) -> set[str]:
    """Codes of what was found of a print."""
    return {finding.code for finding in item.findings}


def row(folder: Path) -> dict[str, object]:
    """Figures of one set."""
    ppi = PPI.get(folder.name, 500.0)
    codes_by_polarity = {"dark": [], "inverted": []}
    doubted = {"as it is": 0, "half": 0, "twice": 0}
    noted = {"as it is": 0, "400 as 500": 0}
    several = 0
    periods = []
    for file in sorted(folder.glob("*.png")):
        image = read_print_png(file).image
        for name, picture in (("dark", image), ("inverted", 255 - image)):
            codes_by_polarity[name].append(codes_of(prepared(PrintFile(picture, ppi, {}))))
        for name, factor in zip(doubted, (1, 0.5, 2), strict=True):
            doubt = resolution_doubt(PrintFile(image, factor * ppi, {}))
            doubted[name] += doubt is not None and doubt.severity == "doubt"
        for name, factor in zip(noted, (1, 1.25), strict=True):
            noted[name] += resolution_doubt(PrintFile(image, factor * ppi, {})) is not None
        several += pressed_ridges(at_500_ppi(image, ppi)).several
        periods.append(ridge_period_px(image))
    periods_px = np.array([period for period in periods if period is not None])
    known = periods_px * 25.4 / ppi / USUAL_PERIOD_MM
    return {
        "set": folder.name,
        "prints": len(periods),
        **{
            f"{name}_turned": sum("white-ridges" in codes for codes in findings)
            for name, findings in codes_by_polarity.items()
        },
        **{
            f"{name}_in_doubt": sum("unknown-polarity" in codes for codes in findings)
            for name, findings in codes_by_polarity.items()
        },
        **{f"doubted_{name.replace(' ', '_')}": count for name, count in doubted.items()},
        **{f"noted_{name.replace(' ', '_')}": count for name, count in noted.items()},
        "several": several,
        "sheets_passed": sum(not pressed_ridges(sheet).several for sheet in sheets(folder, ppi)),
        "no_period": periods.count(None),
        "period_2.5": round(float(np.percentile(known, 2.5)), 3),
        "period_97.5": round(float(np.percentile(known, 97.5)), 3),
    }


def sheets(folder: Path, ppi: float) -> list[np.ndarray]:
    """Nine sheets of two or three fingers' prints at 500 ppi."""
    prints = [
        at_500_ppi(read_print_png(folder / f"{finger}_1.png").image, ppi)
        for finger in range(101, 106)
    ]
    made = []
    for count, axis, first in ((2, 1, 0), (3, 1, 2), (2, 0, 3)):
        for gap, level in ((0, 255), (20, 255), (20, 128)):
            parts = prints[first : first + count]
            across = max(part.shape[1 - axis] for part in parts)
            wide = []
            for part in parts:
                missing = [0, 0]
                missing[axis] = gap if wide else 0
                missing[1 - axis] = across - part.shape[1 - axis]
                padding = [
                    (side if n == axis else 0, 0 if n == axis else side)
                    for n, side in enumerate(missing)
                ]
                wide.append(np.pad(part, padding, constant_values=level))
            made.append(np.concatenate(wide, axis=axis))
    return made


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    options = parser.parse_args()
    data = options.data
    folders = [
        folder
        for folder in (*sorted((data / "fvc").iterdir()), data / "fvc2002_db1b")
        if folder.is_dir()
    ]
    rows = [row(folder) for folder in folders]
    TABLE.write_text(csv_text([rows[0], *(row.values() for row in rows)]), encoding="utf-8")
    print(TABLE.read_text())
