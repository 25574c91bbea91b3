"""``splitknit compare A B``: how two measurements of one surface differ."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from splitknit.cli.verb import Outcome, Progress, new_verb


def add_compare(verbs: Any) -> None:
    """Add the verb."""
    verb = new_verb(verbs, "compare", "how two measurements of one finger differ, laid on each other", _run)
    verb.add_argument("a", type=Path, metavar="A", help="result folder, or its height.npz: what is tested")
    verb.add_argument("b", type=Path, metavar="B", help="the same of the reference")
    verb.add_argument("--out", type=Path, required=True, metavar="R", help="folder to write the report into")
    verb.add_argument(
        "--protocol",
        choices=("powder-5", "powder-10", "powder-20", "cast", "gel"),
        help="what B is (powder: its mean thickness in um): that protocol's simulated error is reported "
        "as well; skin on a gel or of a cast may have shifted (--elastic)",
    )
    verb.add_argument("--elastic", action="store_true", help="let the skin shift smoothly; waves up to 2.5 mm alone")
    verb.add_argument(
        "--repeat", type=Path, metavar="B2", help="a second reference, coated or pressed anew: measures B's own error"
    )


def _run(options: argparse.Namespace) -> Outcome:
    """Compare, write, and report what came out."""
    from splitknit.evaluation.pair import compare_results
    from splitknit.io.results import read_result
    from splitknit.io.targets import check_target
    from splitknit.report.pair import FORMAT, headline, write_comparison

    check_target(options.out, "report.json", "an earlier comparison", form=FORMAT)
    elastic = options.elastic or options.protocol in {"gel", "cast"}
    with Progress(options) as progress:
        progress.update("reading", 0.0)
        a, b, again = (path and read_result(path) for path in (options.a, options.b, options.repeat))
        progress.update("comparing", 0.2)
        pair = compare_results(a, b, fit="elastic" if elastic else "rigid")
        progress.update("B's own error", 0.6)
        repeat = None if again is None else compare_results(b, again, fit="elastic" if elastic else "rigid")
        progress.update("report", 0.9)
        facts = write_comparison(pair, options.out, (options.a, options.b), options.protocol, repeat)
    notes = [f"Please note: {note}" for note in facts["notes"]]
    return {"out": str(options.out), **facts}, [
        *headline(facts), *notes, f"Open {options.out / 'report.html'} in a browser."
    ]  # fmt: skip
