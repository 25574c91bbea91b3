"""The documentation's score file and its Python run."""

import re
from pathlib import Path

from splitknit.cli.main import main

PAGE = (Path(__file__).resolve().parents[4] / "docs" / "guide" / "evaluation.md").read_text(
    encoding="utf-8"
)


def test_the_documented_scores_are_evaluated(tmp_path, capsys):
    (text,) = re.findall(r"<!-- example scores.csv -->\n```\n(.*?)```", PAGE, flags=re.DOTALL)
    (tmp_path / "scores.csv").write_text(text)
    files = ["--scores", str(tmp_path / "scores.csv"), "--out", str(tmp_path / "report")]
    assert main(["evaluate", *files, "--replicates", "50"]) == 0
    assert "3 genuine and 2 impostor" in capsys.readouterr().out
    assert (tmp_path / "report" / "report.html").exists()


def test_the_documented_python_runs(capsys):
    (code,) = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)
    exec(compile(code, "evaluation.md", "exec"), {})
    assert capsys.readouterr().out.count("Interval(value=") == 2
