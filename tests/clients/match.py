"""What a user writes against the matching, for mypy (pyright 1.1.414 strict agrees): an ignored
error is one that both must find."""

from pathlib import Path

import cv2
import numpy as np
from PIL import Image

import splitknit_match


def same(a: Path, b: str) -> bool:
    comparison = splitknit_match.match(a, b, method="ridge", settings={"thesis": False}, fmr=1e-3)
    print(comparison.similarity, comparison.a, comparison.compared, comparison.method)
    return comparison.answer == "match"


def known(gallery: str, probe: Path) -> list[str]:
    splitknit_match.enroll(gallery, probe, "A", "right_index", duplicates="warn")
    identification = splitknit_match.identify(gallery, probe, top=3, merge="person")
    return [
        f"{candidate.rank} {candidate.person} {candidate.similarity}"
        for candidate in identification.candidates
    ]


def printed(result: str) -> None:
    printed = splitknit_match.make_print(result, method="unroll", ppi=500.0)
    cv2.imwrite("print.png", printed.image)
    print(splitknit_match.evaluate(["scores.csv"], cluster="subject"))


def wrong() -> None:
    splitknit_match.match("a", "b", methods="ridges")  # type: ignore[call-arg]
    splitknit_match.identify("g.skg", "probe", tops=3)  # type: ignore[call-arg]
    splitknit_match.make_print("result").picture  # type: ignore[attr-defined]


def sign_in(photograph: str, gallery: splitknit_match.Gallery) -> splitknit_match.Identification:
    """OpenCV's arrays, and every result has a type."""
    picture = cv2.imread(photograph, cv2.IMREAD_GRAYSCALE)
    assert picture is not None
    comparison: splitknit_match.Match = splitknit_match.match(picture, picture, resolution_ppi=500)
    assert comparison.answer
    enrolment: splitknit_match.Enrolment
    enrolment = gallery.enroll(picture, "Ann", "right_index", resolution_ppi=500)
    assert enrolment.enrolled
    return gallery.identify(picture, resolution_ppi=500)


def own_rows(photographs: list[str]) -> str | None:
    """Templates that the user keeps, searched by an array of OpenCV or of Pillow."""
    rows: dict[str, bytes] = {}
    for name in photographs:
        template = splitknit_match.make_template(name, resolution_ppi=500)
        if template.a.acquired:
            rows[name] = template.payload
    candidates = splitknit_match.Candidates(rows)
    probe = cv2.imread("probe.png", cv2.IMREAD_GRAYSCALE)
    assert probe is not None
    search = candidates.search(probe, resolution_ppi=500, top=1)
    candidates.add({"Bob": rows["ann.png"]})
    with Image.open("probe.png") as picture:
        again = candidates.search(np.asarray(picture.convert("L")), resolution_ppi=500)
        candidates.search(picture, resolution_ppi=500)  # type: ignore[arg-type]
    if search.answer != "match" or again.answer != "match":
        return None
    return search.candidates[0].person
