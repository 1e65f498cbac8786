"""Methods that run apart from the package, behind a :class:`Boundary`, and get episodes alone.

A boundary is a container, or namespaces of Linux by ``unshare`` and ``setpriv`` of util-linux. Inside are the interpreter with
its installed libraries but this package, the committed files, an empty ``/tmp``, and two pipes. There is no network, no other
process, no privilege, and no file of anybody. A probe inside looks whether that holds (:func:`find_boundary`), so a machine that
cannot keep the promise refuses to rerun anything.

A method sees what it plays, logs, rallies and positions as arrays, and neither tables of the game nor names of opponents. Each
unit starts a new process. This process plays the game, counts the strokes, and makes the tables of the policies.
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
import types
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from shuttle_marl.base.errors import printable
from shuttle_marl.base.programs import Program
from shuttle_marl.env.vector import RallyVectorEnv
from shuttle_marl.game.observation import observations
from shuttle_marl.game.policy import States
from shuttle_marl.game.tabulated import TabulatedPolicy
from shuttle_marl.kernel import RallyBatch
from shuttle_marl.policy.registry import resolve
from shuttle_marl.suite import apart
from shuttle_marl.suite.adapt import AdaptSetting
from shuttle_marl.suite.exploit import OPPONENT, PlayerSetting, Trained
from shuttle_marl.suite.options import SuiteError
from shuttle_marl.suite.population import luck
from shuttle_marl.suite.task import Setting, table_of

CODE: Final = "/code"
"""Folder of the code inside."""
_ROOT: Final = "/mnt"
"""Mount point of the file system inside, in its own mount namespace."""
_SHOWN: Final = ("/usr", "/bin", "/lib", "/lib64", "/etc/ld.so.cache", "/etc/alternatives")
_DEVICES: Final = ("null", "zero", "urandom")
_NAMESPACES: Final = ("--mount", "--net", "--ipc", "--uts", "--pid", "--fork", "--kill-child")
_PROBE_SECONDS: Final = 120.0
_ENVIRONMENT: Final = ("PATH=/usr/bin:/bin", "HOME=/tmp", "LANG=C.UTF-8", "OMP_NUM_THREADS=1", "PYTHONDONTWRITEBYTECODE=1")
_MOST_RALLIES: Final = 1 << 16
_MOST_BLOCKS: Final = 1 << 21
"""Largest size of a file that a method writes, in blocks of 512 bytes."""
_SECONDS: Final = 6 * 3600.0
"""Longest time of an answer [s]."""
_REQUESTS: Final = ("reset", "step", "policy")
_PROBE: Final = """
import importlib.util, os, socket, sys
import numpy
status = dict(line.split(":", 1) for line in open("/proc/self/status") if ":" in line)
found = {
    "the package": importlib.util.find_spec("shuttle_marl") is not None,
    "a network": any(name != "lo" for _, name in socket.if_nameindex()),
    "privileges": int(status["CapEff"], 16) != 0 or int(status["CapBnd"], 16) != 0 or status["NoNewPrivs"].strip() != "1",
    "other processes": len([name for name in os.listdir("/proc") if name.isdigit()]) > 2,
    "your files": any(os.path.exists(name) for name in sys.argv[1:]),
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
        unshare = ["setpriv", "--pdeathsig=KILL", "unshare", *_NAMESPACES]
        user = [f"--reuid={nobody}", f"--regid={nobody}", "--clear-groups"] if root else []
        drop = ["setpriv", *user, "--no-new-privs", "--inh-caps=-all", "--bounding-set=-all"]
        inside = ["env", "-i", *_ENVIRONMENT, *drop, sys.executable, "-I", *arguments]
        # The shell stays: process 1 is not the method, so all that the method started ends with its main process.
        play = (f"ulimit -f {_MOST_BLOCKS}", f"chroot {_ROOT} {shlex.join(inside)}", "exit 0")
        steps = ["set -e", "mount --make-rprivate /", "cd /", *_mounts(code), *play]
        return [*unshare, *([] if root else ["--user", "--map-root-user"]), "sh", "-c", "\n".join(steps)]


Boundary = Container | Namespaces
"""What runs Python inside."""


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
    steps += [f"mkdir -p {_ROOT}/proc {_ROOT}/tmp", f"chmod 1777 {_ROOT}/tmp", f"mount -t proc -o subset=pid none {_ROOT}/proc"]
    return list(dict.fromkeys(steps))


def find_boundary(code: Path, image: str | None = None, *, hidden: Sequence[Path] = ()) -> Boundary:
    """The boundary of this machine: a container if an image is named, else namespaces.

    Args:
        code: folder that is to be :data:`CODE`.
        hidden: files that must not be seen.

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
            command = boundary.command(code, ["-c", _PROBE, *(str(path.resolve()) for path in hidden)])
            done = subprocess.run(command, capture_output=True, text=True, timeout=_PROBE_SECONDS, check=False)
            if done.returncode == 0 and not done.stdout.strip():
                return boundary
            seen = f"inside, one sees {done.stdout.strip()}" if done.returncode == 0 else done.stderr.strip()[-300:]
            reasons.append(f"{boundary.name}: {seen}")
    missing = "neither podman nor docker" if image is not None else "no unshare and setpriv, and --image names no container"
    raise SuiteError(f"code cannot be rerun here: {'; '.join(reasons) or missing}")


def play_apart(name: str, folder: Path, boundary: Boundary, beacon: str, setting: Setting) -> Any:
    """The trained player of a method ``MODULE:ATTRIBUTE``, or the object that it made.

    Args:
        folder: with :mod:`.apart`, and the code in ``entry``.

    Raises:
        SuiteError: the method failed.
    """
    session = Session(name, folder, boundary, beacon, setting)
    if not isinstance(setting, PlayerSetting):
        return session
    return Trained(player=session.player(call="player"), strokes=session.used)


class Session:
    """A method in a process of its own; :attr:`used` counts the strokes of the learner."""

    def __init__(self, name: str, folder: Path, boundary: Boundary, beacon: str, setting: Setting) -> None:
        self._name, self._setting, self.game, self._beacon = name, setting, setting.game, beacon
        self.used = self._started = 0
        self._opponents: list[TabulatedPolicy] = []
        if isinstance(setting, PlayerSetting) and setting.opponent is not None:
            self._opponents = [resolve(setting.opponent, self.game)]  # type: ignore[list-item]
            (setting.folder / OPPONENT).unlink(missing_ok=True)
        elif isinstance(setting, AdaptSetting):
            self._opponents = list(setting.known.values())
        self._budget = getattr(setting, "budget", 0)
        arguments = [f"{CODE}/apart.py", name, f"{CODE}/entry", "/tmp/unit"]
        self._program = Program(boundary.command(folder, arguments), _SECONDS)
        states = np.arange(self.game.n_states)
        waiting = None if self.game.recovery is None else self.game.waiting.mask(self.game.base(states))
        self._send(
            observation=observations(self.game, states),
            mask=self.game.mask(states),
            feasible=np.zeros((0, 9), np.bool_) if waiting is None else waiting,
            seed=setting.seed,
            budget=self._budget,
            opponents=len(self._opponents),
        )

    def _send(self, **arrays: Any) -> None:
        self._program.write(apart.message(**arrays))

    def _ask(self, **request: Any) -> dict[str, Any]:
        """Send a request, and serve those of the method until it answers."""
        self._send(**request)
        while True:
            try:
                answer = apart.receive(self._program)
            except (ValueError, OSError) as error:
                raise SuiteError(f"the method sent an invalid message: {error}") from error
            served = [name for name in _REQUESTS if name in answer]
            if not served:
                break
            try:
                reply = getattr(self, f"_{served[0]}")(answer)
            except Exception as error:  # the method sent it
                reply = {"error": str(error)}
            self._send(**reply)
        if "error" in answer:
            raise SuiteError(f"the method raised {printable(str(answer['error']))[:1000]}")
        return answer

    def _reset(self, request: dict[str, Any]) -> dict[str, Any]:
        number, opponent = int(request["reset"]), int(request["opponent"])
        if not self._budget or not 1 <= number <= _MOST_RALLIES:
            raise SuiteError(f"{number} rallies: tasks that train players have 1 to {_MOST_RALLIES} at once")
        if (started := self._started + number) > self._budget:  # each shows a serve
            raise SuiteError(f"more rallies were reset than the budget of {self._budget:,} strokes")
        self._started, seed = started, luck("round", self._beacon, self._setting.seed, started)
        if self._opponents:
            against = self._opponents[opponent]
            env = RallyVectorEnv(number, opponent=against, game=self.game, mask="none", info="none")
            env.reset(seed=seed)
            self._batch: RallyBatch | RallyVectorEnv = env
        else:
            self._batch = RallyBatch(self.game, number, seed=seed)
        return self._seen()

    def _seen(self) -> dict[str, Any]:
        rows = self._batch if isinstance(self._batch, RallyBatch) else self._batch.versus
        return {"state": rows.rows.state, "waits": rows.waits}

    def _step(self, request: dict[str, Any]) -> dict[str, Any]:
        actions, batch = request["step"], self._batch
        if (used := self.used + len(actions) + len(request.get("positions", ()))) > self._budget:
            raise SuiteError(f"the budget of {self._budget:,} strokes is used up")
        if isinstance(batch, RallyBatch):
            reward, over = batch.step(actions, request.get("positions"))
        else:
            reward, over = batch.step(actions)[1:3]
        self.used = used
        return {**self._seen(), "reward": reward, "over": over}

    def _policy(self, request: dict[str, Any]) -> dict[str, Any]:
        policy = self._policies[int(request["policy"])]
        return {"probability": policy.probabilities(States(game=self.game, state=request["state"])).astype(np.float32)}

    def player(self, **request: Any) -> TabulatedPolicy:
        """The policy that the method answers with.

        Raises:
            SuiteError, PolicyError: it is none.
        """
        answer, game = self._ask(**request), self.game
        if (strokes := answer.get("stroke", np.zeros(0))).shape == (game.n_states,):
            chance = (strokes[:, None] == np.arange(game.n_strokes)).astype(np.float64)
        elif (chance := answer.get("probability", np.zeros(0))).shape != (game.n_states, game.n_strokes):
            raise SuiteError(f"the method returned a {next(iter(answer))}; expected an object with act or probabilities")
        policy = types.SimpleNamespace(probabilities=lambda states: chance[states.state])
        if "position" in answer:
            policy.positions = lambda states: answer["position"][states.state]
        return table_of(policy, game, self._name)

    def _arrays(self, data: Any) -> dict[str, Any]:
        """Columns of strokes; the stroke stands for the pair, which only the tables number."""
        names = [field.name for field in dataclasses.fields(data) if field.name not in ("game", "pair")]
        return {"stroke": self.game.pair_stroke[data.pair], **{name: np.asarray(getattr(data, name)) for name in names}}

    def fit(self, data: Any) -> TabulatedPolicy:
        """Learn from strokes."""
        return self.player(call="fit", **self._arrays(data))

    def estimate(self, log: Any, policies: list[TabulatedPolicy]) -> Any:
        """Values of policies."""
        self._policies = policies
        return self._ask(call="estimate", policies=len(policies), **self._arrays(log)).get("values")

    def policy_for_next_rally(self) -> TabulatedPolicy:
        """What is played next."""
        return self.player(call="policy_for_next_rally")

    def observe_rally(self, rally: Any) -> None:
        """A rally that was played."""
        self._ask(call="observe_rally", **self._arrays(rally))
