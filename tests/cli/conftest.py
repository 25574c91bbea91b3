"""Enrolled people, made once."""

from __future__ import annotations

from pathlib import Path

import pytest

from enrolled import people


@pytest.fixture(scope="session")
def people_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Enrolment of two people, three fingers, two sessions, as result folders; not to be changed."""
    return people(tmp_path_factory.mktemp("people"))
