"""Tasks on the machines of a Ray cluster, with the same results as in this process.

A task is a function of the package whose result depends only on its arguments, so Ray starts one that is lost with its worker or
machine again elsewhere.
"""

import contextlib
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
from typing import Any, Final, NamedTuple, TypeVar

import shuttle_marl
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.extras import install_hint
from shuttle_marl.base.runs import interrupts_blocked

S = TypeVar("S")
T = TypeVar("T")

LOCAL: Final = "local"
_RETRIES: Final = 3


class ClusterError(ShuttleError):
    """Processes or a cluster that cannot be used, or that lose a task repeatedly."""


class Shared(NamedTuple):
    """A value in the object store of a cluster."""

    reference: Any


class Cluster:
    """Runs tasks on a Ray cluster, which starts lost ones again."""

    def __init__(self, ray: Any, versions: Mapping[str, str], calls: int = 0) -> None:
        self._ray, self._versions = ray, versions
        self._call = ray.remote(num_cpus=1, max_retries=_RETRIES, max_calls=calls, scheduling_strategy="SPREAD")(_call)

    @property
    def slots(self) -> int:
        """Current number of parallel tasks; at least 1."""
        return max(1, int(self._ray.cluster_resources().get("CPU", 0)))

    def share(self, value: Any) -> Shared:
        """Prepare a value as an argument of many tasks, which is sent once to every machine, and read once by every worker."""
        return Shared(self._ray.put(value))

    def submit(self, function: Callable[..., T], *arguments: Any) -> Callable[[], T]:
        """Start a task.

        Args:
            function: a function of the package whose result depends only on its arguments.
            arguments: its arguments; one that is shared is replaced by its value.

        Returns:
            Waits for the result; raises what the function raised, or a ClusterError if the task was lost repeatedly.
        """
        return functools.partial(self._result, self._call.remote(function, self._versions, *arguments))

    def _result(self, reference: Any) -> Any:
        try:
            return self._ray.get(reference)
        except self._ray.exceptions.RayTaskError as error:
            raise error.cause from error
        except self._ray.exceptions.RayError as error:
            raise ClusterError(
                f"a task was lost {_RETRIES + 1} times with its worker, perhaps for lack of memory "
                f"({str(error).strip().partition(chr(10))[0]}); continue with --resume on machines with more memory per processor"
            ) from error


@contextlib.contextmanager
def open_cluster(address: str, packages: Sequence[str], calls: int = 0) -> Iterator[Cluster]:
    """Connect to a Ray cluster, and disconnect at the end.

    Args:
        address: ``local`` starts Ray on this machine, ``auto`` finds the cluster that this machine belongs to; else HOST:PORT of
            its head, or ``ray://HOST:PORT``.
        packages: distributions whose versions affect results; workers with other versions reject tasks.
        calls: number of tasks after which a worker ends; 0: none ends.

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
        yield Cluster(ray, _versions(tuple(packages)), calls)
    finally:
        if joined:
            ray.shutdown()


def _call(function: Callable[..., Any], versions: Mapping[str, str], *arguments: Any) -> Any:
    here = _versions(tuple(versions))
    different = [f"{name} {version} there, {here[name]} here" for name, version in versions.items() if here[name] != version]
    if different:
        raise ClusterError(
            f"machine {platform.node()} of the cluster has other versions than this one ({'; '.join(different)}); "
            "install the same ones on all"
        )
    return function(*(_fetched(each) if isinstance(each, Shared) else each for each in arguments))


@functools.lru_cache(maxsize=2)  # a tournament copies a hundred megabytes when it is read
def _fetched(shared: Shared) -> Any:
    import ray  # noqa: PLC0415  an extra

    return ray.get(shared.reference)


@functools.cache
def _versions(packages: tuple[str, ...]) -> dict[str, str]:
    """Versions of Python, of this package and of distributions; empty if not installed."""
    known = {"python": platform.python_version(), "shuttle_marl": shuttle_marl.__version__}
    found = {**known, **{name: "" for name in packages if name not in known}}
    for name in found.keys() - known.keys():
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            found[name] = importlib.metadata.version(name)
    return found


def in_threads(function: Callable[[S], T], arguments: Iterable[S], threads: int | None = None) -> Iterator[T]:
    """Results of a function by argument, in order, from threads (None: one a core); for compiled code, which frees the lock."""
    with futures.ThreadPoolExecutor(threads or os.cpu_count()) as pool:
        yield from pool.map(function, arguments)


def in_processes(
    function: Callable[[S], T],
    arguments: Iterable[S],
    processes: int,
    *,
    apart: bool = False,
    ray: str | None = None,
    packages: Sequence[str] = (),
) -> Iterator[T]:
    """Call a function of a module with each argument, in this process or in others that end with it; results as they come.

    An argument is taken from the iterable when a process is free, so a generator can stop when time is up.

    Args:
        processes: number of parallel processes; 1: this one.
        apart: make each call in a process of its own, so that none finds what another one left in memory.
        ray, packages: address of a cluster that replaces them, and packages, see :func:`open_cluster`.

    Raises:
        ClusterError: processes cannot be started, or the cluster cannot be used.
    """
    if ray is not None:
        with open_cluster(ray, packages, int(apart)) as cluster:
            yield from (result() for result in [cluster.submit(function, each) for each in arguments])
        return
    check_processes(processes)
    if processes <= 1 and not apart:
        yield from map(function, arguments)
        return
    with WorkerPool(max(1, processes), 1 if apart else None) as pool:
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
    """Processes that end with this one. Ctrl-C does not reach them, but ends the context of the pool, and them with it."""

    def __init__(self, processes: int, calls: int | None = None) -> None:
        context = multiprocessing.get_context("spawn")
        super().__init__(processes, mp_context=context, initializer=_end_with_parent, max_tasks_per_child=calls)

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
    """Check that as many processes can be started. Raises ClusterError: this machine has no semaphores for them."""
    try:
        if processes > 1:
            multiprocessing.get_context("spawn").Lock()
    except (OSError, ImportError) as error:
        raise ClusterError(
            f"processes cannot be started: there are no semaphores here ({error}), perhaps because /dev/shm is missing; "
            "compute in one process, with --workers 1 or --jobs 1"
        ) from error


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None

    def wait() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()
