"""What crosses the doors of the members."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

import pytest

PACKAGES = Path(__file__).resolve().parents[1] / "packages"
MEMBERS = ("splitknit", "splitknit_simulator", "splitknit_rig", "splitknit_match")
APART = {"cli", "demo"}
"""Parts of the simulator's member that may know the estimate: they compare with it."""
SHARED = {"devices", "errors", "exports", "io", "model", "settings", "verbs", "workers"}
"""What of the core the simulator may use: data, files, checks; nothing that estimates."""


def source(member: str) -> Path:
    return PACKAGES / member.replace("_", "-") / "src" / member


@cache
def homes(member: str) -> dict[str, str]:
    """The names at a member's door, with the modules that define them."""
    text = (source(member) / "__init__.pyi").read_text(encoding="utf-8")
    return {name: home for home, name in re.findall(r"^from (\S+) import (\w+) as \2$", text, re.MULTILINE)}


def taken(file: Path, member: str) -> set[str]:
    """Names that a module imports from a member's door."""
    nodes = ast.walk(ast.parse(file.read_text(encoding="utf-8")))
    imports = [node for node in nodes if isinstance(node, ast.ImportFrom) and node.module == member]
    return {alias.name for node in imports for alias in node.names}


def estimating(folder: Path) -> dict[str, set[str]]:
    """By module of the simulator, names whose home is not among those that it may share with the estimate."""
    home = homes("splitknit")
    found = {}
    for file in sorted(folder.rglob("*.py")):
        part = file.relative_to(folder).parts[0].removesuffix(".py")
        names = {name for name in taken(file, "splitknit") if name in home and home[name].split(".")[1] not in SHARED}
        if names and part not in APART:
            found[file.relative_to(folder).as_posix()] = names
    return found


def test_the_simulator_shares_no_code_with_the_estimate() -> None:
    assert estimating(source("splitknit_simulator")) == {}


def test_shared_code_is_found(tmp_path: Path) -> None:
    (tmp_path / "light.py").write_text("def lit():\n    from splitknit import BadInput, reconstruct\n")
    assert estimating(tmp_path) == {"light.py": {"reconstruct"}}


@pytest.mark.parametrize("member", MEMBERS)
def test_a_name_at_the_door_is_for_users_or_used_by_another_member(member: str) -> None:
    others = [file for other in MEMBERS if other != member for file in source(other).rglob("*.py*")]
    used = {name for file in others if file.suffix in (".py", ".pyi") for name in taken(file, member)}
    door = ast.parse((source(member) / "__init__.pyi").read_text(encoding="utf-8"))
    for_users = {node.value for node in ast.walk(door) if isinstance(node, ast.Constant)}
    assert sorted(homes(member).keys() - used - for_users) == []
