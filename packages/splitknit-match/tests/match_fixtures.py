"""Enrolled people, and NFIQ 2 and the ridges of prints, computed once for all tests."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import enrolled
from splitknit_match.prints import from_file, minutiae
from splitknit_match.prints.pressed import pressed_ridges


def once(function: Callable[..., Any]) -> Callable[..., Any]:
    """Remember the results of a function of a print; test_minutiae.py tests that they repeat."""
    results: dict[bytes, Any] = {}

    @wraps(function)
    def called(image: np.ndarray, *arguments: float) -> Any:
        key = sha256(repr((image.shape, arguments)).encode() + image.tobytes()).digest()
        if key not in results:
            results[key] = function(image, *arguments)
        return results[key]

    return called


minutiae.nfiq2 = once(minutiae.nfiq2)
minutiae.pressed_ridges = from_file.pressed_ridges = once(pressed_ridges)


@pytest.fixture(scope="session")
def people_folder(tmp_path_factory) -> Path:
    """Two people, three fingers, two sessions as result folders; not to be changed."""
    return enrolled.people(tmp_path_factory.mktemp("people"))
