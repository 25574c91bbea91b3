"""What installs the program agrees with pyproject.toml: wheel, conda recipe, environment.yml,
Dockerfile, workflow."""

import re
import tomllib
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[1]
MEMBERS = ("splitknit", "splitknit-simulator", "splitknit-rig", "splitknit-match")
PROJECTS = {
    name: tomllib.loads((ROOT / "packages" / name / "pyproject.toml").read_text(encoding="utf-8"))[
        "project"
    ]
    for name in MEMBERS
}
PROJECT = PROJECTS["splitknit"]
NEEDED = sorted(
    {
        requirement
        for project in PROJECTS.values()
        for requirement in project["dependencies"]
        if not requirement.startswith("splitknit")
    }
)
"""By any member, but for the members themselves."""
CONDA = {"opencv-python-headless": "py-opencv", "matplotlib": "matplotlib-base"}
"""Names that differ there."""


def of_conda(requirements):
    """`numpy>=2.0` as conda writes it."""
    names = [
        re.fullmatch(r"([\w-]+)(>=[\d.,<]+)(; .*)?", requirement) for requirement in requirements
    ]
    assert all(names), requirements
    return {f"{CONDA.get(match[1], match[1])} {match[2]}" for match in names if match}


@pytest.mark.parametrize("member", MEMBERS)
def test_the_wheel_holds_every_file_of_the_package(member):
    """No rule of .gitignore, which hatchling obeys, takes out networks, presets, pages or
    licences."""
    wheel = pytest.importorskip("hatchling.builders.wheel")
    home = ROOT / "packages" / member
    held = {
        file.distribution_path for file in wheel.WheelBuilder(str(home)).recurse_included_files()
    }
    files = [path.relative_to(home / "src") for path in (home / "src").rglob("*") if path.is_file()]
    kept = {path.as_posix() for path in files if "__pycache__" not in path.parts}
    assert held == kept
    assert any(name.endswith("/py.typed") for name in held) and any(
        name.endswith("/__init__.pyi") for name in held
    )
    if member == "splitknit":
        assert {Path(name).suffix for name in held} >= {
            ".onnx",
            ".npz",
            ".json",
            ".html",
            ".js",
            ".css",
        }
    for licence in PROJECTS[member]["license-files"]:
        assert (home / licence).is_file()


def test_members_have_one_version_and_need_each_other_in_it():
    assert {project["version"] for project in PROJECTS.values()} == {PROJECT["version"]}
    for name, project in PROJECTS.items():
        others = {
            requirement
            for requirement in project["dependencies"]
            if requirement.startswith("splitknit")
        }
        wanted = set() if name == "splitknit" else {"splitknit"}
        assert others == {f"{requirement}=={PROJECT['version']}" for requirement in wanted}


def test_the_core_needs_nine_packages_and_none_of_the_large_ones():
    names = {re.split(r"[^\w-]", text)[0] for text in PROJECT["dependencies"]}
    assert len(names) <= 9 and not names & {"cryptography", "pyarrow", "torch", "matplotlib"}


def test_the_conda_recipe_needs_what_the_project_needs():
    text = (ROOT / "conda" / "meta.yaml").read_text(encoding="utf-8")
    recipe = yaml.safe_load(re.sub(r"{{ *(\w+) *}}", r"\1", text))
    assert recipe["package"] == {"name": PROJECT["name"], "version": PROJECT["version"]}
    assert set(recipe["requirements"]["run"]) == of_conda(NEEDED) | {
        f"python {PROJECT['requires-python']}"
    }
    ((name, target),) = PROJECT["scripts"].items()
    assert recipe["build"]["entry_points"] == [f"{name} = {target}"]
    assert recipe["about"]["license"] == PROJECT["license"]
    assert recipe["about"]["license_file"] == [
        "LICENSE",
        "packages/splitknit/src/splitknit/report/static/three/LICENSE",
    ]


def test_the_conda_environment_has_the_extra_plot():
    environment = yaml.safe_load((ROOT / "environment.yml").read_text(encoding="utf-8"))
    needed = of_conda(NEEDED + PROJECTS["splitknit-match"]["optional-dependencies"]["plot"])
    conda = {
        requirement for requirement in environment["dependencies"] if isinstance(requirement, str)
    }
    assert conda - {"pip", "python >=3.11,<3.14"} == needed
    assert environment["dependencies"][-1] == {"pip": [f"./packages/{name}" for name in MEMBERS]}


def test_the_docker_image_is_made_of_files_that_are_let_in():
    text = (ROOT / "Dockerfile").read_text(encoding="utf-8")
    copied = {
        name
        for line in re.findall(r"^COPY (?!--)(.*) \S+$", text, flags=re.MULTILINE)
        for name in line.split()
    }
    let_in = set(
        re.findall(
            r"^!(.*)$", (ROOT / ".dockerignore").read_text(encoding="utf-8"), flags=re.MULTILINE
        )
    )
    assert copied == let_in
    assert all((ROOT / name).exists() for name in copied)
    assert "'splitknit-match[plot,serve]'" in text


def test_everything_is_installed_as_the_constraints_say():
    """Every pip command of Makefile, Dockerfile and workflow checks hashes, or takes the project
    alone."""
    for name in ("Makefile", "Dockerfile", ".github/workflows/ci.yml"):
        text = (ROOT / name).read_text(encoding="utf-8").replace("\\\n", " ")
        lines = [
            line for line in text.splitlines() if re.search(r"pip (install|wheel|sync) ", line)
        ]
        commands = [
            command
            for line in lines
            for command in line.split("&&")
            if re.search(r"pip (install|wheel) ", command)
        ]
        assert len(commands) >= 3, name
        assert all(
            "--require-hashes" in command or "--no-deps" in command or "`" in command
            for command in commands
        ), name
        assert "PIP_BUILD_CONSTRAINT" in text, name
    assert "pip uninstall --quiet --quiet --yes setuptools" in (ROOT / "Makefile").read_text(
        encoding="utf-8"
    )


def test_the_workflow_runs_what_is_there_on_versions_that_are_declared():
    workflow = yaml.safe_load(
        (ROOT / ".github" / "workflows" / "ci.yml").read_text(encoding="utf-8")
    )
    jobs = workflow["jobs"]
    assert any(step.get("run") == ".ci/run" for step in jobs["linux"]["steps"])
    tested = {case["python"] for case in jobs["unit"]["strategy"]["matrix"]["include"]} | {"3.11"}
    declared = {
        classifier.rpartition(" ")[2]
        for classifier in PROJECT["classifiers"]
        if re.search(r":: 3\.\d+$", classifier)
    }
    assert tested == declared
    pinned = [step["uses"] for job in jobs.values() for step in job["steps"] if "uses" in step]
    assert all(re.fullmatch(r"actions/[\w-]+@[0-9a-f]{40}", action) for action in pinned)
