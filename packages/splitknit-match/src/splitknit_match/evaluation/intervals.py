"""Confidence intervals by the bootstrap, plain or clustered, and of differences between systems on the same pairs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from splitknit import BadInput
from splitknit.errors import require
from splitknit.settings import Checked, Limits
from splitknit_match.evaluation import rates
from splitknit_match.evaluation.rates import SLACK, Counting, error_bound
from splitknit_match.evaluation.scores import Ids, Scores

# Scores as cells in falling order, so that a replicate of the bootstrap is a weight for each cell and no sorting.
#
# Rates depend on scores through their order alone. Up to a limit every distinct score is a cell and replicates are
# exact. Beyond it, cells are cut at chosen scores: each chosen one is a cell, and so is what lies between two. GAR at
# FAR stays exact between two chosen scores as long as only impostors lie there; all genuine scores are chosen if they
# are few enough. Point estimates never come from cells.


CELLS = 60_000  # at most about so many


@dataclass(frozen=True, slots=True, eq=False)
class _Cells:
    """Where the scores lie; cell 0 holds the highest."""

    genuine: NDArray[np.int64]  # (N,) the cell of each; ``count`` where it is a failure
    impostor: NDArray[np.int64]  # (M,)
    count: int  # cells without that of the failures
    crowded: NDArray[np.bool_]  # (count,) whether a cell holds several distinct impostor scores, and no genuine one
    moments: NDArray[np.float64]  # (2, 2, count): genuine, impostor; mean and variance of a cell's standardised scores


def _make_cells(genuine: NDArray[np.float64], impostor: NDArray[np.float64], limit: int = CELLS) -> _Cells:
    """Put scores (N,) and (M,), NaN included, into cells."""
    sides = [side[~np.isnan(side)] for side in (genuine, impostor)]
    distinct = [np.unique(side) for side in sides]
    every = np.union1d(*distinct)
    edges = every if every.size <= limit else _edges(distinct, sides[1], limit)
    used, codes = np.unique(np.concatenate([_code(side, edges) for side in sides]), return_inverse=True)
    codes = used.size - 1 - codes
    parts = codes[: sides[0].size], codes[sides[0].size :]
    values = np.bincount(used.size - 1 - np.searchsorted(used, _code(distinct[1], edges)), minlength=used.size)
    crowded = (values > 1) & (np.bincount(parts[0], minlength=used.size) == 0)
    middle, scale = float(np.mean(sides[1])), float(np.ptp(every)) or 1.0
    moments = [_moments(part, (side - middle) / scale, used.size) for part, side in zip(parts, sides, strict=True)]
    placed = []
    for whole, part in zip((genuine, impostor), parts, strict=True):
        cell = np.full(whole.size, used.size, dtype=np.int64)
        cell[~np.isnan(whole)] = part
        placed.append(cell)
    return _Cells(placed[0], placed[1], int(used.size), crowded, np.stack(moments))


def _edges(distinct: list[NDArray[np.float64]], impostor: NDArray[np.float64], limit: int) -> NDArray[np.float64]:
    """Scores to cut at: genuine ones, all or evenly by rank; impostor ones evenly by rank, and every one at the top."""
    kept = distinct[0]
    if kept.size > limit // 3:
        kept = kept[np.linspace(0, kept.size - 1, limit // 3).round().astype(np.int64)]
    ordered = np.sort(impostor)
    ranks = np.unique(np.linspace(0, ordered.size - 1, limit // 12).round().astype(np.int64))
    return np.unique(np.concatenate([kept, ordered[ranks], ordered[-(limit // 12) :]]))


def _code(scores: NDArray[np.float64], edges: NDArray[np.float64]) -> NDArray[np.int64]:
    """Twice the number of edges below a score, and one more on an edge."""
    below = np.searchsorted(edges, scores, side="left")
    return np.asarray(below + np.searchsorted(edges, scores, side="right"), dtype=np.int64)


def _moments(cell: NDArray[np.int64], values: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    number = np.maximum(np.bincount(cell, minlength=count), 1)
    mean = np.bincount(cell, weights=values, minlength=count) / number
    return np.stack([mean, np.bincount(cell, weights=(values - mean[cell]) ** 2, minlength=count) / number])


# Rates that rest on a few fingers: how far off they may be.
#
# A bootstrap repeats what was seen. Where only some fingers (subjects, comparisons) were ever rejected, it knows too
# little of those that are, and nothing where none was. The limit is then that of Clopper and Pearson for as many
# independent trials as there are fingers, as if all comparisons of a finger failed together: cautious, and where
# nothing failed the rule of three.


FEW = 5  # fingers (subjects, comparisons) below which percentiles of replicates are not trusted alone


def _bounds(scores: Scores, method: str, targets: Sequence[float]) -> dict[str, tuple[float, float]]:
    """Bounds of each rate of :class:`_Layout`; the rate itself if enough fingers were rejected and accepted."""
    genuine, impostor = scores.genuine, np.sort(scores.impostor)
    ordered, drawn = np.sort(genuine), _drawn(scores, method)
    countings: tuple[tuple[Counting, str], ...] = (("all", ""), ("made", "_made"))
    limits = {}
    for counting, ending in countings:
        known = np.ones(genuine.shape, dtype=np.bool_) if counting == "all" else ~np.isnan(genuine)
        tried = drawn[known]
        equal = rates.equal_error(ordered, impostor, counting=counting)
        rejected = known & ~_accepted(genuine, equal.threshold)
        limits[f"eer{ending}"] = equal.value, _upper(equal.value, drawn[rejected], tried)
        for target in targets:
            point = rates.gar_at_far(ordered, impostor, target, counting=counting)
            accepted = _accepted(genuine, point.threshold)
            low = 1.0 - _upper(1.0 - point.gar, drawn[known & ~accepted], tried)
            limits[f"gar@{target:g}{ending}"] = low, _upper(point.gar, drawn[accepted], tried)
    return limits


def _accepted(scores: NDArray[np.float64], threshold: float | None) -> NDArray[np.bool_]:
    return np.asarray(scores >= (np.inf if threshold is None else threshold))


def _upper(rate: float, hit: NDArray[np.int64], tried: NDArray[np.int64]) -> float:
    """Bound of a rate that `hit` of what was `tried` contribute to; the rate itself where they are enough."""
    return error_bound(rate, np.unique(tried).size) if np.unique(hit).size < FEW else rate


def _drawn(scores: Scores, method: str) -> NDArray[np.int64]:
    """(N,) what each genuine comparison is drawn with."""
    ids = {"finger": scores.finger, "subject": scores.subject}.get(method)
    return np.arange(int(scores.label.sum())) if ids is None else ids.codes[scores.label, 0]


TARGETS = (0.01, 0.001, 0.0001)
METHODS = ("plain", "finger", "subject")
Progress = Callable[[float], None]


CONFIDENCE = 0.95  # fraction of the resampled figures that an interval spans, between 0 and 1


@dataclass(frozen=True, slots=True)
class BootstrapSettings(Checked):
    """How intervals are made."""

    replicates: Annotated[int, Limits(20, 1_000_000)] = 1000
    """Resampled sets of comparisons."""
    seed: Annotated[int, Limits(0)] = 0
    """What the sets are drawn from, 0 or more."""
    targets: Annotated[tuple[float, ...], Limits(0, 1, above=True)] = TARGETS
    """FARs at which the GAR is given."""
    curve_points: Annotated[int, Limits(0, 1000)] = 41
    """FARs of the band around the ROC, evenly spaced in the logarithm; 0: no band."""


@dataclass(frozen=True, slots=True)
class Interval:
    """A figure and between what it lies; low <= value <= high."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, slots=True, eq=False)
