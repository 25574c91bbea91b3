"""Measuring a rig: its camera, its lights, its sensor."""

from splitknit.calibrate.board import Board, BoardSettings, find_board, size_in_view

__all__ = ["Board", "BoardSettings", "find_board", "size_in_view"]
