"""Fixtures of the simulator, and of enrolled people."""

from match_fixtures import *
from twin_fixtures import *
