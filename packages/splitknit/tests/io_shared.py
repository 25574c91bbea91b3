"""What the tests of `io` share."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from splitknit.model import Capture

Build = Callable[..., Capture]


def edit(file: Path, change: Callable[[Any], None]) -> None:
    """Change a JSON file."""
    document = json.loads(file.read_text())
    change(document)
    file.write_text(json.dumps(document))
