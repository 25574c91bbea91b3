"""Python without files: arrays, templates as bytes, a gallery that stays open, one finger under two
names."""

import os
import threading

import numpy as np
import pytest

import splitknit_match
from refusals import bad_input
from splitknit.errors import BadInput
from splitknit_match.gallery.file import Key
from splitknit_simulator.finger.master_print import MasterPrintSettings, ink_print, master_print

PPI = 500.0


def press(seed, shift=0, noise=0.0):
    """A print of a simulated finger, moved by some pixels."""
    master = master_print(
        "left_loop", seed, MasterPrintSettings(half_width_mm=7.0, distal_mm=16.0, proximal_mm=1.0)
    )
    image = np.pad(ink_print(master), 20, constant_values=255).astype(np.float32)
    image = np.roll(image, shift, axis=1) + noise * np.random.default_rng(seed).standard_normal(
        image.shape
    )
    return np.clip(image, 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def prints():
    return {
        "ann": press(1),
        "ann again": press(1, 9, 12.0),
        "bob": press(2),
        "bob again": press(2, -7, 12.0),
    }


@pytest.mark.slow
def test_arrays_are_matched_as_files_are(prints, tmp_path):
    from splitknit.io.prints import write_print_png

    write_print_png(tmp_path / "a.png", prints["ann"])
    write_print_png(tmp_path / "b.png", prints["ann again"])
    of_files = splitknit_match.match(tmp_path / "a.png", tmp_path / "b.png")
    of_arrays = splitknit_match.match(prints["ann"], prints["ann again"], resolution_ppi=PPI)
    assert of_arrays.similarity == of_files.similarity
    assert of_arrays.decision is not None and of_arrays.decision.match
    template = splitknit_match.make_template(prints["ann"], resolution_ppi=PPI)
    assert template.payload and template.template is None and template.a.acquired
    assert "x00" not in repr(template)  # nothing prints it
    assert (
        splitknit_match.match(template.payload, prints["ann again"], resolution_ppi=PPI).similarity
        == of_files.similarity
    )
    splitknit_match.make_template(prints["ann"], tmp_path / "a.skt", resolution_ppi=PPI)
    assert (
        splitknit_match.match(tmp_path / "a.skt", tmp_path / "b.png").similarity
        == of_files.similarity
    )


@pytest.mark.parametrize(
    ("finger", "ppi", "words"),
    [
        (
            np.zeros((90, 90), np.uint8),
            None,
            "does not state its resolution; give it: `resolution_ppi`",
        ),
        (np.zeros((90, 90), np.uint8), 199, "in 200 to 5080, but it is 199"),
        (np.zeros((90, 90), np.uint8), 5081, "in 200 to 5080"),
        (np.zeros((90, 90), np.uint8), float("nan"), "in 200 to 5080"),
        (np.zeros((90, 90)), PPI, r"must be \(H, W\) uint8"),
        (np.zeros((90, 90, 3), np.uint8), PPI, r"must be \(H, W\) uint8"),
        (b"no template", None, "contradicts itself|not a packed"),
        (7, None, "a finger is a path"),
    ],
)
def test_what_is_no_finger_is_refused(finger, ppi, words, tmp_path):
    for call in (
        lambda: splitknit_match.match(finger, finger, resolution_ppi=ppi),
        lambda: splitknit_match.make_template(finger, resolution_ppi=ppi),
        lambda: splitknit_match.enroll(
            tmp_path / "g.skg", finger, "Ann", "right_index", resolution_ppi=ppi
        ),
    ):
        with bad_input(words):
            call()
    assert not (tmp_path / "g.skg").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"fmr": "high"}, "`fmr` must lie between 0 and 1, but it is 'high'"),
        ({"person": 17}, "a person's name is a text, not 17"),
        ({"top": "all"}, "`top` must be"),
        ({"finger": 17}, "'17' is not a finger"),
    ],
)
def test_arguments_of_another_kind_are_refused(arguments, words, tmp_path):
    with bad_input(words):
        splitknit_match.identify(tmp_path / "g.skg", b"", **arguments)
    if "person" in arguments:
        with bad_input(words):
            splitknit_match.enroll(tmp_path / "g.skg", b"", 17, "right_index")


