"""Photographs of a flat surface, which even out lights of unknown fall-off."""

import cv2
import numpy as np

from refusals import bad_input
from splitknit.observation.plain import read_flat


def test_flat_photographs_of_different_sizes_are_refused(tmp_path):
    for k, side in enumerate((200, 260, 200)):
        cv2.imwrite(str(tmp_path / f"{k}.png"), np.full((side, side), 180, np.uint8))
    with bad_input("differ in size"):
        read_flat(tmp_path, 3, "linear")
    cv2.imwrite(str(tmp_path / "1.png"), np.full((200, 200), 180, np.uint8))
    assert len(read_flat(tmp_path, 3, "linear")[0]) == 3
