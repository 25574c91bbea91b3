"""Measure the structure of the members: files, lines, settings, public names, imports; as tables,
or as JSON.

    python tools/measure_house.py [--json] [--src packages/splitknit/src ...]

Nothing of the package is executed. What is counted:

- settings: annotated fields of classes whose name ends in ``Settings``, and of those derived from
  ``Checked``;
- tokens by member and package: what Python's tokenizer gives, without comments, docstrings (of
  attributes, too), and layout, so that neither wide lines nor blank ones count; ``all Python`` are
  those of every tracked ``.py`` file;
- lines by member: of ``.py`` and ``.pyi`` files; public names by member: what stands at its door,
  ``__init__.pyi``;
- words by page: of ``docs``, as ``wc -w`` counts them; pages that a script writes are not in the
  sum;
- names of modules: functions and classes at their top level, without a leading underscore;
  homonyms: those that two modules or more define;
- whole settings: functions below the entry (``reconstruct``) with a parameter of the type
  ``PipelineSettings``;
- many parameters: functions and methods with six or more, ``self`` not counted;
- noqa: lines that silence the linter; README words: as ``wc -w`` counts them;
- files to the equations, and to the PLY: files on the shortest chain of imports (lazy ones
  included) from the verb ``reconstruct`` to the least squares of photometric stereo, and to the
  mesh writer;
- tuned constants: upper-case numbers of modules and fields of ``*Thresholds`` whose docstring names
  no ``Source:``, and what states ``Chosen on:``;
- circles: sets of modules that import each other, lazily or not;
- one importer: files that one other file alone imports, in the same folder.
"""

from __future__ import annotations

import argparse
import ast
import io
import itertools
import json
import re
import subprocess
import sys
import tokenize
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

VERB = ("splitknit.folders",)
EQUATIONS = ("splitknit.photometric.lambertian",)
MESH = ("splitknit.io.mesh",)
ENTRIES = ("reconstruct",)
"""Functions that may take whole settings: they pick a method and its parameters."""
CHOSEN = "Chosen on:"
"""What the docstring says of a constant that holds a tuned number beside words."""
THRESHOLDS = "Thresholds"
"""How the name of a dataclass of tuned constants ends."""
GENERATED = ("guide/examples.md",)
ROOT = Path(__file__).resolve().parents[1]


