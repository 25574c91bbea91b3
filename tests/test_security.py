"""SECURITY.md, sentence by sentence: each claim stands there, and names the tests that try to break
it."""

import re
from pathlib import Path

import pytest

from splitknit.io.paging import IN_MEMORY

ROOT = Path(__file__).resolve().parents[1]
CORE, RIG, MATCH = (
    f"packages/{member}/tests" for member in ("splitknit", "splitknit-rig", "splitknit-match")
)
CLAIMS = {
    "nothing is sent and no name is looked up": ("tests/test_no_network.py",),
    "files are made 0600, folders 0700": (
        f"{CORE}/io/test_io_atomic.py::test_what_is_written_is_private",
        "tests/cli/test_private_files.py",
    ),
    "an existing gallery keeps its mode, and a note says so": (
        f"{MATCH}/cli/test_enroll.py::test_a_gallery_that_others_can_read_gets_a_note",
        f"{MATCH}/cli/test_evaluate_gallery.py::test_failures_to_acquire_give_no_score",
        f"{MATCH}/gallery/test_serve.py::test_what_it_cannot_serve_with_is_one_sentence",
    ),
    "loopback unless a TLS certificate is given": (
        f"{MATCH}/gallery/test_serve.py::test_it_is_for_this_machine_and_wants_a_token",
    ),
    "an audit line for each act, of an enrolment before it is final, without biometric data": (
        f"{MATCH}/gallery/test_serve.py::test_a_client_made_of_the_document_enrols_and_identifies",
    ),
    "what is printed, and what a report shows, holds no control character": (
        "tests/cli/test_cli.py::test_a_success_moves_no_cursor_whatever_its_files_are_called",
        f"{CORE}/report/test_report.py::test_the_page_escapes_control_and_bidi_characters",
    ),
    "a text that would run as a formula begins with an apostrophe": (
        f"{CORE}/io/test_csv_table.py",
    ),
    "plain `tcp://` to another computer is refused": (
        f"{MATCH}/batch/test_batch_workers.py::test_code_goes_to_other_computers_only_encrypted",
    ),
    "the WSQ decoder does not inherit variables": (
        f"{MATCH}/io/test_wsq.py::test_the_child_inherits_no_key",
    ),
    "WSQ, whose decoder is third-party code, is decoded in a process of its own": (
        f"{MATCH}/io/test_wsq.py::test_a_child_that_ends_hangs_or_talks_is_refused",
    ),
    "splitknit sets `ORT_DISABLE_TELEMETRY=1` before importing it": (
        f"{CORE}/networks/test_unet.py::test_onnxruntime_is_imported_without_telemetry",
    ),
    "is refused where it may refer to data outside the file": (
        f"{CORE}/networks/test_weights.py::test_data_outside_the_file_are_refused",
    ),
    "sizes are checked before memory is taken": (
        f"{CORE}/io/test_npz.py::test_a_bomb_is_refused_before_memory_is_taken",
        f"{CORE}/io/test_photos.py::test_a_size_is_refused_before_memory_is_taken",
        f"{CORE}/io/test_io_images.py::test_files_of_countless_parts_are_refused",
        f"{MATCH}/gallery/test_gallery.py::test_pages_that_no_gallery_has_are_refused",
    ),
    "a gallery's tables are compared before SQLite parses them": (
        f"{MATCH}/gallery/test_gallery.py::test_a_hostile_schema_is_refused_before_it_is_evaluated",
    ),
    "nor does what lies beside a gallery": (
        f"{MATCH}/gallery/test_gallery.py::test_a_journal_deletes_no_other_file",
        f"{MATCH}/gallery/test_gallery.py::test_what_lies_beside_it_leads_nowhere",
    ),
    "whatever cannot be read is refused in one sentence": (
        f"{RIG}/cli/test_bad_input.py::test_bad_captures_are_refused_in_one_sentence",
        "tests/cli/test_cli.py::test_a_closed_pipe_is_no_error_and_a_full_disk_is_one_sentence",
        "tests/fuzz/run.py",
    ),
    "a folder or file that splitknit did not write is never replaced or deleted": (
        f"{CORE}/io/test_io_atomic.py::test_files_of_others_are_never_deleted",
        f"{MATCH}/gallery/test_gallery.py::test_a_journal_deletes_no_other_file",
        f"{CORE}/io/test_io_atomic.py::test_a_list_of_files_counts_only_as_a_file_of_its_own",
    ),
    "reads and writes through no symbolic link inside a folder that it is given": (
        f"{CORE}/io/test_io_atomic.py::"
        "test_nothing_is_written_through_a_link_inside_a_given_folder",
    ),
    "After Ctrl-C and SIGTERM nothing stays": (
        f"{CORE}/io/test_io_atomic.py::test_an_interrupt_while_tidying_waits_until_that_is_done",
        "tests/fuzz/kills.py",
    ),
    "the next command that writes into the same folder, or into the gallery, removes it": (
        f"{CORE}/io/test_io_atomic.py::test_the_next_program_removes_what_a_killed_one_left",
        "tests/fuzz/kills.py",
    ),
    "shows most vulnerabilities as well": ("tests/fuzz/run.py",),
    "every page is encrypted with AES-256 and authenticated": (
        f"{MATCH}/gallery/test_gallery.py::test_all_sides_of_a_key",
        f"{MATCH}/gallery/test_gallery.py::"
        "test_what_an_encrypted_file_reveals_is_no_name_and_any_changed_byte_is_noticed",
    ),
    "the key is 256 random bits, or stretched from a passphrase": (
        f"{MATCH}/gallery/test_gallery_key.py::test_kinds_of_keys",
        f"{MATCH}/gallery/test_gallery.py::test_all_sides_of_a_key",
    ),
    "its rows are zeroed, and the file is written anew": (
        f"{MATCH}/gallery/test_gallery.py::test_nothing_remains_of_a_removed_finger",
        f"{MATCH}/gallery/test_gallery.py::test_second_copies_in_a_page_go_with_a_removal",
    ),
    "The SHA-256 of its templates detects damage": (
        f"{MATCH}/gallery/test_gallery.py::test_damage_is_refused",
    ),
    "loads nothing from elsewhere": (
        f"{CORE}/report/test_report.py::test_page_is_self_contained",
        f"{CORE}/report/test_page_browser.py",
    ),
    "lets your group read them": (
        "tests/cli/test_private_files.py::test_verbs_write_private_files",
    ),
    "After `kill -9` a folder": ("tests/fuzz/kills.py",),
    "gone when the program ends, however it ends": (
        f"{CORE}/observation/test_plain.py::test_large_stacks_are_processed_in_strips_from_disk",
    ),
    "Whoever holds a key signed by the cluster's CA": (
        f"{MATCH}/batch/test_batch_workers.py::test_a_cluster_is_used_by_whom_its_ca_knows",
    ),
    "Another user of the machine can occupy": (
        f"{MATCH}/gallery/test_serve.py::test_slow_clients_are_let_go_and_no_host_is_believed",
    ),
    "answers name no folder": (
        f"{MATCH}/gallery/test_serve.py::test_no_answer_names_a_folder_given_as_relative",
        f"{MATCH}/gallery/test_serve.py::"
        "test_a_gallery_that_is_gone_is_503_and_no_answer_names_a_folder",
    ),
    "bounded bodies, comparisons, connections (64, others are closed at once), silence": (
        f"{MATCH}/gallery/test_serve.py::test_silent_connections_do_not_hold_the_door",
        f"{MATCH}/gallery/test_serve.py::test_who_fetches_no_answer_is_let_go",
        f"{MATCH}/gallery/test_serve.py::test_what_is_wrong_is_one_sentence",
        f"{MATCH}/gallery/test_serve.py::test_slow_clients_are_let_go_and_no_host_is_believed",
    ),
    "TLS with certificates on both sides": (
        f"{MATCH}/batch/test_batch_workers.py::test_a_cluster_is_used_by_whom_its_ca_knows",
    ),
    "fuzzers for every reader": ("tests/fuzz/test_fuzz.py", "tests/fuzz/run.py"),
    "photographs that it wrote are replaced with `--overwrite` only": (
        "tests/io/test_targets.py::test_no_verb_replaces_photographs",
    ),
    "leads to no file outside its folder": (
        "tests/batch/test_batch_stages.py::test_nothing_is_written_or_read_through_a_link",
    ),
    "is checked against the SHA-256 in `constraints.txt`": (
        "tests/test_packaging.py::test_everything_is_installed_as_the_constraints_say",
    ),
    "splitknit writes to the folders that it is given, and to `TMPDIR`": (
        "tests/test_no_network.py::test_nothing_leaves_the_machine",
    ),
    f"more than {IN_MEMORY / 1e6:g} MB decoded": (
        f"{CORE}/observation/test_light.py::test_a_paged_stack_gives_the_same_light",
    ),
    "lie in a file without a name while they are worked on": (
        f"{CORE}/observation/test_plain.py::test_large_stacks_are_processed_in_strips_from_disk",
    ),
    "`--scheduler` connects to the scheduler that you name": (
        f"{MATCH}/batch/test_batch_workers.py::"
        "test_the_client_opens_no_port_and_dask_s_configuration_weakens_nothing",
    ),
    "of a gallery no template": (
        f"{MATCH}/gallery/test_gallery_workers.py::"
        "test_what_dask_moves_or_puts_aside_is_how_a_part_is_read",
    ),
    "`serve` listens on loopback": (
        f"{MATCH}/gallery/test_serve.py::test_it_is_for_this_machine_and_wants_a_token",
    ),
    "must set the variable itself, otherwise networks are refused": (
        f"{CORE}/networks/test_unet.py::test_onnxruntime_imported_with_telemetry_is_refused",
    ),
    "The test runs under strace": ("tests/test_no_network.py::test_what_leaves_is_seen",),
    "it is checked by the SHA-256 of its card": (
        f"{CORE}/networks/test_weights.py::test_weights_with_a_changed_byte_are_refused",
    ),
}
UNTESTED = {
    "Fingerprints cannot be changed as a password can": "a statement of purpose",
    "This page says what splitknit protects": "a statement of purpose",
    "Please write to the maintainers": "a request to readers; CITATION.cff names them",
    "Never send real fingerprints": "a request to readers",
    "Only the latest version is fixed": "a promise of the maintainers",
    "asset | against | by": "the head of the table",
    "Whoever can replace the file can put an earlier one back": (
        "nothing in the file says which copy it is (read)"
    ),
    "keep backups, and the folder, out of others' reach": "advice",
    "and the time of its last change can be seen": "what every file shows",
    "are deleted, not overwritten": "what SQLite and file systems do (read)",
    "use a key, and encrypt the disk": "advice",
    "leftovers of file managers": "held with the list `.splitknit` above",
    "the Docker image below it is a tag": "read in the Dockerfile; no image was built",
    "Caches of optional packages": "what other packages do; not tried again",
    "a token compared in constant time": (
        "`hmac.compare_digest` in `gallery/serve.py` (read); times were not measured"
    ),
    "not encrypted": "read in `io.paging`",
    "onnxruntime 1.31 sends telemetry by default": "its vendor's words",
    "without strace it uses an audit hook": "what Python's documentation says of such hooks",
    "host names are not compared with certificates": "what Dask does (read)",
    "**Templates are biometric data.**": (
        "a template is a picture of the ridges of two bits a pixel (read)"
    ),
    "it is not a one-way hash": "a template is a picture of the ridges of two bits a pixel (read)",
    "limits on size hold for each file": "read",
    "A Dask worker keeps": "what Dask does; not tried again",
    "a Dask scheduler shows its dashboard": "what Dask does; not tried again",
    "a detector was fitted to simulated ones": "a statement of what was measured",
    "no real one has been measured": "a statement of what was measured",
    "Whoever is root, or runs code as you": "the kernel's rights; nothing is claimed against them",
    "Keys are not locked in memory": "no call of mlock in the program (read)",
    "swap and core dumps": "the system's",
    "A network file that you name runs in this process": "onnxruntime's behaviour",
    "A scheduler on `tcp://127.0.0.1`": (
        "a client of another account ran a function on such a scheduler"
    ),
    "Folders above the output that become links meanwhile": "19 runs in a race (tried by hand)",
}
"""What no test holds, and what was tried or read instead."""


