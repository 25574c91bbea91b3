"""Fixtures of the folder."""

from matching_fixtures import *
