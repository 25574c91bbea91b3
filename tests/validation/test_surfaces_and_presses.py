"""Surfaces and presses of the same fingers match, those of others do not, by every door."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import splitknit_match
from script_folder import VALIDATION, scripts_of
from splitknit.io.npz import write_npz
from splitknit_simulator.finger.finger import draw_finger

SEEDS = (53_201, 53_202, 53_203)
PRESSES = (4, 3, 3)


@pytest.mark.slow
def test_a_surface_is_printed_before_it_meets_a_press(tmp_path: Path) -> None:
    with scripts_of(VALIDATION / "match") as named:
        drawn, presses = named("impostors").FINE, named("pressed_prints")
        results, images = {}, {}
        for finger, (seed, count) in enumerate(zip(SEEDS, PRESSES, strict=True)):
            surface = drawn(seed)
            results[finger] = tmp_path / str(finger) / "height.npz"
            results[finger].parent.mkdir()
            fields = ("ridge_mm", "shape_mm", "normals", "mask", "input_from_upright")
            arrays = {name: getattr(surface, name) for name in fields}
            scale = {
                "pitch_mm": np.float64(surface.pitch_mm),
                "upright_size": np.array(surface.upright_size),
            }
            write_npz(results[finger], arrays | scale)
            master = draw_finger(seed).master()
            for number in range(count):
                images[finger, number] = presses.press(master, number)
    surfaces = {
        str(finger): splitknit_match.make_template(path).payload for finger, path in results.items()
    }
    candidates = splitknit_match.Candidates(surfaces)
    with splitknit_match.Gallery(tmp_path / "g.skg") as gallery:
        for finger, path in results.items():
            gallery.enroll(path, str(finger), "right_index")
        for (finger, _), image in images.items():
            for people in (gallery, candidates):
                search = people.identify if people is gallery else people.search
                found = search(image, resolution_ppi=500)
                assert (found.answer, found.candidates[0].person) == ("match", str(finger))
                assert found.fmr_basis.population.startswith("of them")
            for other, template in surfaces.items():
                expected = "match" if other == str(finger) else "no match"
                pair = splitknit_match.match(template, image, resolution_ppi=500)
                assert (pair.method, pair.answer) == ("fusion", expected)
        press = splitknit_match.make_template(images[0, 0], resolution_ppi=500).payload
        of_file = splitknit_match.match(results[0], press)
        of_template = splitknit_match.match(surfaces["0"], press)
        assert of_file.similarity == of_template.similarity
        assert of_file.fmr == of_template.fmr
