"""Fixtures of the folder."""

from io_fixtures import *
