"""Over which range of each tuned constant does the result hardly change?

    python validation/parameters/sensitivity.py [PACKAGE ...]        # resumes, then sums up
    python validation/parameters/sensitivity.py --summary            # sums up what there is

Every constant (and field of thresholds) is set to 0.5, 0.7, 1.4 and 2 times its value wherever it is held, in the captures of
``cases.py`` that use it; a row is written to ``sensitivity.csv`` for each. A result hardly changes
if every figure stays within 5 % of its value, or within the amount in `FLOORS`, and the findings
are the same. Where half and twice the value give the same bytes, the factors between are left out.
"""

from __future__ import annotations

import argparse
import ast
import csv
import importlib
import inspect
import runpy
import sys
import threading
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

from cases import CASES, Measure, Outcome

HERE = Path(__file__).resolve().parent
SOURCE = HERE.parents[1] / "packages" / "splitknit" / "src"
CONSTANTS = runpy.run_path(str(HERE.parents[1] / "tools" / "measure_house.py"))["constants"]
DEFAULT = ("finger", "skin", "mirrors", "separation")
"""Packages of the core."""
OUT = HERE / "sensitivity.csv"
OUTER = (0.5, 2.0)
INNER = (0.7, 1.4)
FRACTION = 0.05
"""Change of a figure, over its value, up to which the result hardly changes."""
FLOORS = {
    "surface_rms_mm": 0.005,
    "shape_rms_mm": 0.005,
    "ridge_rms_um": 0.3,
    "yaw_error_deg": 0.5,
    "crease_error_mm": 0.2,
    "period_error": 0.01,
}
"""Change of a figure up to which the result hardly changes too, whatever its value."""
NOT_SCALED = {
    "LED_RANGE": "an interval about one",
    "NETWORK_PITCH_MM": "what the networks were trained on",
    "SLANT_DEG": "places of a table",
    "FILM_ERROR_DEG": "places of a table",
    "STATED_DEG": "places of a table",
    "SHADOW_PX": "places of a table",
    "LOWEST": "bounds of different kinds",
    "HIGHEST": "bounds of different kinds",
    "GAINS": "an interval about one",
    "THICKNESS": "an interval",
    "HELD_PRIORS": "different kinds",
}
"""Tables that are no longer what they are when they are multiplied."""
COLUMNS = [
    *("package", "constant", "value", "factor", "tried", "cases"),
    *("result", "change", "case", "figure", "before", "after"),
]
Row = dict[str, str]


@dataclass(frozen=True, slots=True)
class Constant:
    """A tuned constant, or a field of thresholds."""

    module: str
    """Where it is defined: ``splitknit.skin.refine``."""
    name: str
    value: Any
    thresholds: Any = None
    """What it is a field of."""

    @property
    def package(self) -> str:
        """Its module, without ``splitknit.``."""
        return self.module.split(".", 1)[1]

    def times(self, factor: float) -> Any:
        """The value, or all of a table, times a factor."""
        return scaled(self.value, factor)

    @property
    def owners(self) -> list[Any]:
        """What has it as an attribute: its thresholds, or loaded modules."""
        return self.holders if self.thresholds is None else [self.thresholds]

    @property
    def holders(self) -> list[Any]:
        """Loaded modules that may read it."""
        if self.thresholds is not None:
            return [module for name, module in sys.modules.items() if name.startswith("splitknit.")]
        named = [sys.modules[self.module]]
        for name, module in list(sys.modules.items()):
            if name.startswith("splitknit") and self.name in imported(name).get(self.module, ()):
                named.append(module)
        return named


def scaled(value: Any, factor: float) -> Any:
    """A number, or all numbers of a table, times a factor; integers rounded."""
    if isinstance(value, dict):
        return {key: scaled(part, factor) for key, part in value.items()}
    if isinstance(value, tuple):
        return tuple(scaled(part, factor) for part in value)
    return round(value * factor) if isinstance(value, int) else value * factor


@cache
def imported(module: str) -> dict[str, set[str]]:
    """Names that a module imports, by the module that they come from."""
    try:
        tree = ast.parse(inspect.getsource(sys.modules[module]))
    except (OSError, TypeError):
        return {}
    names: dict[str, set[str]] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            names.setdefault(node.module, set()).update(alias.name for alias in node.names)
    return names


def constants_of(package: str) -> list[Constant]:
    """Tuned numbers and tables of numbers of a package of the core, by module."""
    constants = []
    for constant in CONSTANTS(SOURCE):
        if not constant.tuned or constant.module.split(".")[1] != package:
            continue
        module = importlib.import_module(constant.module)
        kind, _, name = constant.name.rpartition(".")
        groups = [value for value in vars(module).values() if kind and type(value).__name__ == kind]
        for owner in groups or [module]:
            value, thresholds = getattr(owner, name), owner if groups else None
            constants.append(Constant(constant.module, name, value, thresholds))
    return constants


