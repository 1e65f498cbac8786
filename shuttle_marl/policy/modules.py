"""Policies of the user's own: ``module:attribute``, which imports the module and so runs its code."""

import dataclasses
import difflib
import importlib
import inspect
import operator
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import numpy.typing as npt

from shuttle_marl.errors import described
from shuttle_marl.game.policy import Policy, PolicyError, States
from shuttle_marl.game.rally import Game


class ModuleMissingError(PolicyError):
    """The module of a policy is neither in the current folder nor installed."""


@dataclasses.dataclass(frozen=True, eq=False)
class FunctionPolicy:
    """A plain function from states to probabilities as a policy; its attribute ``reads_score`` counts."""

    function: Callable[[States], npt.NDArray[np.floating]]

    @property
    def reads_score(self) -> bool:
        """Whether the function says that it reads the score."""
        return bool(getattr(self.function, "reads_score", False))

    def probabilities(self, states: States) -> npt.NDArray[np.floating]:
        """Probabilities that the function returns, ``[B, n]``."""
        return self.function(states)


def from_module(name: str, game: Game) -> Policy:
    """Import a policy.

    Args:
        name: ``module:attribute``; the attribute is a policy, a class of policies that takes nothing or the game, or a function
            from :class:`States` to ``[B, n]`` probabilities. The module may lie in the current folder.
        game: the tables that the policy will play on.

    Raises:
        PolicyError: the module or the attribute is not there, or raises, or is no policy.
    """
    module_name, _, attribute = name.partition(":")
    module = _import(name, module_name)
    try:
        thing: Any = operator.attrgetter(attribute)(module)
    except AttributeError as error:
        close = difflib.get_close_matches(attribute, [a for a in vars(module) if not a.startswith("_")], n=4, cutoff=0.5)
        hint = f"; did you mean {', '.join(close)}?" if close else ""
        raise PolicyError(f"policy {name!r}: module {module_name!r} has no {attribute!r}{hint}") from error
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        raise PolicyError(f"policy {name!r}: finding it in its module raised {described(error)}") from error
    if inspect.isclass(thing):
        thing = _instance(name, thing, game)
    if callable(getattr(thing, "probabilities", None)):
        return thing
    if callable(thing):
        return FunctionPolicy(thing)
    raise PolicyError(
        f"policy {name!r} is a {type(thing).__name__}; expected an object or class with a method probabilities(states), "
        "or a function from states to an array [B, n] of probabilities"
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
            raise ModuleMissingError(f"policy {name!r}: no module {module_name!r} in the current folder or installed") from error
        raise PolicyError(f"policy {name!r}: its module needs {error.name!r}, which is not installed") from error
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # sys.exit too
        raise PolicyError(f"policy {name!r}: importing its module raised {described(error)}") from error


def _instance(name: str, cls: Callable[..., Any], game: Game) -> Any:
    try:
        try:
            inspect.signature(cls).bind()
        except TypeError:
            return cls(game)
        return cls()
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # sys.exit too
        raise PolicyError(f"policy {name!r}: making it raised {described(error)}") from error
