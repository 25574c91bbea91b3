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


def test_the_page_holds_markers_that_its_tables_replace() -> None:
    page = (BENCHMARKS.parent / "docs" / "experiments" / "performance.md").read_text(encoding="utf-8")
    with scripts_of(BENCHMARKS) as script:
        run_all = script("run_all")
        for name in run_all.SUITES:
            assert page.count(f"<!-- {name} -->") == page.count(f"<!-- /{name} -->") <= 1, name
        changed = run_all.replaced(page, "bench_match.py", "\n| a | b |\n")
        assert "<!-- bench_match.py -->\n| a | b |\n<!-- /bench_match.py -->" in changed
        assert run_all.replaced(changed, "bench_match.py", "| a | b |") == changed


def test_a_ratio_is_taken_round_by_round() -> None:
    with scripts_of(BENCHMARKS) as script:
        timing = script("timing")
        rows = timing.race({"nothing": lambda: None, "something": lambda: sum(range(20_000))}, 5)
        assert timing.ratio(rows[0], rows[0]) == 1.0
        assert timing.ratio(rows[1], rows[0]) > 5
        first, other = (timing.Row("", None, (1.0,) * 3, cpu) for cpu in ((1.0, 2.0, 4.0), (3.0, 6.0, 4.0)))
        assert timing.ratio(other, first) == 3.0
