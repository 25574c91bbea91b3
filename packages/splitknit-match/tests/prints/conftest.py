"""Fixtures of the folder."""

from prints_fixtures import *
