"""The shipped wheel and repository, and the files of a release: complete, licensed, and without data of others."""

import ast
import fnmatch
import hashlib
import json
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from importlib.metadata import packages_distributions, requires
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

import shuttle_marl

ROOT = Path(__file__).parents[2]
TEXT_LIMIT = 1 << 20


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dist")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    (path,) = folder.glob("*.whl")
    return path


def declared_requirements(*, without: str = "") -> list[Requirement]:
    """Requirements of pyproject.toml, with all extras but one; not what the metadata of an older installation say."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = [texts for extra, texts in project["optional-dependencies"].items() if extra != without]
    texts = [*project["dependencies"], *(text for extra in extras for text in extra)]
    return [need for need in map(Requirement, texts) if need.name != project["name"]]


def tracked() -> list[Path]:
    """Files of the repository; of an unpacked source distribution, all files outside hidden folders and caches."""
    done = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode == 0:
        names = [name for name in done.stdout.split("\0") if name]
    else:
        names = [
            str(name)
            for name in (path.relative_to(ROOT) for path in ROOT.rglob("*"))
            if not any(part[0] == "." or part == "__pycache__" for part in name.parts)
        ]
    return [ROOT / name for name in names if (ROOT / name).is_file()]


def test_wheel_holds_the_package_and_nothing_else(wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())
    page = ROOT / "shuttle_marl" / "court" / "page"  # without its sources, the built page is not taken for an outdated one
    package = [path for path in tracked() if (ROOT / "shuttle_marl") in path.parents and page not in path.parents]
    assert {str(path.relative_to(ROOT)) for path in package} <= names
    assert [name for name in names if name.startswith("shuttle_marl/court/page")] == []
    assert {"shuttle_marl/py.typed", "shuttle_marl/models/default/game.safetensors"} <= names
    assert {name.split("/")[0].split("-")[0] for name in names} == {"shuttle_marl"}
    assert [name for name in names if name.endswith((".csv", ".pyc"))] == ["shuttle_marl/data/template/strokes.csv"]


def test_source_distribution_holds_tracked_files_and_nothing_else(tmp_path: Path) -> None:
    """Annotated matches are often linked into a checkout, where only the developer's git ignores them."""
    root, foreign = tmp_path / "root", tmp_path / "matches"
    names = {str(path.relative_to(ROOT)) for path in tracked()}
    for name in names:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(ROOT / name, root / name)
    foreign.mkdir()
    (foreign / "set1.csv").write_text("private")
    (root / "shuttleset").symlink_to(foreign, target_is_directory=True)
    command = [sys.executable, "-m", "hatchling", "build", "-t", "sdist", "-d", str(tmp_path / "dist")]
    subprocess.run(command, cwd=root, check=True, capture_output=True)
    (path,) = (tmp_path / "dist").glob("*.tar.gz")
    with tarfile.open(path) as archive:
        packed = {member.name.partition("/")[2] for member in archive.getmembers() if not member.isdir()}
    assert packed - names == {"PKG-INFO"}
    assert names - packed == set()


