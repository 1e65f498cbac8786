"""Methods by name: the baselines of the suite, and user code ``MODULE:ATTRIBUTE``.

A method is called with the setting of a case (see the page of the task) and returns what the protocol of the task asks for. A
baseline is a module of this package; its name may have an argument after a colon, such as ``restricted-nash:0.5``.
"""

import functools
import importlib
import inspect
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from shuttle_marl.base.errors import ShuttleError, described
from shuttle_marl.policy.foreign import import_attribute
from shuttle_marl.policy.sources import source_hashes
from shuttle_marl.suite.options import SuiteError

Method = Callable[..., Any]

BASELINES: Final[dict[str, dict[str, str]]] = {
    "exploit": {
        "ppo": "training:ppo",
        "a2c": "training:a2c",
        "sac": "training:sac",
        "dqn": "deep:dqn",
        "maskable-ppo": "sb3:maskable_ppo",
        "constant": "constant:constant",
        "constant-by-incoming": "constant:by_incoming",
        "bc": "references:bc",
        "minimax": "references:minimax",
        "best-response": "references:best_response",
        "random": "references:random",
    },
    "equilibrium": {
        "ppo": "training:ppo",
        "a2c": "training:a2c",
        "sac": "training:sac",
        "ppo-best-response": "training:ppo_best_response",
        "ppo-restarts": "training:ppo_restarts",
        "ppo-pool": "training:ppo_pool",
        "ppo-magnet": "training:ppo_magnet",
        "ppo-nash": "training:ppo_nash",
        "psro": "training:psro",
        "psro-exact": "training:psro_exact",
        "fictitious-play": "references:fictitious_play",
        "bc": "references:bc",
        "minimax": "references:minimax",
        "random": "references:random",
    },
    "adapt": {
        "minimax": "adapters:Minimax",
        "best-response-bc": "adapters:RestrictedNash",
        "restricted-nash": "adapters:RestrictedNash",
        "bandit": "adapters:Bandit",
        "bayes": "adapters:Bayes",
        "thompson": "adapters:Thompson",
        "posterior-mean": "adapters:PosteriorMean",
        "counts": "adapters:Counts",
        "tilted-mixture": "tilt:TiltedMixture",
        "tilted-mixture-without-levels": "tilt:WithoutLevels",
        "tilted-mixture-without-mixture": "tilt:WithoutMixture",
        "tilted-mixture-without-tilt": "tilt:WithoutTilt",
        "tilted-mixture-without-change": "tilt:WithoutChange",
    },
    "offline": {
        "clone": "learned:Clone",
        "one-step": "learned:OneStep",
        "fitted-q": "learned:FittedQ",
        "bcq": "learned:ConstrainedQ",
        "cql": "deep:ConservativeQ",
        "iql": "deep:ImplicitQ",
        "model": "learned:Model",
        "model-pessimistic": "learned:PessimisticModel",
        "fitted-q-boosted": "boosted:BoostedQ",
        "model-boosted": "boosted:BoostedModel",
    },
    "evaluate": {
        "importance-sampling": "estimators:ImportanceSampling",
        "weighted-importance-sampling": "estimators:WeightedImportanceSampling",
        "per-decision": "estimators:PerDecision",
        "doubly-robust": "estimators:DoublyRobust",
        "fitted-q-evaluation": "estimators:FittedQEvaluation",
        "model": "estimators:ModelBased",
    },
    "imitate": {"bc": "imitation:Named", "policy": "imitation:Named", "counts": "imitation:Counts"},
    "robust": {
        "minimax": "references:minimax",
        "minimax-robust": "robust:minimax_robust",
        "mean-game": "robust:mean_game",
        "human": "robust:human",
        "bc": "references:bc",
    },
    "text": {"random": "text:RandomLegal", "policy": "text:Policy", "chat": "text:chat"},
}
"""Baselines by kind of task, as ``MODULE:ATTRIBUTE`` within this package."""


PROGRAMS: Final = ("exploit", "equilibrium", "robust", "text")
"""Kinds of tasks whose methods may be programs."""


def kind_of(task: str) -> str:
    """Kind of a task: its name without the version."""
    return task.rpartition("-")[0]


def find(task: str, name: str) -> Method:
    """A method by name.

    Args:
        task: name of the task.
        name: a baseline of the task, ``program:COMMAND`` for a program in any language, or ``MODULE:ATTRIBUTE``; the module may
            be in the current folder.

    Raises:
        SuiteError: there is no such method.
        PolicyError: importing the module failed.
    """
    known = BASELINES[kind_of(task)]
    key, colon, argument = name.partition(":")
    if key in known:
        module, _, attribute = known[key].partition(":")
        method: Method = getattr(importlib.import_module(f"shuttle_marl.suite.methods.{module}"), attribute)
        return functools.partial(method, argument=argument) if colon else method
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


def made(method: Method, setting: Any, name: str) -> Any:
    """Call a method with a setting; a class or function without parameters is called without one.

    Raises:
        SuiteError: it raised.
    """
    try:
        inspect.signature(method).bind()
    except TypeError:
        return called(name, method, setting)
    return called(name, method)


def called(name: str, function: Callable[..., Any], *arguments: Any) -> Any:
    """Call code of a method.

    Raises:
        SuiteError: it raised.
    """
    try:
        return function(*arguments)
    except ShuttleError:
        raise
    except (Exception, SystemExit) as error:
        # The last line of the file whose code was called.
        frames = traceback.extract_tb(error.__traceback__)[1:]
        own = [frame for frame in frames if frame.filename == frames[0].filename]
        place = f" ({Path(own[-1].filename).name}, line {own[-1].lineno})" if own else ""
        raise SuiteError(f"the method of {name} raised {described(error)}{place}") from error