class Intervals:
    """All figures of one system by one scheme of drawing."""

    method: str  # ``plain``, ``finger`` or ``subject``
    drawn: int  # comparisons of the smaller class, fingers or subjects
    figures: Mapping[str, Interval]  # by the names of :class:`_Layout`
    curve_far: NDArray[np.float64]  # (P,) and the band of the GAR there:
    curve_low: NDArray[np.float64]
    curve_high: NDArray[np.float64]


DEFAULTS = BootstrapSettings()


def bootstrap(
    scores: Scores, method: str = "plain", settings: BootstrapSettings = DEFAULTS, progress: Progress | None = None
) -> Intervals:
    """Percentile intervals of all rates; `method`, what is drawn with replacement: ``plain``, ``finger``, ``subject``.
    They hold the value itself, and are wider where it rests on less than five fingers (subjects, comparisons). Raises
    BadInput if the ids are missing that `method` needs, or there are fewer than three to draw from.
    """
    values = _figure_values(scores, settings.targets)
    layout = _Layout(settings.targets, _curve(scores, settings))
    cells = _make_cells(scores.genuine, scores.impostor)
    of_plain = method == "plain"
    units = _plain_units(cells.genuine, cells.impostor, cells.count + 1) if of_plain else _clusters(scores, method)
    rows = _rows(units, [cells], layout, settings, progress)[0]
    possible = _bounds(scores, method, settings.targets)
    lows, highs = _limits(rows)
    there = [(k, name) for k, name in enumerate(layout.names) if name in values]
    figures = {name: _holding(values[name], lows[k], highs[k], possible.get(name, ())) for k, name in there}
    band = slice(len(layout.names) - len(layout.curve), None)
    return Intervals(method, units.clusters, figures, np.array(layout.curve), lows[band], highs[band])