def functions_of(module: Any) -> Iterator[FunctionType]:
    """Functions and methods that a module defines."""
    for value in list(vars(module).values()):
        for member in [value, *(vars(value).values() if isinstance(value, type) else ())]:
            function = inspect.unwrap(member) if callable(member) else member
            if isinstance(function, FunctionType) and function.__module__ == module.__name__:
                yield function


def is_default(value: Any, function: FunctionType) -> bool:
    """Whether a parameter of a function has this very object as its default."""
    defaults = *(function.__defaults__ or ()), *(function.__kwdefaults__ or {}).values()
    return any(part is value for part in defaults)


@contextmanager
def holding(constant: Constant, value: Any) -> Iterator[None]:
    """The constant has another value, in all modules that hold it and as a default of their
    functions."""
    defaults = [
        (function, function.__defaults__, function.__kwdefaults__)
        for module in constant.holders
        for function in functions_of(module)
        if is_default(constant.value, function)
    ]
    try:
        for owner in constant.owners:
            object.__setattr__(owner, constant.name, value)
        for function, plain, by_name in defaults:
            function.__defaults__ = plain and tuple(
                value if part is constant.value else part for part in plain
            )
            function.__kwdefaults__ = by_name and {
                key: value if part is constant.value else part for key, part in by_name.items()
            }
        forget()
        yield
    finally:
        for owner in constant.owners:
            object.__setattr__(owner, constant.name, constant.value)
        for function, plain, by_name in defaults:
            function.__defaults__, function.__kwdefaults__ = plain, by_name
        forget()


def forget() -> None:
    """Empty the program's caches, which hold results of other constants."""
    for name, module in list(sys.modules.items()):
        if name.startswith("splitknit."):
            for value in list(vars(module).values()):
                if hasattr(value, "cache_clear") and getattr(value, "__module__", "") == name:
                    value.cache_clear()


def called_by(measure: Measure) -> tuple[Outcome, set[CodeType]]:
    """The outcome, and the code that ran."""
    codes: set[CodeType] = set()

    def note(frame: Any, event: str, _: Any) -> None:
        if event == "call":
            codes.add(frame.f_code)

    threading.setprofile(note)
    sys.setprofile(note)
    try:
        result = measure()
    finally:
        sys.setprofile(None)
        threading.setprofile(None)
    return result, codes


@cache
def ready(case: str) -> tuple[Measure, Outcome, set[CodeType]]:
    """A case, its outcome with the constants as they are, and the code that it runs."""
    measure = CASES[case].make()
    before, codes = called_by(measure)
    forget()
    repeated = measure()
    if repeated.digest != before.digest:
        raise SystemExit(f"{case}: two runs give different bytes.")
    return measure, before, codes


def cases_of(constant: Constant) -> list[str]:
    """Captures on which code runs that reads the constant."""
    names = []
    for name, case in CASES.items():
        if not any(part.startswith(constant.package.split(".")[0]) for part in packages_of(case)):
            continue
        codes = ready(name)[2]
        for module in constant.holders:
            if not module.__name__.startswith(case.modules):
                continue
            read = any(
                code.co_filename == module.__file__ and constant.name in code.co_names
                for code in codes
            )
            held = any(
                function.__code__ in codes and is_default(constant.value, function)
                for function in functions_of(module)
            )
            if read or held:
                names.append(name)
                break
    return names


def packages_of(case: Any) -> list[str]:
    """Packages whose constants a case can read; the methods' are those of skin."""
    return [
        "skin" if module == "splitknit.methods" else module.split(".")[1] for module in case.modules
    ]


def change(before: Outcome, after: Outcome) -> tuple[float, str, str, str]:
    """The largest change of a figure, over what still counts as hardly any; its name, and both
    values."""
    if before.findings != after.findings:
        return float("inf"), "findings", before.findings or "none", after.findings or "none"
    if set(before.figures) != set(after.figures):
        lacking = " ".join(sorted(set(before.figures) ^ set(after.figures)))
        return float("inf"), lacking, "", ""
    worst = (0.0, "", "", "")
    for name, value in before.figures.items():
        limit = max(FRACTION * abs(value), FLOORS.get(name, 0.0))
        by = abs(after.figures[name] - value) / limit
        if not by <= worst[0]:
            worst = by, name, f"{value:.5g}", f"{after.figures[name]:.5g}"
    return worst


def tried(constant: Constant, factor: float, cases: Sequence[str]) -> Row:
    """The row of a constant and a factor."""
    value = constant.times(factor)
    row = {
        "package": constant.package,
        "constant": constant.name,
        "value": text(constant.value),
        "factor": f"{factor:g}",
        "tried": text(value),
        "cases": " ".join(name.replace(" ", "-") for name in cases),
        "result": "same",
        "change": "0",
    }
    if value == constant.value:
        return row
    worst = -1.0
    for case in cases:
        measure, before, _ = ready(case)
        with holding(constant, value), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                after = measure()
            except Exception as error:  # a refusal is an answer, and so is a failure
                row |= {"result": "raises", "change": "inf", "case": case, "figure": "raises"}
                return row | {"before": "", "after": type(error).__name__}
        if after.digest == before.digest:
            continue
        by, figure, was, became = change(before, after)
        if not by <= worst:
            worst = by
            row |= {"result": "hardly" if by <= 1 else "changes", "change": f"{by:.3g}"}
            row |= {"case": case, "figure": figure, "before": was, "after": became}
    return row


