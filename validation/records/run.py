"""What does WSQ cost a print? Its loss on real prints, in pixels, in quality and in scores.

    pip install 'splitknit[minutiae,records]'
    python validation/records/run.py                    # the 40 real prints of the independent data, some minutes
    python validation/records/run.py A/print.png ...    # and other prints of 500 ppi

writes ``results.json`` beside this file.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from splitknit.io.images import read_image
from splitknit_match.matching.minutiae import extract, minutiae_match, nfiq2
from splitknit_match.matching.minutiae_record import Minutiae
from splitknit_match.records.wsq_image import decode_wsq, encode_wsq

HERE = Path(__file__).resolve().parent


def loss(image: NDArray[np.uint8]) -> tuple[dict[str, float], NDArray[np.uint8]]:
    """How a print and its WSQ differ, and the print that comes back."""
    data = encode_wsq(image)
    back = decode_wsq(data).image
    error = back.astype(float) - image
    figures = {
        "ratio": image.size / len(data),
        "bits_a_pixel": 8 * len(data) / image.size,
        "psnr_db": float(10 * np.log10(255**2 / np.mean(error**2))),
        "correlation": float(np.corrcoef(back.ravel(), image.ravel())[0, 1]),
        "nfiq2": nfiq2(image),
        "nfiq2_after": nfiq2(back),
    }
    return figures, back


def spread(values: list[float]) -> dict[str, float]:
    """Median and extremes."""
    array = np.array(values, dtype=float)
    return {"median": float(np.median(array)), "least": float(array.min()), "most": float(array.max())}


def scores(sides: list[tuple[str, Minutiae]]) -> dict[str, float]:
    """bozorth3 of all pairs of one finger, and of all pairs of different fingers."""
    pairs = [(x == y, minutiae_match(a, b)) for (x, a), (y, b) in itertools.combinations(sides, 2)]
    genuine = [score for same, score in pairs if same]
    impostor = [score for same, score in pairs if not same]
    above = float(np.mean(np.array(genuine) > max(impostor)))
    return {
        "genuine_pairs": len(genuine),
        "impostor_pairs": len(impostor),
        "genuine_mean": float(np.mean(genuine)),
        "genuine_median": float(np.median(genuine)),
        "impostor_mean": float(np.mean(impostor)),
        "impostor_99th_percentile": float(np.percentile(impostor, 99)),
        "highest_impostor": float(max(impostor)),
        "genuine_above_impostors": above,
    }


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("prints", nargs="*", type=Path)
    options = parser.parse_args()
    data = Path(os.environ.get("SPLITKNIT_DATA", HERE.parents[2] / "shared" / "data")) / "fvc2002_db1b"
    real = sorted(data.glob("*_*.png"))
    if not real:
        raise SystemExit(f"no prints at {data}; set SPLITKNIT_DATA")
    result: dict[str, object] = {}
    for name, files in (("fvc2002_db1b", real), ("others", options.prints)):
        if not files:
            continue
        images = [np.ascontiguousarray(read_image(file)[..., 0]) for file in files]
        found = [loss(image) for image in images]
        table = {key: spread([figures[key] for figures, _ in found]) for key in found[0][0]}
        before = [extract(image) for image in images]
        after = [extract(back) for _, back in found]
        table["bozorth3_print_with_its_wsq"] = spread(
            [minutiae_match(a, b) for a, b in zip(before, after, strict=True)]
        )
        table["bozorth3_print_with_itself"] = spread([minutiae_match(a, a) for a in before])
        result[name] = {"prints": len(files), "wsq": table}
        if name == "others":
            continue
        fingers = [file.name.split("_")[0] for file in files]
        kinds = {"as_found": before, "wsq": after}
        result["scores"] = {kind: scores(list(zip(fingers, sides, strict=True))) for kind, sides in kinds.items()}
    text = json.dumps(result, indent=1)
    (HERE / "results.json").write_text(text + "\n", encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
