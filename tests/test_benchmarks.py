"""Every benchmark is run by the one that runs them all, and the page beside them names it."""

import json
from pathlib import Path

import pytest

from script_folder import scripts_of

BENCHMARKS = Path(__file__).resolve().parents[1] / "benchmarks"


def test_all_benchmarks_are_run_and_named():
    scripts = {file.name for file in BENCHMARKS.glob("bench_*.py")}
    with scripts_of(BENCHMARKS) as script:
        run_all = script("run_all")
        assert set(run_all.SUITES) == scripts
    page = (BENCHMARKS / "README.md").read_text(encoding="utf-8")
    assert [name for name in sorted(scripts) if f"| `{name}` |" not in page] == []


def test_the_page_shows_rows_of_the_stored_tables():
    page = (BENCHMARKS.parent / "docs" / "experiments" / "performance.md").read_text(
        encoding="utf-8"
    )
    with scripts_of(BENCHMARKS) as script:
        run_all = script("run_all")
        assert run_all.replaced(page, run_all.page_table()) == page, (
            "run benchmarks/run_all.py --page"
        )
        for words, name, title, row, peer in run_all.SHOWN:
            tables = json.loads(run_all.stored(name).read_text(encoding="utf-8"))["tables"]
            assert "-" not in [
                run_all.figure(tables, title, case, "wall") for case in (row, peer) if case
            ], words
        changed = run_all.replaced(page, "| a | b |")
        assert "<!-- run_all.py -->\n| a | b |\n<!-- /run_all.py -->" in changed
        names = {run_all.stored(name) for name in run_all.SUITES}
        assert {file for file in run_all.TABLES.glob("bench_*.json") if file not in names} == set()


def test_what_a_script_prints_is_stored_as_tables():
    printed = (
        "Cores: 2\n\n**First**\n\n| a | b |\n| --- | --- |\n| 1 | 2 / 3 |\n\n| c |\n| --- |\n|"
        " |\n### Next\nmore\n"
    )
    with scripts_of(BENCHMARKS) as script:
        run_all = script("run_all")
        results = run_all.parsed(printed)
        assert results["notes"] == ["Cores: 2", "more"]
        assert results["tables"][0] == {
            "title": "First",
            "columns": ["a", "b"],
            "rows": [["1", "2 / 3"]],
        }
        assert [table["title"] for table in results["tables"]] == ["First", "First"]
        assert json.loads(run_all.as_json(results)) == results
        assert '["1", "2 / 3"]' in run_all.as_json(results)
        times = [
            {
                "title": "T 7",
                "columns": ["method", "wall ms, min / median"],
                "rows": [["x", "1 / 2"]],
            }
        ]
        assert run_all.figure(times, "T", "x", "wall") == "1 / 2"
        assert (
            run_all.figure(times, "T", "y", "wall")
            == run_all.figure(times, "T", "x", "processor")
            == "-"
        )


def test_a_ratio_is_taken_round_by_round():
    with scripts_of(BENCHMARKS) as script:
        timing = script("timing")
        rows = timing.race({"nothing": lambda: None, "something": lambda: sum(range(20_000))}, 5)
        assert timing.ratio(rows[0], rows[0]) == 1.0
        assert timing.ratio(rows[1], rows[0]) > 5
        faster, slower = (
            timing.Row("", None, (1.0,) * 3, cpu) for cpu in ((1.0, 2.0, 4.0), (3.0, 6.0, 4.0))
        )
        assert timing.ratio(slower, faster) == 3.0


@pytest.mark.slow
def test_the_memory_of_photographs_is_measured(tmp_path, capsys, monkeypatch):
    with scripts_of(BENCHMARKS) as script:
        bench = script("bench_reconstruct")
        monkeypatch.setattr(bench, "OUT", tmp_path)
        bench.photographs("8x1")
    name, *figures = capsys.readouterr().out.strip("|\n ").split(" | ")
    assert name == "8 of 1 MP"
    assert all(float(figure) > 0 for figure in figures)
