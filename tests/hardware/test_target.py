"""The printed sheet, read back: true to scale, found by the calibration that it is for, the same
bytes each time."""

import numpy as np
import pytest

from hardware.target import (
    CARD_MARGIN_MM,
    POINTS_PER_MM,
    RULER_MM,
    RULER_Y_MM,
    TargetSettings,
    target_pdf,
)
from page_raster import draw, objects_of
from refusals import bad_input
from splitknit.cli.main import main
from splitknit_rig.calibration.targets import Board, find_board

PX_PER_MM = 12.0


@pytest.fixture(scope="module")
def sheet():
    return draw(target_pdf(), PX_PER_MM)


def card(image, settings, across, down):
    """The picture of one card, from the settings' own layout."""
    width, height = settings.card_mm
    count = settings.copies[0]
    free = 210 - count * width
    x = free * (across + 1) / (count + 1) + across * width
    y = RULER_Y_MM - 10 - (down + 1) * height - 3 * down
    columns = slice(round((x + 0.5) * PX_PER_MM), round((x + width - 0.5) * PX_PER_MM))
    return image[
        round((297 - y - height + 0.5) * PX_PER_MM) : round((297 - y - 0.5) * PX_PER_MM), columns
    ]


def test_every_board_is_found_at_true_scale(sheet):
    settings = TargetSettings()
    assert settings.board_mm == (30.0, 21.0)
    across, down = settings.copies
    assert across * down >= 6
    board = Board(9, 6, 3.0)
    for column, row in ((0, 0), (across - 1, down - 1), (1, 1)):
        picture = card(sheet[0], settings, column, row)
        rows, columns = (np.flatnonzero((picture < 128).any(axis=axis)) for axis in (1, 0))
        rims = [
            rows[0],
            picture.shape[0] - 1 - rows[-1],
            columns[0],
            picture.shape[1] - 1 - columns[-1],
        ]
        assert np.abs(np.array(rims) / PX_PER_MM - (CARD_MARGIN_MM - 0.5)).max() < 0.15
        corners = find_board(picture, board)
        assert corners is not None
        sizes = np.linalg.svd(corners - corners.mean(axis=0), compute_uv=False)
        true = np.linalg.svd(board.points_mm - board.points_mm.mean(axis=0), compute_uv=False)
        np.testing.assert_allclose(sizes / true, PX_PER_MM, rtol=5e-4)


def test_the_ruler_is_as_long_as_it_says(sheet):
    image = sheet[0]
    row = image[round((297 - RULER_Y_MM) * PX_PER_MM)]
    dark = np.flatnonzero(row < 128)
    assert len(dark) / PX_PER_MM == pytest.approx(RULER_MM, abs=0.3)
    assert (dark[-1] - dark[0]) == len(dark) - 1


def test_a_folder_or_a_file_is_written(tmp_path, capsys):
    assert main(f"rig target --out {tmp_path}/target".split()) == 0
    assert f"{tmp_path}/target/target.pdf: 16 checkerboards" in capsys.readouterr().out
    assert (tmp_path / "target" / "target.pdf").read_bytes() == target_pdf()
    assert main(f"rig target --out {tmp_path}/target".split()) == 0  # again, in its place
    assert main(f"rig target --out {tmp_path}/sheet.PDF".split()) == 0
    assert (tmp_path / "sheet.PDF").read_bytes() == target_pdf()
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("x")
    assert main(f"rig target --out {tmp_path}/mine".split()) == 2
    assert "not empty and is not an earlier sheet of targets" in capsys.readouterr().err


def test_lines_of_words_and_a_sheet_of_a4(sheet):
    texts = sheet[1]
    assert len(texts) == 13  # and the ruler's numbers
    assert "9 x 6 inner corners, squares 3 mm" in texts[0]
    assert "100 %" in texts[1]
    data = target_pdf()
    assert data.startswith(b"%PDF-1.")
    assert b"/PrintScaling /None" in objects_of(data)[1]
    assert (
        f"[0 0 {210 * POINTS_PER_MM:.4f} {297 * POINTS_PER_MM:.4f}]".replace("0]", "]").encode()
        in data
    )
    assert len(data) < 10_000


def test_same_settings_same_bytes():
    assert target_pdf() == target_pdf(TargetSettings())
    assert target_pdf() != target_pdf(TargetSettings(square_mm=3.1))


def test_other_boards():
    data = target_pdf(TargetSettings(7, 5, 12.0))
    image, texts = draw(data, 4.0)
    assert "7 x 5" in texts[0]
    assert find_board(image[:720], Board(7, 5, 12.0)) is not None
    with bad_input("does not fit on the sheet"):
        TargetSettings(square_mm=30.0)