def clauses():
    """SECURITY.md in pieces: each sentence, and of a row of its table each part of the last
    cell."""
    pieces = []
    text = (ROOT / "SECURITY.md").read_text(encoding="utf-8")
    for block in re.split(r"\n\s*\n|\n(?=- |\|)", text):
        words = " ".join(block.split()).lstrip("- ")
        if words.startswith("|") and set(words) != set("| -"):
            *first, last = words.strip("| ").rsplit(" | ", 1)
            begin, *more = last.split("; ")
            pieces += [" | ".join([*first, begin]), *more]
        elif words and not words.startswith(("#", "|")):
            pieces += re.split(r"(?<=[.;]) ", words)
    return pieces


@pytest.mark.parametrize("clause", clauses())
def test_every_sentence_is_held_by_a_test_or_listed_as_untested(clause):
    assert [part for part in (*CLAIMS, *UNTESTED) if part in clause or clause.strip(".; |") in part]


@pytest.mark.parametrize("claim", [*CLAIMS, *UNTESTED])
def test_each_claim_stands_there_and_its_tests_exist(claim):
    assert claim in " ".join((ROOT / "SECURITY.md").read_text(encoding="utf-8").split())
    assert (claim in CLAIMS) != (claim in UNTESTED)
    for place in CLAIMS.get(claim, ()):
        file, _, name = place.partition("::")
        text = (ROOT / file).read_text(encoding="utf-8")
        assert not name or re.search(rf"^def {name}\(", text, flags=re.MULTILINE), place
