"""Prints of real fingers: minutiae joined with ridges, against nbis-py as it comes."""

import itertools

import cv2
import numpy as np
import pytest

from refusals import bad_input
from splitknit_match import enroll, identify, match
from splitknit_match.matching.fusion import fused_match
from splitknit_match.matching.inputs import print_template
from splitknit_match.matching.minutiae_match import minutiae_match
from splitknit_match.matching.ridge import Prepared
from splitknit_match.prints.from_file import minutiae_of
from splitknit_match.prints.pressed import pressed_ridges
from splitknit_match.records.minutiae_files import read_minutiae_record
from splitknit_match.records.pictures import read_print_png

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


def gar_at_far_0(files, similarity):
    scores = {True: [], False: []}
    for i, j in itertools.combinations(range(len(files)), 2):
        scores[files[i].stem[:3] == files[j].stem[:3]].append(similarity(i, j))
    return float(np.mean(np.array(scores[True]) > max(scores[False])))


@pytest.mark.slow
def test_ridges_and_minutiae_are_no_worse_than_nbis_py(files):
    extractor = nbis_py()
    theirs = [extractor.extract_minutiae(file.read_bytes()) for file in files]
    ours = [Prepared(print_template(read_print_png(file).image)) for file in files]
    reference = gar_at_far_0(files, lambda i, j: theirs[i].compare(theirs[j]))
    fused = gar_at_far_0(files, lambda i, j: fused_match(ours[i], ours[j]).similarity)
    assert fused >= reference > 0.7


@pytest.mark.parametrize(
    ("name", "highest"), [("fvc2002_db1b", 5), ("fvc2002_db2b", 3), ("fvc2004_db4b", 6)]
)
def test_records_of_another_vendor_are_matched(data_dir, name, highest):
    """Equal error rate, percent, of 140 genuine and 640 impostor pairs."""
    folder = data_dir / "iso_templates" / name
    if not folder.is_dir():
        pytest.skip(f"{folder} is absent")
    sides = [
        (file.stem[:3], minutiae_of(read_minutiae_record(file)[0]))
        for file in sorted(folder.glob("*.iso"))
    ]
    pairs = [
        (a[0] == b[0], minutiae_match(a[1], b[1])) for a, b in itertools.combinations(sides, 2)
    ]
    genuine, impostor = (np.array([s for same, s in pairs if same == kind]) for kind in (1, 0))
    assert (genuine.size, impostor.size) == (140, 640)
    rates = [max((genuine < s).mean(), (impostor >= s).mean()) for s in np.unique(genuine)]
    assert 100 * min(rates) <= highest


def test_touches_of_a_laptops_sensor_are_matched_at_their_resolution(data_dir, tmp_path):
    """At 508 ppi, as they were said to have, their ridges would lie closer than people's do."""
    folder, gallery = data_dir / "small_sensor", tmp_path / "people.skg"
    if not folder.is_dir():
        pytest.skip(f"{folder} is absent")
    touches = [folder / "register" / f"{number}.tiff" for number in range(1, 12)]
    with bad_input(r"at 508 ppi its ridges are 0.3\d mm apart"):
        enroll(gallery, touches, "Ann", "right_index", resolution_ppi=508)
    enroll(gallery, touches, "Ann", "right_index", resolution_ppi=350)
    for number in (1, 2):
        probe = folder / "match" / f"{number}.tiff"
        assert identify(gallery, probe, resolution_ppi=350).answer == "match"


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        "fvc2000_db2b", "fvc2000_db3b", "fvc2002_db2b", "fvc2002_db3b", "fvc2004_db1b",
        "fvc2004_db2b", "fvc2004_db3b",
    ],
)  # fmt: skip
def test_sheets_of_several_prints_are_refused_and_no_print(name, data_dir):
    folder = data_dir / "fvc" / name
    if not folder.is_dir():
        pytest.skip(f"{folder} is absent")
    prints = [read_print_png(folder / f"{finger}_1.png").image for finger in range(101, 106)]
    assert not any(pressed_ridges(image).several for image in prints)
    gap = np.full((prints[0].shape[0], 20), 255, np.uint8)
    for parts in (prints[:2], [prints[2], gap, prints[3]], [prints[4], gap, prints[0], prints[1]]):
        assert len({part.shape[0] for part in parts}) == 1
        sheet = np.concatenate(parts, axis=1)
        assert pressed_ridges(sheet).several
        with bad_input("prints of several fingers"):
            print_template(sheet)


def test_crops_of_real_skin_are_prints_and_match(data_dir, tmp_path):
    film = data_dir / "author_film" / "grey_crop.png"
    if not film.is_file():
        pytest.skip(f"{film} is absent")
    skin = np.clip(cv2.imread(str(film)) * [1.0, 1.15, 1.6], 0, 255)  # BGR, as warm as skin
    turned = cv2.warpAffine(skin, cv2.getRotationMatrix2D((360, 300), 25, 0.9), (720, 720))
    sides = []
    for picture, top, left in ((skin, 80, 220), (turned, 130, 250)):
        sides.append(tmp_path / f"{top}.png")
        cv2.imwrite(str(sides[-1]), picture[top : top + 340, left : left + 340].astype(np.uint8))
    found = match(*sides)
    assert found.answer == "match"
    assert found.alignment.rotation_deg == pytest.approx(25, abs=3)
    assert sum("skin to its edges" in str(each) for each in found.findings) == 2
