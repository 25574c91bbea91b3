"""What mkdocs needs beside the pages: links out of ``docs``, the help of every verb, public names,
tables made of the code, executed notebooks.

``mkdocs.yml`` names this file. A link to a table of the repository leads to a copy in the site, one
to any other file that is not a page becomes the file's path; one that leads nowhere ends a strict
build, as does a public name without a docstring, or a page that would fetch something when it is
read.
"""

from __future__ import annotations

import importlib
import logging
import os
import re
import runpy
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
LOG = logging.getLogger("mkdocs.hooks.splitknit")
"""Warnings of this logger end a strict build."""
TABLES = ("settings", "findings", "parameters")
"""What ``reference_tables.py`` makes of the code."""
DOORS = ("splitknit", "splitknit_simulator", "splitknit_rig", "splitknit_match")
"""What users import: ``__all__`` of each."""
ARRAYS = (
    "splitknit.photometric.lambertian.lambertian",
    "splitknit.photometric.robust.robust",
    "splitknit.photometric.near_light.near_light",
    "splitknit.photometric.near_light.pseudo_normals",
    "splitknit.imaging.light_field.light_vectors_at",
    "splitknit.integration.frankot_chellappa.frankot_chellappa",
    "splitknit.integration.poisson.poisson",
    "splitknit.integration.poisson.piecewise",
    "splitknit.integration.shapelets.shapelets",
    "splitknit.integration.shapelets.shapelet_response",
)
"""Functions on arrays that are public as well."""
RESULTS = (
    "splitknit_match.prints.make.Print",
    "splitknit_match.matching.results.Match",
    "splitknit_match.matching.results.ComparedSide",
    "splitknit_match.matching.results.MatchDecision",
    "splitknit_match.gallery.identify.Identification",
    "splitknit_match.gallery.identify.RankedCandidate",
    "splitknit_match.gallery.identify.Searched",
    "splitknit_match.evaluation.evaluate.Evaluation",
    "splitknit_match.evaluation.evaluate.Result",
    "splitknit_rig.calibration.camera_photos.MeasuredCamera",
    "splitknit_rig.calibration.lights_found.CalibratedLights",
    "splitknit_rig.calibration.lights.CalibratedLed",
    "splitknit_rig.calibration.radiometry.RadiometricCalibration",
)
"""What public functions return."""


COPIED = (".csv", ".json")
"""Endings of tables, which a reader may want to open."""


def inside(markdown: str, folder: Path, add: Callable[[Path], str]) -> str:
    """Replace links to files outside `DOCS` by the files' paths; `add` takes a picture or a table
    into the site."""

    def path_of(link: re.Match[str]) -> str:
        label, target = link[2], link[3].partition("#")[0]
        if "://" in target or not target:
            return link[0]
        file = Path(os.path.normpath(folder / target))
        if file.is_relative_to(DOCS):
            return link[0]
        if not file.exists():
            LOG.warning("%s: no file %s", folder.relative_to(ROOT), target)
            return link[0]
        if link[1] or file.suffix in COPIED:
            return f"{link[1]}[{label}]({os.path.relpath(DOCS / add(file), folder)})"
        name = file.relative_to(ROOT).as_posix()
        return f"`{name}`" if label.strip("`") in (name, file.name) else f"{label} (`{name}`)"

    parts = re.split(r"(^ *```.*?^ *```$)", markdown, flags=re.DOTALL | re.MULTILINE)
    return "".join(
        part if "```" in part else re.sub(r"(!?)\[([^\]]+)\]\(([^)\s]+)\)", path_of, part)
        for part in parts
    )


def help_of_every_verb() -> str:
    """`--help` of every verb, as Markdown."""
    os.environ["COLUMNS"] = "110"
    cli = importlib.import_module("splitknit.cli.app")
    app = cli.build_app()
    return "\n\n".join(
        f"### `splitknit {' '.join(words)}`\n\n```\n{cli.help_of(app, words).rstrip()}\n```"
        for words in cli.words_of_verbs(app)
    )


