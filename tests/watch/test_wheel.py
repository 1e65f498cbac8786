"""The built wheel in an environment with only what it requires: it serves the page, without Node and without a checkout."""

import http.client
import re
import signal
import subprocess
import sys
import venv
from importlib.metadata import distribution
from pathlib import Path

import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).parents[2]

pytestmark = pytest.mark.slow


def link_requirements(name: str, folder: Path, seen: set[str]) -> None:
    """Link to the installed files of what a distribution requires without extras, directly or not."""
    for need in map(Requirement, distribution(name).requires or []):
        if need.name in seen or (need.marker is not None and not need.marker.evaluate({"extra": ""})):
            continue
        seen.add(need.name)
        required = distribution(need.name)
        for part in {file.parts[0] for file in required.files or []} - {"..", "__pycache__"}:
            if not (folder / part).exists():
                (folder / part).symlink_to(str(required.locate_file(part)))
        link_requirements(need.name, folder, seen)


def test_the_wheel_serves_the_page(tmp_path: Path, page_folder: Path) -> None:
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path)]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    venv.create(tmp_path / "empty", with_pip=False)
    scripts = tmp_path / "empty" / ("Scripts" if sys.platform == "win32" else "bin")
    install = [
        sys.executable,
        "-m",
        "pip",
        "--python",
        str(scripts / "python"),
        "install",
        "-q",
        "--no-deps",
        "--no-index",
        str(wheel),
    ]
    subprocess.run(install, check=True, capture_output=True)
    (packages,) = (tmp_path / "empty").glob("[lL]ib/**/site-packages")
    link_requirements("shuttle-marl", packages, set())
    env = {"PATH": str(scripts), "HOME": str(tmp_path), "LANG": "C.UTF-8"}
    command = [str(scripts / "python"), "-m", "shuttle_marl.watch", "--no-browser", "--port", "0"]
    process = subprocess.Popen(command, cwd=tmp_path, env=env, stderr=subprocess.PIPE, text=True)
    try:
        said = process.stderr.readline()
        found = re.match(r"http://127\.0\.0\.1:(\d+)/ shows", said)
        assert found, said + process.stderr.read()
        connection = http.client.HTTPConnection("127.0.0.1", int(found[1]), timeout=60)
        for name in ("/", "/watch.js", "/watch.css", "/male.glb"):
            connection.request("GET", name)
            answer = connection.getresponse()
            assert answer.status == 200
            assert len(answer.read()) > 500
        connection.close()
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(20)
        process.stderr.close()