def differences(
    first: Scores, second: Scores, method: str = "plain", settings: BootstrapSettings = DEFAULTS
) -> dict[str, Interval]:
    """Figures of `first` minus figures of `second`, which scored the same pairs in the same order. Both get the same
    replicates, so that what is hard for both cancels; a difference is beyond chance where its interval leaves out zero.
    Raises BadInput if the systems differ in number or labels, or `method` lacks its ids.
    """
    same = first.label.shape == second.label.shape and bool((first.label == second.label).all())
    require(same, f"'{first.name}' and '{second.name}' did not score the same pairs; their labels differ.")
    layout = _Layout(settings.targets)
    systems = [_make_cells(one.genuine, one.impostor) for one in (first, second)]
    if method == "plain":  # drawn one by one: the same for both
        units = _plain_units(np.arange(first.genuine.size), np.arange(first.impostor.size))
    else:
        units = _clusters(first, method)
    rows = _rows(units, systems, layout, settings, None)
    lows, highs = _limits(rows[0] - rows[1])
    values = [_figure_values(one, settings.targets) for one in (first, second)]
    both = [name for name in layout.names if name in values[0] and name in values[1]]
    places = {name: layout.names.index(name) for name in both}
    return {name: _holding(values[0][name] - values[1][name], lows[places[name]], highs[places[name]]) for name in both}


def _figure_values(scores: Scores, targets: Sequence[float]) -> dict[str, float]:
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
    units: _Units, systems: list[_Cells], layout: _Layout, settings: BootstrapSettings, progress: Progress | None
) -> list[NDArray[np.float64]]:
    """(replicates, figures) for each system."""
    rows = [np.empty((settings.replicates, len(layout.names))) for _ in systems]
    done = 0
    for weights in _cell_weights(units, systems, settings.replicates, settings.seed):
        for table, cells, (genuine, impostor) in zip(rows, systems, weights, strict=True):
            columns = np.ascontiguousarray(genuine.T), np.ascontiguousarray(impostor.T)
            for k in range(len(columns[0])):
                table[done + k] = _figures_of(cells, columns[0][k], columns[1][k], layout)
        done += weights[0][0].shape[1]
        if progress is not None:
            progress(done / settings.replicates)
    return rows


