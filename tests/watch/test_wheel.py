"""The built wheel in an empty environment: it serves the page, without Node and without a checkout."""

import http.client
import os
import re
import signal
import subprocess
import sys
import venv
from pathlib import Path

import pytest

from tests.needs import missing

ROOT = Path(__file__).parents[2]

pytestmark = pytest.mark.slow


@pytest.mark.slow(minutes=True)
def test_the_wheel_serves_the_page(tmp_path: Path, page_folder: Path) -> None:
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path)]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    venv.create(tmp_path / "empty", with_pip=True)
    scripts = tmp_path / "empty" / ("Scripts" if sys.platform == "win32" else "bin")
    install = [str(scripts / "python"), "-m", "pip", "install", "-q", "-c", str(ROOT / "constraints.txt"), str(wheel)]
    env = {"PATH": str(scripts), "HOME": str(tmp_path), "LANG": "C.UTF-8"}
    env |= {name: value for name, value in os.environ.items() if name.startswith("PIP_") or name.lower().endswith("_proxy")}
    done = subprocess.run(install, env=env, capture_output=True, text=True, check=False)
    if done.returncode:
        missing(f"the wheel cannot be installed: {done.stderr[-500:]}")
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
