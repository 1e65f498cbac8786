"""Every player by name: one registry for shipped policies, families of policies, and a user's own.

A name is ``KEY`` or ``KEY:ARGUMENT`` where KEY was registered (``random``, ``bc:viktor-axelsen``), else
``module:attribute``. ``@greedy`` or ``@TEMPERATURE`` behind it makes the policy sharper or flatter (``bc@0.5``). A new
family is one call of :func:`register`.
"""

import dataclasses
import difflib
import functools
import importlib
import inspect
import operator
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import numpy.typing as npt

from shuttle_marl.policy import bc
from shuttle_marl.policy.base import Policy, PolicyError, States
from shuttle_marl.policy.scripted import STYLES, ScriptedPolicy
from shuttle_marl.policy.tempered import TemperedPolicy
from shuttle_marl.policy.uniform import UniformPolicy
from shuttle_marl.rally import Game

Load = Callable[[str | None, Game], Policy]


@dataclasses.dataclass(frozen=True)
class _Family:
    load: Load
    names: Callable[[], Iterable[str]]


_FAMILIES: dict[str, _Family] = {}


def register(key: str, load: Load, names: Callable[[], Iterable[str]] | None = None) -> None:
    """Add policies to the registry.

    Args:
        key: what stands before the colon, or the whole name.
        load: called with what stands behind the colon (None without one) and the game; raises :class:`PolicyError` for an
            argument it does not know. Import what is heavy inside.
        names: the full names that can be listed now; default just ``key``.

    Raises:
        PolicyError: the key is taken, or is no plain word.
    """
    if not key or any(c in key for c in ":@ "):
        raise PolicyError(f"policy key {key!r}: expected a word without ':', '@' and spaces")
    if key in _FAMILIES:
        raise PolicyError(f"policy key {key!r} is registered already; choose another")
    _FAMILIES[key] = _Family(load, names or (lambda: (key,)))


def names() -> tuple[str, ...]:
    """Names of all policies that can be listed: those that come with the package and those registered since."""
    return tuple(name for family in _FAMILIES.values() for name in family.names())


def resolve(name: str, game: Game) -> Policy:
    """Find a policy by name.

    Args:
        name: see the module's first lines; ``attribute`` of ``module:attribute`` is a policy, a class of policies that
            takes nothing or the game, or a function from :class:`States` to ``[B, n]`` chances. The module may lie in the
            current folder.
        game: the tables that the policy will play on.

    Raises:
        PolicyError: there is no such policy (with the closest names), or it cannot be made.
    """
    base, at, suffix = name.rpartition("@")
    if not at:
        return _resolve_plain(name, game)
    return TemperedPolicy(_resolve_plain(base, game), _temperature(name, suffix))


def _resolve_plain(name: str, game: Game) -> Policy:
    key, colon, argument = name.partition(":")
    if key in _FAMILIES:
        return _FAMILIES[key].load(argument if colon else None, game)
    if colon and key and argument:
        return _from_module(name, key, argument, game)
    close = difflib.get_close_matches(name, names(), n=4, cutoff=0.5)
    hint = f"did you mean {', '.join(close)}?" if close else f"known: {', '.join(names())}."
    raise PolicyError(f"no policy {name!r}; {hint} Your own is given as module:attribute.")


def _temperature(name: str, suffix: str) -> float:
    if suffix == "greedy":
        return 0.0
    try:
        temperature = float(suffix)
    except ValueError:
        temperature = -1.0
    if not 0 < temperature < float("inf"):
        raise PolicyError(f"policy {name!r}: expected @greedy or a temperature above 0 such as @0.5 behind the name")
    return temperature


@dataclasses.dataclass(frozen=True, eq=False)
class FunctionPolicy:
    """A plain function from states to chances as a policy; its attribute ``reads_score`` counts."""

    function: Callable[[States], npt.NDArray[np.floating]]

    @property
    def reads_score(self) -> bool:
        """Whether the function says that it reads the score."""
        return bool(getattr(self.function, "reads_score", False))

    def probabilities(self, states: States) -> npt.NDArray[np.floating]:
        """What the function returns."""
        return self.function(states)


def _from_module(name: str, module_name: str, attribute: str, game: Game) -> Policy:
    module = _import(name, module_name)
    try:
        thing: Any = operator.attrgetter(attribute)(module)
    except AttributeError as error:
        close = difflib.get_close_matches(attribute, [a for a in vars(module) if not a.startswith("_")], n=4, cutoff=0.5)
        hint = f"; did you mean {', '.join(close)}?" if close else ""
        raise PolicyError(f"policy {name!r}: module {module_name!r} has no {attribute!r}{hint}") from error
    if inspect.isclass(thing):
        thing = _instance(name, thing, game)
    if callable(getattr(thing, "probabilities", None)):
        return thing
    if callable(thing):
        return FunctionPolicy(thing)
    raise PolicyError(
        f"policy {name!r} is a {type(thing).__name__}; expected an object or class with a method probabilities(states), "
        "or a function from states to an array [B, n] of chances"
    )


def _import(name: str, module_name: str) -> ModuleType:
    here = str(Path.cwd())
    if here not in sys.path:
        # Behind everything else, so that a file of the user's hides no installed module; it stays, because the policy
        # may import its neighbours later.
        sys.path.append(here)
    try:
        return importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        if (module_name + ".").startswith(f"{error.name}."):
            close = difflib.get_close_matches(name, names(), n=4, cutoff=0.6)
            hint = f"; did you mean {', '.join(close)}?" if close else ""
            raise PolicyError(f"policy {name!r}: no module {module_name!r} in the current folder or installed{hint}") from error
        raise PolicyError(f"policy {name!r}: its module needs {error.name!r}, which is not installed") from error
    except Exception as error:
        raise PolicyError(f"policy {name!r}: importing its module raised {type(error).__name__}: {error}") from error


def _instance(name: str, cls: Callable[..., Any], game: Game) -> Any:
    try:
        try:
            inspect.signature(cls).bind()
        except TypeError:
            return cls(game)
        return cls()
    except Exception as error:
        raise PolicyError(f"policy {name!r}: making it raised {type(error).__name__}: {error}") from error


def _plain(key: str, make: Callable[[], Policy]) -> None:
    """Register a policy that takes no argument."""

    def load(argument: str | None, game: Game) -> Policy:  # noqa: ARG001  every family is called alike
        if argument is not None:
            raise PolicyError(f"policy {key}:{argument}: {key!r} takes nothing behind a colon; write {key}")
        return make()

    register(key, load)


def _load_bc(player: str | None, game: Game) -> Policy:
    return bc.load(player, game)


def _bc_names() -> list[str]:
    return ["bc", *(f"bc:{player}" for player in bc.players())] if bc.installed() else []


register("bc", _load_bc, _bc_names)
for _key, _style in STYLES.items():
    _plain(_key, functools.partial(ScriptedPolicy, _style))
_plain("random", UniformPolicy)
