"""Packages that only the batch engine needs, imported when it needs them."""

from __future__ import annotations

import importlib
from typing import Any

from splitknit.errors import BadInput


def load(module: str, extra: str) -> Any:
    """Import `module`, which comes with the extra `extra`.

    Raises
    ------
    BadInput
        If it is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        package = module.partition(".")[0]
        raise BadInput(
            f"this needs {package}, which cannot be imported ({error}); pip install 'splitknit[{extra}]'."
        ) from error
