"""Confidence intervals by the bootstrap, plain or clustered, and of differences between systems on the same pairs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, require
from splitknit.evaluation import rates
from splitknit.evaluation.cells import Cells, make_cells
from splitknit.evaluation.few_errors import bounds
from splitknit.evaluation.replicate_figures import Layout, figures_of
from splitknit.evaluation.replicates import Units, cell_weights, cluster_units, pair_units, plain_units
from splitknit.evaluation.scores import Ids, Scores

TARGETS = (0.01, 0.001, 0.0001)
METHODS = ("plain", "finger", "subject")
Progress = Callable[[float], None]


@dataclass(frozen=True, slots=True)
class BootstrapSettings:
    """How intervals are made."""

    replicates: int = 1000
    """Resampled sets of comparisons."""
    confidence: float = 0.95
    """Share of the resampled figures that an interval spans, between 0 and 1."""
    seed: int = 0
    """What the sets are drawn from, 0 or more."""
    targets: tuple[float, ...] = TARGETS
    """FARs at which the GAR is given."""
    curve_points: int = 41
    """FARs of the band around the ROC, evenly spaced in the logarithm; 0: no band."""

    def __post_init__(self) -> None:
        require(20 <= self.replicates <= 1_000_000, f"replicates must be 20 to 1000000, but are {self.replicates}.")
        require(0 < self.confidence < 1, f"confidence must lie between 0 and 1, but it is {self.confidence}.")
        require(self.seed >= 0, f"the seed must not be negative, but it is {self.seed}.")
        require(all(0 < far <= 1 for far in self.targets), "FAR targets must lie above 0 and not above 1.")
        require(0 <= self.curve_points <= 1000, "curve_points must be 0 to 1000.")


@dataclass(frozen=True, slots=True)
class Interval:
    """A figure and between what it lies; low <= value <= high."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, slots=True, eq=False)
class Intervals:
    """All figures of one system by one way of drawing."""

    method: str
    """``plain``, ``finger`` or ``subject``."""
    drawn: int
    """Comparisons of the smaller class, fingers or subjects."""
    figures: Mapping[str, Interval]
    """By the names of :class:`splitknit.evaluation.replicate_figures.Layout`."""
    curve_far: NDArray[np.float64]
    """(P,) and the band of the GAR there:"""
    curve_low: NDArray[np.float64]
    curve_high: NDArray[np.float64]


DEFAULTS = BootstrapSettings()


def bootstrap(
    scores: Scores, method: str = "plain", settings: BootstrapSettings = DEFAULTS, progress: Progress | None = None
) -> Intervals:
    """Confidence intervals of all rates.

    Parameters
    ----------
    scores : Scores
    method : ``plain``, ``finger`` or ``subject``
        What is drawn with replacement; see :mod:`splitknit.evaluation.replicates`.
    settings : BootstrapSettings
    progress : called with the share done

    Returns
    -------
    Intervals
        Percentile intervals, widened so as to hold the value itself, and where it rests on less than five fingers
        (subjects, comparisons): see :mod:`splitknit.evaluation.few_errors`.

    Raises
    ------
    BadInput
        If the ids are missing that `method` needs, or there are fewer than three to draw from.
    """
    values = figure_values(scores, settings.targets)
    layout = Layout(settings.targets, _curve(scores, settings))
    cells = make_cells(scores.genuine, scores.impostor)
    units = plain_units(cells) if method == "plain" else _clusters(scores, method)
    rows = _rows(units, [cells], layout, settings, progress)[0]
    possible = bounds(scores, method, settings.targets)
    lows, highs = _limits(rows, settings.confidence)
    figures = {
        name: _holding(values[name], lows[k], highs[k], possible.get(name, ()))
        for k, name in enumerate(layout.names)
        if name in values
    }
    band = slice(len(layout.names) - len(layout.curve), None)
    return Intervals(method, units.clusters, figures, np.array(layout.curve), lows[band], highs[band])


