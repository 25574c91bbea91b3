"""Fixtures of the folder."""

from capture_fixtures import *
