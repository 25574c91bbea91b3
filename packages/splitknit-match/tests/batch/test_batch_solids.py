"""Features in space in a batch: made with the reconstruction or from stored surfaces, the same bytes; compared."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from batch_stores import EA, chunks, pairs_of
from splitknit.errors import BadInput
from splitknit_match.batch.engine import run_batch
from splitknit_match.batch.store import Store
from splitknit_match.matching.minutiae3d import minutiae3d_match
from splitknit_match.matching.minutiae_record import unpack_space_minutiae
from splitknit_match.matching.surface_code import surface_code_match, unpack_surface_code

CODES = replace(EA, matchers=("surface-code",))
SPACE = replace(EA, matchers=("minutiae3d", "tetrahedra"))


def payloads(out: Path, kind: str, column: str) -> dict[str, bytes]:
    from splitknit_match.batch.chunks import read_chunk

    found = {}
    for file in Store(out).files(kind, "ea"):
        table = read_chunk(file)
        found |= dict(zip(table.column("capture").to_pylist(), table.column(column).to_pylist(), strict=True))
    return found


@pytest.mark.slow
def test_codes_from_stored_surfaces_are_those_of_the_reconstruction(people: Path, store: Path, tmp_path: Path) -> None:
    before = chunks(store)
    run_batch(people, store, CODES, jobs=1)
    fresh = tmp_path / "fresh"
    run_batch(people, fresh, CODES, jobs=1)
    assert chunks(fresh) == chunks(store)
    assert before.items() <= chunks(store).items()  # the features have not changed
    codes = payloads(store, "surface_codes", "surface_code")
    rows = Store(store).scores("ea", "surface-code").to_pylist()
    assert len(rows) == len(pairs_of(store, "surface-code")) == 4
    for row in rows:
        found = surface_code_match(*(unpack_surface_code(codes[row[side]]) for side in "ab"))
        assert (row["similarity"], row["distance"]) == (found.similarity, found.distance)
        assert row["compared"]
    assert run_batch(people, store, CODES, jobs=1)["scores"][0]["compared"] == 0  # nothing is done twice


def test_a_lost_chunk_is_made_again(people: Path, store: Path) -> None:
    run_batch(people, store, CODES, jobs=1)
    whole = chunks(store)
    lost = Store(store).files("surface_codes", "ea")[0]
    lost.unlink()
    run_batch(people, store, CODES, jobs=1)
    assert chunks(store) == whole


@pytest.mark.slow
def test_without_surfaces(people: Path, reconstructed: Path, tmp_path: Path) -> None:
    """They can be made with the reconstruction, not afterwards."""
    bare = replace(CODES, surfaces=False)
    run_batch(people, tmp_path / "at once", bare, jobs=1)
    assert len(Store(tmp_path / "at once").scores("ea", "surface-code")) == 4
    run_batch(people, tmp_path / "later", replace(bare, matchers=()), jobs=1)
    with pytest.raises(BadInput, match=r"holds no surfaces.*delete it and run the same again"):
        run_batch(people, tmp_path / "later", bare, jobs=1)


def test_minutiae_in_space(people: Path, store: Path) -> None:
    pytest.importorskip("nbis")
    run_batch(people, store, SPACE, jobs=1)
    found = {name: unpack_space_minutiae(data) for name, data in payloads(store, "minutiae3d", "minutiae3d").items()}
    assert len(found) == 4
    for row in Store(store).scores("ea", "minutiae3d").to_pylist():
        sides = [found[row[side]] for side in "ab"]
        assert row["compared"] == all(side.acquired for side in sides)
        if row["compared"]:
            assert row["similarity"] == minutiae3d_match(*sides).similarity
    assert len(Store(store).scores("ea", "tetrahedra")) == 4
    assert (store / "csv" / "ea_tetrahedra.csv").is_file()
