"""``training/patterns.py``: a folder in, a folder out, one sentence where it cannot."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from checkerboards import checkerboard_patterns
from splitknit.io.images import read_image, write_image
from written_files import read_light_tiff

sys.path.append(str(Path(__file__).resolve().parents[2] / "training"))

from patterns import main

SIZE = (40, 50)
ROWS, COLUMNS = np.mgrid[: SIZE[0], : SIZE[1]]
DIRECT = 0.2 * (1 + 0.3 * np.sin(ROWS / 9))
GLOBAL = 0.4 + 0.1 * np.cos(COLUMNS / 17)
STEP = 1 / 65535
SHIFTS = [(2 * i, 2 * j) for i in range(5) for j in range(5)]


def stored(light, full=65535):
    return np.round(np.clip(light, 0, 1) * full).astype(np.uint16 if full > 255 else np.uint8)


def write(folder, images):
    folder.mkdir(exist_ok=True)
    for name, light in images.items():
        write_image(folder / name, stored(light))
    return folder


@pytest.fixture
def boards(tmp_path):
    """25 shifted checkerboards over a black level, with a white image, named by their shifts."""
    patterns = checkerboard_patterns(SIZE, 5, SHIFTS)
    images = {
        f"board_{i}_{j}.png": p * DIRECT + 0.5 * GLOBAL + 0.03
        for (i, j), p in zip(SHIFTS, patterns, strict=True)
    }
    images["black.png"] = np.full(SIZE, 0.03)
    images["white.png"] = DIRECT + GLOBAL + 0.03
    return write(tmp_path / "boards", images)


def run(*words):
    return main(list(map(str, words)))


def refusal(capsys, out, *words):
    """Return the one sentence with which a run is refused; nothing is left behind."""
    before = sorted(out.parent.iterdir())
    assert run(*words, "--out", out) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("patterns.py: error: ")
    assert printed.err.count("\n") == 1
    assert sorted(out.parent.iterdir()) == before
    return printed.err


def test_checkerboards_of_a_folder_give_direct_and_global_light(boards, tmp_path, capsys):
    out = tmp_path / "out"
    assert run(boards, "--out", out) == 0
    facts = json.loads((out / "report.json").read_text())
    direct, metadata = read_light_tiff(out / "direct.tiff")
    global_, _ = read_light_tiff(out / "global.tiff")
    assert np.abs(direct - DIRECT).max() < 3 * STEP
    assert np.abs(global_ - GLOBAL).max() < 4 * STEP
    assert len(facts["images"]) == 25
    assert "black.png" in facts["inputs"]
    assert metadata["inputs"] == facts["inputs"]
    assert facts["notes"] == []
    written = sorted(path.name for path in out.iterdir() if path.name[0] != ".")
    assert written == ["direct.png", "direct.tiff", "global.png", "global.tiff", "report.json"]
    assert facts["direct_share"] == pytest.approx(np.median(DIRECT / (DIRECT + GLOBAL)), 0.02)
    preview = read_image(out / "direct.png")
    assert preview.shape == (*SIZE, 1)
    assert preview.max() == 255
    first = {name: (out / name).read_bytes() for name in written if name != "report.json"}
    assert run(boards, "--out", out) == 0  # ours may be replaced; same input, same bytes
    assert {name: (out / name).read_bytes() for name in first} == first
    assert "direct in the median" in capsys.readouterr().out


def test_patterns_are_estimated_or_read_and_a_mask_is_respected(boards, tmp_path):
    patterns = checkerboard_patterns(SIZE, 5, SHIFTS)
    states = write(tmp_path / "states", {f"s_{k:02}.png": p for k, p in enumerate(patterns)})
    mask = np.zeros(SIZE)
    mask[5:30, 8:40] = 1
    write_image(boards / "mask.png", stored(mask))
    for choice, kind in ((states, "given"), ("estimate", "estimate")):
        out = tmp_path / f"out_{kind}"
        assert run(boards, "--out", out, "--patterns", choice) == 0
        direct, metadata = read_light_tiff(out / "direct.tiff")
        assert np.array_equal(np.isnan(direct), mask == 0)
        assert np.nanmax(np.abs(direct - DIRECT)) < 3 * STEP
        assert metadata["settings"]["separate"]["patterns"] == kind


def test_known_states_need_the_size_of_checks_for_skin(boards, tmp_path, capsys):
    """Skin is where it matters, and what is in the images the verb cannot know; the size alone is
    enough for it."""
    written = {}
    for number, words in enumerate((("--patterns", "estimate"), ("--check-px", 5))):
        out = tmp_path / f"out_{number}"
        assert run(boards, *words, "--out", out) == 0
        facts = json.loads((out / "report.json").read_text())
        assert ("give --check-px for skin" in capsys.readouterr().out) == (
            "--check-px" not in words
        )
        assert facts["settings"]["separate"]["patterns"] == "estimate"
        written[number] = read_light_tiff(out / "direct.tiff")[0]
        assert np.abs(written[number] - DIRECT).max() < 4 * STEP
    assert not np.array_equal(written[0], written[1])
    assert "5 pixels or more" in refusal(capsys, tmp_path / "x", boards, "--check-px", 4)


def test_negative_global_light_gets_a_note(boards, tmp_path, capsys):
    assert run(boards, "--dark", 0.8, "--out", tmp_path / "out") == 0
    assert "global light is negative" in capsys.readouterr().out


def test_refusals_of_a_stack_name_the_file(boards, tmp_path, capsys):
    out, board = tmp_path / "out", boards / "board_0_4.png"
    good = board.read_bytes()
    write_image(board, stored(np.full(SIZE, 0.03)))
    assert "image 2 (board_0_4.png) is black" in refusal(capsys, out, boards)
    write_image(board, stored(np.full((40, 51), 0.3)))
    assert "board_0_4.png has 40 x 51 pixels" in refusal(capsys, out, boards)
    board.write_bytes(good[: len(good) // 2])
    assert "board_0_4.png" in refusal(capsys, out, boards)
    board.write_bytes(good)
    write_image(boards / "board_2_0.png", stored(np.full(SIZE, 1.0)))
    assert "saturated" in refusal(capsys, out, boards)
    assert "alpha must lie" in refusal(capsys, out, boards, "--alpha", 0)
    assert "not a folder of patterns" in refusal(
        capsys, out, boards, "--patterns", tmp_path / "none"
    )
    assert "not a folder" in refusal(capsys, out, tmp_path / "none")
    (tmp_path / "empty").mkdir()
    assert "holds no PNG, TIFF or JPEG" in refusal(capsys, out, tmp_path / "empty")
    assert "holds the input itself" in refusal(capsys, boards, boards)