def test_wheel_carries_licence_and_extras(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        licences = {name.partition("/licenses/")[2]: name for name in archive.namelist() if "/licenses/" in name}
        assert set(licences) == {
            "LICENSE",
            "THIRD_PARTY_NOTICES.md",
            "shuttle_marl/data/upstream/LICENSE",
            "shuttle_marl/court/staging/athletes/LICENSE-CC0.md",
        }
        for file, name in licences.items():
            assert archive.read(name) == (ROOT / file).read_bytes()
        (metadata,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        text = archive.read(metadata).decode()
        (points,) = (name for name in archive.namelist() if name.endswith(".dist-info/entry_points.txt"))
        assert "shuttle-marl = shuttle_marl.__main__:main" in archive.read(points).decode().splitlines()
    header, _, description = text.partition("\n\n")
    assert "License-Expression: MIT AND CC0-1.0" in header
    assert re.findall(r"^Project-URL: [^,]+, (\S+)$", header, re.MULTILINE)
    # Relative links would be broken on a package index.
    assert re.findall(r"\]\((?!https?:|#)", description) == []
    assert "## Data and citations" in description
    needed = [line for line in text.splitlines() if line.startswith("Requires-Dist:") and "extra ==" not in line]
    assert needed
    assert [line for line in needed if "torch" in line] == []


def test_notices_hold_the_licence_of_every_bundled_library() -> None:
    notices = (ROOT / "THIRD_PARTY_NOTICES.md").read_text(encoding="utf-8")
    lock = json.loads((ROOT / "shuttle_marl/court/page/package-lock.json").read_text(encoding="utf-8"))
    bundled = {name.rpartition("node_modules/")[2]: each for name, each in lock["packages"].items() if name and "dev" not in each}
    assert set(bundled) == {"three"}
    assert bundled["three"]["license"] == "MIT"
    assert f"## three.js {bundled['three']['version']}" in notices
    text = notices.replace("> ", "").replace(">", "")
    for licence in (ROOT / "shuttle_marl/data/upstream/LICENSE", ROOT / "LICENSE"):
        conditions = licence.read_text(encoding="utf-8").partition("Permission is hereby granted")[2].strip()
        assert " ".join(conditions.split()) in " ".join(text.split())


def test_every_import_is_of_a_declared_dependency() -> None:
    declared = {canonicalize_name(need.name) for need in declared_requirements()}
    imported: set[str] = set()
    sources = [path for path in tracked() if path.suffix == ".py"]
    for source in sources:
        for node in ast.walk(ast.parse(source.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                imported |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                imported.add(node.module.split(".")[0])
            elif isinstance(node, ast.Call) and getattr(node.func, "attr", "") == "importorskip":
                imported.add(ast.literal_eval(node.args[0]).split(".")[0])
    own = {part for path in sources for part in path.relative_to(ROOT).with_suffix("").parts}
    foreign = imported - sys.stdlib_module_names - own
    assert {"numpy", "tyro", "pytest"} <= foreign
    providers = packages_distributions()
    # A library that is not installed has the name of its distribution.
    found = {name: {canonicalize_name(d) for d in providers.get(name, (name,))} for name in foreign}
    assert [name for name in sorted(foreign) if not found[name] & declared] == []


def test_environment_of_the_tests_is_the_pinned_one() -> None:
    """Every distribution that the package and its extras need, directly or not, has a pin, but Ray, which users install.

    The environment of the tests has no notebooks. Builds of PyTorch for GPUs need libraries that those for CPUs do not.
    """
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pinned = {canonicalize_name(line.split("==")[0]) for line in lines if "==" in line}
    needs = [need for need in declared_requirements(without="notebooks") if need.name != "ray"]
    queue = [(canonicalize_name(need.name), extra) for need in needs for extra in ("", *need.extras)]
    seen: set[tuple[str, str]] = set()
    while queue:
        name, extra = queue.pop()
        if (name, extra) in seen:
            continue
        seen.add((name, extra))
        for need in map(Requirement, requires(name) or []):
            if need.marker is None or need.marker.evaluate({"extra": extra}):
                queue += [(canonicalize_name(need.name), e) for e in ("", *need.extras)]
    assert {name for name, _ in seen if not name.startswith(("cuda-", "nvidia-", "triton"))} <= pinned


def test_no_file_of_the_annotated_matches_is_tracked() -> None:
    """The package knows the SHA-256 of every file of the data sets."""
    manifest = (ROOT / "shuttle_marl" / "data" / "upstream" / "MANIFEST.sha256").read_text(encoding="utf-8")
    foreign = {line.split()[0] for line in manifest.splitlines() if line.endswith(".csv")}
    assert len(foreign) > 100
    files = {path: hashlib.sha256(path.read_bytes()).hexdigest() for path in tracked()}
    assert [path for path, digest in files.items() if digest in foreign] == []
    named = [path for path in files if re.fullmatch(r"(set\d+|match)\.csv", path.name)]
    assert [path for path in named if "cases" not in path.parts] == [], "files of cases are small and invented"


def test_no_file_names_a_folder_of_a_certain_machine() -> None:
    home = re.compile(rb"(?<![\w.~)}/*-])/(?:home|root|Users|opt|work|mnt|srv)/\w")
    texts = [path for path in tracked() if path.stat().st_size < TEXT_LIMIT and b"\0" not in path.read_bytes()]
    assert len(texts) > 20
    found = {str(path.relative_to(ROOT)): match[0] for path in texts if (match := home.search(path.read_bytes()))}
    assert found == {}
    assert home.search(b"see /ho" + b"me/me/data")


RECIPE = (ROOT / "conda/recipe.yaml").read_text(encoding="utf-8")
CONDA = {"matplotlib": "matplotlib-base"}


def test_workflows_pin_actions_and_read_only() -> None:
    workflows = sorted((ROOT / ".github/workflows").glob("*.yml"))
    assert len(workflows) > 3
    for path in workflows:
        text = path.read_text(encoding="utf-8")
        assert yaml.safe_load(text)["permissions"] == {"contents": "read"}
        foreign = [name for name in re.findall(r"uses: (\S+)", text) if not name.startswith("./")]
        assert [name for name in foreign if not re.search(r"@[0-9a-f]{40}$", name)] == []


def test_the_changelog_states_both_games() -> None:
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert [name for name in ("default", "default:recovery") if shuttle_marl.load_game(name).hash not in text] == []


def test_every_file_states_the_version() -> None:
    version = shuttle_marl.__version__
    assert json.loads((ROOT / "codemeta.json").read_text())["version"] == version
    assert json.loads((ROOT / ".zenodo.json").read_text())["version"] == version
    assert yaml.safe_load((ROOT / "CITATION.cff").read_text())["version"] == version
    assert yaml.safe_load(RECIPE)["context"]["version"] == version
    assert f"version = {{{version}}}" in (ROOT / "docs/index.md").read_text()
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


def test_every_shipped_file_has_a_licence() -> None:
    done = subprocess.run(["git", "ls-files", "shuttle_marl"], cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        pytest.skip("not a checkout")
    names = [name.removeprefix("shuttle_marl/") for name in done.stdout.splitlines()]
    names += [f"court/built/{name}" for name in ("index.html", "watch.js", "watch.css", "source.sha256")]
    text = (ROOT / "THIRD_PARTY_NOTICES.md").read_text(encoding="utf-8").partition("## Everything")[2].partition("\n## ")[0]
    rows = [line.split(" | ")[0] for line in text.splitlines() if line.startswith("| `")]
    known = [pattern for row in rows for pattern in re.findall(r"`([^`]+)`", row)]
    assert [name for name in names if not any(fnmatch.fnmatchcase(name, pattern) for pattern in known)] == []
    assert all(fnmatch.filter(names, pattern) for pattern in known), "every row names a file"
