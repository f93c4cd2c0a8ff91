"""Files around the package: versions agree, workflows and forms say what is there."""

from __future__ import annotations

import json
import re
import runpy
import tomllib
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

from twinct.version import __version__

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
WORKFLOWS = sorted(ROOT.glob(".github/workflows/*.yml"))
PYTHONS = ["3.11", "3.12", "3.13"]


def check(function: str, *arguments: str) -> list[str]:
    tool = runpy.run_path(str(ROOT / "tools" / "check_release.py"))
    return [*tool[function](*arguments)]


def test_all_files_state_one_version() -> None:
    assert check("versions") == []


def test_a_release_needs_its_tag_addresses_and_a_dated_section() -> None:
    found = "\n".join(check("release", "v0.0.9"))
    assert f"so the tag is v{__version__}" in found
    tagged = check("release", f"v{__version__}")
    assert not any("so the tag is" in problem for problem in tagged)
    placeholders = [url for url in PROJECT["urls"].values() if ".example/" in url]
    assert sum("is a placeholder" in problem for problem in tagged) == len(placeholders)


def test_llvmlite_is_bounded_by_numba_alone() -> None:
    needed = {one.name: one for one in map(Requirement, PROJECT["dependencies"])}
    for name in ("numba", "llvmlite"):
        assert not any(bound.operator in ("<", "<=", "==") for bound in needed[name].specifier)


def test_the_pythons_are_the_same_everywhere() -> None:
    told = [c.split(" :: ")[-1] for c in PROJECT["classifiers"] if ":: Python :: " in c]
    assert told == PYTHONS
    for name in ("tests", "release"):
        text = (ROOT / ".github" / "workflows" / f"{name}.yml").read_text(encoding="utf-8")
        assert yaml.safe_load(re.search(r"python: (\[.*\])\}", text)[1]) == PYTHONS


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.stem)
def test_a_workflow_runs_targets_and_files_that_exist(path: Path) -> None:
    workflow = yaml.safe_load(path.read_text(encoding="utf-8"))
    steps = [step for job in workflow["jobs"].values() for step in job["steps"]]
    lines = [step["run"] for step in steps if "run" in step]
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    for line in lines:
        for target in re.findall(r"\bmake ([a-z-]+)", line):
            assert target in targets, line
        for file in re.findall(r"(?:^|\s)((?:tools|\.ci)/[\w.-]+)", line):
            assert (ROOT / file).is_file(), line
    assert all("uses" in step or "run" in step for step in steps)


def test_ci_runs_the_same_command_as_the_workflow() -> None:
    text = (ROOT / ".github" / "workflows" / "tests.yml").read_text(encoding="utf-8")
    assert "run: .ci/run" in text


@pytest.mark.parametrize("path", sorted(ROOT.glob(".github/ISSUE_TEMPLATE/*.yml")), ids=str)
def test_issue_forms_have_the_fields_that_a_form_needs(path: Path) -> None:
    form = yaml.safe_load(path.read_text(encoding="utf-8"))
    if path.name == "config.yml":
        assert form.keys() <= {"blank_issues_enabled", "contact_links"}
        return
    assert form["name"] and form["description"] and form["body"]
    kinds = {"input", "textarea", "checkboxes", "dropdown", "markdown"}
    ids = [field.get("id") for field in form["body"]]
    assert len(set(ids)) == len(ids)
    for field in form["body"]:
        assert field["type"] in kinds and field["attributes"]["label"]


def test_the_conda_recipe_needs_what_the_package_needs() -> None:
    recipe = yaml.safe_load((ROOT / "packaging/conda/recipe.yaml").read_text(encoding="utf-8"))
    conda = {"matplotlib-base": "matplotlib"}
    needed = {}
    for line in recipe["requirements"]["run"]:
        name, _, bound = line.partition(" ")
        needed[conda.get(name, name)] = SpecifierSet(bound)
    assert needed.pop("__linux") == SpecifierSet("")
    assert needed.pop("python") == SpecifierSet(PROJECT["requires-python"])
    assert needed == {one.name: one.specifier for one in map(Requirement, PROJECT["dependencies"])}


def test_citation_and_zenodo_agree() -> None:
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    stored = json.loads((ROOT / ".zenodo.json").read_text(encoding="utf-8"))
    assert cited["title"] == stored["title"]
    assert cited["license"] == stored["license"] == PROJECT["license"]
    assert [one["name"] for one in cited["authors"]] == [one["name"] for one in stored["creators"]]


def test_contributing_says_which_of_these_were_never_executed_here() -> None:
    page = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    told = page.partition("never executed here")[2]
    for path in (*WORKFLOWS, ROOT / "Dockerfile", ROOT / ".devcontainer", ROOT / "packaging/conda"):
        assert str(path.relative_to(ROOT)) in told, path


def test_the_page_of_packages_names_every_extra_and_system_library() -> None:
    page = (ROOT / "docs" / "packages.md").read_text(encoding="utf-8")
    named = set(re.findall(r"^\| `(\w+)` \|", page, re.MULTILINE))
    assert named == PROJECT["optional-dependencies"].keys() - {"dev", "docs"}
    script = (ROOT / "tools" / "system-libraries").read_text(encoding="utf-8")
    for library in re.search(r"packages=\(\n(.*?)\n\)", script, re.DOTALL)[1].split():
        assert f" {library}" in page, library


def test_users_get_the_versions_of_ros_that_are_locked():
    """One of these packages runs at every start of Python (docs/security.md)."""
    locked = set(
        re.findall(r"^(ros-[a-z0-9-]+==\S+)", (ROOT / "constraints.txt").read_text(), re.M)
    )
    stated = {word for word in PROJECT["optional-dependencies"]["ros"] if word.startswith("ros-")}
    assert stated == locked
    assert any(word.startswith("ros-wheels-bootstrapper==") for word in stated)
