"""The stable surface says what goes in, what comes out, and what is refused."""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import logging
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import splitknit


def _hooks() -> ModuleType:
    """What the documentation's site is built with; it needs mkdocs only where pictures are taken
    in."""
    spec = importlib.util.spec_from_file_location(
        "docs_hooks", Path(__file__).parents[1] / "tools" / "docs_hooks.py"
    )
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


HOOKS = _hooks()
PUBLIC = {f"splitknit.{name}": getattr(splitknit, name) for name in splitknit.__all__}
PUBLIC = {name: value for name, value in PUBLIC.items() if inspect.isfunction(value)} | {
    name: getattr(importlib.import_module(name.rpartition(".")[0]), name.rpartition(".")[2])
    for name in HOOKS.ARRAYS
}
REFUSES = ("require(", "BadInput(", "check_stack(", "check_lights(", "check_image(")


def lacking(function: Callable[..., Any]) -> list[str]:
    """Sections that the docstring of a public function should have and has not."""
    words, source = inspect.getdoc(function) or "", inspect.getsource(function)
    told = "Parameters are those of" in words
    missing = [] if told or len(inspect.signature(function).parameters) < 2 else ["Parameters"]
    if inspect.signature(function).return_annotation not in (None, "None") and not told:
        missing.append("Returns")
    if any(word in source for word in REFUSES):
        missing.append("Raises")
    words = words.replace("Yields\n------", "Returns\n-------")
    return [section for section in missing if f"{section}\n{'-' * len(section)}" not in words]


@pytest.mark.parametrize("name", sorted(PUBLIC))
def test_public_functions_are_described(name):
    assert lacking(PUBLIC[name]) == []


def test_what_lacks_is_found():
    def silent(a, b):
        """Add."""
        raise splitknit.BadInput(str(a + b))

    assert lacking(silent) == ["Parameters", "Returns", "Raises"]


@pytest.fixture(scope="module")
def hooks() -> ModuleType:
    return HOOKS


def test_the_site_shows_every_public_name_and_verb(hooks, caplog):
    with caplog.at_level(logging.WARNING):
        page = hooks.public_names()
    assert caplog.records == []
    documented = {
        line.strip(":#` ") for line in page.splitlines() if line.startswith((":::", "### "))
    }
    assert documented >= set(PUBLIC) and "splitknit.Capture" in documented
    assert "### `splitknit gallery import`" in hooks.help_of_every_verb()


def test_a_public_name_without_words_is_found(hooks, caplog, monkeypatch):
    monkeypatch.setattr(splitknit.Led, "__doc__", "Led(position_mm)")
    with caplog.at_level(logging.WARNING):
        hooks.public_names()
    assert "splitknit.Led is public and has no docstring" in caplog.text


def test_links_out_of_the_pages_become_paths_and_tables_are_copied(hooks, caplog):
    text = "[README](../README.md), [code](../packages/splitknit/src/splitknit/model.py#a), "
    text += "[page](guide/install.md), [table](../validation/thesis/tables/claims.csv), "
    text += "[gone](../gone.py)"
    with caplog.at_level(logging.WARNING):
        linked = hooks.inside(text, hooks.DOCS, lambda picture: picture.name)
    assert linked.startswith(
        "README (`README.md`), code (`packages/splitknit/src/splitknit/model.py`),"
        " [page](guide/install.md), [table](claims.csv)"
    )
    assert "no file ../gone.py" in caplog.text