@pytest.mark.slow
@pytest.mark.parametrize("key", [None, Key("0f" * 32)], ids=["plain", "encrypted"])
def test_a_gallery_stays_open(prints, tmp_path, key, monkeypatch):
    if key is not None:  # by the index of minutiae, brought up to date
        pytest.importorskip("sqlcipher3")
        monkeypatch.setattr("splitknit_match.gallery.identify.ALL_PRINTS", 0)
    file = tmp_path / "people.skg"
    with splitknit_match.Gallery(file, key) as gallery:
        assert not gallery.there
        for name in ("ann", "bob"):
            done = gallery.enroll(prints[name], name, "right_index", resolution_ppi=PPI)
            assert done.alike == ()
        identification = gallery.identify(prints["ann again"], resolution_ppi=PPI)
        assert identification.candidates[0].person == "ann" and identification.decision.match
        fresh = splitknit_match.identify(file, prints["ann again"], key, resolution_ppi=PPI)
        assert [candidate.similarity for candidate in fresh.candidates] == [
            candidate.similarity for candidate in identification.candidates
        ]
        assert not gallery.identify(
            prints["ann again"], resolution_ppi=PPI, person="bob"
        ).decision.match
        # what another program changes is seen with the next call
        splitknit_match.enroll(file, press(3), "zoe", "left_thumb", key=key, resolution_ppi=PPI)
        assert len(gallery) == 3
        assert gallery.identify(press(3, 5), resolution_ppi=PPI).candidates[0].person == "zoe"
        with splitknit_match.Gallery(file, key) as second_gallery:
            second_gallery.remove("ann")
        assert "ann" not in [
            candidate.person
            for candidate in gallery.identify(prints["ann"], resolution_ppi=PPI).candidates
        ]


@pytest.mark.slow
@pytest.mark.parametrize("how", ["moved over it", "copied over it", "removed and written"])
def test_another_file_of_the_name_is_searched_at_once(prints, tmp_path, how):
    file, other_file = tmp_path / "people.skg", tmp_path / "other.skg"
    # as many changes, and of one size
    for place, names in ((file, ("ann", "zoe")), (other_file, ("bob", "zoe"))):
        for name in names:
            finger = prints[name] if name != "zoe" else press(3)
            splitknit_match.enroll(
                place, finger, name if name == "zoe" else "x", "right_index", resolution_ppi=PPI
            )
    with splitknit_match.Gallery(file) as gallery:
        assert gallery.identify(prints["ann again"], resolution_ppi=PPI).decision.match
        content = other_file.read_bytes()
        if how == "moved over it":
            other_file.rename(file)
        else:
            if how.startswith("removed"):
                file.unlink()
            file.write_bytes(content)
        assert not gallery.identify(prints["ann again"], resolution_ppi=PPI).decision.match
        assert gallery.identify(prints["bob again"], resolution_ppi=PPI).decision.match


def test_a_file_that_is_gone_is_not_searched(prints, tmp_path):
    file = tmp_path / "people.skg"
    splitknit_match.enroll(file, prints["ann"], "ann", "right_index", resolution_ppi=PPI)
    with splitknit_match.Gallery(file) as gallery:
        file.rename(tmp_path / "away")
        for call in (
            lambda: gallery.identify(prints["ann again"], resolution_ppi=PPI),
            lambda: gallery.enroll(prints["bob"], "bob", "right_index", resolution_ppi=PPI),
            lambda: len(gallery),
        ):
            with bad_input("is gone"):
                call()
        assert not file.exists()
        (tmp_path / "away").rename(file)
        assert gallery.identify(prints["ann again"], resolution_ppi=PPI).decision.match


@pytest.mark.slow
@pytest.mark.parametrize("duplicates", ["refuse", "warn"])
def test_one_finger_under_two_names_at_once(prints, tmp_path, duplicates):
    """Whoever comes first: of several who look at the same time one is enrolled, and the others
    hear of it."""
    template = splitknit_match.make_template(prints["ann"], resolution_ppi=PPI).payload
    told = []

    def enrol(gallery, name):
        start.wait()
        try:
            told.append(
                len(gallery.enroll(template, name, "right_index", duplicates=duplicates).alike)
            )
        except BadInput as error:
            told.append(str(error))

    for trial in range(3):
        with splitknit_match.Gallery(tmp_path / f"{trial}.skg") as gallery:
            if trial > 0:
                gallery.enroll(prints["bob"], "bob", "left_thumb", resolution_ppi=PPI)
            told.clear()
            start = threading.Barrier(3)
            threads = [
                threading.Thread(target=enrol, args=(gallery, name))
                for name in ("eve", "ivy", "kim")
            ]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()
            if duplicates == "warn":
                assert sorted(told, key=str) == [0, 1, 2], told
            else:
                assert (
                    told.count(0) == 1
                    and sum("of another person" in str(answer) for answer in told) == 2
                ), told
                assert len(gallery) == (1 if trial == 0 else 2)


