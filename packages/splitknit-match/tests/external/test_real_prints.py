"""Prints of real fingers: our minutiae route, joined with ridges, against nbis-py as it comes."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from splitknit.io.prints import read_print_png
from splitknit_match.matching.fusion import fused_match
from splitknit_match.matching.inputs import print_template
from splitknit_match.matching.ridge import Prepared
from splitknit_match.prints.minutiae import extract, minutiae_match
from splitknit_match.prints.minutiae_record import pack_minutiae, unpack_minutiae

pytestmark = pytest.mark.external
KEPT = (1, 2, 3, 5, 7)
"""Presses of each finger that are compared."""


@pytest.fixture(scope="module")
def files(data_dir):
    """Five presses of each of five fingers."""
    folder = data_dir / "fvc2002_db1b"
    if not folder.is_dir():
        pytest.skip(f"{folder} is absent")
    pytest.importorskip("nbis")
    return [folder / f"{finger}_{press}.png" for finger in range(101, 106) for press in KEPT]


def share_above_all_impostors(files, match) -> float:
    """GAR at FAR 0."""
    scores: dict[bool, list[float]] = {True: [], False: []}
    for i, j in itertools.combinations(range(len(files)), 2):
        scores[files[i].stem[:3] == files[j].stem[:3]].append(match(i, j))
    return float(np.mean(np.array(scores[True]) > max(scores[False])))


@pytest.mark.slow
def test_our_route_is_no_worse_than_nbis_py(files) -> None:
    import nbis

    extractor = nbis.new_nbis_extractor(
        nbis.NbisExtractorSettings(
            min_quality=0.0,
            get_center=False,
            check_fingerprint=False,
            compute_nfiq2=False,
            ppi=500.0,
        )
    )
    plain = [extractor.extract_minutiae(file.read_bytes()) for file in files]
    sides = [Prepared(print_template(read_print_png(file).image)) for file in files]
    theirs = share_above_all_impostors(files, lambda i, j: plain[i].compare(plain[j]))
    ours = share_above_all_impostors(files, lambda i, j: fused_match(sides[i], sides[j]).similarity)
    assert ours >= theirs > 0.7


def test_unenhanced_minutiae_give_the_scores_of_nbis_py(files) -> None:
    """Also after packing: files in, the same whole numbers out."""
    import nbis

    extractor = nbis.new_nbis_extractor(
        nbis.NbisExtractorSettings(
            min_quality=0.0,
            get_center=False,
            check_fingerprint=False,
            compute_nfiq2=False,
            ppi=500.0,
        )
    )
    some = files[::6]
    plain = [extractor.extract_minutiae(file.read_bytes()) for file in some]
    ours = [
        unpack_minutiae(pack_minutiae(extract(read_print_png(file).image, edge_mm=0.0)))
        for file in some
    ]
    for i, j in itertools.product(range(len(some)), repeat=2):
        assert minutiae_match(ours[i], ours[j]) == plain[i].compare(plain[j])