def public_names() -> str:
    """One entry of the page for each public name."""
    parts = []
    doors = [f"{door}.{name}" for door in DOORS for name in importlib.import_module(door).__all__]
    titles = {RESULTS[0]: "Results", ARRAYS[0]: "Functions on arrays"}
    for door in DOORS[1:]:
        titles[next(full for full in doors if full.startswith(f"{door}."))] = door
    for full in (*doors, *RESULTS, *ARRAYS):
        module, _, name = full.rpartition(".")
        value: Any = getattr(importlib.import_module(module), name)
        if full in titles:
            parts.append(f"## {titles[full]}")
        if isinstance(value, str):  # the version
            continue
        words = (value.__doc__ or "").strip()
        if not words or words.startswith(f"{name}("):  # what dataclasses write themselves
            LOG.warning("%s is public and has no docstring", full)
        parts.append(f"::: {full}")
    return "\n\n".join(parts)


def table(name: str) -> str:
    """One of :data:`TABLES`, as Markdown."""
    text: str = runpy.run_path(str(ROOT / "tools" / "reference_tables.py"))["TABLES"][name]()
    return text


def executed(notebook: Path, files_folder: str) -> tuple[str, dict[str, bytes]]:
    """A notebook, run in a folder of its own, as Markdown, and the pictures it drew by their names
    from that page."""
    import nbformat  # the tests load this file without what builds the site
    from nbconvert import MarkdownExporter
    from nbconvert.preprocessors import ExecutePreprocessor

    run = nbformat.read(notebook, as_version=4)
    with tempfile.TemporaryDirectory() as folder:
        # an error ends the build
        ExecutePreprocessor(timeout=300).preprocess(run, {"metadata": {"path": folder}})
    text, resources = MarkdownExporter().from_notebook_node(run, {"output_files_dir": files_folder})
    return text, resources["outputs"]


def on_files(files: Any, config: Any) -> None:
    """Run the notebooks and put their pages into the site, beside the notebooks themselves (an
    event of mkdocs)."""
    from mkdocs.structure.files import File

    for notebook in [file for file in files if file.src_uri.endswith(".ipynb")]:
        source = Path(notebook.abs_src_path)
        text, pictures = executed(source, f"{source.stem}_files")
        title, _, rest = text.strip().partition("\n")
        text = f"{title}\n\n[This page as a notebook]({source.name})\n{rest}\n"
        files.append(
            File.generated(config, notebook.src_uri.replace(".ipynb", ".md"), content=text)
        )
        folder = Path(notebook.src_uri).parent.as_posix()
        for name, content in pictures.items():
            files.append(File.generated(config, f"{folder}/{name}", content=content))


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:
    """Complete one page (an event of mkdocs)."""

    from mkdocs.structure.files import File  # the tests load this file without mkdocs

    def add(file: Path) -> str:
        uri = f"outside/{file.relative_to(ROOT).as_posix()}"
        if files.get_file_from_path(uri) is None:
            files.append(File.generated(config, uri, abs_src_path=str(file)))
        return uri

    for mark, make in (
        ("<!-- help of every verb -->", help_of_every_verb),
        ("<!-- public names -->", public_names),
        *((f"<!-- {name} -->", partial(table, name)) for name in TABLES),
    ):
        if mark in markdown:
            markdown = markdown.replace(mark, make())
    # GitHub wants them escaped
    markdown = re.sub(r"`[^`\n]*`", lambda code: code[0].replace("\\|", "|"), markdown)
    here = DOCS / page.file.src_uri
    if not here.with_suffix(".ipynb").exists():  # which links to the notebook itself
        markdown = re.sub(r"(\]\([^)\s:]+)\.ipynb\)", r"\1.md)", markdown)
    return inside(markdown, here.parent, add)


def on_page_content(html: str, **_: Any) -> str:
    """Take the roles out of docstrings (an event of mkdocs)."""
    return re.sub(r":(?:func|class|data|mod|meth|attr):(?=<code>|`)", "", html)


def on_post_build(config: Any, **_: Any) -> None:
    """Take out what the theme would fetch, and look for what is left (an event of mkdocs)."""
    site = Path(config["site_dir"])
    for script in (site / "assets" / "javascripts").glob("bundle.*.js"):
        text = script.read_text(encoding="utf-8")
        script.write_text(
            re.sub(r"https://(unpkg\.com|api\.github\.com)[^\"`$]*", "about:blank", text),
            encoding="utf-8",
        )
    for page in site.rglob("*.html"):
        for url in re.findall(
            r"<(?:script|img|iframe|link)\b[^>]*(?:src|href)=\"?(https?://[^\">]+)",
            page.read_text("utf-8"),
        ):
            LOG.warning("%s fetches %s", page.relative_to(site), url)
