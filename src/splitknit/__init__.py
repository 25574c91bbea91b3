"""splitknit: metric 3D fingerprints from one camera.

The surface of the package is imported when it is first used, so that ``import splitknit`` is quick.
"""

from __future__ import annotations

TYPE_CHECKING = False  # as typing's, whose import would take longer than all the rest of the command line's start
if TYPE_CHECKING:
    from typing import Any

    from splitknit.errors import BadInput as BadInput
    from splitknit.io import read_capture as read_capture
    from splitknit.io import write_capture as write_capture
    from splitknit.model import Camera as Camera
    from splitknit.model import Capture as Capture
    from splitknit.model import Led as Led
    from splitknit.model import Reconstruction as Reconstruction
    from splitknit.model import Rig as Rig

    __version__: str
    from splitknit.pipeline import preset_settings as preset_settings
    from splitknit.pipeline import reconstruct as reconstruct
    from splitknit.simulator.twin import simulate_capture as simulate_capture

_HOMES = {
    "BadInput": "splitknit.errors",
    "Camera": "splitknit.model",
    "Capture": "splitknit.model",
    "Led": "splitknit.model",
    "Reconstruction": "splitknit.model",
    "Rig": "splitknit.model",
    "preset_settings": "splitknit.pipeline",
    "read_capture": "splitknit.io",
    "reconstruct": "splitknit.pipeline",
    "simulate_capture": "splitknit.simulator.twin",
    "write_capture": "splitknit.io",
}

__all__ = [  # noqa: RUF022 - what a user needs first comes first
    "read_capture",
    "reconstruct",
    "write_capture",
    "simulate_capture",
    "preset_settings",
    "BadInput",
    "Camera",
    "Capture",
    "Led",
    "Reconstruction",
    "Rig",
    "__version__",
]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib import metadata  # noqa: PLC0415

        return metadata.version("splitknit")
    home = _HOMES.get(name)
    if home is None:
        raise AttributeError(f"module 'splitknit' has no attribute {name!r}")
    import importlib  # noqa: PLC0415

    value = getattr(importlib.import_module(home), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES})
