"""Tasks on the machines of a Ray cluster, with the results that they would have here.

A task is one of the package's own functions, and what it returns follows from its arguments alone. So a task that is lost with
its worker or its machine is started again elsewhere, and taken here when no worker is left.
"""

import contextlib
import dataclasses
import functools
import importlib.metadata
import logging
import os
import platform
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Final, Generic, Protocol, TypeVar

import shuttle_marl
from shuttle_marl.errors import ShuttleError
from shuttle_marl.extras import install_hint

T = TypeVar("T")

LOCAL: Final = "local"
"""Address that starts Ray on this machine alone."""
_ATTEMPTS: Final = 4
"""Times that a task is started before it counts as one that takes its workers down."""
_PATIENCE: Final = 5.0
"""Seconds after which a cluster from which nothing came is asked whether it has workers left."""
_SHARED_VALUES: Final = 2
"""Shared values that a worker keeps."""


class ClusterError(ShuttleError):
    """A cluster that cannot be used, or that loses a task again and again."""


class LostError(Exception):
    """The worker of a task died, or the machine that held its result."""


class Backend(Protocol):
    """Machinery that runs the tasks of a :class:`Cluster`."""

    def slots(self) -> int:
        """Tasks that run side by side; 0 where no worker is left."""

    def put(self, value: Any) -> Any:
        """Send a value to wherever it will be needed, once; returns a reference to it."""

    def start(self, function: Callable[..., Any], arguments: Sequence[Any]) -> Any:
        """Start a task; arguments may be references. Returns a handle that can be hashed."""

    def wait(self, started: Sequence[Any], seconds: float) -> Sequence[Any]:
        """Those of some handles whose tasks are over or lost; waits for the first one, but no longer than this."""

    def get(self, started: Any) -> Any:
        """Result of a task, or its error.

        Raises:
            LostError: there is no result, because a worker or a machine died.
        """


@dataclasses.dataclass(frozen=True, eq=False)
class Shared(Generic[T]):
    """A value that many tasks take as an argument, sent once to every machine."""

    value: T
    reference: Any


class Task(Generic[T]):
    """A task that was given to a cluster."""

    def __init__(self, cluster: "Cluster", function: Callable[..., T], arguments: Sequence[Any]) -> None:
        self._cluster, self.function, self.arguments = cluster, function, arguments
        self.attempts = 0
        self._outcome: Callable[[], T] | None = None

    def result(self) -> T:
        """Result of the function; waits for it.

        Raises:
            ClusterError: the task was lost again and again.
            Exception: that of the function.
        """
        while self._outcome is None:
            self._cluster.advance()
        return self._outcome()

    def end(self, outcome: Callable[[], T]) -> None:
        """Keep the result, or the error, of the attempt that counts."""
        self._outcome = outcome

    def take_here(self) -> None:
        """Call the function in this process."""
        value = self.function(*(each.value if isinstance(each, Shared) else each for each in self.arguments))
        self.end(lambda: value)


class Cluster:
    """Runs tasks, and runs those again that are lost.

    Args:
        backend: what runs them.
    """

    def __init__(self, backend: Backend) -> None:
        self._backend = backend
        self._open: dict[Any, Task[Any]] = {}

    @property
    def slots(self) -> int:
        """Tasks that run side by side now; at least 1."""
        return max(1, self._backend.slots())

    def share(self, value: T) -> Shared[T]:
        """Prepare a value as an argument of many tasks."""
        return Shared(value, self._backend.put(value))

    def submit(self, function: Callable[..., T], *arguments: Any) -> Task[T]:
        """Start a task.

        Args:
            function: one of a module of the package; what it returns follows from its arguments.
            arguments: of the function; a :class:`Shared` one stands for its value.
        """
        task = Task(self, function, arguments)
        self._start(task)
        return task

    def _start(self, task: Task[Any]) -> None:
        task.attempts += 1
        arguments = [each.reference if isinstance(each, Shared) else each for each in task.arguments]
        self._open[self._backend.start(task.function, arguments)] = task

    def advance(self) -> None:
        """Wait for tasks that are over, and start those again that are lost; take one here where no worker is left."""
        # Results are fetched as soon as they are there: a machine that dies later takes none of them with it.
        over = self._backend.wait(list(self._open), _PATIENCE)
        for started in over:
            task = self._open.pop(started)
            try:
                value = self._backend.get(started)
            except LostError as error:
                self._start_again(task, error)
            except Exception as error:  # whatever the function raised is raised where its result is asked for
                task.end(functools.partial(_raise, error))
            else:
                task.end(functools.partial(_same, value))
        if not over and not self._backend.slots():
            self._open.pop(next(iter(self._open))).take_here()

    def _start_again(self, task: Task[Any], error: LostError) -> None:
        if task.attempts < _ATTEMPTS:
            self._start(task)
            return
        message = (
            f"a task was lost {_ATTEMPTS} times with its worker, perhaps for lack of memory ({error}); continue with --resume on "
            "machines with more memory for every processor"
        )
        task.end(functools.partial(_raise, ClusterError(message)))


