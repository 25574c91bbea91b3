"""The matcher ``voted`` of a batch: a folder of its own, made once, beside what is there."""

from __future__ import annotations

from pathlib import Path

import pytest

from batch_stores import chunks
from splitknit.errors import BadInput
from splitknit.io.capture import read_capture
from splitknit.presets import preset_settings
from splitknit_match.batch.chunks import read_chunk, read_origin
from splitknit_match.batch.engine import run_batch
from splitknit_match.batch.population import read_population
from splitknit_match.batch.settings import BatchSettings, preset_cases
from splitknit_match.batch.store import Store, open_store
from splitknit_match.matching.minutiae_record import pack_minutiae
from splitknit_match.matching.surface import MatchingSettings
from splitknit_match.matching.voted_minutiae import LeaveOneOutSettings, VoteSettings, voted_minutiae

MATCHING = MatchingSettings(
    leave_one_out=LeaveOneOutSettings(pictures=("albedo",)), voted=VoteSettings(least_share=0.3)
)
VOTED = BatchSettings(cases=preset_cases(("ea",)), matchers=("voted",), chunk_captures=2, matching=MATCHING)


@pytest.mark.slow
def test_voted_minutiae_have_a_folder_of_their_own(people: Path, store: Path) -> None:
    pytest.importorskip("nbis")
    before = chunks(store)
    facts = run_batch(people, store, VOTED, jobs=1)
    after = chunks(store)
    assert {name: after[name] for name in before} == before
    assert facts["scores"][0]["compared"] == 4
    files = Store(store).files("voted", "ea")
    assert [file.stem for file in files] == [file.stem for file in Store(store).files("features", "ea")]
    table = read_chunk(files[0])
    name = table.column("capture")[0].as_py()
    expected = voted_minutiae(
        read_capture(people / name), preset_settings("ea"), MATCHING.leave_one_out, MATCHING.voted
    )
    assert table.column("minutiae")[0].as_py() == pack_minutiae(expected)
    assert table.column("acquired")[0].as_py() == expected.acquired
    assert read_origin(files[0])["kind"] == "voted"
    again = run_batch(people, store, VOTED, jobs=1)
    assert again["scores"][0]["compared"] == 0
    assert chunks(store) == after


def test_other_votes_need_another_store(people: Path, store: Path) -> None:
    there = read_population(people)
    open_store(store, there, VOTED)
    other = BatchSettings(cases=preset_cases(("ea",)), matchers=("voted",), chunk_captures=2)
    with pytest.raises(BadInput, match="other settings of matcher 'voted'"):
        open_store(store, there, other)
