"""Fixtures of the folder."""

from report_fixtures import *
