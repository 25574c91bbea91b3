"""splitknit: metric 3D fingerprints from one camera.

The surface of the package is imported when it is first used, so that ``import splitknit`` is quick.
"""

from __future__ import annotations

from splitknit.hooks import RESULT_HOOKS

TYPE_CHECKING = False  # as typing's, whose import would take longer than all the rest of the command line's start
if TYPE_CHECKING:
    from typing import Any

    from splitknit.api import calibrate_camera as calibrate_camera
    from splitknit.api import calibrate_lights as calibrate_lights
    from splitknit.api import calibrate_radiometry as calibrate_radiometry
    from splitknit.api import evaluate as evaluate
    from splitknit.api import identify as identify
    from splitknit.api import make_print as make_print
    from splitknit.api import match as match
    from splitknit.api import read_photographs as read_photographs
    from splitknit.errors import BadInput as BadInput
    from splitknit.evaluation.accuracy import compare as compare
    from splitknit.evaluation.pair import compare_results as compare_results
    from splitknit.io.capture import read_capture as read_capture
    from splitknit.io.capture import write_capture as write_capture
    from splitknit.io.results import read_result as read_result
    from splitknit.io.rig import read_rig as read_rig
    from splitknit.io.rig import write_rig as write_rig
    from splitknit.model import Band as Band
    from splitknit.model import Camera as Camera
    from splitknit.model import Capture as Capture
    from splitknit.model import Led as Led
    from splitknit.model import Mirror as Mirror
    from splitknit.model import Reconstruction as Reconstruction
    from splitknit.model import Rig as Rig
    from splitknit.pipeline import reconstruct as reconstruct
    from splitknit.presets import preset_settings as preset_settings
    from splitknit.simulator.twin import simulate_capture as simulate_capture

    __version__: str

_HOMES = {
    "api": (
        "read_photographs",
        "make_print",
        "match",
        "identify",
        "evaluate",
        "calibrate_camera",
        "calibrate_lights",
        "calibrate_radiometry",
    ),
    "io.capture": ("read_capture", "write_capture"),
    "io.results": ("read_result",),
    "io.rig": ("read_rig", "write_rig"),
    "pipeline": ("reconstruct",),
    "presets": ("preset_settings",),
    "simulator.twin": ("simulate_capture",),
    "evaluation.accuracy": ("compare",),
    "evaluation.pair": ("compare_results",),
    "model": ("Band", "Camera", "Capture", "Led", "Mirror", "Reconstruction", "Rig"),
    "errors": ("BadInput",),
}
"""Module of every public name, in the order in which a user needs them."""
_MODULE_OF = {name: module for module, names in _HOMES.items() for name in names}

__all__ = [*_MODULE_OF, "__version__"]  # noqa: PLE0604 - texts all of them


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib import metadata

        return metadata.version("splitknit")
    module = _MODULE_OF.get(name)
    if module is None:
        raise AttributeError(f"module 'splitknit' has no attribute {name!r}")
    import importlib

    value = getattr(importlib.import_module(f"splitknit.{module}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)


def _save(*given: Any) -> None:
    from splitknit.report.result import write_results

    write_results(*given)


def _plot(*given: Any) -> Any:
    from splitknit.report.plot import plot

    return plot(*given)


def _show(*given: Any) -> str:
    from splitknit.viewer.server import show

    return show(*given)


def _preview(*given: Any) -> str:
    from splitknit.report.result import preview_html

    return preview_html(*given)


RESULT_HOOKS.update(save=_save, plot=_plot, show=_show, preview=_preview)
