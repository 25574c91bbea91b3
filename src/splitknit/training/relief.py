"""Training of the relief network, which separates relief from specular reflection for the `metric` method.

What photometric stereo leaves of the light of skin is split by how it turns with the light's azimuth
(:mod:`splitknit.skin.learned`); the network learns on simulated fingers what of it is relief and what is specular
reflection (here: glare).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Annotated, Any

import numpy as np

from splitknit.errors import require
from splitknit.model import FloatArray
from splitknit.networks.augmentation import Symmetry
from splitknit.settings import Limits
from splitknit.skin.learned import RELIEF_MM, RELIEF_SYMMETRY
from splitknit.training.fields import (
    FIELDS,
    FieldsLoss,
    FieldsSettings,
    FieldsTrainer,
    Sample,
    check_channels,
    mean_figures,
    one_scale,
    patch_at,
    patch_with_skin,
    rounded,
    runner_of,
    stride_of,
    write_fields,
)
from splitknit.training.relief_data import CHANNELS, GLARE, RELIEF, WEIGHT, ReliefData, training_crops, training_sample
from splitknit.training.trainer import (
    HELD_OUT_FROM,
    LearningCurve,
    NetworkKind,
    TrainingRun,
    files_of,
    load_data,
    make_data,
    open_folder,
    require_subjects,
    require_torch,
    train_in_folder,
)
from splitknit.training.trainer import Sample as Stored

NETWORK = NetworkKind(
    "relief",
    "relief and glare of skin: the fields of splitknit.skin.learned to the relief in 0.02 mm, seven "
    "waves of the glare over the light's azimuth in 0.05 of the green level, and the logarithm of the relief's "
    "variance",
)
FILES = files_of(NETWORK.name, "fingers")
PARTS = ("relief", "slope", "likelihood", "glare")
OUTPUTS = 9
"""Of the network: the relief, seven waves of the glare, the logarithm of the relief's variance."""
SYMMETRY = Symmetry(
    vectors=(*RELIEF_SYMMETRY.vectors, (34, 35)),
    second_harmonics=(*RELIEF_SYMMETRY.second_harmonics, (36, 37)),
    third_harmonics=(*RELIEF_SYMMETRY.third_harmonics, (38, 39)),
)
"""Of a sample."""
JUDGED_PX = 512
"""Side of the middle part of a finger on which the network is evaluated."""
UNIT_UM = 1000.0 * float(RELIEF_MM)
"""Unit of the network's relief, micrometres."""
VARIANCE_LIMITS = (-6.0, 4.0)
"""Of the logarithm of the relief's variance, in the network's unit."""
_MIN_WEIGHT = 0.2
"""Patches with a smaller mean weight are not used: they hold next to no skin."""
_MIN_DEVIATION = 0.02
_SCALE_PATCHES = 12


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


def _relief_trainer(settings: ReliefSettings, samples: Sequence[Sample], whole: Sequence[Sample] = ()) -> FieldsTrainer:
    """The network of the relief in training, its first weights from the settings' seed.

    A fraction of the patches (`whole_share`) is cut from the samples `whole`, if there are any.
    """
    check_channels(samples, CHANNELS)
    if len(whole) > 0:
        check_channels(whole, CHANNELS)
    weights = (1.0, settings.slope_share, settings.likelihood_share, settings.glare_share)
    loss = FieldsLoss(
        lambda iteration: _draw_batch(samples, settings, iteration, whole),
        _relief_losses,
        dict(zip(PARTS, weights, strict=True)),
    )
    return FieldsTrainer(settings, OUTPUTS, _field_scale(samples, settings, whole), loss)