def _clusters(scores: Scores, method: str) -> _Units:
    require(method in METHODS, f"the bootstrap draws by {', '.join(METHODS)}, not by '{method}'.")
    ids: Ids | None = scores.finger if method == "finger" else scores.subject
    if ids is None:
        raise BadInput(f"{scores.name}: to draw by {method}, columns {method}_a and {method}_b are needed.")
    units = _cluster_units(scores.label, ids)
    fault = f"{scores.name}: a bootstrap by {method} needs three of them at least,"
    require(units.clusters >= 3, f"{fault} but there are {units.clusters}.")
    return units


def _curve(scores: Scores, settings: BootstrapSettings) -> tuple[float, ...]:
    if settings.curve_points == 0:
        return ()
    lowest = min(0.1, 1.0 / int(np.sum(~scores.label)))
    return tuple(float(far) for far in np.geomspace(lowest, 1.0, settings.curve_points))


def _limits(rows: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Percentiles over replicates; those in which a class was not drawn at all are left out."""
    tail = (1 - CONFIDENCE) / 2
    limits = np.full((2, rows.shape[1]), np.nan)
    for k, column in enumerate(rows.T):
        known = column[np.isfinite(column)]
        if known.size:
            limits[:, k] = np.quantile(known, [tail, 1 - tail])
    return limits[0], limits[1]


def _holding(value: float, low: float, high: float, possible: tuple[float, ...] = ()) -> Interval:
    limits = [value, *(float(limit) for limit in (low, high) if np.isfinite(limit)), *possible]
    return Interval(value, min(limits), max(limits))


# Figures of one replicate from the weights of its cells: what :mod:`splitknit_match.evaluation.rates` does with scores.

Row = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class _Layout:
    """Which number of a replicate's row is what."""

    targets: tuple[float, ...]  # FARs at which the GAR is asked
    curve: tuple[float, ...] = ()  # FARs of the band around the ROC

    @property
    def names(self) -> list[str]:
        """``eer``, ``auc``, ``d_prime``, ``gar@...``; with ``_made`` failures left out; ``curve@...``."""
        gars = [f"gar@{target:g}" for target in self.targets]
        made = [f"{name}_made" for name in ("eer", *gars)]
        return ["eer", *gars, *made, "auc", "d_prime", *(f"curve@{far!r}" for far in self.curve)]


def _figures_of(cells: _Cells, genuine: Row, impostor: Row, layout: _Layout) -> Row:
    """Figures in the order of `layout.names` from the cells' weights (count + 1,); NaN without a class or spread."""
    g, i = genuine[:-1], impostor[:-1]
    made_g, made_i = float(g.sum()), float(i.sum())
    if made_g <= 0 or made_i <= 0:
        return np.full(len(layout.names), np.nan)
    accepted_g, accepted_i = (np.concatenate([[0.0], np.cumsum(side)]) for side in (g, i))
    all_g, all_i = made_g + float(genuine[-1]), made_i + float(impostor[-1])

    def gars(fars: tuple[float, ...], total_g: float, total_i: float) -> list[float]:
        k = np.searchsorted(accepted_i, np.array(fars) * total_i * (1 + SLACK), side="right") - 1
        return [float(value) for value in accepted_g[k] / total_g]

    totals = (all_g, all_i), (made_g, made_i)
    eers = [_equal_error(accepted_g / total_g, accepted_i / total_i, cells.crowded) for total_g, total_i in totals]
    area = _dot(g, made_i - accepted_i[1:] + 0.5 * i) / (made_g * made_i)
    of_all, of_made = gars(layout.targets, all_g, all_i), gars(layout.targets, made_g, made_i)
    d_prime = _d_prime(cells, g / made_g, i / made_i)
    return np.array([eers[0], *of_all, eers[1], *of_made, area, d_prime, *gars(layout.curve, all_g, all_i)])


def _equal_error(gar: Row, far: Row, crowded: NDArray[np.bool_]) -> float:
    """(FAR + FRR) / 2 beside the crossing, whichever sum is smaller; (count + 1,) rates, rising."""
    both = gar + far
    k1 = int(np.searchsorted(both, 1.0 - SLACK))  # the highest threshold with FRR <= FAR
    if k1 == both.size:
        return float(far[-1] + 1.0 - gar[-1]) / 2
    if k1 == 0 or both[k1] <= 1.0 + SLACK:
        return float(far[k1] + 1.0 - gar[k1]) / 2
    if crowded[k1 - 1]:  # the crossing lies among many impostors of one cell, where FRR stands still
        return float(1.0 - gar[k1])
    sums = far[k1] + 1.0 - gar[k1], far[k1 - 1] + 1.0 - gar[k1 - 1]
    return float(min(sums)) / 2


def _d_prime(cells: _Cells, genuine: Row, impostor: Row) -> float:
    means, spreads = [], []
    for fraction, (mean, variance) in zip((genuine, impostor), cells.moments, strict=True):
        means.append(_dot(fraction, mean))
        spreads.append(_dot(fraction, variance + (mean - means[-1]) ** 2))
    spread = float(np.sqrt(sum(spreads) / 2))
    return (means[0] - means[1]) / spread if spread > 1e-9 else float("nan")


def _dot(a: Row, b: Row) -> float:
    """Sum of products, in one thread: the same for any number of cores, and threads cost more than they save here."""
    return float(np.einsum("c,c->", a, b))


# Resampling: how often each comparison counts in a replicate of the bootstrap.
#
# ``plain``: comparisons are drawn, genuine and impostor ones apart. Right only if they are independent, which they are
# not where a finger takes part in several.
#
# ``finger``, ``subject``: fingers (or subjects) are drawn with replacement, and a comparison counts as often as the
# product of how often its finger, or each of its two fingers, was drawn: w_a for a genuine pair of finger a, w_a w_b
# for an impostor pair of a and b. (Two fingers of one subject, drawn by subject, count w_s: they come along together.)
# Impostor scores that share either finger thus rise and fall together. Copies of one finger in a replicate are not
# compared with each other: there is no score for it.
#
# Source: T. A. B. Snijders, S. P. Borgatti, "Non-parametric standard errors and tests for network statistics",
# Connections 22(2), 1999 (the vertex bootstrap). A. B. Owen, "The pigeonhole bootstrap", Annals of Applied Statistics
# 1(2), 2007 (two-way; the variance is right or a little large). R. M. Bolle, N. K. Ratha, S. Pankanti, "Error analysis
# of pattern recognition systems - the subsets bootstrap", Computer Vision and Image Understanding 93(1), 2004 (one-way:
# by one finger of a pair, which is too narrow for impostors). N. Poh, A. Martin, S. Bengio, "Performance generalization
# in biometric authentication using joint user-specific and sample bootstraps", IEEE PAMI 29(3), 2007. R. Fogliato, P.
# Patil, P. Perona, "Confidence intervals for error rates in 1:1 matching tasks", International Journal of Computer
# Vision, 2024 (a review: bootstraps cover too often or too rarely where errors are few).

Weights = NDArray[np.float64]
BATCH = 1_000_000  # numbers held at a time for one side, about


@dataclass(frozen=True, slots=True, eq=False)
class _Units:
    """What is drawn, for both sides: each comparison belongs to a unit."""

    genuine: NDArray[np.int64]  # (N,) unit of each genuine comparison
    impostor: NDArray[np.int64]  # (M,)
    clusters: int  # things that are drawn: comparisons of the smaller side, fingers or subjects
    sizes: tuple[NDArray[np.int64], NDArray[np.int64]] | None = None  # plain: comparisons in each unit, of both sides
    cluster: NDArray[np.int64] | None = None  # clustered: (U,) cluster of each unit of genuine comparisons
    pairs: NDArray[np.int64] | None = None  # clustered: (V, 2) clusters of each unit of impostor comparisons

    def draw(self, generator: np.random.Generator, count: int) -> tuple[Weights, Weights]:
        """How often each unit counts in `count` replicates: (U, count) and (V, count)."""
        if self.sizes is not None:
            genuine, impostor = (_multinomial(generator, sizes, count) for sizes in self.sizes)
            return genuine, impostor
        assert self.cluster is not None and self.pairs is not None
        drawn = _multinomial(generator, np.ones(self.clusters, dtype=np.int64), count)
        a, b = self.pairs.T
        return drawn[self.cluster], np.where((a == b)[:, None], drawn[a], drawn[a] * drawn[b])

    def batch(self) -> int:
        """Replicates at a time."""
        largest = max(int(self.genuine.max(initial=0)), int(self.impostor.max(initial=0))) + 1
        return max(1, min(32, BATCH // largest))


def _plain_units(genuine: NDArray[np.int64], impostor: NDArray[np.int64], least: int = 0) -> _Units:
    """Comparisons (N,), (M,) are drawn; those of one number are equivalent and need not be separated."""
    sizes = np.bincount(genuine, minlength=least), np.bincount(impostor, minlength=least)
    return _Units(genuine, impostor, min(genuine.size, impostor.size), sizes)


def _cluster_units(label: NDArray[np.bool_], ids: Ids) -> _Units:
    """Fingers, or subjects, are drawn."""
    _, codes = np.unique(ids.codes, return_inverse=True)
    codes = codes.reshape(ids.codes.shape)
    clusters = int(codes.max()) + 1
    cluster, genuine = np.unique(codes[label, 0], return_inverse=True)
    low, high = codes[~label].min(axis=1), codes[~label].max(axis=1)
    keys, impostor = np.unique(low * clusters + high, return_inverse=True)
    pairs = np.stack([keys // clusters, keys % clusters], axis=1)
    return _Units(genuine.ravel(), impostor.ravel(), clusters, None, cluster, pairs)


def _cell_weights(
    units: _Units, systems: list[_Cells], replicates: int, seed: int
) -> Iterator[list[tuple[Weights, Weights]]]:
    """Draw the same replicates for all systems: weights (count + 1, R) of the cells (last: failures), both sides."""
    generator = np.random.default_rng(seed)
    sides = [((one.genuine, units.genuine), (one.impostor, units.impostor), one.count + 1) for one in systems]
    gather = [(_sums(*genuine, count), _sums(*impostor, count)) for genuine, impostor, count in sides]
    size = min(units.batch(), max(1, BATCH // (max(cells.count for cells in systems) + 1)))
    for start in range(0, replicates, size):
        genuine, impostor = units.draw(generator, min(size, replicates - start))
        yield [(_apply(of_genuine, genuine), _apply(of_impostor, impostor)) for of_genuine, of_impostor in gather]


def _sums(cell: NDArray[np.int64], unit: NDArray[np.int64], cells: int) -> csr_array | None:
    """(cells, units) matrix of how many comparisons of a unit lie in a cell; None where cells are the units."""
    if cell is unit:
        return None
    ones = np.ones(cell.size, dtype=np.float64)
    return csr_array((ones, (cell, unit)), shape=(cells, int(unit.max()) + 1))


def _apply(matrix: csr_array | None, weights: Weights) -> Weights:
    return weights if matrix is None else np.asarray(matrix @ weights)


def _multinomial(generator: np.random.Generator, sizes: NDArray[np.int64], count: int) -> Weights:
    """(units, count): as many draws as there are comparisons, each unit as likely as it is large."""
    total, units = int(sizes.sum()), sizes.size
    drawn = np.empty((units, count), dtype=np.float64)
    if total > 4 * units:
        drawn[:] = generator.multinomial(total, sizes / total, size=count).T
        return drawn
    member = np.repeat(np.arange(units), sizes)
    for k in range(count):
        drawn[:, k] = np.bincount(member[generator.integers(0, total, total)], minlength=units)
    return drawn
