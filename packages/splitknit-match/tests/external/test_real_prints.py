"""Prints of real fingers: minutiae joined with ridges, against nbis-py as it comes."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit.io.prints import read_print_png
from splitknit_match import enroll, identify
from splitknit_match.matching.fusion import fused_match
from splitknit_match.matching.inputs import print_template
from splitknit_match.matching.ridge import Prepared
from splitknit_match.prints.minutiae import extract, minutiae_match
from splitknit_match.prints.minutiae_record import pack_minutiae, unpack_minutiae

pytestmark = pytest.mark.external
KEPT = (1, 2, 3, 5, 7)
"""Presses of each finger that are compared."""


def nbis_py():
    """Its extractor, set to give every minutia."""
    nbis = pytest.importorskip("nbis")
    settings = nbis.NbisExtractorSettings(
        min_quality=0.0, get_center=False, check_fingerprint=False, compute_nfiq2=False, ppi=500.0
    )
    return nbis.new_nbis_extractor(settings)


@pytest.fixture(scope="module")
def files(data_dir):
    """Five presses of each of five fingers."""
    folder = data_dir / "fvc2002_db1b"
    if not folder.is_dir():
        pytest.skip(f"{folder} is absent")
    return [folder / f"{finger}_{press}.png" for finger in range(101, 106) for press in KEPT]


def gar_at_far_0(files, similarity) -> float:
    scores: dict[bool, list[float]] = {True: [], False: []}
    for i, j in itertools.combinations(range(len(files)), 2):
        scores[files[i].stem[:3] == files[j].stem[:3]].append(similarity(i, j))
    return float(np.mean(np.array(scores[True]) > max(scores[False])))


@pytest.mark.slow
def test_ridges_and_minutiae_are_no_worse_than_nbis_py(files) -> None:
    extractor = nbis_py()
    theirs = [extractor.extract_minutiae(file.read_bytes()) for file in files]
    ours = [Prepared(print_template(read_print_png(file).image)) for file in files]
    reference = gar_at_far_0(files, lambda i, j: theirs[i].compare(theirs[j]))
    fused = gar_at_far_0(files, lambda i, j: fused_match(ours[i], ours[j]).similarity)
    assert fused >= reference > 0.7


def test_unenhanced_minutiae_give_the_scores_of_nbis_py(files) -> None:
    """Also after packing."""
    extractor, some = nbis_py(), files[::6]
    theirs = [extractor.extract_minutiae(file.read_bytes()) for file in some]
    extracted = [extract(read_print_png(file).image, edge_mm=0.0) for file in some]
    ours = [unpack_minutiae(pack_minutiae(minutiae)) for minutiae in extracted]
    for i, j in itertools.product(range(len(some)), repeat=2):
        assert minutiae_match(ours[i], ours[j]) == theirs[i].compare(theirs[j])


def test_touches_of_a_laptops_sensor_are_matched_at_their_resolution(data_dir, tmp_path) -> None:
    """At 508 ppi, as they were said to have, their ridges would lie closer than people's do."""
    folder, gallery = data_dir / "small_sensor", tmp_path / "people.skg"
    if not folder.is_dir():
        pytest.skip(f"{folder} is absent")
    touches = [folder / "register" / f"{number}.tiff" for number in range(1, 12)]
    with pytest.raises(BadInput, match=r"at 508 ppi its ridges are 0.3\d mm apart"):
        enroll(gallery, touches, "Ann", "right_index", resolution_ppi=508)
    enroll(gallery, touches, "Ann", "right_index", resolution_ppi=350)
    for number in (1, 2):
        probe = folder / "match" / f"{number}.tiff"
        assert identify(gallery, probe, resolution_ppi=350).answer == "match"