def text(value: Any) -> str:
    """A value, its numbers with six digits."""
    if isinstance(value, dict):
        return ", ".join(f"{key} {text(part)}" for key, part in value.items())
    if isinstance(value, tuple):
        return "(" + ", ".join(text(part) for part in value) + ")"
    return f"{value:.6g}"


def rows_of(path: Path) -> list[Row]:
    """What is measured already."""
    if not path.is_file():
        return []
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def measure_all(packages: Sequence[str], out: Path) -> None:
    """Measure what is missing; each row is written at once."""
    done = {(row["package"], row["constant"], row["factor"]): row for row in rows_of(out)}
    constants = [constant for package in packages for constant in constants_of(package)]
    with out.open("a", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, restval="", lineterminator="\n")
        if not done:
            writer.writeheader()
        for number, constant in enumerate(constants):
            show(number, len(constants), constant.name)
            if constant.name in NOT_SCALED:
                continue
            keys = [(constant.package, constant.name, f"{factor:g}") for factor in (*OUTER, *INNER)]
            if all(key in done for key in keys[:2]) and (
                all(done[key]["result"] in ("same", "not read") for key in keys[:2])
                or all(key in done for key in keys[2:])
            ):
                continue
            cases = cases_of(constant)
            for key, factor in zip(keys, (*OUTER, *INNER), strict=True):
                if factor in INNER and all(
                    done[outer]["result"] in ("same", "not read") for outer in keys[:2]
                ):
                    break
                if key in done:
                    continue
                done[key] = tried(constant, factor, cases)
                if not cases:
                    done[key]["result"] = "not read"
                writer.writerow(done[key])
                file.flush()
        show(len(constants), len(constants), "")


def show(number: int, count: int, name: str) -> None:
    """A progress bar, on a terminal only."""
    if sys.stderr.isatty():
        done = 40 * number // max(count, 1)
        end = "\n" if number == count else ""
        bar = f"\r[{'#' * done}{' ' * (40 - done)}] {number} of {count} {name:30.30s}"
        print(bar, end=end, file=sys.stderr, flush=True)


def hardly_from_to(rows: Mapping[float, Row]) -> tuple[float, float]:
    """The lowest and the highest factor, without a gap around one, at which the result hardly
    changes. `rows`: of one constant, by factor."""

    def reached(factors: Sequence[float]) -> float:
        last = 1.0
        for factor in factors:
            if factor not in rows or rows[factor]["result"] not in ("same", "hardly"):
                break
            last = factor
        return last

    return reached((0.7, 0.5)), reached((1.4, 2.0))


def by_constant(rows: Sequence[Row]) -> dict[tuple[str, str], dict[float, Row]]:
    """Rows by package and constant, then by factor."""
    table: dict[tuple[str, str], dict[float, Row]] = {}
    for row in rows:
        table.setdefault((row["package"], row["constant"]), {})[float(row["factor"])] = row
    return table


def summary(rows: Sequence[Row]) -> list[str]:
    """How many constants change what, and which hardly do, as lines of Markdown."""
    counts: dict[str, dict[str, int]] = {}
    lines = ["", "Hardly any change from half to twice the value:", ""]
    for (package, name), tried_at in by_constant(rows).items():
        results = {row["result"] for row in tried_at.values()}
        kind = "some"
        if results == {"not read"}:
            kind = "not read"
        elif results == {"same"}:
            kind = "no effect"
        elif hardly_from_to(tried_at) == (0.5, 2.0):
            kind = "hardly"
            worst = max(tried_at.values(), key=lambda row: float(row["change"]))
            effect = f"{worst['figure']} {worst['before']} to {worst['after']}"
            lines.append(f"- {package} {name} = {worst['value']}: {effect} ({worst['case']})")
        of_package = counts.setdefault(package, {})
        of_package[kind] = of_package.get(kind, 0) + 1
    kinds = ("not read", "no effect", "hardly", "some")
    head = [
        "| package | not read here | no effect here | hardly any change | changes |",
        "| --- | --- | --- | --- | --- |",
    ]
    for package, of_package in counts.items():
        head.append(
            f"| {package} | " + " | ".join(str(of_package.get(kind, 0)) for kind in kinds) + " |"
        )
    return head + lines


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure what is missing, then sum up."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("packages", nargs="*", default=DEFAULT)
    parser.add_argument("--out", type=Path, default=OUT)
    parser.add_argument("--summary", action="store_true", help="sum up, measure nothing")
    options = parser.parse_args(arguments)
    if not options.summary:
        measure_all(options.packages, options.out)
    print("\n".join(summary(rows_of(options.out))))


if __name__ == "__main__":
    main()