def differences(
    first: Scores,
    second: Scores,
    method: str = "plain",
    settings: BootstrapSettings = DEFAULTS,
    progress: Progress | None = None,
) -> dict[str, Interval]:
    """Figures of `first` minus figures of `second`, which scored the same pairs in the same order.

    Both systems get the same replicates, so that what is hard for both cancels: the interval of the difference is
    narrower than the two intervals together suggest. A difference is beyond chance where its interval leaves out
    zero.

    Raises
    ------
    BadInput
        If the systems differ in number or labels, or `method` lacks its ids.
    """
    same = first.label.shape == second.label.shape and bool((first.label == second.label).all())
    require(same, f"'{first.name}' and '{second.name}' did not score the same pairs; their labels differ.")
    layout = Layout(settings.targets)
    systems = [make_cells(one.genuine, one.impostor) for one in (first, second)]
    if method == "plain":
        units = pair_units(int(first.label.sum()), int((~first.label).sum()))
    else:
        units = _clusters(first, method)
    rows = _rows(units, systems, layout, settings, progress)
    lows, highs = _limits(rows[0] - rows[1], settings.confidence)
    values = [figure_values(one, settings.targets) for one in (first, second)]
    both = [name for name in layout.names if name in values[0] and name in values[1]]
    places = {name: layout.names.index(name) for name in both}
    return {name: _holding(values[0][name] - values[1][name], lows[places[name]], highs[places[name]]) for name in both}


def figure_values(scores: Scores, targets: Sequence[float]) -> dict[str, float]:
    """The figures themselves, from all scores; d' is left out where no score varies."""
    g, i = np.sort(scores.genuine), np.sort(scores.impostor)
    values = {"eer": rates.equal_error(g, i).value, "auc": rates.auc(g, i)}
    values["eer_made"] = rates.equal_error(g, i, counting="made").value
    for target in targets:
        values[f"gar@{target:g}"] = rates.gar_at_far(g, i, target).gar
        values[f"gar@{target:g}_made"] = rates.gar_at_far(g, i, target, counting="made").gar
    d_prime = rates.d_prime(g, i)
    return values if d_prime is None else {**values, "d_prime": d_prime}


def _rows(
    units: Units, systems: list[Cells], layout: Layout, settings: BootstrapSettings, progress: Progress | None
) -> list[NDArray[np.float64]]:
    """(replicates, figures) for each system."""
    rows = [np.empty((settings.replicates, len(layout.names))) for _ in systems]
    done = 0
    for weights in cell_weights(units, systems, settings.replicates, settings.seed):
        for table, cells, (genuine, impostor) in zip(rows, systems, weights, strict=True):
            columns = np.ascontiguousarray(genuine.T), np.ascontiguousarray(impostor.T)
            for k in range(len(columns[0])):
                table[done + k] = figures_of(cells, columns[0][k], columns[1][k], layout)
        done += weights[0][0].shape[1]
        if progress is not None:
            progress(done / settings.replicates)
    return rows


def _clusters(scores: Scores, method: str) -> Units:
    require(method in METHODS, f"the bootstrap draws by {', '.join(METHODS)}, not by '{method}'.")
    ids: Ids | None = scores.finger if method == "finger" else scores.subject
    if ids is None:
        raise BadInput(f"{scores.name}: to draw by {method}, columns {method}_a and {method}_b are needed.")
    units = cluster_units(scores.label, ids)
    require(
        units.clusters >= 3,
        f"{scores.name}: a bootstrap by {method} needs three of them at least, but there are {units.clusters}.",
    )
    return units


def _curve(scores: Scores, settings: BootstrapSettings) -> tuple[float, ...]:
    if settings.curve_points == 0:
        return ()
    lowest = min(0.1, 1.0 / int(np.sum(~scores.label)))
    return tuple(float(far) for far in np.geomspace(lowest, 1.0, settings.curve_points))


def _limits(rows: NDArray[np.float64], confidence: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Percentiles over replicates; those in which a class was not drawn at all tell nothing."""
    tail = (1 - confidence) / 2
    limits = np.full((2, rows.shape[1]), np.nan)
    for k, column in enumerate(rows.T):
        known = column[np.isfinite(column)]
        if known.size:
            limits[:, k] = np.quantile(known, [tail, 1 - tail])
    return limits[0], limits[1]


def _holding(value: float, low: float, high: float, possible: tuple[float, ...] = ()) -> Interval:
    limits = [value, *(float(limit) for limit in (low, high) if np.isfinite(limit)), *possible]
    return Interval(value, min(limits), max(limits))
