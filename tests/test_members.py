"""What members import of each other."""

import ast
import re
from pathlib import Path

import pytest

PACKAGES = Path(__file__).resolve().parents[1] / "packages"
MEMBERS = ("splitknit", "splitknit_simulator", "splitknit_rig", "splitknit_match")


def source(member):
    return PACKAGES / member.replace("_", "-") / "src" / member


def private_imports(text, member):
    """Names with a leading underscore that a module of `member` imports from another member."""
    nodes = [
        node
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.ImportFrom) and node.module
    ]
    others = [node for node in nodes if node.module.split(".")[0] in set(MEMBERS) - {member}]
    return [
        f"{node.module}.{alias.name}"
        for node in others
        for alias in node.names
        if re.search(r"(^|\.)_[a-z]", f"{node.module}.{alias.name}")
    ]


@pytest.mark.parametrize("member", MEMBERS)
def test_no_private_name_of_another_member_is_imported(member):
    files = sorted(source(member).rglob("*.py"))
    private = {file.name: private_imports(file.read_text("utf-8"), member) for file in files}
    assert len(files) > 5
    assert {name: names for name, names in private.items() if names} == {}


def test_a_private_import_is_found():
    text = (
        "def f():\n    from splitknit.io.png import _crc, read_png\n    from splitknit_match.prints"
        " import _x\n"
    )
    assert private_imports(text, "splitknit_match") == ["splitknit.io.png._crc"]


@pytest.mark.parametrize("member", MEMBERS)
def test_a_door_holds_what_users_type_and_no_more(member):
    text = (source(member) / "__init__.pyi").read_text(encoding="utf-8")
    names = set(re.findall(r"^from \S+ import \w+ as (\w+)$", text, re.MULTILINE))
    assert names | {"__version__"} == set(re.findall(r'"(\w+)"', text.partition("__all__ = ")[2]))
