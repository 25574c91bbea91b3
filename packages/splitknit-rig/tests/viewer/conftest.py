"""Fixtures of the folder."""

from viewer_fixtures import *
