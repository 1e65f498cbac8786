"""Tasks on the machines of a Ray cluster, with the same results as in this process.

A task is a function of the package whose result depends only on its arguments. A task that is lost with its worker or machine is
restarted elsewhere, and run in this process if no worker is left.
"""

import contextlib
import dataclasses
import functools
import importlib.metadata
import itertools
import logging
import multiprocessing
import os
import platform
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent import futures
from typing import Any, Final, Generic, Protocol, TypeVar

import shuttle_marl
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.extras import install_hint
from shuttle_marl.base.interrupts import interrupts_blocked

S = TypeVar("S")
T = TypeVar("T")

LOCAL: Final = "local"
"""Address that starts Ray on this machine alone."""
_ATTEMPTS: Final = 4
"""Attempts before a task counts as one that crashes its workers."""
_PATIENCE: Final = 5.0
"""Seconds without a result after which the workers of a cluster are counted."""
_SHARED_VALUES: Final = 2
"""Capacity of the cache of shared values in a worker."""


class ClusterError(ShuttleError):
    """Processes or a cluster that cannot be used, or that lose a task repeatedly."""


class LostError(Exception):
    """The worker of a task, or the machine with its result, died."""


class Backend(Protocol):
    """Executor of the tasks of a :class:`Cluster`."""

    def slots(self) -> int:
        """Number of parallel tasks; 0 if no worker is left."""

    def put(self, value: Any) -> Any:
        """Store a value for many tasks; returns a reference to it."""

    def start(self, function: Callable[..., Any], arguments: Sequence[Any]) -> Any:
        """Start a task; arguments may be references. Returns a hashable handle."""

    def wait(self, started: Sequence[Any], seconds: float) -> Sequence[Any]:
        """Handles whose tasks have ended or are lost; waits for the first one, or until the timeout [s]."""

    def get(self, started: Any) -> Any:
        """Result of a task, or its error.

        Raises:
            LostError: the result was lost with a worker or a machine.
        """


@dataclasses.dataclass(frozen=True, eq=False)
class Shared(Generic[T]):
    """An argument of many tasks, sent once to every machine."""

    value: T
    reference: Any


class Task(Generic[T]):
    """A task of a cluster."""

    def __init__(self, cluster: "Cluster", function: Callable[..., T], arguments: Sequence[Any]) -> None:
        self._cluster, self.function, self.arguments = cluster, function, arguments
        self.attempts = 0
        self._outcome: Callable[[], T] | None = None

    def result(self) -> T:
        """Wait for the result of the function.

        Raises:
            ClusterError: the task was lost repeatedly.
            Exception: raised by the function.
        """
        while self._outcome is None:
            self._cluster.advance()
        return self._outcome()

    def end(self, outcome: Callable[[], T]) -> None:
        """Store the result, or the error, of the last attempt."""
        self._outcome = outcome

    def run_here(self) -> None:
        """Call the function in this process."""
        value = self.function(*(each.value if isinstance(each, Shared) else each for each in self.arguments))
        self.end(lambda: value)


class Cluster:
    """Runs tasks, and restarts lost ones.

    Args:
        backend: executor of the tasks.
    """

    def __init__(self, backend: Backend) -> None:
        self._backend = backend
        self._open: dict[Any, Task[Any]] = {}

    @property
    def slots(self) -> int:
        """Current number of parallel tasks; at least 1."""
        return max(1, self._backend.slots())

    def share(self, value: T) -> Shared[T]:
        """Prepare a value as an argument of many tasks."""
        return Shared(value, self._backend.put(value))

    def submit(self, function: Callable[..., T], *arguments: Any) -> Task[T]:
        """Start a task.

        Args:
            function: a function of the package whose result depends only on its arguments.
            arguments: its arguments; a :class:`Shared` is replaced by its value.
        """
        task = Task(self, function, arguments)
        self._start(task)
        return task

    def _start(self, task: Task[Any]) -> None:
        task.attempts += 1
        arguments = [each.reference if isinstance(each, Shared) else each for each in task.arguments]
        self._open[self._backend.start(task.function, arguments)] = task

    def advance(self) -> None:
        """Collect finished tasks and restart lost ones; run one in this process if no worker is left."""
        # Results are fetched as soon as they are complete, so that a machine that fails later loses none.
        over = self._backend.wait(list(self._open), _PATIENCE)
        for started in over:
            task = self._open.pop(started)
            try:
                value = self._backend.get(started)
            except LostError as error:
                self._start_again(task, error)
            except Exception as error:  # raised again by `Task.result`
                task.end(functools.partial(_raise, error))
            else:
                task.end(functools.partial(_same, value))
        if not over and not self._backend.slots():
            self._open.pop(next(iter(self._open))).run_here()

    def _start_again(self, task: Task[Any], error: LostError) -> None:
        if task.attempts < _ATTEMPTS:
            self._start(task)
            return
        message = (
            f"a task was lost {_ATTEMPTS} times with its worker, perhaps for lack of memory ({error}); continue with --resume on "
            "machines with more memory per processor"
        )
        task.end(functools.partial(_raise, ClusterError(message)))


