"""User policies: Python code ``module:attribute``; and the time limit of programs (:mod:`shuttle_marl.policy.programs`).

Code in this process cannot be stopped safely, so a policy that may hang plays as a program. By the hashes of user code, a resumed
run does not mix the results of two versions.
"""

import contextlib
import contextvars
import dataclasses
import hashlib
import importlib
import inspect
import math
import operator
import shlex
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

from shuttle_marl.base.arrays import Floats
from shuttle_marl.base.errors import described, did_you_mean
from shuttle_marl.game.policy import Policy, PolicyError, States
from shuttle_marl.game.tables import Game

PACKAGE: Final = Path(__file__).parents[1]


class ModuleMissingError(PolicyError):
    """The module of a policy is neither in the current folder nor installed."""


@dataclasses.dataclass(frozen=True, eq=False)
class FunctionPolicy:
    """A function from states to probabilities as a policy; an attribute ``reads_score`` of the function is used."""

    function: Callable[[States], Floats]

    @property
    def reads_score(self) -> bool:
        """Whether the function reads the score."""
        return bool(getattr(self.function, "reads_score", False))

    def probabilities(self, states: States) -> Floats:
        """``[B, n]`` probabilities of the function."""
        return self.function(states)


@contextlib.contextmanager
def blaming(what: str) -> Iterator[None]:
    """Context in which whatever foreign code raises, ``sys.exit`` too, becomes a PolicyError that begins with ``what``."""
    try:
        yield
    except (KeyboardInterrupt, PolicyError):
        raise
    except BaseException as error:
        raise PolicyError(f"{what} raised {described(error)}") from error


def import_attribute(name: str) -> Any:
    """The attribute ``module:attribute``; the module may be in the current folder.

    Raises:
        PolicyError: the module or the attribute does not exist, or importing it raised.
    """
    module_name, _, attribute = name.partition(":")
    here = str(Path.cwd())
    if here not in sys.path:
        # Last, so that files of the user hide no installed module; permanent, because the policy may import more later.
        sys.path.append(here)
    with blaming(f"policy {name!r}: importing its module"):
        try:
            module = importlib.import_module(module_name)
        except ModuleNotFoundError as error:
            if (module_name + ".").startswith(f"{error.name}."):
                raise ModuleMissingError(
                    f"policy {name!r}: no module {module_name!r} in the current folder or installed"
                ) from error
            raise PolicyError(f"policy {name!r}: its module needs {error.name!r}, which is not installed") from error
    with blaming(f"policy {name!r}: finding it in its module"):
        try:
            found = operator.attrgetter(attribute)(module)
        except AttributeError as error:
            hint = did_you_mean(attribute, [known for known in vars(module) if not known.startswith("_")], cutoff=0.5)
            raise PolicyError(f"policy {name!r}: module {module_name!r} has no {attribute!r}{hint}") from error
    return found


def from_module(name: str, game: Game) -> Policy:
    """Import a policy.

    Args:
        name: ``module:attribute``; the attribute is a policy, a class whose constructor takes nothing or the game, or a
            function from :class:`States` to ``[B, n]`` probabilities. The module may be in the current folder.

    Raises:
        PolicyError: the module or the attribute does not exist, raises, or is not a policy.
    """
    thing = import_attribute(name)
    make: Any = thing if inspect.isclass(thing) else None
    if make is not None:
        with blaming(f"policy {name!r}: making it"):
            try:
                inspect.signature(make).bind()
            except TypeError:
                thing = make(game)
            else:
                thing = make()
    if callable(getattr(thing, "probabilities", None)):
        return thing
    if callable(thing):
        return FunctionPolicy(thing)
    raise PolicyError(
        f"policy {name!r} is a {type(thing).__name__}; expected an object or class with a method probabilities(states), "
        "or a function from states to an array [B, n] of probabilities"
    )


POLICY_TIMEOUT: Final = 10.0  # default time limit of the command lines [s]

_seconds: Final = contextvars.ContextVar("seconds", default=0.0)


@contextlib.contextmanager
def time_limit(seconds: float) -> Iterator[None]:
    """Limit the time of each stroke of programs that are resolved within this context, even after it ended.

    Args:
        seconds: time limit [s]; 0 for no limit.

    Raises:
        PolicyError: ``seconds`` is negative or not finite.
    """
    if not (math.isfinite(seconds) and 0 <= seconds <= threading.TIMEOUT_MAX):
        raise PolicyError(f"--policy-timeout {seconds:g}: expected seconds, or 0 for no limit")
    token = _seconds.set(seconds)
    try:
        yield
    finally:
        _seconds.reset(token)


def current_limit() -> float:
    """Time limit of the current context [s]; 0 without one."""
    return _seconds.get()


def source_hashes(name: str) -> dict[str, str]:
    """SHA-256 of the code behind a name, by the file or the package.

    Args:
        name: ``module:attribute``, whose module was imported; ``program:COMMAND``; or a name with files in its parts, such as
            ``table:FILE``. A module of a package, and code of this one, counts with the whole package, any other file alone:
            what it imports, and data that the code reads, are not seen.

    Raises:
        OSError: a file cannot be read.
    """
    head, _, rest = name.partition(":")
    module = getattr(sys.modules.get(head), "__file__", None)
    if module is not None and head != "program":
        levels = head.count(".") + (Path(module).name == "__init__.py")
        return _hashes(Path(module).parents[levels - 1] if levels else Path(module))
    parts = rest.split(":")
    if head == "program":
        with contextlib.suppress(ValueError):  # quotation marks that do not close
            parts = shlex.split(rest)
    return _hashes(*(Path(part) for part in parts if Path(part).is_file()))


def _hashes(*paths: Path) -> dict[str, str]:
    hashes = {}
    for path in (PACKAGE if path.is_relative_to(PACKAGE) else path for path in paths):
        files = sorted(path.rglob("*.py")) if path.is_dir() else [path]
        content = b"".join(f"{file.relative_to(path.parent).as_posix()}\0".encode() + file.read_bytes() for file in files)
        hashes[path.name] = hashlib.sha256(content).hexdigest()
    return hashes
