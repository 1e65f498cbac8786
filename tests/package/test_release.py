"""The files of a release agree with the package, and everything shipped has a licence."""

import fnmatch
import json
import re
import subprocess
import tomllib
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.version import Version

import shuttle_marl

ROOT = Path(__file__).parents[2]
RECIPE = (ROOT / "conda/recipe.yaml").read_text(encoding="utf-8")
CONDA = {"matplotlib": "matplotlib-base"}


def test_every_file_states_the_version() -> None:
    version = shuttle_marl.__version__
    assert json.loads((ROOT / "codemeta.json").read_text())["version"] == version
    assert json.loads((ROOT / ".zenodo.json").read_text())["version"] == version
    assert yaml.safe_load((ROOT / "CITATION.cff").read_text())["version"] == version
    assert yaml.safe_load(RECIPE)["context"]["version"] == version
    assert f"version = {{{version}}}" in (ROOT / "README.md").read_text()
    changelog = (ROOT / "CHANGELOG.md").read_text()
    (latest, *_) = re.findall(r"^## \[(\d[^\]]*)\] - \d{4}-\d\d-\d\d$", changelog, re.MULTILINE)
    if Version(version).is_devrelease:  # between two releases
        assert Version(latest) < Version(version)
        assert "## [Unreleased]\n" in changelog
    else:
        assert latest == version


def test_the_conda_recipe_has_the_dependencies_of_the_package() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    declared = {CONDA.get(need.name, need.name): str(need.specifier) for need in map(Requirement, project["dependencies"])}
    run = yaml.safe_load(RECIPE)["requirements"]["run"]
    assert {(need := Requirement(text)).name: str(need.specifier) for text in run if not text.startswith("python ")} == declared


@pytest.mark.parametrize("name", ["test", "docs", "release"])
def test_workflows_call_targets_that_exist(name: str) -> None:
    workflow = yaml.safe_load((ROOT / f".github/workflows/{name}.yml").read_text())
    targets = set(re.findall(r"^(\w[\w-]*):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    steps = [step.get("run", "") for job in workflow["jobs"].values() for step in job.get("steps", ())]
    called = {target for step in steps for target in re.findall(r"^make ([\w-]+)", step)}
    assert called <= targets
    assert workflow["permissions"] == {"contents": "read"}


def patterns() -> list[str]:
    text = (ROOT / "THIRD_PARTY_NOTICES.md").read_text(encoding="utf-8").partition("## Everything")[2].partition("\n## ")[0]
    rows = [line.split(" | ")[0] for line in text.splitlines() if line.startswith("| `")]
    return [pattern for row in rows for pattern in re.findall(r"`([^`]+)`", row)]


def unlicensed(names: list[str], known: list[str]) -> list[str]:
    return [name for name in names if not any(fnmatch.fnmatchcase(name, pattern) for pattern in known)]


def test_every_shipped_file_has_a_licence() -> None:
    done = subprocess.run(["git", "ls-files", "shuttle_marl"], cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        pytest.skip("not a checkout")
    names = [name.removeprefix("shuttle_marl/") for name in done.stdout.splitlines()]
    names += [f"watch/built/{name}" for name in ("index.html", "watch.js", "watch.css", "source.sha256")]
    known = patterns()
    assert unlicensed(names, known) == []
    assert unlicensed(["watch/page/font.woff2", "staging/hall.glb", "data/matches.csv"], known) == [
        "watch/page/font.woff2",
        "staging/hall.glb",
        "data/matches.csv",
    ]
    assert all(fnmatch.filter(names, pattern) for pattern in known), "every row names a file"
