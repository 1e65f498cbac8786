"""Boundaries around the code of a stranger: a container, or namespaces of Linux by ``unshare`` and ``setpriv`` of util-linux.

Inside are the interpreter with its installed libraries but this package, the committed files, an empty ``/tmp``, and two pipes.
There is no network, no other process, no privilege, and no file of anybody. A probe inside looks whether that holds
(:func:`find_boundary`), so a machine that cannot keep the promise refuses to rerun anything.
"""

import contextlib
import dataclasses
import os
import secrets
import shlex
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from shuttle_marl.suite.options import SuiteError

CODE: Final = "/code"
"""Folder of the code inside."""
_SHOWN: Final = ("/usr", "/bin", "/lib", "/lib64", "/etc/ld.so.cache", "/etc/alternatives")
_DEVICES: Final = ("null", "zero", "urandom")
_SECONDS: Final = 120.0
_ENVIRONMENT: Final = ("PATH=/usr/bin:/bin", "HOME=/tmp", "LANG=C.UTF-8", "OMP_NUM_THREADS=1", "PYTHONDONTWRITEBYTECODE=1")
_PROBE: Final = """
import importlib.util, os, socket
import numpy
status = dict(line.split(":", 1) for line in open("/proc/self/status") if ":" in line)
found = {
    "the package": importlib.util.find_spec("shuttle_marl") is not None,
    "a network": any(name != "lo" for _, name in socket.if_nameindex()),
    "privileges": int(status["CapEff"], 16) != 0 or int(status["CapBnd"], 16) != 0 or status["NoNewPrivs"].strip() != "1",
    "other processes": len([name for name in os.listdir("/proc") if name.isdigit()]) > 2,
    "writable code": os.access("/code", os.W_OK) or os.access(os.__file__, os.W_OK),
}
print(", ".join(name for name, seen in found.items() if seen))
"""


def _nobody() -> str:
    """Another user for each process: the kernel keeps keys of a user, in which a unit could leave notes for the next one."""
    return str((1 << 30) + secrets.randbelow(1 << 29))


@dataclasses.dataclass(frozen=True)
class Container:
    """A container of an image with Python and NumPy."""

    name: str
    image: str

    def command(self, code: Path, arguments: Sequence[str]) -> list[str]:
        """The command that runs Python with arguments inside, where a folder is :data:`CODE`."""
        nobody = _nobody()
        limits = ("--network=none", f"--user={nobody}:{nobody}", "--read-only", "--cap-drop=ALL", "--pids-limit=512")
        options = [*limits, "--security-opt=no-new-privileges", "--tmpfs=/tmp:rw,mode=1777", f"--volume={code}:{CODE}:ro"]
        set_ = [f"--env={each}" for each in _ENVIRONMENT]
        return [self.name, "run", "--rm", "--interactive", *options, *set_, self.image, "python", "-I", *arguments]


@dataclasses.dataclass(frozen=True)
class Namespaces:
    """Namespaces with a file system that shows what Python needs, read-only; another user, where the caller is root."""

    name: str = "unshare"

    def command(self, code: Path, arguments: Sequence[str]) -> list[str]:
        """The command that runs Python with arguments inside, where a folder is :data:`CODE`."""
        root, nobody = os.geteuid() == 0, _nobody()
        apart = ["unshare", "--mount", "--net", "--ipc", "--uts", "--pid", "--fork", "--kill-child"]
        user = [f"--reuid={nobody}", f"--regid={nobody}", "--clear-groups"] if root else []
        drop = ["setpriv", *user, "--no-new-privs", "--inh-caps=-all", "--bounding-set=-all"]
        inside = ["env", "-i", *_ENVIRONMENT, *drop, sys.executable, "-I", *arguments]
        steps = ["set -e", "mount --make-rprivate /", "cd /", *_mounts(code), f"exec chroot {_ROOT} {shlex.join(inside)}"]
        return [*apart, *([] if root else ["--user", "--map-root-user"]), "sh", "-c", "\n".join(steps)]


Boundary = Container | Namespaces
"""What runs Python inside."""
_ROOT: Final = "/mnt"
"""Where the file system of the inside is mounted, in a namespace of its own."""


def _mounts(code: Path) -> list[str]:
    """Steps of a shell that mount the file system of the inside."""
    steps = [f"mount -t tmpfs -o mode=755,size=4g none {_ROOT}"]

    def show(outside: str, inside: str, *, writable: bool = False) -> None:
        target, folder = shlex.quote(f"{_ROOT}{inside}"), shlex.quote(str(Path(f"{_ROOT}{inside}").parent))
        kind = f"mkdir -p {target}" if Path(outside).is_dir() else f"touch {target}"
        steps.extend((f"mkdir -p {folder}", kind, f"mount --bind {shlex.quote(outside)} {target}"))
        if not writable:
            steps.append(f"mount -o remount,bind,ro {target}")

    places = [*_SHOWN, os.path.realpath(sys.base_prefix), sys.base_prefix, sys.prefix]
    shown: list[str] = []
    for place in places:
        if not Path(place).exists() or any(Path(place).is_relative_to(other) for other in shown):
            continue
        shown.append(place)
        if Path(place).is_symlink():
            inside = shlex.quote(f"{_ROOT}{place}")
            steps.extend((f"mkdir -p $(dirname {inside})", f"ln -s {shlex.quote(str(Path(place).readlink()))} {inside}"))
        else:
            show(place, place)
    for name in ("purelib", "platlib"):
        for package in sorted(Path(sysconfig.get_path(name)).glob("shuttle_marl*")):
            if package.is_dir():
                steps.append(f"mount -t tmpfs -o ro none {shlex.quote(f'{_ROOT}{package}')}")
    for name in _DEVICES:
        show(f"/dev/{name}", f"/dev/{name}", writable=True)
    show(str(code), CODE)
    steps += [f"mkdir -p {_ROOT}/proc {_ROOT}/tmp", f"chmod 1777 {_ROOT}/tmp", f"mount -t proc none {_ROOT}/proc"]
    return list(dict.fromkeys(steps))


def find_boundary(code: Path, image: str | None = None) -> Boundary:
    """The boundary of this machine: a container if an image is named, else namespaces.

    Args:
        code: folder that is to be :data:`CODE`.

    Raises:
        SuiteError: there is none, or a probe inside sees what it must not.
    """
    reasons = []
    runtimes = [name for name in ("podman", "docker") if shutil.which(name)]
    found: list[Boundary] = [Container(name, image) for name in runtimes] if image is not None else []
    if image is None and shutil.which("unshare") and shutil.which("setpriv"):
        found = [Namespaces()]
    for boundary in found:
        with contextlib.suppress(subprocess.TimeoutExpired):
            command = boundary.command(code, ["-c", _PROBE])
            done = subprocess.run(command, capture_output=True, text=True, timeout=_SECONDS, check=False)
            if done.returncode == 0 and not done.stdout.strip():
                return boundary
            seen = f"inside, one sees {done.stdout.strip()}" if done.returncode == 0 else done.stderr.strip()[-300:]
            reasons.append(f"{boundary.name}: {seen}")
    missing = "neither podman nor docker" if image is not None else "no unshare and setpriv, and --image names no container"
    raise SuiteError(f"code cannot be rerun here: {'; '.join(reasons) or missing}")