def _relief_losses(made: Any, batch: Any) -> dict[str, Any]:
    """The parts of the loss, each a mean over the pixels that count.

    `made`: (B, 9, h, w) torch.Tensor, the network's result; `batch`: (B, 41, h, w) torch.Tensor, samples, see
    :mod:`splitknit.training.relief_data`. Returns dict of torch scalars by the names of :data:`PARTS`: ``relief``, the
    mean squared error of the heights; ``slope``, that of their differences from pixel to pixel, where ridges outweigh
    what is wide; ``likelihood``, the negative logarithm of the likelihood of the error under the estimated variance
    (the error is taken as given here, so that no height is made worse for it); ``glare``, the mean squared error of its
    waves.
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


def _judge_middle(run: Callable[[FloatArray], FloatArray], sample: Sample, stride: int) -> dict[str, float]:
    """Figures of :func:`_judged` for the middle of a finger, as `run` turns its fields (32, h, w) into (9, h, w)."""
    limits = [min(JUDGED_PX, length // stride * stride) for length in sample.shape[1:]]
    require(min(limits) > 0, f"a finger of {sample.shape[1]} x {sample.shape[2]} pixels is too small to be judged.")
    first = [(length - side) // 2 for length, side in zip(sample.shape[1:], limits, strict=True)]
    rows, columns = (slice(start, start + side) for start, side in zip(first, limits, strict=True))
    middle = np.asarray(sample[:, rows, columns], dtype=np.float32)
    return _judged(run(middle[:FIELDS]), middle)


def _judged(made: FloatArray, sample: FloatArray) -> dict[str, float]:
    """Figures of a result (9, h, w) against the truth in a sample (41, h, w), where the weight is above 1/2.

    Returns dict of ``correlation`` of the relief; ``gain``, the slope of result over truth; ``rms``, its error in the
    network's unit; ``error_ratio``, that error over what the network expected of it (one is honest); ``glare_r2``, the
    part of the glare's power that is explained, all waves together. NaN where the sample holds no skin, or no glare.
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


def _draw_patch(
    samples: Sequence[Sample], settings: ReliefSettings, rng: np.random.Generator, whole: Sequence[Sample] = ()
) -> FloatArray:
    """Cut a patch (41, side, side) anywhere in any sample, as it is; zero where a sample is smaller.

    Where there are whole fingers, a fixed fraction of the patches is from them. Raises BadInput if patches with enough
    skin cannot be found.
    """
    side = settings.patch_px

    def cut() -> FloatArray:
        pool = whole if len(whole) > 0 and rng.random() < settings.whole_share else samples
        sample = pool[int(rng.integers(len(pool)))]
        row, column = (int(rng.integers(max(1, length - side))) for length in sample.shape[1:])
        return patch_at(sample, row, column, side)

    return patch_with_skin(cut, side, _MIN_WEIGHT)


def _draw_batch(
    samples: Sequence[Sample], settings: ReliefSettings, iteration: int, whole: Sequence[Sample] = ()
) -> FloatArray:
    """The patches (batch, 41, side, side) of one iteration; they follow from its number and the settings' seed."""
    rng = np.random.default_rng(np.random.SeedSequence([settings.seed, 0xBE, iteration]))
    return np.stack(
        [
            SYMMETRY.oriented(_draw_patch(samples, settings, rng, whole), int(rng.integers(8)))
            for _ in range(settings.batch)
        ]
    )


def _field_scale(samples: Sequence[Sample], settings: ReliefSettings, whole: Sequence[Sample] = ()) -> FloatArray:
    """(32,) factors that bring the fields to about one scale: one over their standard deviation in a few patches."""
    rng = np.random.default_rng(np.random.SeedSequence([settings.seed, 0x5C]))
    patches = np.stack([_draw_patch(samples, settings, rng, whole)[:FIELDS] for _ in range(_SCALE_PATCHES)])
    return one_scale(patches, _MIN_DEVIATION)


