"""Fixtures of the simulator."""

from twin_fixtures import *