def _same(value: T) -> T:
    return value


def _raise(error: Exception) -> Any:
    raise error


@contextlib.contextmanager
def open_cluster(address: str, packages: Sequence[str]) -> Iterator[Cluster]:
    """Connect to a Ray cluster, and leave it at the end.

    Args:
        address: ``local`` starts Ray on this machine, ``auto`` finds the cluster that this machine belongs to; else HOST:PORT of
            its head, or ``ray://HOST:PORT``.
        packages: distributions whose versions decide results; a worker with other ones refuses its tasks.

    Raises:
        ClusterError: Ray is not installed, or there is no cluster.
    """
    # Nothing is reported to Ray's makers unless the user wants it.
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    try:
        import ray  # noqa: PLC0415  of an extra, and slow to import
    except ModuleNotFoundError as error:
        raise ClusterError(f"--ray {address}: Ray is not installed; {install_hint('ray')}") from error
    joined = not ray.is_initialized()  # else the calling program has joined one, and stays in it
    if joined:
        own: dict[str, Any] = {"include_dashboard": False} if address == LOCAL else {}
        try:
            ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR, **own)
        except (ConnectionError, RuntimeError, ValueError, TimeoutError, ImportError) as error:
            reason = str(error).strip().partition("\n")[0]
            raise ClusterError(
                f"--ray {address}: no cluster can be reached there ({reason}); `ray start --head` starts one, --ray local uses "
                "this machine"
            ) from error
    try:
        yield Cluster(_Ray(ray, _versions(tuple(packages))))
    finally:
        if joined:
            ray.shutdown()


class _Ray:
    """Ray as a :class:`Backend`."""

    def __init__(self, ray: Any, versions: Mapping[str, str]) -> None:
        self._ray, self._versions = ray, versions
        # Tasks that are lost are started again by the cluster above.
        self._call = ray.remote(num_cpus=1, max_retries=0, scheduling_strategy="SPREAD")(_call)

    def slots(self) -> int:
        return int(self._ray.cluster_resources().get("CPU", 0))

    def put(self, value: Any) -> Any:
        return _Reference(self._ray.put(value))

    def start(self, function: Callable[..., Any], arguments: Sequence[Any]) -> Any:
        return self._call.remote(function, list(arguments), self._versions)

    def wait(self, started: Sequence[Any], seconds: float) -> Sequence[Any]:
        over: Sequence[Any] = self._ray.wait(list(started), num_returns=1, timeout=seconds, fetch_local=False)[0]
        return over

    def get(self, started: Any) -> Any:
        try:
            return self._ray.get(started)
        except self._ray.exceptions.RayTaskError as error:
            raise error.cause from error
        except self._ray.exceptions.RayError as error:
            raise LostError(str(error).strip().partition("\n")[0]) from error


@dataclasses.dataclass(frozen=True)
class _Reference:
    """A value in Ray's store, fetched by the worker that needs it and kept there for its next task."""

    reference: Any


@functools.lru_cache(maxsize=_SHARED_VALUES)
def _fetched(shared: _Reference) -> Any:
    import ray  # noqa: PLC0415  of an extra

    return ray.get(shared.reference)


def _call(function: Callable[..., Any], arguments: Sequence[Any], versions: Mapping[str, str]) -> Any:
    """Call a function in a worker."""
    here = _versions(tuple(name for name in versions if name not in _OWN))
    different = [f"{name} {version} there, {here[name]} here" for name, version in versions.items() if here[name] != version]
    if different:
        raise ClusterError(
            f"machine {platform.node()} of the cluster has other versions than the one that asks ({'; '.join(different)}); "
            "install the same ones on all"
        )
    return function(*(_fetched(each) if isinstance(each, _Reference) else each for each in arguments))


_OWN: Final = ("python", "shuttle_marl")


@functools.cache
def _versions(packages: tuple[str, ...]) -> dict[str, str]:
    """Versions of Python, of this package and of some distributions; empty for one that is not installed."""
    found = {"python": platform.python_version(), "shuttle_marl": shuttle_marl.__version__}
    for name in packages:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = ""
    return found
