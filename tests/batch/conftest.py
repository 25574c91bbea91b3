"""Fixtures of the folder."""

from batch_fixtures import *