def test_what_is_put_down_comes_before_the_finger(prints, tmp_path):
    file, seen = tmp_path / "people.skg", list[int]()
    splitknit_match.enroll(file, prints["bob"], "bob", "right_index", resolution_ppi=PPI)

    def refuse():
        raise BadInput("no line, no finger.")

    with splitknit_match.Gallery(file) as gallery, splitknit_match.Gallery(file) as another:
        with bad_input("no line"):
            gallery.enroll(prints["ann"], "ann", "right_index", resolution_ppi=PPI, put_down=refuse)
        assert len(gallery) == 1
        gallery.enroll(
            prints["ann"],
            "ann",
            "right_index",
            resolution_ppi=PPI,
            put_down=lambda: seen.append(len(another)),
        )
        assert (seen, len(another)) == ([1], 2)


@pytest.mark.slow
def test_threads_and_forks_share_it(prints, tmp_path):
    with splitknit_match.Gallery(tmp_path / "g.skg") as gallery:
        for name in ("ann", "bob"):
            gallery.enroll(prints[name], name, "right_index", resolution_ppi=PPI)
        probe = splitknit_match.make_template(prints["bob again"], resolution_ppi=PPI).payload
        expected = [
            (candidate.person, candidate.similarity)
            for candidate in gallery.identify(probe).candidates
        ]
        answers = []

        def ask():
            answers.append(
                [
                    (candidate.person, candidate.similarity)
                    for candidate in gallery.identify(probe).candidates
                ]
            )

        threads = [threading.Thread(target=ask) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert answers == [expected] * 4
        if hasattr(os, "fork"):
            child = os.fork()
            if child == 0:
                same = [
                    (candidate.person, candidate.similarity)
                    for candidate in gallery.identify(probe).candidates
                ] == expected
                os._exit(0 if same else 1)
            assert os.waitpid(child, 0)[1] == 0
        assert [
            (candidate.person, candidate.similarity)
            for candidate in gallery.identify(probe).candidates
        ] == expected


@pytest.mark.slow
def test_one_finger_under_two_names(prints, tmp_path):
    file = tmp_path / "g.skg"
    splitknit_match.enroll(file, prints["ann"], "ann", "right_index", resolution_ppi=PPI)
    with bad_input("matches right index of another person, 'ann'"):
        splitknit_match.enroll(
            file, prints["ann again"], "eve", "left_thumb", resolution_ppi=PPI, duplicates="refuse"
        )
    assert len(splitknit_match.Gallery(file)) == 1
    told = splitknit_match.enroll(
        file, prints["ann again"], "eve", "left_thumb", resolution_ppi=PPI
    )
    assert [duplicate.person for duplicate in told.alike] == ["ann"]
    quiet = splitknit_match.enroll(
        file, press(1, 3), "ivy", "left_thumb", resolution_ppi=PPI, duplicates="allow"
    )
    assert quiet.alike == () and quiet.content.captures == 3
    same = splitknit_match.enroll(file, press(1, -3), "ivy", "left_thumb", resolution_ppi=PPI)
    assert {duplicate.person for duplicate in same.alike} == {"ann", "eve"}
    with bad_input("one of refuse, warn, allow"):
        splitknit_match.enroll(
            file, prints["ann"], "x", "left_thumb", resolution_ppi=PPI, duplicates="maybe"
        )


@pytest.mark.slow
def test_a_small_print_asks_for_another_impression(prints, tmp_path):
    whole = splitknit_match.enroll(
        tmp_path / "g.skg", prints["ann"], "Ann", "right_index", resolution_ppi=500
    )
    part = prints["bob"][150:270, 120:240]
    small = splitknit_match.enroll(
        tmp_path / "g.skg", part, "Bob", "right_index", resolution_ppi=500
    )
    assert whole.enrolled[0].chance > 0.9
    assert small.enrolled[0].chance < 0.5
    assert [finding.code for finding in whole.findings] == []
    assert "enrol another impression" in str(small.findings[0])
