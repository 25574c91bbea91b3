"""The state of a training as bytes: read back, and refused where it belongs to another training."""

from __future__ import annotations

import io
from collections.abc import Collection, Mapping
from typing import Any

from splitknit.errors import refusing, require

NEEDED = ("settings", "curve", "network", "optimiser")


def packed_state(torch: Any, state: Mapping[str, Any]) -> bytes:
    """`state` as torch writes it."""
    buffer = io.BytesIO()
    torch.save(dict(state), buffer)
    return buffer.getvalue()


def opened_state(torch: Any, state: bytes, device: Any, settings: Mapping[str, Any], free: Collection[str]) -> Any:
    """Document that :func:`packed_state` wrote.

    Parameters
    ----------
    torch : the module
    state : what was written
    device : where its tensors go
    settings : of the training that is to go on
    free : names of settings that may have changed on the way

    Raises
    ------
    BadInput
        If it is damaged or of a training with other settings.
    """
    with refusing("the checkpoint is damaged; train anew in another folder."):
        document = torch.load(io.BytesIO(state), map_location=device, weights_only=True)
        theirs, *_ = (document[name] for name in NEEDED)
        changed = [name for name in settings if name not in free and theirs.get(name) != settings[name]]
    require(
        not changed,
        f"the checkpoint is of a training with other settings ({', '.join(changed)}); "
        "resume with the same settings or train in another folder.",
    )
    return document
