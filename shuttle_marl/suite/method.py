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
from shuttle_marl.policy.sources import source_hashes
from shuttle_marl.suite.options import Access, Kind, SuiteError

Method = Callable[..., Any]


@dataclasses.dataclass(frozen=True)
class Baseline:
    """A method of this package.

    Attributes:
        path: ``MODULE:NAME``: the class or function of that name of a module of :mod:`.methods`, as ``adapters:tilts``.
        kind: references do not depend on the seed, so one is enough.
        argument: of the method, if its name has none.
    """

    path: str
    access: Access = "samples"
    kind: Kind = "method"
    argument: str | None = None


def _all(module: str, *names: str, access: Access = "samples", kind: Kind = "method") -> dict[str, Baseline]:
    """Baselines that stand in a module under their names."""
    return {name: Baseline(f"{module}:{name}", access, kind) for name in names}


_LEARNERS: Final = {name: Baseline("training:learner", argument=name) for name in ("ppo", "a2c", "sac")}
_KNOWN: Final = {name: Baseline("solving:named", "tables", "reference", name) for name in ("bc", "minimax")}
_RANDOM: Final = {"random": Baseline("solving:named", kind="reference", argument="random")}
BASELINES: Final[dict[str, dict[str, Baseline]]] = {
    "exploit": {
        **_LEARNERS,
        **_all("training", "ppo-self-play"),
        **_all("training", "ppo-restricted", access="tables"),
        **_all("solving", "restricted-counts", "restricted-mixture", access="tables"),
        "best-response-counts": Baseline("solving:restricted-counts", "tables", argument="1"),
        **{name: Baseline("solving:from-log", argument=name) for name in ("fitted-q", "fitted-q-boosted", "model")},
        **_all("solving", "model-boosted"),
        **_all("solving", "constant", "constant-by-incoming", access="opponent", kind="reference"),
        **_KNOWN,
        **_all("solving", "best-response", "restricted", access="opponent", kind="reference"),
        **_RANDOM,
    },
    "equilibrium": {
        **_LEARNERS,
        **_all("training", "ppo-deterministic", "fictitious-self-play"),
        **_all("training", "psro", access="tables"),
        **{f"ppo-{name}": Baseline("training:ppo-variant", "tables", argument=name) for name in ("best-response", "restarts")},
        **{f"ppo-{name}": Baseline("training:ppo-variant", argument=name) for name in ("pool", "magnet", "nash")},
        "model": Baseline("solving:solved-model", argument="means"),
        "model-boosted": Baseline("solving:solved-model", argument="trees"),
        **_all("training", "psro-exact", access="tables", kind="reference"),
        **_all("solving", "fictitious-play", "minimax-deterministic", access="tables", kind="reference"),
        **_KNOWN,
        **_RANDOM,
    },
    "adapt": {
        **_all("adapters", "minimax", "restricted-nash", access="tables", kind="reference"),
        "best-response-bc": Baseline("adapters:restricted-nash", "tables", "reference"),
        **_all("adapters", "bandit", "bayes", "thompson", "posterior-mean", "likeliest", access="tables"),
        **_all("adapters", "counts", "counts-recent", "counts-typed", "tilts", "mixture", access="tables"),
        **{
            f"mixture-without-{part}": Baseline("adapters:ablated", "tables", "ablation", part)
            for part in ("levels", "weights", "places", "change")
        },
    },
    "offline": {
        **_all("learned", "clone", "clone-won", "one-step", "fitted-q", "model"),
        "advantage-weighted": Baseline("learned:advantage-weighted", argument="0.02"),
        "fitted-q-pessimistic": Baseline("learned:fitted-q-pessimistic", argument="0.1"),
        "bcq": Baseline("learned:bcq", argument="0.3"),
        "iql": Baseline("learned:iql", argument="10"),
        "model-pessimistic": Baseline("learned:model-pessimistic", argument="0.1"),
        "model-ensemble": Baseline("learned:model-ensemble", argument="3"),
        "fitted-q-boosted": Baseline("learned:fitted-q-boosted", argument="100"),
        "model-boosted": Baseline("learned:model-boosted", argument="150"),
        "shipped-minimax": Baseline("learned:shipped", "tables", "reference", "minimax"),
        "shipped-best-response": Baseline("learned:shipped", "tables", "reference", "best-response:human:0.05"),
    },
    "evaluate": {
        **_all("estimators", "behaviour", kind="reference"),
        **_all("estimators", "importance-sampling", "weighted-importance-sampling", "truncated-importance-sampling"),
        **_all("estimators", "doubly-robust", "weighted-doubly-robust", "magic", "dice", "fitted-q-evaluation"),
        **_all("estimators", "model", "model-boosted"),
    },
    "text": {
        **_all("chat", "random", kind="reference"),
        "ppo": Baseline("chat:policy", argument="ppo"),
        "ppo-self-play": Baseline("chat:policy", argument="ppo:self-play"),
        **_all("chat", "policy", access="tables", kind="reference"),
        **_all("chat", "chat"),
    },
}
"""Baselines by kind of task."""


