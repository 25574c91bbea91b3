"""Calibration of a rig from the command line: photographs and tables in, rig files out."""
