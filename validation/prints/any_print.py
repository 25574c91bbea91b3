"""What is found out about real prints: whether their ridges are dark, their resolution, and a print on a page.

    python validation/prints/any_print.py [--data ../shared/data]

writes ``tables/any_print.csv``, a row for each set of 40 prints. *white*: of the prints as they are, and inverted, how
many are turned, and of how many it is said to be in doubt. *doubted*: prints whose resolution is in doubt as it is, and
if half or twice of it is stated. *period*: distance of the ridges over 0.46 mm, 2.5 % and
97.5 %, by :func:`splitknit_match.prints.from_file._ridge_period_px`, and of how many prints none is found. *page*: the
first impressions on a white page of 2000 x 2000: in how many exactly one print is found, and mean minutiae alone and
on the page.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

import numpy as np

from splitknit import PrintFile, read_print_png
from splitknit_match.prints.from_file import USUAL_PERIOD_MM, _prints_on, _ridge_period_px, print_minutiae

PPI = {"fvc2002_db2b": 569.0, "fvc2004_db3b": 512.0}
TABLE = Path(__file__).parent / "tables" / "any_print.csv"


def row(folder: Path) -> dict[str, object]:
    """Figures of one set."""
    ppi = PPI.get(folder.name, 500.0)
    said = {"dark": [], "inverted": []}
    doubted = {"as it is": 0, "half": 0, "twice": 0}
    periods, alone, on_page, single = [], [], [], 0
    for file in sorted(folder.glob("*.png")):
        image = read_print_png(file).image
        for name, picture in (("dark", image), ("inverted", 255 - image)):
            said[name].append(_prints_on(PrintFile(picture, ppi, {}))[0].note)
        for name, factor in zip(doubted, (1, 0.5, 2), strict=True):
            doubted[name] += bool(_prints_on(PrintFile(image, factor * ppi, {}))[0].doubt)
        periods.append(_ridge_period_px(image))
        if file.stem.endswith("_1"):
            page = np.full((2000, 2000), 255, np.uint8)
            page[700 : 700 + image.shape[0], 900 : 900 + image.shape[1]] = image
            found = _prints_on(PrintFile(page, 500.0, {}))
            single += len(found) == 1
            alone.append(print_minutiae(image).count)
            on_page.append(print_minutiae(found[0].image).count)
    known = np.array([one for one in periods if one is not None]) * 25.4 / ppi / USUAL_PERIOD_MM
    return {
        "set": folder.name,
        "prints": len(periods),
        **{f"{name}_turned": sum("turned dark" in one for one in notes) for name, notes in said.items()},
        **{f"{name}_in_doubt": sum("invert the picture" in one for one in notes) for name, notes in said.items()},
        **{f"doubted_{name.replace(' ', '_')}": count for name, count in doubted.items()},
        "no_period": periods.count(None),
        "period_2.5": round(float(np.percentile(known, 2.5)), 3),
        "period_97.5": round(float(np.percentile(known, 97.5)), 3),
        "pages": len(alone),
        "one_print_on_page": single,
        "minutiae_alone": round(float(np.mean(alone)), 1),
        "minutiae_on_page": round(float(np.mean(on_page)), 1),
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    data = parser.parse_args().data
    rows = [row(folder) for folder in (*sorted((data / "fvc").iterdir()), data / "fvc2002_db1b") if folder.is_dir()]
    TABLE.parent.mkdir(exist_ok=True)
    with TABLE.open("w", newline="") as stream:
        writer = csv.DictWriter(stream, rows[0], lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    print(TABLE.read_text())
