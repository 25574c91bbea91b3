"""SECURITY.md, sentence by sentence: each claim stands there, and names the tests that try to break it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
CLAIMS: dict[str, tuple[str, ...]] = {
    "nothing is sent and no name is looked up": ("tests/test_no_network.py",),
    "files are made 0600, folders 0700": (
        "packages/splitknit/tests/io/test_io_atomic.py::test_what_is_written_is_private",
        "tests/cli/test_private_files.py",
    ),
    "an existing gallery keeps its mode, and a note says so": (
        "packages/splitknit-match/tests/cli/test_enroll.py::test_a_gallery_that_others_can_read_gets_a_note",
    ),
    "every content is bound to its row": ("packages/splitknit-match/tests/gallery/test_gallery_key.py",),
    "a sealed count and digest of all rows": ("packages/splitknit-match/tests/gallery/test_gallery_rows.py",),
    "a list of all files with their SHA-256, under an HMAC": ("packages/splitknit-match/tests/gallery/test_shards.py",),
    "rows, pages, journal and files are overwritten": (
        "packages/splitknit-match/tests/gallery/test_gallery.py::test_no_journal_stays_after_an_interrupt_or_beside_a_gallery_that_is_read",
        "packages/splitknit-match/tests/batch/test_forget.py::test_a_strangers_folder_holds_no_erasure_up",
    ),
    "checks of `Host`, `Origin` and `Sec-Fetch-Site`": ("packages/splitknit/tests/viewer/test_viewer_guard.py",),
    "loopback unless a TLS certificate is given; a token": (
        "packages/splitknit-match/tests/gallery/test_serve.py::test_it_is_for_this_machine_and_wants_a_token",
    ),
    "an audit line for each act, without biometric data": (
        "packages/splitknit-match/tests/gallery/test_serve.py::test_a_client_made_of_the_document_enrols_and_identifies",
    ),
    "what is printed, and what a report shows, holds no control character": (
        "tests/cli/test_cli.py::test_a_success_moves_no_cursor_whatever_its_files_are_called",
        "packages/splitknit/tests/report/test_report.py::test_a_page_turns_no_writing_and_holds_no_control_character",
    ),
    "a text that would run as a formula begins with an apostrophe": ("packages/splitknit/tests/io/test_csv_table.py",),
    "plain `tcp://` to another computer is refused": (
        "packages/splitknit-match/tests/batch/test_batch_workers.py::test_code_goes_to_other_computers_only_encrypted_or_on_demand",
    ),
    "the browser and the WSQ decoder do not inherit variables": (
        "packages/splitknit-match/tests/io/test_wsq.py::test_the_child_inherits_no_key",
        "packages/splitknit-match/tests/viewer/test_viewer_verb.py::test_the_browser_gets_neither_the_token_nor_a_key",
    ),
    "WSQ, whose decoder is third-party code, is decoded in a process of its own": (
        "packages/splitknit-match/tests/io/test_wsq.py::test_a_child_that_ends_hangs_or_talks_is_refused",
    ),
    "against the return of the whole file in an earlier state a counter file": (
        "packages/splitknit-match/tests/gallery/test_gallery_rows.py::test_an_older_copy_is_found_by_the_counter",
    ),
    "splitknit sets `ORT_DISABLE_TELEMETRY=1` before importing it": (
        "packages/splitknit/tests/networks/test_unet.py::test_onnxruntime_is_imported_without_telemetry",
    ),
    "is refused where it may refer to data outside the file": (
        "packages/splitknit/tests/networks/test_weights.py::test_data_outside_the_file_are_refused",
    ),
    "sizes are checked before memory is taken": (
        "packages/splitknit/tests/io/test_height_maps.py::test_what_an_x3p_unpacks_to_is_bounded",
        "packages/splitknit/tests/io/test_npz.py::test_a_long_list_of_files_takes_no_memory",
        "packages/splitknit/tests/io/test_npz.py::test_files_of_an_archive_that_lie_on_each_other_are_refused",
    ),
    "whatever cannot be read is refused in one sentence": (
        "packages/splitknit-rig/tests/cli/test_bad_input.py::test_bad_captures",
        "tests/cli/test_cli.py::test_a_closed_pipe_is_no_error_and_a_full_disk_is_one_sentence",
        "tests/fuzz/run.py",
    ),
    "a folder or file that splitknit did not write is never replaced or deleted": (
        "packages/splitknit/tests/io/test_io_atomic.py::test_files_of_others_are_never_deleted",
        "packages/splitknit/tests/io/test_io_atomic.py::test_a_list_of_files_counts_only_as_a_file_of_its_own",
    ),
    "reads and writes through no symbolic link inside a folder that it is given": (
        "packages/splitknit/tests/io/test_io_atomic.py::test_nothing_is_written_through_a_link_inside_a_given_folder",
    ),
    "After Ctrl-C and SIGTERM nothing stays": (
        "packages/splitknit/tests/io/test_io_atomic.py::test_an_interrupt_while_tidying_waits_until_that_is_done",
        "tests/fuzz/kills.py",
    ),
    "the next command that writes into the same folder, or opens the gallery, removes it": (
        "packages/splitknit/tests/io/test_io_atomic.py::test_the_next_program_removes_what_a_killed_one_left",
        "tests/fuzz/kills.py",
    ),
}


@pytest.mark.parametrize("claim", CLAIMS)
def test_each_claim_stands_there_and_its_tests_exist(claim: str) -> None:
    assert claim in " ".join((ROOT / "SECURITY.md").read_text(encoding="utf-8").split())
    for place in CLAIMS[claim]:
        file, _, name = place.partition("::")
        text = (ROOT / file).read_text(encoding="utf-8")
        assert not name or re.search(rf"^def {name}\(", text, flags=re.MULTILINE), place