def train_relief(run: TrainingRun, data: ReliefData, settings: ReliefSettings) -> dict[str, Any]:
    """Simulate the fingers and train; return what came out.

    Raises
    ------
    BadInput
        If torch is missing, the folder is in use, what is there does not fit the settings, or no finger can be used.
    """
    started = time.perf_counter()
    require_torch(settings)
    open_folder(run, data, settings)

    def shoot(kind: str, number: int) -> list[Stored]:
        if kind == "finger":
            return [training_sample(number, data)]
        pieces = training_crops(number, data)
        return [(pieces, {"finger": number, "pieces": len(pieces)})]

    def fits(shape: tuple[int, ...], facts: Mapping[str, Any]) -> bool:
        return len(shape) == 3 and shape[0] == CHANNELS and min(shape) >= settings.stride

    pieces, whole, held_out = _numbers(data)
    subjects = [*(("pieces", number) for number in pieces), *(("finger", number) for number in (*whole, *held_out))]
    refused = make_data(run, subjects, shoot)
    cut = load_data(run.out, "pieces", pieces, lambda shape, facts: fits(shape[1:], facts))
    crops = [crop for found in cut.values() for crop in found[0][0]]
    fingers, judges = (
        {number: found[0][0] for number, found in load_data(run.out, "finger", numbers, fits).items()}
        for numbers in (whole, held_out)
    )
    require_subjects(len(crops), "train on", refused)
    require_subjects(len(judges), "judge the network on", refused)
    trainer = _relief_trainer(settings, crops, list(fingers.values()))
    lines = {
        "training": lambda entry: UNIT_UM * math.sqrt(entry["relief"]),
        "held out": lambda entry: UNIT_UM * entry["held_out_rms"],
    }
    curve = LearningCurve(
        settings.report_every,
        lambda: mean_figures([_judge_middle(trainer.run, sample, settings.stride) for sample in judges.values()]),
        lines,
        "error of the relief, µm",
    )
    train_in_folder(run, trainer, settings.iterations, curve)
    run.progress("exporting", 1.0)
    facts = {
        "command": run.command,
        "training": {**asdict(settings), "iterations_done": trainer.done},
        "data": {
            **asdict(data),
            "pieces_used": len(crops),
            "whole_fingers_used": len(fingers),
            "fingers_refused": len(refused),
        },
        "metrics": _network_metrics(trainer.network.state_dict(), judges),
    }
    written = write_fields(run.out, NETWORK, trainer.network.state_dict(), facts)
    return {**written, "refused": len(refused), "out": str(run.out), "total_s": time.perf_counter() - started}


def _numbers(data: ReliefData) -> tuple[range, range, range]:
    """Numbers of the fingers to take pieces of, of the whole ones, and of those held out."""
    return (
        range(data.first, data.first + data.fingers),
        range(data.first_whole, data.first_whole + data.whole_fingers),
        range(HELD_OUT_FROM, HELD_OUT_FROM + data.held_out),
    )


def _network_metrics(state: Mapping[str, Any], samples: Mapping[int, Sample]) -> dict[str, Any]:
    """The card's figures of a network on fingers that it was not trained on.

    Parameters
    ----------
    state : torch's ``state_dict`` of the network
    samples : fingers (41, h, w) by their numbers

    Returns
    -------
    dict with the figures of each finger, see :func:`_judged`, and their means
    """
    run, stride = runner_of(state), stride_of(state)
    figures = {number: _judge_middle(run, sample, stride) for number, sample in samples.items()}

    def in_um(entry: Mapping[str, float]) -> dict[str, float | None]:
        others = {name: value for name, value in entry.items() if name != "rms"}
        return rounded({**others, "rms_um": UNIT_UM * entry["rms"]})

    return {
        "held_out": f"{len(figures)} simulated fingers not trained on, drawn from the same ranges; the middle "
        f"{JUDGED_PX} x {JUDGED_PX} pixels, on the smooth shape they would be trained on",
        "mean": in_um(mean_figures(list(figures.values()))),
        "fingers": [{"finger": number, **in_um(entry)} for number, entry in figures.items()],
    }
