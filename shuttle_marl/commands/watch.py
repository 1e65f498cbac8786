"""``python -m shuttle_marl.watch``: the live 3D court, a page served by this machine."""

import contextlib
import dataclasses
import functools
import threading
import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING, Final

import tyro

from shuttle_marl.base.errors import counted, printable
from shuttle_marl.commands import cli
from shuttle_marl.commands.options import RALLY_MODEL, Appearance, RallyGameOptions, RallyModel
from shuttle_marl.court import WatchError, building
from shuttle_marl.game.pairs import pair_game
from shuttle_marl.game.scoring import RulesName
from shuttle_marl.game.shipped import load_game, origin_of
from shuttle_marl.game.tables import Game
from shuttle_marl.policy.baselines import imitation
from shuttle_marl.policy.baselines import players as imitated
from shuttle_marl.policy.registry import resolve
from shuttle_marl.reports.languages import Language, current

if TYPE_CHECKING:
    from shuttle_marl.court.answers import Answers
    from shuttle_marl.court.plan import Plan
    from shuttle_marl.court.recorded import Recorded
    from shuttle_marl.court.server import Downloads
    from shuttle_marl.court.tagging import TagFile


GAME: Final = "default:recovery"
"""Game of matches: players choose where to wait, too."""
_APPEARANCE: Final = Appearance()
FAMOUS: Final = {"men": ("bc:viktor-axelsen", "bc:kento-momota"), "women": ("bc:an-se-young", "bc:chen-yufei")}
"""Players of the default match; of a model that does not imitate them, an agent and the average pro."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class MatchOptions:
    """The match that a page shows first.

    Attributes:
        a: policy of the near player; default: Viktor Axelsen, or with --players that player, imitated.
        b: policy of the far player; default: Kento Momota, or with --players that player, imitated.
        temperature: temperatures of both policies; 1: unchanged, 0: greedy.
        seed: random seed.
        players: near and far player, with their skill: the game of this pair; default: both strike with the same probabilities.
        date: day of their skill, such as 2021-07-31; default: the last one known.
    """

    a: str | None = None
    b: str | None = None
    temperature: tuple[float, float] = (1.0, 1.0)
    seed: int = 0
    players: tuple[str, str] | None = None
    date: str | None = None

    def policies(self, game: Game) -> tuple[str, str]:
        """Policies of the near and the far player; by default the players of the game of a pair, imitated."""
        origin = origin_of(game)
        first, second = FAMOUS["women" if origin is not None and origin.variant == "women" else "men"]
        if not {first, second} <= {f"bc:{player}" for player in imitated(game)}:
            first, second = ("ppo", "bc")
        if self.players is not None and game.people is not None:
            first, second = map(imitation, game.people.players, game.seats)
        return self.a or first, self.b or second

    def plan(self, game: Game) -> "Plan":
        """The match."""
        from shuttle_marl.court.plan import Plan  # noqa: PLC0415

        sides = [{"policy": name, "temperature": t} for name, t in zip(self.policies(game), self.temperature, strict=True)]
        return Plan.parse({"seed": self.seed, "sides": sides})


@dataclasses.dataclass(frozen=True, kw_only=True)
class RallyOptions:
    """Recorded rallies instead of a match.

    Attributes:
        replay: rally log to show.
        real: annotated matches to show: a stroke table, or a folder with the raw files.
        rally: number of the rally to show first, from 0.
        rules: of the annotated or tagged matches, such as 15, 11 or 21x1; default: those of the table, or of its scores.
    """

    replay: Path | None = None
    real: Path | None = None
    rally: int | None = None
    rules: RulesName | None = None


@dataclasses.dataclass(frozen=True, kw_only=True)
class TagOptions:
    """A video whose strokes are entered, instead of a match.

    Attributes:
        tag: the video, which only this machine reads.
        out: table of the strokes, a CSV file; continued if it exists.
    """

    tag: Path | None = None
    out: Path | None = None

    def open(self, rules: RulesName | None = None) -> "TagFile | None":
        """The files; None: no video is tagged."""
        from shuttle_marl.court.tagging import TagFile  # noqa: PLC0415

        if (self.tag is None) != (self.out is None):
            raise WatchError("--tag and --out belong together: a video, and the table of its strokes")
        return None if self.tag is None or self.out is None else TagFile(self.tag, self.out, rules)


@dataclasses.dataclass(frozen=True, kw_only=True)
class OutputOptions:
    """Files that are written.

    Attributes:
        record: folder for the logs of rallies that you play.
        save_site: write the match as static files to this folder, for any web server, and exit.
    """

    record: Path = Path("runs/watch")
    save_site: Path | None = None


@dataclasses.dataclass(frozen=True, kw_only=True)
class ServerOptions:
    """The server of the page.

    Attributes:
        host: address to listen on; the default accepts connections from this machine only.
        allowed_hosts: further host names of the server, such as that of a proxy in front of it.
        port: port; if it is in use, a free one.
        browser: open the page in the browser.
        language: language of the page until its reader chooses another: English, Chinese (simplified) or Indonesian.
    """

    host: str = "127.0.0.1"
    allowed_hosts: tuple[str, ...] = ()
    port: int = 8090
    browser: bool = True
    language: Language = "en"


def watch(
    *,
    match: tyro.conf.OmitArgPrefixes[MatchOptions] = MatchOptions(),
    rallies: tyro.conf.OmitArgPrefixes[RallyOptions] = RallyOptions(),
    tagging: tyro.conf.OmitArgPrefixes[TagOptions] = TagOptions(),
    appearance: tyro.conf.OmitArgPrefixes[Appearance] = _APPEARANCE,
    output: tyro.conf.OmitArgPrefixes[OutputOptions] = OutputOptions(),
    model: RallyModel = RALLY_MODEL,
    server: tyro.conf.OmitArgPrefixes[ServerOptions] = ServerOptions(),
) -> None:
    """Watch matches in 3D, analyse them, or play: opens a page in the browser, served by this machine.

    Args:
        match: match that a page shows first.
        rallies: recorded rallies instead of a match.
        tagging: a video whose strokes are entered, instead of a match.
        appearance: appearance of the players.
        output: files that are written.
        model: the game.
        server: server of the page.
    """
    from shuttle_marl.court.answers import Answers, first_key, shipped_rally  # noqa: PLC0415  these keep --help quick
    from shuttle_marl.court.match import MatchLog, PolicyTables  # noqa: PLC0415
    from shuttle_marl.court.server import Server, application, bind, hosts_of  # noqa: PLC0415

    console = cli.console(stderr=True)
    if rallies.rules is not None and rallies.real is None and tagging.tag is None:
        raise WatchError(f"--rules {rallies.rules}: are of annotated matches, --real, or of a tagged one, --tag")
    tags = tagging.open(rallies.rules)
    game = _game(match, rallies, model)
    plan, policies = match.plan(game), PolicyTables(game, match.policies(game))
    recorded, first = _recorded(rallies, policies.game), rallies.rally or 0
    for name in match.policies(game) if recorded is None and tags is None else ():
        resolve(name, policies.game.seats[0])  # an unknown one is an error before the page is served
    try:  # last, because it may take longest
        page = building.build(lambda words: console.print(words, soft_wrap=True))
    except building.BuildError as error:
        raise WatchError(str(error)) from error
    with (
        contextlib.closing(bind(server.host, server.port)) as listener,
        contextlib.closing(MatchLog(output.record, policies)) as log,
    ):
        athletes, hands = appearance.athletes, appearance.hands
        key = first_key(policies.game, plan, athletes, hands)
        answers = Answers(
            policies,
            plan,
            athletes=athletes,
            hands=hands,
            recorded=recorded,
            first=first,
            log=log,
            tags=tags,
            shipped=shipped_rally(key) if recorded is None and tags is None else None,
        )
        if output.save_site is not None:
            _save_site(output.save_site, page, answers, server.language)
            return
        host = f"[{server.host}]" if ":" in server.host else server.host
        if server.port not in (0, listener.getsockname()[1]):
            console.print(f"--port {server.port}: in use, so another one is taken", soft_wrap=True)
        address = f"http://{host}:{listener.getsockname()[1]}/"
        app = application(
            answers,
            page,
            downloads={} if recorded is None else _downloads(rallies, recorded, policies.game),
            video=None if tags is None else tags.video,
            language=server.language,
            hosts=hosts_of(server.host),
            proxies=tuple(map(str.lower, server.allowed_hosts)),
        )
        console.print(f"{address} shows the {'match' if tags is None else 'video'}; press Ctrl-C to stop", soft_wrap=True)
        if tags is None:
            threading.Thread(target=answers.warm, daemon=True).start()
        if server.browser:
            webbrowser.open(address)
        with contextlib.suppress(KeyboardInterrupt):
            Server(app).run(sockets=[listener])


def _game(match: MatchOptions, rallies: RallyOptions, model: RallyGameOptions) -> Game:
    """The game of the recorded rallies, of two players, or of a model; by default, matches are played with recovery.

    Raises:
        WatchError: players and recorded rallies, which have their own; or a date without players.
    """
    if match.players is None:
        if match.date is not None:
            raise WatchError(f"--date {match.date}: is the day of the skill of --players; give both")
        if model.game is None and rallies.replay is None and rallies.real is None:
            return load_game(GAME if model.profile is None else GAME.replace(":", f":{model.profile}-"))
        return model.load_for(rallies.replay or rallies.real)
    if rallies.replay is not None or rallies.real is not None:
        raise WatchError("--players and recorded rallies, which name their own players; leave out --players")
    return pair_game(*match.players, date=match.date, discipline=model.profile, game=model.game or GAME)


def _recorded(options: RallyOptions, game: Game) -> "Recorded | None":
    """The recorded rallies to show; None: a match.

    Raises:
        WatchError: two sources, or no such rally.
    """
    from shuttle_marl.court.recorded import LogRallies, RealRallies  # noqa: PLC0415
    from shuttle_marl.data import read_matches  # noqa: PLC0415
    from shuttle_marl.data.hands import unknown_hands  # noqa: PLC0415
    from shuttle_marl.recording.reader import RallyLog  # noqa: PLC0415

    if options.replay is not None and options.real is not None:
        raise WatchError("--replay and --real: give one of them")
    recorded: Recorded | None = None
    if options.replay is not None:
        recorded = LogRallies(RallyLog(options.replay), game)
    elif options.real is not None:
        strokes = read_matches(options.real, rules=options.rules)
        for sentence in unknown_hands(strokes):
            cli.console(stderr=True).print(printable(sentence), soft_wrap=True)
        recorded = RealRallies(options.real, game, strokes)
    if recorded is not None and not 0 <= (options.rally or 0) < recorded.count:
        raise WatchError(f"--rally {options.rally}: expected 0 to {recorded.count - 1}")
    return recorded


def _downloads(options: RallyOptions, recorded: "Recorded", game: Game) -> "Downloads":
    """The report of the match of a recorded rally, by the name and the media type of the file."""
    path = options.replay or options.real
    assert path is not None

    @functools.lru_cache(maxsize=8)
    def report(match: str | tuple[int, int], _: Language) -> bytes:
        from shuttle_marl.court.clips import match_clips  # noqa: PLC0415
        from shuttle_marl.reports.coach import report as made  # noqa: PLC0415  Jinja

        pairing, name = (0, match) if isinstance(match, str) else (match[0], str(match[1]))
        return made(path, name, pairing=pairing, game=game, rules=options.rules, clips=match_clips).html(current())

    return {("report", "text/html"): lambda number: report(recorded.match(number), current())}


def _save_site(folder: Path, page: Path, answers: "Answers", language: Language) -> None:
    from shuttle_marl.court.site import save_site  # noqa: PLC0415

    with cli.console(stderr=True).status("saving the rallies …") as status:
        count, size, left = save_site(
            folder, page, answers, lambda done: status.update(f"saving the rallies … {done}"), language=language
        )
    rest = f"; {left:,} more did not fit" if left else ""
    cli.say(f"{folder}: {counted(count, 'rally', 'rallies')}, {size / 1e6:.1f} MB{rest}")


COMMANDS: Final = watch
main: Final = cli.entry_point(COMMANDS, "python -m shuttle_marl.watch", (watch.__doc__ or "").partition("\n")[0])
