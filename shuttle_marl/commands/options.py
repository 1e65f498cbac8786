"""Options that several commands share, as dataclasses whose fields become flags."""

import contextlib
import dataclasses
import itertools
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

import msgspec
import tyro

from shuttle_marl.base.errors import OptionError, printable
from shuttle_marl.base.files import Seed, check_bounds, replace_file
from shuttle_marl.commands.cli import console, print_json, say
from shuttle_marl.exact.fixed_point import ExactError
from shuttle_marl.game.policy import TabulatedPolicy, tabulate
from shuttle_marl.game.shipped import Profile, resolve_game, shipped_game
from shuttle_marl.game.tables import Game
from shuttle_marl.policy.foreign import POLICY_TIMEOUT
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
class PlayerOptions:
    """The players of strokes."""

    hand: HandsTold = ()  # Hand of a player, such as kento-momota=left. Default: strokes around the head tell it.
    anonymous: bool = False  # Replace the names of players and matches.


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
class SampleOptions:
    """Matches of policies that read the score."""

    matches: Annotated[int, msgspec.Meta(ge=1, le=10_000_000)] = 400  # Number of matches played for a policy that is sampled.
    seed: Seed = 0  # Random seed of these matches.
    record: Literal["all", "none"] = "all"  # Which of their rallies are recorded.
    log: File = None  # Rally log of these matches; default: runs/evaluate-SEED.mcap, or the next such name that is free.
    policy_timeout: float = POLICY_TIMEOUT  # Seconds that a program may take for one stroke; 0 for no limit.

    def __post_init__(self) -> None:
        check_bounds(self, ExactError)


@dataclasses.dataclass(frozen=True, kw_only=True)
class ReportOptions(PlayerOptions):
    """Files and figures of a report."""

    out: File = None  # HTML file; default: the name of the command.
    pdf: File = None  # PDF file, written by Chromium; its first page is one side for the player.
    figures: File = None  # CSV or Parquet file for a table of all figures.
    language: Language = "en"  # Language of the page: English, Chinese (simplified) or Indonesian.
    json_output: Json = False  # Print the figures as JSON, and write no page unless --out or --pdf is given.

    def write(self, report: "CoachReport", name: str) -> None:
        """Write the page, the PDF file and the figures that the options ask for.

        Args:
            name: of the file of the page by default.

        Raises:
            WatchError: there is no Chromium, or it cannot print; the page is written.
        """
        files: dict[str, Path] = {}
        if self.figures is not None:
            write_figures(report.figures, self.figures)
            files["figures"] = self.figures
        if self.json_output:
            print_json(report.figures)
        if not self.json_output or self.out is not None or self.pdf is not None:
            content = report.html(self.language)
            out = self.out or Path(name)
            replace_file(out, content)
            files["report"] = out
            if self.pdf is not None:
                replace_file(self.pdf, printed(content, out))
                files["PDF"] = self.pdf
        for what, path in () if self.json_output else files.items():
            say(f"{what}: {path}")


def write_figures(figures: Mapping[str, Any], path: Path) -> None:
    """Write all figures of a report as a table: the name of each, such as ``page1.0.count``, and its number or text.

    Raises:
        OptionError: the name of the file does not end in ``.csv`` or ``.parquet``.
        FileWriteError: it cannot be written.
    """
    import pyarrow as pa  # noqa: PLC0415  these keep --help quick

    from shuttle_marl.base.table_files import csv_bytes, parquet_bytes  # noqa: PLC0415

    def parts(value: Any, name: str) -> Iterator[tuple[str, Any]]:
        inner = value.items() if isinstance(value, Mapping) else enumerate(value) if isinstance(value, list) else None
        if inner is None:
            yield name, value
        else:
            for key, part in inner:
                yield from parts(part, f"{name}.{key}" if name else f"{key}")

    names, values = zip(*parts(figures, ""), strict=True)
    numbers = [float(value) if isinstance(value, int | float) else None for value in values]
    texts = [value if isinstance(value, str) else None for value in values]
    table = pa.table({"figure": names, "number": pa.array(numbers, pa.float64()), "text": pa.array(texts, pa.string())})
    if path.suffix not in (".csv", ".parquet"):
        raise OptionError(f"--figures {path}: expected a file name that ends in .csv or .parquet")
    replace_file(path, csv_bytes(table) if path.suffix == ".csv" else parquet_bytes(table))


def printed(page: bytes, out: Path) -> bytes:
    """A page on paper of size A4.

    Args:
        page: content of the HTML file.
        out: its name, for errors.
    """
    from playwright.sync_api import Error  # noqa: PLC0415  an extra

    from shuttle_marl.court import WatchError  # noqa: PLC0415
    from shuttle_marl.court.server import browser_page, browser_program  # noqa: PLC0415

    try:
        with tempfile.TemporaryDirectory() as folder, browser_page() as tab:
            file = Path(folder) / "report.html"
            file.write_bytes(page)
            tab.goto(file.as_uri())
            return tab.pdf(prefer_css_page_size=True, print_background=True)
    except Error as error:
        reason = error.message.partition("\n")[0]
        advice = f"open {out} in another browser and print it"
        raise WatchError(f"{browser_program()} cannot print the report ({reason}); {advice}") from error
