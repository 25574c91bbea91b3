"""Enrolled people, and what prints are asked for again and again, computed once for all tests."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import enrolled
from splitknit_match.matching import methods
from splitknit_match.prints import from_file, minutiae
from splitknit_match.prints.pressed import pressed_ridges


def once(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function of a print, the same at every call (test_minutiae.py), which so is called once for
    all tests."""
    kept: dict[bytes, Any] = {}

    @wraps(function)
    def called(image: np.ndarray, *others: float) -> Any:
        key = sha256(repr((image.shape, others)).encode() + image.tobytes()).digest()
        if key not in kept:
            kept[key] = function(image, *others)
        return kept[key]

    return called


minutiae.nfiq2 = methods.nfiq2 = once(minutiae.nfiq2)
minutiae.pressed_ridges = from_file.pressed_ridges = once(pressed_ridges)


@pytest.fixture(scope="session")
def people_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Enrolment of two people, three fingers, two sessions, as result folders; not to be
    changed."""
    return enrolled.people(tmp_path_factory.mktemp("people"))
