"""Fuzzers of everything that reads files. Samples are made by what the members' tests share."""

import sys
from pathlib import Path

PACKAGES = Path(__file__).resolve().parents[2] / "packages"
sys.path += map(str, PACKAGES.glob("*/tests"))
