"""One pair of fingers, whatever they were made of, has one answer: files, templates, bytes, a
gallery, candidates and the service agree."""

import asyncio
import base64
import itertools
from dataclasses import replace

import cv2
import numpy as np
import pytest

import splitknit_match
from drawn_photo import PX_PER_MM, drawn
from enrolled import POSES
from perfect_results import write_perfect
from refusals import bad_input
from splitknit.io.prints import write_print_png
from splitknit.nominal import default_rig
from splitknit_match.gallery.gallery import Enrolling
from splitknit_match.gallery.serve import make_app
from splitknit_match.matching.inputs import held, print_of_surface, print_template, read_surface
from splitknit_match.matching.match import make_template
from splitknit_match.matching.methods import TABLES, impostors_of
from splitknit_match.matching.template import VERSION, mirrored, pack, unpack
from splitknit_match.records.minutiae_record import pack_minutiae
from splitknit_match.records.templates import encode_template, write_template
from splitknit_simulator.finger.finger import draw_finger, finger_surface
from splitknit_simulator.finger.master_print import ink_print

pytest.importorskip("starlette")
httpx = pytest.importorskip("httpx")

TOKEN = "a-token-of-many-letters"
KINDS = ("print", "photo", "scaled photo", "surface", "contactless")


@pytest.fixture(scope="module")
def sources(tmp_path_factory):
    """Of each kind two impressions; of all but photographs of one finger."""
    folder = tmp_path_factory.mktemp("kinds")
    files = {}
    camera = default_rig(0.2).camera
    finger = draw_finger(732, "right_loop")
    image = ink_print(finger.master())
    for number, pose in enumerate(POSES):
        shifted = np.pad(image, 20 + 5 * number, constant_values=255)
        noise = np.random.default_rng(number).normal(0, 10, shifted.shape)
        files["print", number] = folder / f"print{number}.png"
        pixels = np.clip(shifted + noise, 0, 255).astype(np.uint8)
        write_print_png(files["print", number], pixels)
        seen = finger_surface(finger, pose, camera)
        files["surface", number] = write_perfect(folder / f"surface{number}", seen, camera)
        printed = files["contactless", number] = folder / f"contactless{number}"
        printed.mkdir()  # as `splitknit print` writes it
        unrolled = print_of_surface(read_surface(files["surface", number] / "height.npz"))
        write_print_png(printed / "print.png", unrolled)
        (printed / "map.npz").write_bytes(b"")
        (printed / "report.json").write_text('{"method": "unroll"}')
        photo = files["photo", number] = folder / f"photo{number}.png"
        cv2.imwrite(str(photo), drawn(20.0 * number, minutiae=30)[0][..., ::-1])
        files["scaled photo", number] = photo
    return files


def ppi_of(kind):
    return PX_PER_MM * 25.4 if kind == "scaled photo" else None


@pytest.fixture(scope="module")
def templates(sources):
    return {
        (kind, number): make_template(path, resolution_ppi=ppi_of(kind)).payload
        for (kind, number), path in sources.items()
    }


def of_match(match):
    return of_answer(match, match)


def of_search(search):
    return of_answer(search, search.candidates[0])


def of_answer(answer, candidate):
    decision = answer.decision
    return (
        candidate.similarity,
        candidate.fmr,
        answer.fmr_basis,
        answer.answer,
        decision and (decision.match, decision.fmr, decision.threshold),
    )


def of_service(facts):
    first, decision, basis = facts["candidates"][0], facts["decision"], facts["fmr_basis"]
    return (
        first["similarity"],
        first["fmr"],
        basis and basis["impostors"],
        facts["answer"],
        decision and (decision["match"], decision["fmr"], decision["threshold"]),
    )


