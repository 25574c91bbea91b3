"""Measuring a rig: its camera, its lights, its sensor."""

from splitknit.calibration.camera import CameraCalibration, CameraSettings, calibrate_camera
from splitknit.calibration.plane import PlanePose, plane_pose
from splitknit.calibration.targets import Board, find_board, find_disc, size_in_view

__all__ = [
    "Board",
    "CameraCalibration",
    "CameraSettings",
    "PlanePose",
    "calibrate_camera",
    "find_board",
    "find_disc",
    "plane_pose",
    "size_in_view",
]
