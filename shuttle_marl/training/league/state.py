"""State of a league between two rounds: one file, written whole, that names all that the next round depends on."""

import dataclasses
from pathlib import Path
from typing import Any, Final

from shuttle_marl.files import FileReadError, read_sealed, replace_file, seal
from shuttle_marl.training.league.config import LeagueTrainingError
from shuttle_marl.training.league.population import Frozen

LEAGUE: Final = "league.json"
"""File of the state in the folder of a run."""


@dataclasses.dataclass(kw_only=True)
class Member:
    """A learner.

    Attributes:
        turns: since it began with new weights.
        strokes: in all.
        hash: of its present table; empty before its first turn with these weights.
    """

    turns: int = 0
    strokes: int = 0
    hash: str = ""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Best:
    """The least exploitable main agent so far.

    Attributes:
        name: of the policy, such as ``main-agent-0@3``.
        hash: of its table.
        exploitability: what a best response to it gains.
        temperature: at which its network is played; 1 for a mixture.
    """

    name: str
    hash: str
    exploitability: float
    temperature: float


@dataclasses.dataclass(kw_only=True)
class LeagueState:
    """Everything between two rounds.

    Attributes:
        game: hash of the game.
        round: rounds that are over.
        population: frozen policies, in the order in which they joined.
        members: learners by name.
        cells: payoffs that are known; see :class:`~shuttle_marl.training.league.population.Payoffs`.
        best: None before the first round is over.
        converged: whether the last best response of psro was there already.
        seconds: of the whole run so far.
        overhead: seconds of the last round in which its main agent did not learn.
        metrics: what :class:`~shuttle_marl.training.metrics.Metrics` needs to cut what came later.
    """

    game: str
    round: int = 0
    population: list[Frozen] = dataclasses.field(default_factory=list)
    members: dict[str, Member] = dataclasses.field(default_factory=dict)
    cells: dict[str, list[float]] = dataclasses.field(default_factory=dict)
    best: Best | None = None
    converged: bool = False
    seconds: float = 0.0
    overhead: float = 0.0
    metrics: dict[str, Any] | None = None

    def save(self, folder: Path) -> None:
        """Write the state into the folder of its run."""
        replace_file(folder / LEAGUE, seal(dataclasses.asdict(self)))

    @classmethod
    def load(cls, folder: Path, game: str) -> "LeagueState | None":
        """The state in a folder; None before the first one was written.

        Raises:
            LeagueTrainingError: it is damaged, or of another game.
        """
        path = folder / LEAGUE
        if not path.exists():
            return None
        try:
            fields = read_sealed(path)
            fields = {field.name: fields[field.name] for field in dataclasses.fields(cls)}
            fields["population"] = [Frozen(**each) for each in fields["population"]]
            fields["members"] = {name: Member(**each) for name, each in fields["members"].items()}
            fields["best"] = None if fields["best"] is None else Best(**fields["best"])
        except (FileReadError, KeyError, TypeError, AttributeError) as error:
            raise LeagueTrainingError(f"{path}: cannot be used ({error}); train again with --overwrite") from error
        if fields["game"] != game:
            raise LeagueTrainingError(
                f"{path}: was trained on game {str(fields['game'])[:12]}, this is {game[:12]}; continue with the same --game, or "
                "train again with another --out"
            )
        return cls(**fields)
