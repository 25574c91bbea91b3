"""Training of the relief network, which separates relief from specular reflection for the `metric` method.

What photometric stereo leaves of the light of skin is split by how it turns with the light's azimuth
(:mod:`splitknit.skin.learned`); the network learns on simulated fingers what of it is relief and what is specular
reflection (here: glare).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from splitknit import RELIEF_MM, RELIEF_SYMMETRY, FloatArray, Limits, Symmetry
from splitknit_simulator.training.fields import FIELDS, FieldsSettings, FieldsTask, Run, Sample
from splitknit_simulator.training.relief_data import (
    CHANNELS,
    GLARE,
    RELIEF,
    WEIGHT,
    ReliefData,
    training_crops,
    training_sample,
)
from splitknit_simulator.training.trainer import NetworkKind, files_of
from splitknit_simulator.training.trainer import Sample as Stored

NETWORK = NetworkKind(
    "relief",
    "relief and glare of skin: the fields of splitknit.skin.learned to the relief in 0.02 mm, seven "
    "waves of the glare over the light's azimuth in 0.05 of the green level, and the logarithm of the relief's "
    "variance",
    (FIELDS, 9),  # the relief, seven waves of the glare, the logarithm of the relief's variance
)
FILES = files_of(NETWORK.name, "fingers")
PARTS = ("relief", "slope", "likelihood", "glare")
SYMMETRY = Symmetry(
    vectors=(*RELIEF_SYMMETRY.vectors, (34, 35)),
    second_harmonics=(*RELIEF_SYMMETRY.second_harmonics, (36, 37)),
    third_harmonics=(*RELIEF_SYMMETRY.third_harmonics, (38, 39)),
)
"""Symmetry of a sample."""
JUDGED_PX = 512  # side of the middle part of a finger on which the network is evaluated
UNIT_UM = 1000.0 * float(RELIEF_MM)  # unit of the network's relief, micrometres
VARIANCE_LIMITS = (-6.0, 4.0)  # limits of the logarithm of the relief's variance, in the network's unit


@dataclass(frozen=True, slots=True)
class ReliefSettings(FieldsSettings):
    """Network, loss and training.

    The network that ships was trained in three runs, each from the weights of the one before: about 2400 iterations on
    whole fingers alone, then 200 and 4600 on pieces too. The defaults are its numbers, in one run.
    """

    whole_share: Annotated[float, Limits(0, 1)] = 0.2
    """Fraction of the patches that are cut from whole fingers, where there are any; the others are from pieces."""
    slope_share: Annotated[float, Limits(0)] = 1.0
    """Weight of the relief's slopes in the loss, beside its heights with weight one."""
    likelihood_share: Annotated[float, Limits(0)] = 0.2
    """Weight of how well the network knows its own error."""
    glare_share: Annotated[float, Limits(0)] = 0.2
    """Weight of the glare."""

    @property
    def loss_weights(self) -> dict[str, float]:
        """Weights of the loss's parts in their sum."""
        weights = (1.0, self.slope_share, self.likelihood_share, self.glare_share)
        return dict(zip(PARTS, weights, strict=True))


def _relief_losses(made: Any, batch: Any) -> dict[str, Any]:
    """Losses of `made` (B, 9, h, w), means over the pixels that count: ``relief``, squared error of heights; ``slope``,
    of their differences, where ridges outweigh what is wide; ``likelihood``, negative log-likelihood of the error
    (fixed, so that no height gets worse) under the estimated variance; ``glare``, squared error of its waves.
    """
    weight = batch[:, WEIGHT]
    count = weight.sum() + 1.0
    error = made[:, 0] - batch[:, RELIEF]
    along = (error[:, :, 1:] - error[:, :, :-1]) * weight[:, :, 1:]
    down = (error[:, 1:] - error[:, :-1]) * weight[:, 1:]
    logarithm = made[:, 8].clamp(*VARIANCE_LIMITS)
    glare = made[:, 1:8] - batch[:, GLARE]
    return {
        "relief": (error**2 * weight).sum() / count,
        "slope": ((along**2).sum() + (down**2).sum()) / count,
        "likelihood": ((error.detach() ** 2 * (-logarithm).exp() + logarithm) * weight).sum() / count,
        "glare": (glare**2 * weight[:, None]).sum() / count / glare.shape[1],
    }


def _judge_middle(run: Run, sample: Sample, stride: int) -> dict[str, float]:
    """Figures of :func:`_judged` for the middle of a finger, as `run` turns its fields (32, h, w) into (9, h, w)."""
    sides = np.minimum(JUDGED_PX, np.array(sample.shape[1:]) // stride * stride)
    starts = (np.array(sample.shape[1:]) - sides) // 2
    rows, columns = (slice(int(start), int(start + side)) for start, side in zip(starts, sides, strict=True))
    middle = np.asarray(sample[:, rows, columns], dtype=np.float32)
    return _judged(run(middle[:FIELDS]), middle)


def _judged(made: FloatArray, sample: FloatArray) -> dict[str, float]:
    """Figures of a result (9, h, w) against a sample (41, h, w) of weight above 1/2: of the relief ``correlation``,
    ``gain``, ``rms`` error (network's unit), ``error_ratio`` to the expected one; ``glare_r2``, explained power. NaN
    without skin or glare.
    """
    counts = sample[WEIGHT] > 0.5
    if not counts.any():
        return dict.fromkeys(("correlation", "gain", "rms", "error_ratio", "glare_r2"), math.nan)
    drawn, truth = (np.asarray(field[counts], dtype=np.float64) for field in (made[0], sample[RELIEF]))
    power = float((truth**2).mean())
    square = float(((drawn - truth) ** 2).mean())
    expected = float(np.exp(np.clip(made[8][counts], *VARIANCE_LIMITS), dtype=np.float64).mean())
    spread = float(drawn.std() * truth.std())
    glare = np.asarray(sample[GLARE][:, counts], dtype=np.float64)
    missed = float(((made[1:8][:, counts] - glare) ** 2).mean())
    shone = float((glare**2).mean())
    product = float(((drawn - drawn.mean()) * (truth - truth.mean())).mean())
    return {
        "correlation": product / spread if spread > 0 else math.nan,
        "gain": float((drawn * truth).mean()) / power if power > 0 else math.nan,
        "rms": math.sqrt(square),
        "error_ratio": math.sqrt(square / expected),
        "glare_r2": 1.0 - missed / shone if shone > 0 else math.nan,
    }


def _shoot(kind: str, number: int, data: ReliefData) -> Sequence[Stored]:
    if kind == "finger":
        return [training_sample(number, data)]
    pieces = training_crops(number, data)
    return [(pieces, {"finger": number, "pieces": len(pieces)})]


TASK = FieldsTask(
    kind=NETWORK,
    channels=CHANNELS,
    symmetry=SYMMETRY,
    losses=_relief_losses,
    judge=_judge_middle,
    in_units=lambda entry: {**{k: v for k, v in entry.items() if k != "rms"}, "rms_um": UNIT_UM * entry["rms"]},
    held_out=f"; the middle {JUDGED_PX} x {JUDGED_PX} pixels, on the smooth shape they would be trained on",
    lines={
        "training": lambda entry: UNIT_UM * math.sqrt(entry["relief"]),
        "held out": lambda entry: UNIT_UM * entry["held_out_rms"],
    },
    unit="error of the relief, µm",
    min_weight=0.2,
    min_deviation=0.02,
    scale_patches=12,
    shoot=_shoot,
)
