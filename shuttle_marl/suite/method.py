"""Methods by name: the baselines of the suite, and user code ``MODULE:ATTRIBUTE``.

A method is called with the setting of a case (see the page of the task) and returns what the protocol of the task asks for. A
baseline is a function or class of :mod:`.methods`; its name may have an argument after a colon, such as ``restricted-nash:0.5``.
"""

import dataclasses
import functools
import importlib
import inspect
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from shuttle_marl.base.errors import ShuttleError, described
from shuttle_marl.base.extras import lacking
from shuttle_marl.policy.foreign import import_attribute
from shuttle_marl.suite.options import Access, Kind, SuiteError

Method = Callable[..., Any]


@dataclasses.dataclass(frozen=True)
class Baseline:
    """A method of this package."""

    module: str  # of `.methods`
    member: str  # name of its class or function, with hyphens, as `restricted-nash`
    access: Access
    kind: Kind  # references do not depend on the seed, so one is enough
    argument: str | None  # of the method, if its name has none


def _all(module: str, *names: str, access: Access = "samples", kind: Kind = "method") -> dict[str, Baseline]:
    """Baselines of a module by name: each ``NAME``, or ``NAME = MEMBER:ARGUMENT``."""
    found = {}
    for each in names:
        name, _, other = each.partition(" = ")
        member, _, argument = (other or name).partition(":")
        found[name] = Baseline(module, member, access, kind, argument or None)
    return found


_LEARNERS: Final = _all("players", *(f"{name} = learner:{name}" for name in ("ppo", "a2c", "sac")))
_KNOWN: Final = {
    **_all("players", "bc = named:bc", "minimax = named:minimax", access="tables", kind="reference"),
    **_all("players", "random = named:random", kind="reference"),
}
BASELINES: Final[dict[str, dict[str, Baseline]]] = {  # baselines by kind of task
    "exploit": {
        **_LEARNERS,
        **_all("players", "ppo-restricted", "ppo-self-play"),
        **_all("players", "restricted-counts", "best-response-counts = restricted-counts:1", access="tables"),
        **_all("players", "model-boosted"),
        **_all("players", "restricted-bc", access="tables", kind="reference"),
        **_all("players", "constant", "constant-by-incoming", access="opponent", kind="reference"),
        **_KNOWN,
        **_all("players", "best-response = restricted:1", "restricted", access="opponent", kind="reference"),
    },
    "equilibrium": {
        **_LEARNERS,
        **_all("players", *(f"ppo-{name} = ppo-variant:{name}" for name in ("best-response", "restarts")), access="tables"),
        **_all("players", *(f"ppo-{name} = ppo-variant:{name}" for name in ("pool", "magnet", "emagnet", "nash"))),
        **_all("players", "model-boosted"),
        **_all("players", "minimax-deterministic", access="tables", kind="reference"),
        **_KNOWN,
    },
    "adapt": {
        **_all("adapters", "minimax", "restricted-nash", "best-response-bc = restricted-nash", access="tables", kind="reference"),
        **_all("adapters", "posterior-mean", "counts", "mixture", access="tables"),
    },
    "offline": {
        **_all("logs", "clone", "one-step", "fitted-q"),
        **_all("logs", "model", "model-pessimistic = model-pessimistic:0.1"),
        **_all("logs", "model-boosted = model-boosted:150"),
        **_all("logs", "shipped-minimax = shipped:minimax", access="tables", kind="reference"),
        **_all("logs", "shipped-best-response = shipped:best-response:human:0.05", access="tables", kind="reference"),
    },
    "evaluate": {
        **_all("logs", "behaviour", kind="reference"),
        **_all("logs", "importance-sampling", "weighted-importance-sampling", "doubly-robust"),
        **_all("logs", "dice", "fitted-q-evaluation", "model = model-value", "model-boosted = model-boosted-value"),
    },
}


def kind_of(task: str) -> str:
    """Kind of a task: the first word of its name, which it shares with its entrance."""
    return task.partition("-")[0]


def baseline_of(task: str, name: str) -> Baseline | None:
    """The baseline of this package that a name means; None for methods of others."""
    return BASELINES[kind_of(task)].get(name.partition(":")[0])


def find(task: str, name: str) -> Method:
    """A method by name.

    Args:
        name: a baseline of the task, or ``MODULE:ATTRIBUTE``; the module may be in the current folder.

    Raises:
        SuiteError: there is no such method.
        PolicyError: importing the module failed.
    """
    known = BASELINES[kind_of(task)]
    key, colon, argument = name.partition(":")
    if key in known:
        member = known[key].member
        members = vars(importlib.import_module(f"shuttle_marl.suite.methods.{known[key].module}"))
        method: Method = members.get(member.title().replace("-", "")) or members[member.replace("-", "_")]
        settable = inspect.signature(method).parameters.get("argument")
        if colon and (settable is None or settable.default is settable.empty):
            raise SuiteError(f"method {name!r}: {key} takes no argument")
        chosen = argument if colon else known[key].argument
        return method if chosen is None else functools.partial(method, argument=chosen)
    if not colon or not argument:
        raise SuiteError(f"no method {name!r} of {task}; there are: {', '.join(known)}. Your own is given as MODULE:ATTRIBUTE")
    thing = import_attribute(name)
    if not callable(thing):
        raise SuiteError(f"method {name!r} is a {type(thing).__name__}; expected a function or a class")
    return thing


def made(method: Method, setting: Any, name: str, *calls: str) -> Any:
    """Call a method with a setting, if it takes one. Raises SuiteError: it raised, or made an object without one of ``calls``."""
    try:
        inspect.signature(method).bind()
    except TypeError:
        found = called(name, method, setting)
    else:
        found = called(name, method)
    if not all(callable(getattr(found, call, None)) for call in calls):
        raise SuiteError(f"the method of {name}: expected an object with {' and '.join(calls)}, got a {type(found).__name__}")
    return found


def called(name: str, function: Callable[..., Any], *arguments: Any) -> Any:
    """Call code of a method. Raises SuiteError: it raised."""
    try:
        return function(*arguments)
    except ShuttleError:
        raise
    except ModuleNotFoundError as error:
        raise SuiteError(f"the method of {name}: {lacking(error) or error}") from error
    except (Exception, SystemExit) as error:
        # The last line of the file whose code was called.
        frames = traceback.extract_tb(error.__traceback__)[1:]
        own = [frame for frame in frames if frame.filename == frames[0].filename]
        place = f" ({Path(own[-1].filename).name}, line {own[-1].lineno})" if own else ""
        raise SuiteError(f"the method of {name} raised {described(error)}{place}") from error
