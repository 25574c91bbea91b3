"""Every benchmark is run by the one that runs them all, and the page beside them names it."""

from __future__ import annotations

from pathlib import Path

from script_folder import scripts_of

BENCHMARKS = Path(__file__).resolve().parents[1] / "benchmarks"


def test_all_benchmarks_are_run_and_named() -> None:
    scripts = {file.name for file in BENCHMARKS.glob("bench_*.py")}
    with scripts_of(BENCHMARKS) as script:
        run_all = script("run_all")
        assert set(run_all.SUITES) == scripts
        assert set(run_all.JSON) <= scripts
    page = (BENCHMARKS / "README.md").read_text(encoding="utf-8")
    assert [name for name in sorted(scripts) if f"| `{name}` |" not in page] == []


def test_quick_runs_ask_for_one_or_two_rounds() -> None:
    with scripts_of(BENCHMARKS) as script:
        for name, (full, quick) in script("run_all").SUITES.items():
            for arguments in (full, quick):
                assert all(isinstance(word, str) for word in arguments), name
            if "--rounds" in full:
                assert int(quick[quick.index("--rounds") + 1]) <= 2, name
