"""Fixtures of the folder."""

from cli_fixtures import *