PROGRAMS: Final = ("exploit", "equilibrium", "text")
"""Kinds of tasks whose methods may be programs."""


def kind_of(task: str) -> str:
    """Kind of a task: the first word of its name, which it shares with its entrance."""
    return task.partition("-")[0]


def baseline_of(task: str, name: str) -> Baseline | None:
    """The baseline of this package that a name means; None for methods of others."""
    return BASELINES[kind_of(task)].get(name.partition(":")[0])


def find(task: str, name: str) -> Method:
    """A method by name.

    Args:
        name: a baseline of the task, ``program:COMMAND`` for a program in any language, or ``MODULE:ATTRIBUTE``; the module may
            be in the current folder.

    Raises:
        SuiteError: there is no such method.
        PolicyError: importing the module failed.
    """
    known = BASELINES[kind_of(task)]
    key, colon, argument = name.partition(":")
    if key in known:
        module, _, own = known[key].path.partition(":")
        members = vars(importlib.import_module(f"shuttle_marl.suite.methods.{module}"))
        method: Method = members.get(own.title().replace("-", "")) or members[own.replace("-", "_")]
        settable = inspect.signature(method).parameters.get("argument")
        if colon and (settable is None or settable.default is settable.empty):
            raise SuiteError(f"method {name!r}: {key} takes no argument")
        chosen = argument if colon else known[key].argument
        return method if chosen is None else functools.partial(method, argument=chosen)
    if key == "program" and argument and kind_of(task) in PROGRAMS:
        return functools.partial(_program, name)
    if key == "program":
        tasks = ", ".join(f"{kind}-v0" for kind in PROGRAMS)
        raise SuiteError(f"no method {name!r} of {task}: programs, as program:COMMAND, are possible in {tasks}")
    if not colon or not argument:
        raise SuiteError(f"no method {name!r} of {task}; there are: {', '.join(known)}. Your own is given as MODULE:ATTRIBUTE")
    thing = import_attribute(name)
    if not callable(thing):
        raise SuiteError(f"method {name!r} is a {type(thing).__name__}; expected a function or a class")
    return thing


def sources(task: str, name: str) -> dict[str, str]:
    """Hashes of the files of a method that :func:`find` found, by file or package."""
    key, _, argument = name.partition(":")
    if key not in BASELINES[kind_of(task)]:
        return source_hashes(name)
    return {**source_hashes(f"{__name__}:"), **source_hashes(f":{argument}")}


def _program(name: str, setting: Any) -> Any:
    """What a program plays: a name for tasks of players, else its adapter of the task."""
    return setting.program(name) if hasattr(setting, "program") else name


def made(method: Method, setting: Any, name: str, *calls: str) -> Any:
    """Call a method with a setting; a class or function without parameters is called without one.

    Raises:
        SuiteError: it raised, or made an object without one of the ``calls``.
    """
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
    """Call code of a method.

    Raises:
        SuiteError: it raised.
    """
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