def _same(value: T) -> T:
    return value


def _raise(error: Exception) -> Any:
    raise error


@contextlib.contextmanager
def open_cluster(address: str, packages: Sequence[str]) -> Iterator[Cluster]:
    """Connect to a Ray cluster, and disconnect at the end.

    Args:
        address: ``local`` starts Ray on this machine, ``auto`` finds the cluster that this machine belongs to; else HOST:PORT of
            its head, or ``ray://HOST:PORT``.
        packages: distributions whose versions affect results; workers with other versions reject tasks.

    Raises:
        ClusterError: Ray is not installed, or there is no cluster.
    """
    # Telemetry of Ray is off unless the user turns it on.
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    try:
        import ray  # noqa: PLC0415  an extra
    except ModuleNotFoundError as error:
        raise ClusterError(f"--ray {address}: Ray is not installed; {install_hint('ray')}") from error
    joined = not ray.is_initialized()  # else the calling program is connected already
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
        # :class:`Cluster` restarts lost tasks.
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
    """A value in the object store of Ray, cached by each worker."""

    reference: Any


@functools.lru_cache(maxsize=_SHARED_VALUES)
def _fetched(shared: _Reference) -> Any:
    import ray  # noqa: PLC0415  an extra

    return ray.get(shared.reference)


def _call(function: Callable[..., Any], arguments: Sequence[Any], versions: Mapping[str, str]) -> Any:
    """Call a function in a worker."""
    here = _versions(tuple(name for name in versions if name not in _OWN))
    different = [f"{name} {version} there, {here[name]} here" for name, version in versions.items() if here[name] != version]
    if different:
        raise ClusterError(
            f"machine {platform.node()} of the cluster has other versions than this one ({'; '.join(different)}); "
            "install the same ones on all"
        )
    return function(*(_fetched(each) if isinstance(each, _Reference) else each for each in arguments))


_OWN: Final = ("python", "shuttle_marl")


@functools.cache
def _versions(packages: tuple[str, ...]) -> dict[str, str]:
    """Versions of Python, of this package and of distributions; empty if not installed."""
    found = {"python": platform.python_version(), "shuttle_marl": shuttle_marl.__version__}
    for name in packages:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = ""
    return found


def in_processes(function: Callable[[S], T], arguments: Iterable[S], processes: int) -> Iterator[T]:
    """Call a function of a module with each argument, in this process or in others that end with it; results as they come.

    An argument is taken from the iterable when a process is free, so a generator can stop when time is up.

    Args:
        function: called with one argument.
        arguments: of the calls.
        processes: number of parallel processes; 1: this one.

    Raises:
        ClusterError: processes cannot be started.
    """
    check_processes(processes)
    if processes <= 1:
        yield from map(function, arguments)
        return
    with WorkerPool(processes) as pool:
        waiting: set[futures.Future[T]] = set()
        left = iter(arguments)
        while True:
            waiting |= {pool.submit(function, each) for each in itertools.islice(left, processes - len(waiting))}
            if not waiting:
                return
            done, waiting = futures.wait(waiting, return_when=futures.FIRST_COMPLETED)
            for each in done:
                yield each.result()


class WorkerPool(futures.ProcessPoolExecutor):
    """Processes that end with this one. Ctrl-C does not reach them, but ends the context of the pool, and them with it.

    Args:
        processes: their number.
    """

    def __init__(self, processes: int) -> None:
        super().__init__(processes, mp_context=multiprocessing.get_context("spawn"), initializer=_end_with_parent)

    def submit(self, function: Callable[..., T], /, *arguments: Any, **options: Any) -> futures.Future[T]:
        """Submit a call, which may start a process."""
        with interrupts_blocked():
            return super().submit(function, *arguments, **options)

    def kill(self) -> None:
        """End the processes at once; calls that are not complete raise BrokenProcessPool."""
        for process in list((self._processes or {}).values()):
            process.kill()

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind in (KeyboardInterrupt, GeneratorExit):
            self.kill()
        self.shutdown(cancel_futures=True)


def check_processes(processes: int) -> None:
    """Check that as many processes can be started.

    Raises:
        ClusterError: this machine has no semaphores for them.
    """
    try:
        if processes > 1:
            multiprocessing.get_context("spawn").Lock()
    except (OSError, ImportError) as error:
        raise ClusterError(
            f"processes cannot be started: there are no semaphores here ({error}), perhaps because /dev/shm is missing; "
            "compute in one process, with --workers 1 or --jobs 1"
        ) from error


def _end_with_parent() -> None:
    """End this worker when its parent process ends for any reason."""
    parent = multiprocessing.parent_process()
    assert parent is not None

    def wait() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()