def verified(gallery, template):
    """What the service answers about a probe that is said to be Ann's."""

    async def posted():
        app = httpx.ASGITransport(make_app(gallery, TOKEN))
        async with httpx.AsyncClient(transport=app, base_url="http://service") as client:
            sent = {"template": base64.b64encode(template).decode(), "person": "Ann"}
            head = {"Authorization": f"Bearer {TOKEN}"}
            return (await client.post("/verify", json=sent, headers=head)).json()

    return asyncio.run(posted())  # type: ignore[no-any-return]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("enrolled", "probe"), [*itertools.combinations_with_replacement(KINDS, 2)]
)
def test_every_door_has_one_answer(sources, templates, tmp_path, enrolled, probe):
    a, b = templates[enrolled, 0], templates[probe, 1]
    for name, payload in (("a", a), ("b", b)):
        (tmp_path / f"{name}.skt").write_bytes(payload)
    expected = of_match(splitknit_match.match(b, a))
    stated = {
        "templates": of_match(splitknit_match.match(tmp_path / "b.skt", tmp_path / "a.skt")),
        "exchanged": of_match(splitknit_match.match(a, b)),
        "candidates": of_search(splitknit_match.Candidates({"Ann": a}).search(b)),
    }
    ppi = ppi_of(enrolled) or ppi_of(probe)
    if ppi is None or enrolled in (probe, "print", "contactless", "surface"):
        stated["files"] = of_match(
            splitknit_match.match(sources[probe, 1], sources[enrolled, 0], resolution_ppi=ppi)
        )
    with splitknit_match.Gallery(tmp_path / "g.skg") as gallery:
        how = Enrolling(resolution_ppi=ppi_of(enrolled))
        gallery.enroll(sources[enrolled, 0], "Ann", "right_index", how=how)
        for name, finger, resolution_ppi in (
            ("gallery", sources[probe, 1], ppi_of(probe)),
            ("gallery, a template", b, None),
        ):
            search = gallery.identify(finger, person="Ann", resolution_ppi=resolution_ppi)
            stated[name] = of_search(search)
        facts = verified(gallery, b)
    for name, answer in stated.items():
        assert answer == expected, name
    basis = expected[2]
    service = (*expected[:2], basis and basis.impostors, *expected[3:])
    assert of_service(facts) == service
    if {enrolled, probe} <= {"print", "surface", "contactless"}:
        assert expected[3] == "match"
    photos = sum("photo" in kind for kind in (enrolled, probe))
    if photos and basis is not None:
        assert "telephone photographs" in basis.population
    if photos == 1 and {enrolled, probe} & {"surface", "contactless"}:
        assert expected[1] is None  # not measured


def test_minutiae_know_what_they_were_found_in(sources, templates, tmp_path):
    """Rates of two surfaces, and of photographs, were not measured."""
    record = tmp_path / "a.skt"
    surface = print_of_surface(read_surface(sources["surface", 0] / "height.npz"))
    minutiae = print_template(surface).minutiae
    assert minutiae is not None
    write_template(record, pack_minutiae(minutiae), VERSION)
    with splitknit_match.Gallery(tmp_path / "g.skg") as gallery:
        gallery.enroll(record, "Record", "right_index")
        for kind in ("surface", "print"):
            gallery.enroll(sources[kind, 0], kind, "right_index")
        for kind in ("surface", "print"):
            for person in (kind, "Record"):
                other = record if person == "Record" else sources[kind, 0]
                pair = of_match(splitknit_match.match(sources[kind, 1], other, "minutiae"))
                assert of_search(gallery.identify(sources[kind, 1], person=person)) == pair
                if person == kind == "surface":
                    assert pair[2] is None  # rates of two surfaces were not measured
                else:
                    assert "presses" in pair[2].population
    assert impostors_of("minutiae", "photo", "print") not in TABLES


def test_templates_that_do_not_know_are_refused(templates):
    """Those of version 1: what to do is said."""
    payload = held(templates["print", 0])
    assert isinstance(payload, bytes)
    with bad_input("of version 1, but this program reads version 2; make the"):
        held(encode_template(payload, 1))
    for damaged in (bytes([len(KINDS)]) + payload[1:], payload[1:]):
        with bad_input("contradicts itself"):
            unpack(damaged)
    surface = held(templates["surface", 0])
    assert isinstance(surface, bytes)
    template = unpack(surface)
    assert template.kind == "surface" and template.printed.kind == "contactless"
    assert pack(template) == surface
    turned = mirrored(template).printed
    np.testing.assert_array_equal(turned.valid, template.printed.valid[:, ::-1])
    with bad_input("contradicts itself"):
        unpack(pack(replace(template, flat=unpack(payload))))  # a print is no surface's
