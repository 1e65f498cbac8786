"""Programs that tests need, and what is done where they are missing."""

import json
import os
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest

from shuttle_marl.court import WatchError
from shuttle_marl.court.building import node
from shuttle_marl.court.server import browser_program

_BROWSER, _READERS = (Path(__file__).parent / name for name in ("browser", "recording/typescript"))


def missing(reason: str) -> None:
    """Skip what needs something that is not here; where every change is checked, fail."""
    if os.environ.get("CI") == "true":
        raise RuntimeError(reason)
    pytest.skip(reason)


def installed(source: Path, folder: Path, what: str) -> str:
    """Node, with whose npm the packages of a folder are installed into a copy of it."""
    program, npm = node(), shutil.which("npm")
    if program is None or npm is None:
        missing(f"needs {what}, or Node and npm to fetch it")
    shutil.copytree(source, folder, ignore=shutil.ignore_patterns("node_modules"), dirs_exist_ok=True)
    install = [str(npm), "ci", "--ignore-scripts", "--no-audit", "--no-fund"]
    done = subprocess.run(install, cwd=folder, capture_output=True, text=True, check=False, timeout=300)
    if done.returncode:
        missing(f"npm cannot fetch {what}: {done.stderr[-500:]}")
    return str(program)


def node_readers(folder: Path, script: Path) -> list[str]:
    """The command that runs a script with the official readers of MCAP and Arrow, which npm installs into a folder."""
    program = installed(_READERS, folder, "the readers")
    shutil.copy(script, folder)
    return [program, str(folder / script.name)]


def chromium(folder: Path) -> str:
    """Chromium: of the machine, else from npm, unpacked into a folder.

    The one from npm, which stays there, is a script that sets its libraries, fonts and renderer; those of the machine may be too
    old or missing.
    """
    try:
        return browser_program()
    except WatchError:
        pass
    script = folder / "chromium.sh"
    if script.exists():  # written last
        return str(script)
    # It is unpacked into the folder for temporary files, which may hold another version or an incomplete one.
    place = {**os.environ, "TMPDIR": str(folder)}
    program = installed(_BROWSER, folder, "Chromium")
    said = subprocess.run([program, "where.mjs"], cwd=folder, env=place, capture_output=True, check=True).stdout
    found = {name: shlex.quote(value) for name, value in json.loads(said).items()}
    # Its configuration looks for fonts in /tmp; without any font Chromium ends as soon as it draws text.
    fonts = folder / "fonts" / "fonts.conf"
    fonts.write_text(fonts.read_text().replace(">/tmp/", f">{folder}/"))
    script.write_text(
        "#!/bin/sh\n"
        f"LD_LIBRARY_PATH={found['libraries']} FONTCONFIG_PATH={found['fonts']} "
        f'exec {found["path"]} "$@" --use-angle=swiftshader\n'
    )
    script.chmod(0o755)
    return str(script)
