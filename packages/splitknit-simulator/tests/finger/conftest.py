"""Fixtures of the folder."""

from drawn_fingers import *
