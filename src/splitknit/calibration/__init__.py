"""Measuring a rig: its camera, its lights, its sensor."""

from splitknit.calibration.board import Board, BoardSettings, find_board, size_in_view
from splitknit.calibration.camera import CameraCalibration, CameraSettings, calibrate_camera
from splitknit.calibration.disc import find_disc
from splitknit.calibration.plane import PlanePose, plane_pose

__all__ = [
    "Board",
    "BoardSettings",
    "CameraCalibration",
    "CameraSettings",
    "PlanePose",
    "calibrate_camera",
    "find_board",
    "find_disc",
    "plane_pose",
    "size_in_view",
]