class House:
    """All modules of a source tree: their syntax trees and who imports whom."""

    def __init__(self, sources: Sequence[Path]) -> None:  # noqa: D107 - the class says it
        self.files = {
            _module(path, src): path for src in sources for path in sorted(src.rglob("*.py"))
        }
        self.trees = {
            name: ast.parse(path.read_text(encoding="utf-8")) for name, path in self.files.items()
        }
        self.imports = {name: self._imports(name) for name in self.files}

    def _imports(self, module: str) -> set[str]:
        modules: set[str] = set()
        for node in ast.walk(self.trees[module]):
            if isinstance(node, ast.Import):
                modules |= {self._known(alias.name) for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
                modules |= {self._known(f"{node.module}.{alias.name}") for alias in node.names}
        return modules - {"", module}

    def _known(self, name: str) -> str:
        """The module that a dotted name lies in; empty for other packages."""
        while name and name not in self.files:
            name = name.rpartition(".")[0]
        return name

    def circles(self) -> list[list[str]]:
        """Sets of modules that can reach each other (Tarjan's strongly connected components),
        larger than one."""
        order: dict[str, int] = {}
        low: dict[str, int] = {}
        stack: list[str] = []
        components: list[list[str]] = []

        def visit(name: str) -> None:
            order[name] = low[name] = len(order)
            stack.append(name)
            for imported in sorted(self.imports[name]):
                if imported not in order:
                    visit(imported)
                    low[name] = min(low[name], low[imported])
                elif imported in stack:
                    low[name] = min(low[name], order[imported])
            if low[name] == order[name]:
                place = stack.index(name)
                component = stack[place:]
                del stack[place:]
                if len(component) > 1:
                    components.append(sorted(component))

        sys.setrecursionlimit(10_000)
        for name in self.files:
            if name not in order:
                visit(name)
        return components

    def chain(self, starts: tuple[str, ...], goals: tuple[str, ...]) -> list[str]:
        """Shortest chain of imports between the first of each that exist; packages' ``__init__``
        are passed through."""
        start = next((name for name in starts if name in self.files), None)
        goal = next((name for name in goals if name in self.files), None)
        if start is None or goal is None:
            return []
        before: dict[str, str] = {start: ""}
        waiting = deque([start])
        while waiting:
            name = waiting.popleft()
            if name == goal:
                path = []
                while name:
                    path.append(name)
                    name = before[name]
                return path[::-1]
            for imported in sorted(self.imports[name]):
                if imported not in before:
                    before[imported] = name
                    waiting.append(imported)
        return []

    def single_importer(self) -> list[str]:
        """Files that one other file alone imports, in the same folder."""
        importers: dict[str, set[str]] = {name: set() for name in self.files}
        for name, others in self.imports.items():
            for imported in others:
                importers[imported].add(name)
        return [
            name
            for name, who in importers.items()
            if len(who) == 1
            and self.files[name].name != "__init__.py"
            and self.files[next(iter(who))].parent == self.files[name].parent
        ]

    def settings_fields(self) -> int:
        """Fields of settings classes."""
        return sum(
            isinstance(item, ast.AnnAssign)
            for tree in self.trees.values()
            for node in ast.walk(tree)
            if isinstance(node, ast.ClassDef)
            and (
                node.name.endswith("Settings")
                or any(ast.unparse(base) == "Checked" for base in node.bases)
            )
            for item in node.body
        )

    def module_names(self) -> Counter[str]:
        """Functions and classes at the top level of modules, and how many modules define each."""
        kinds = (ast.FunctionDef, ast.ClassDef)
        nodes = (
            node for tree in self.trees.values() for node in tree.body if isinstance(node, kinds)
        )
        return Counter(node.name for node in nodes if not node.name.startswith("_"))

    def parameters(self) -> Iterator[tuple[str, list[ast.arg]]]:
        """Name and parameters of every function and method, without ``self`` and ``cls``."""
        for tree in self.trees.values():
            for node in ast.walk(tree):
                if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                    every = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
                    yield node.name, [arg for arg in every if arg.arg not in ("self", "cls")]


LAYOUT = (
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
)


def tokens(path: Path) -> int:
    """Tokens of a file without comments, docstrings and layout."""
    text = path.read_text(encoding="utf-8")
    strings = {
        (node.lineno, node.value.col_offset)
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    }
    each = tokenize.generate_tokens(io.StringIO(text).readline)
    return sum(token.type not in LAYOUT and token.start not in strings for token in each)


def tokens_by_package(package: Path) -> Counter[str]:
    """Tokens of a member's packages, and of the modules beside them together (``.``)."""
    counts: Counter[str] = Counter()
    for file in (*package.rglob("*.py"), *package.rglob("*.pyi")):
        parts = file.relative_to(package).parts
        counts[parts[0] if len(parts) > 1 else "."] += tokens(file)
    return counts


def members(sources: Sequence[Path]) -> list[dict[str, str | int]]:
    """Files, lines and public names of every package."""
    rows: list[dict[str, str | int]] = []
    for package in sorted(
        path for src in sources for path in src.iterdir() if (path / "__init__.py").is_file()
    ):
        files = [*package.rglob("*.py"), *package.rglob("*.pyi")]
        door = package / "__init__.pyi"
        names = (
            re.findall(r"^from \S+ import \w+ as (\w+)$", door.read_text(), re.MULTILINE)
            if door.is_file()
            else []
        )
        lines = sum(len(file.read_text(encoding="utf-8").splitlines()) for file in files)
        count = sum(map(tokens, files))
        row = {"files": len(files), "lines": lines, "tokens": count, "public_names": len(names)}
        rows.append({"member": package.name, **row})
    every = {
        name: sum(int(row[name]) for row in rows)
        for name in ("files", "lines", "tokens", "public_names")
    }
    return [*rows, {"member": "all", **every}]


class Constant(NamedTuple):
    """A named number, or a table of numbers."""

    module: str
    name: str
    """With its class, if it is a field of thresholds."""
    value: ast.expr
    words: str
    """Docstring below it, on one line; empty where there is none."""

    @property
    def tuned(self) -> bool:
        """It could have another value: no paper, standard or definition gives it."""
        return "Source:" not in self.words


def constants(source: Path) -> Iterator[Constant]:
    """Upper-case numbers of modules, numeric fields of ``*Thresholds``, and what states what it was
    chosen on."""
    for path in sorted(source.rglob("*.py")):
        module = _module(path, source)
        tree = ast.parse(path.read_text(encoding="utf-8"))
        groups = [("", tree.body)]
        for node in tree.body:
            if isinstance(node, ast.ClassDef) and node.name.endswith(THRESHOLDS):
                groups.append((f"{node.name}.", node.body))
        for prefix, body in groups:
            for line, following in itertools.zip_longest(body, body[1:], fillvalue=ast.Pass()):
                if not isinstance(line, ast.Assign | ast.AnnAssign) or line.value is None:
                    continue
                target = line.targets[0] if isinstance(line, ast.Assign) else line.target
                names = [node.id for node in ast.walk(target) if isinstance(node, ast.Name)]
                upper = all(name.lstrip("_").isupper() for name in names)
                words = " ".join((ast.get_docstring(ast.Module([following], [])) or "").split())
                number = _numeric(line.value) or CHOSEN in words
                if not ((prefix or upper) and number):
                    continue
                for name in names:
                    yield Constant(module, prefix + name, line.value, words)


def _numeric(value: ast.expr) -> bool:
    nodes = list(ast.walk(value))
    constants = [node.value for node in nodes if isinstance(node, ast.Constant)]
    return (
        any(isinstance(constant, int | float) for constant in constants if constant is not True)
        and not any(isinstance(constant, str | bytes | bool) for constant in constants)
        and not any(isinstance(node, ast.Lambda | ast.Dict) for node in nodes)
    )


def pages(docs: Path) -> dict[str, int]:
    """Words of every page, and ``all``: of those that are not generated."""
    words = {
        page.relative_to(docs).as_posix(): len(page.read_text(encoding="utf-8").split())
        for page in sorted(docs.rglob("*.md"))
    }
    return {**words, "all": sum(count for page, count in words.items() if page not in GENERATED)}


def tracked() -> list[Path]:
    """Every tracked Python file of the repository."""
    command = ["git", "-C", str(ROOT), "ls-files", "-z", "--", "*.py", "*.pyi"]
    names = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split("\0")
    return [ROOT / name for name in names if name and (ROOT / name).is_file()]


def measure(sources: Sequence[Path]) -> dict[str, float | int | None]:
    """All other figures by name."""
    house = House(sources)
    texts = [path.read_text(encoding="utf-8") for path in house.files.values()]
    names, parameters = house.module_names(), list(house.parameters())
    readme = ROOT / "README.md"
    return {
        "python_files": len(house.files),
        "lines": sum(len(text.splitlines()) for text in texts),
        "tokens_of_all_python": sum(map(tokens, tracked())),
        "settings_fields": house.settings_fields(),
        "names_of_modules": names.total(),
        "homonyms": sum(count > 1 for count in names.values()),
        "functions_with_whole_settings": sum(
            name not in ENTRIES and any(_takes_whole_settings(arg) for arg in arguments)
            for name, arguments in parameters
        ),
        "functions_with_many_parameters": sum(len(arguments) > 5 for _, arguments in parameters),
        "noqa": sum("noqa" in line for text in texts for line in text.splitlines()),
        "readme_words": (
            len(readme.read_text(encoding="utf-8").split()) if readme.is_file() else None
        ),
        "files_to_the_equations": len(house.chain(VERB, EQUATIONS)),
        "files_to_the_ply": len(house.chain(VERB, MESH)),
        "tuned_constants": sum(
            constant.tuned for source in sources for constant in constants(source)
        ),
        "import_circles": len(house.circles()),
        "one_importer_in_the_same_folder": len(house.single_importer()),
    }


def _takes_whole_settings(arg: ast.arg) -> bool:
    return arg.annotation is not None and "PipelineSettings" in ast.unparse(arg.annotation)


def _module(path: Path, src: Path) -> str:
    parts = path.relative_to(src).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def main() -> None:
    """Print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--src", type=Path, nargs="+", default=sorted(ROOT.glob("packages/*/src")))
    options = parser.parse_args()
    figures, by_member, words = measure(options.src), members(options.src), pages(ROOT / "docs")
    if options.json:
        sys.stdout.write(
            json.dumps({**figures, "members": by_member, "words": words}, indent=1) + "\n"
        )
        return
    lines = [f"{'member':24}{'files':>8}{'lines':>8}{'tokens':>9}{'public names':>14}"]
    lines += [
        f"{row['member']:24}{row['files']:8}{row['lines']:8}{row['tokens']:9}"
        f"{row['public_names']:14}"
        for row in by_member
    ]
    packages = [
        package for src in options.src for package in sorted(src.iterdir()) if package.is_dir()
    ]
    lines += ["", f"{'package':44}{'tokens':>8}"]
    lines += [
        f"{f'{package.name}.{name}':44}{count:8}"
        for package in packages
        for name, count in sorted(tokens_by_package(package).items())
    ]
    lines += [
        "",
        f"{'page':44}{'words':>8}",
        *(f"{page:44}{count:8}" for page, count in words.items()),
    ]
    lines += ["", *(f"{name.replace('_', ' '):34} {value}" for name, value in figures.items())]
    sys.stdout.write("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
