import importlib
import os
import pickle
from pathlib import Path

import numpy as np
import pytest

from refusals import bad_input
from splitknit.checks import check_image, check_lights, check_mask, check_stack
from splitknit.errors import BadInput, importing, refusing, require
from splitknit.files import read_bytes

RING = np.array([[np.cos(a), np.sin(a), 2.0] for a in 2 * np.pi * np.arange(5) / 5])


def test_bad_input_is_a_value_error():
    require(True, "never seen")
    with pytest.raises(ValueError, match="this is why"):
        require(False, "this is why")


def test_a_stack_is_checked_for_shape_count_and_finite_values():
    stack = check_stack(np.ones((3, 4, 5), dtype=np.uint8), least=3)
    assert stack.dtype == np.float32
    for bad, words in (
        (np.ones((4, 5)), r"\(4, 5\)"),
        (np.ones((2, 4, 5)), "at least 3"),
        (np.ones((3, 0, 5)), "empty"),
        (np.full((3, 4, 5), np.inf), "infinite"),
    ):
        with bad_input(words):
            check_stack(bad, least=3)


def test_an_image_is_checked_for_shape_and_finite_values():
    assert check_image([[1, 2], [3, 4]]).dtype == np.float32
    for bad in (np.ones(4), np.ones((0, 4)), np.array([[1.0, np.nan]])):
        with bad_input("the picture"):
            check_image(bad, name="the picture")


def test_a_mask_is_checked_for_shape_and_content():
    assert check_mask(None, (2, 3)).all()
    np.testing.assert_array_equal(check_mask([[0, 2]], (1, 2)), [[False, True]])
    with bad_input("shape"):
        check_mask(np.ones((2, 2)), (2, 3))
    with bad_input("empty"):
        check_mask(np.zeros((2, 3)), (2, 3))


def test_lights_keep_their_length():
    strong = RING * np.array([[1], [2], [3], [4], [5]])
    np.testing.assert_array_equal(check_lights(strong, 5), strong)


@pytest.mark.parametrize(
    ("lights", "words"),
    [
        (RING[:, :2], r"\(L, 3\)"),
        (RING[:2], "at least 3"),
        (np.where(np.eye(5, 3), np.nan, RING), "NaN"),
        (RING * np.array([[1], [0], [1], [1], [1]]), r"zero vector \(light 1\)"),
        (np.vstack([RING, 3 * RING[2]]), "2 and 5 have the same direction"),
        (np.column_stack([np.arange(-2.0, 3.0), np.zeros(5), np.ones(5)]), "coplanar"),
        (np.column_stack([np.arange(-2.0, 3.0), [0.01, 0, 0.02, 0, 0.01], np.ones(5)]), "coplanar"),
    ],
)
def test_lights_that_determine_no_normal_are_refused(lights, words):
    with bad_input(words):
        check_lights(lights)


def test_lights_must_match_the_images():
    with bad_input("5 lights for 7 images"):
        check_lights(RING, 7)


def test_lights_just_off_a_common_plane_are_accepted():
    """Directions 2 deg about one: all near a line, but not in a plane."""
    angles = 2 * np.pi * np.arange(3) / 3
    lights = np.column_stack([0.035 * np.cos(angles), 0.035 * np.sin(angles), np.ones(3)])
    assert len(check_lights(lights)) == 3


def test_only_whole_regular_files_of_the_budget_are_read(tmp_path):
    (tmp_path / "a").write_bytes(b"12345")
    assert read_bytes(tmp_path / "a", 5) == b"12345"
    os.mkfifo(tmp_path / "pipe")
    for path, words in (
        (tmp_path / "a", "too large: 5 bytes"),
        (tmp_path / "pipe", "is not a file"),
        (tmp_path, "is not a file"),
        ("/dev/zero", "is not a file"),
        (tmp_path / "none", "does not exist"),
        (tmp_path / "a" / "b", "cannot be read"),
        ("a\0b", "cannot be read"),
        ("/proc/self/maps", "too large: more than 4 bytes"),
    ):
        with bad_input(words):
            read_bytes(path, 4)


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="open files cannot be listed")
def test_a_refused_folder_is_closed(tmp_path):
    before = len(list(Path("/proc/self/fd").iterdir()))
    for _ in range(5):
        with bad_input("is not a file"):
            read_bytes(tmp_path, 4)
    assert len(list(Path("/proc/self/fd").iterdir())) == before


@pytest.mark.parametrize(
    ("raised", "expected"),
    [
        (KeyError("x"), BadInput),
        (RecursionError(), BadInput),
        (MemoryError(), MemoryError),
        (BadInput("x"), BadInput),
    ],
)
def test_parser_errors_become_one_refusal_but_lack_of_memory_does_not(raised, expected):
    with pytest.raises(expected) as caught, refusing("the table is damaged."):
        raise raised
    assert str(caught.value) == (
        "the table is damaged." if type(caught.value) is not type(raised) else str(raised)
    )


def test_refusals_are_one_printable_line_whatever_they_quote():
    error = BadInput("'a\nb\x1b[2J\ud800\u2028é' is no name")
    assert str(error) == r"'a\nb\x1b[2J\ud800\u2028é' is no name"
    assert str(pickle.loads(pickle.dumps(error))) == str(error)
    assert len(str(BadInput("x" * 10**6))) < 2100
    with bad_input("NaN or infinite"):
        check_lights([[1e200, 0, 1], [0, 1, 1], [-1, 0, 1]])


def test_a_missing_package_is_refused_whatever_the_file_is_called():
    words = r"a\{b\}\.exr needs a package: install it \(No module"
    with pytest.raises(BadInput, match=words), importing("a{b}.exr needs a package: install it."):
        importlib.import_module("splitknit.no_such_module")
