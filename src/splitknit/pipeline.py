"""From a capture to a metric fingerprint: one line a stage, and the presets.

`ea`, `pr` and `snk` are the thesis's three cases; `metric` is the default. Every choice is a field of a frozen settings
dataclass, so that an experiment changes one thing at a time.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

from splitknit.errors import BadInput, require
from splitknit.model import Capture, Reconstruction
from splitknit.recipe.coloured import as_lit
from splitknit.recipe.finger import finger_key
from splitknit.recipe.memory import Memory
from splitknit.recipe.mirrors import on_mirror_shape, seen_in_mirrors
from splitknit.recipe.presets import PRESETS, PipelineSettings
from splitknit.recipe.rays import as_modelled
from splitknit.recipe.result import assemble
from splitknit.recipe.settings_document import settings_document
from splitknit.recipe.skin import metric_skin
from splitknit.recipe.steady import find_steady_finger
from splitknit.recipe.stopwatch import Stopwatch
from splitknit.recipe.surfaces import metric_opaque, thesis
from splitknit.settings import override

__all__ = ["PRESETS", "PipelineSettings", "preset_settings", "reconstruct"]


def preset_settings(preset: str) -> PipelineSettings:
    """Settings of a preset.

    Parameters
    ----------
    preset : ``metric``, ``snk``, ``pr``, ``ea``, ``kumar``, ``zheng``, ``lin`` or ``xie``

    Returns
    -------
    PipelineSettings
        Frozen; :func:`splitknit.settings.override` gives changed ones.

    Raises
    ------
    BadInput
        If there is no such preset.
    """
    if preset not in PRESETS:
        raise BadInput(f"there is no preset '{preset}'; known are {', '.join(PRESETS)}.")
    return PRESETS[preset]


def reconstruct(
    capture: Capture,
    preset: str = "metric",
    settings: Mapping[str, Any] | PipelineSettings | None = None,
    progress: Callable[[str, float], None] | None = None,
    *,
    memory: Memory | None = None,
) -> Reconstruction:
    """Reconstruct one finger.

    Parameters
    ----------
    capture : Capture
        From :func:`splitknit.read_capture` or a simulator.
    preset : a name of :data:`PRESETS`
    settings : mapping from ``stage.field`` to a value (or nested mappings), or whole settings, optional
        Changes to the preset.
    progress : called with the name of the stage and the share done, optional
    memory : what several cases of this very capture share, optional
        Saves time; changes nothing.

    Returns
    -------
    Reconstruction
        On the input's pixel grid.

    Raises
    ------
    BadInput
        If the capture shows no finger, lacks a band, a setting is not known, or the memory is another capture's.

    References
    ----------
    A. Srivastava, "Split and Knit Algorithm for 3D fingerprint reconstruction using Single Camera", chapter 3.
    """
    chosen = settings if isinstance(settings, PipelineSettings) else override(preset_settings(preset), settings or {})
    require("white" in capture.bands, "the capture has no band 'white'; every reconstruction needs it.")
    memory = Memory(capture) if memory is None else memory
    memory.check(capture)
    capture, notes = as_lit(as_modelled(capture, chosen), chosen)
    watch = Stopwatch(progress)
    capture, finger = memory(finger_key(chosen), partial(find_steady_finger, capture, chosen, watch))
    mirrors = None
    if chosen.shape.source == "mirror":
        with watch("finger"):
            mirrors = seen_in_mirrors(capture, chosen)
    if chosen.method == "thesis":
        surface = thesis(capture, finger, chosen, watch, memory)
    elif undoes_blur(capture, chosen):
        require(
            not capture.bands["white"].colours,
            "the skin blurs the light of each coloured LED differently, which this preset does not undo; use lin, ea "
            "or another of the published cases.",
        )
        surface = metric_skin(capture, finger, chosen, watch)
    else:
        surface = metric_opaque(capture, finger, chosen, watch)
    if mirrors is not None:
        finger, surface = on_mirror_shape(finger, surface, mirrors, chosen)
    with watch("result"):
        result = assemble(capture, finger, surface, chosen)
    return replace(
        result,
        preset=preset,
        settings=settings_document(chosen),
        hashes=capture.hashes,
        warnings=(*notes, *finger.warnings, *surface.warnings),
        timings_s=watch.seconds,
    )


def undoes_blur(capture: Capture, settings: PipelineSettings) -> bool:
    """Whether subsurface scattering is undone: as the settings say, else where the capture's material is skin."""
    wanted = settings.skin.invert_blur
    return capture.material == "skin" if wanted is None else wanted
