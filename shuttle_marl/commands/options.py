"""Options that several commands share, as dataclasses whose fields become flags."""

import contextlib
import dataclasses
import itertools
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Literal

import tyro

from shuttle_marl.base.errors import printable
from shuttle_marl.base.files import replace_file
from shuttle_marl.commands.cli import console, print_json, say
from shuttle_marl.game.policy import TabulatedPolicy, tabulate
from shuttle_marl.game.shipped import Profile, resolve_game, shipped_game
from shuttle_marl.game.tables import Game
from shuttle_marl.reports.languages import Language

if TYPE_CHECKING:
    from shuttle_marl.reports.coach import CoachReport

Policies = Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[POLICY ...]")]
Policy = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="POLICY")]
Json = Annotated[bool, tyro.conf.arg(name="json", help="print JSON.")]
File = Annotated[Path | None, tyro.conf.arg(metavar="FILE")]
Athlete = Literal["male", "female"]
Hand = Literal["right", "left"]
HandsTold = Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(name="hand", metavar="NAME=HAND")]


@contextlib.contextmanager
def hands_told(hands: HandsTold) -> Iterator[None]:
    """Within the block strokes are read with the hands that the option tells; then stderr says whose hands are unknown."""
    from shuttle_marl.data.hands import telling_hands  # noqa: PLC0415  pyarrow

    with telling_hands(hands) as unknown:
        yield
    for sentence in dict.fromkeys(itertools.chain(*unknown)):
        console(stderr=True).print(printable(sentence))


@dataclasses.dataclass(frozen=True, kw_only=True)
class GameOptions:
    """The game that is solved or played."""

    game: str = "default"  # Model of the game: a shipped one or a folder.
    profile: Profile | None = None  # Discipline of the game; default: the average of both.

    def load(self) -> Game:
        """The tables of the game."""
        return resolve_game(self.game, self.profile)


Model = tyro.conf.OmitArgPrefixes[GameOptions]
MODEL: Final = GameOptions()


@dataclasses.dataclass(frozen=True, kw_only=True)
class RallyGameOptions:
    """The game of recorded rallies."""

    game: str | None = None  # Model of the game: a shipped one or a folder; default: the shipped game that the log was played on.
    profile: Profile | None = None  # Discipline of the game.

    def load_for(self, path: Path | None) -> Game:
        """The game of a rally log; for annotated matches the shipped one, with a notice.

        Args:
            path: the log, or annotated matches; None: no recorded rallies.

        Raises:
            RecordingError: the log cannot be read, or was played on a game that is not shipped.
        """
        from shuttle_marl.recording import RallyLog, RecordingError  # noqa: PLC0415  pyarrow
        from shuttle_marl.recording.reader import is_log  # noqa: PLC0415

        if path is None or not is_log(path):
            if path is None or self.game is not None or self.profile is not None:
                return resolve_game(self.game, self.profile)
            console(stderr=True).print("game: the shipped one, of elite men's and women's singles; --game MODEL names another")
            return resolve_game(None)
        with RallyLog(path) as log:
            played, pair = log.files[0].header.game, log.files[0].header.pair
        if pair is not None:
            return pair.game(self.game or "default")
        if self.game is not None or self.profile is not None:
            return resolve_game(self.game, self.profile)
        game = shipped_game(played)
        if game is None:
            raise RecordingError(f"{path}: played on game {played[:12]}, which is not shipped; name its model with --game")
        return game


RallyModel = tyro.conf.OmitArgPrefixes[RallyGameOptions]
RALLY_MODEL: Final = RallyGameOptions()


def tables_of(names: Iterable[str], game: Game) -> list[TabulatedPolicy]:
    """The tables of policies by name."""
    from shuttle_marl.policy.registry import resolve  # noqa: PLC0415

    return [tabulate(resolve(name, game), game) for name in names]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Appearance:
    """Appearance of the players."""

    athletes: tuple[Athlete, Athlete] | None = None  # Athletes at seats 0 and 1 (A and B); default: as the players are.
    hands: tuple[Hand, Hand] | None = None  # Racket hands at seats 0 and 1 (A and B); default: those of the players.


@dataclasses.dataclass(frozen=True, kw_only=True)
class ReportOptions:
    """The page and the figures of a report."""

    out: File = None  # HTML file; default: the name of the command.
    language: Language = "en"  # Language of the page: English, Chinese (simplified) or Indonesian.
    hand: HandsTold = ()  # Hand of a player, such as kento-momota=left. Default: strokes around the head tell it.
    json_output: Json = False  # Print the figures as JSON, and write no page unless --out is given.

    def write(self, report: "CoachReport", name: str) -> None:
        """Write the page and print the figures that the options ask for; ``name``: of the page by default."""
        if self.json_output:
            print_json(report.figures)
        if self.out is not None or not self.json_output:
            out = self.out or Path(name)
            replace_file(out, report.html(self.language))
            if not self.json_output:
                say(f"report: {out}")
