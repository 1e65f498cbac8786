"""``python -m shuttle_marl.recording info | check | recover | export | show | scene``."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Literal

import tyro

from shuttle_marl.base.errors import counted, printable
from shuttle_marl.base.files import replace_file
from shuttle_marl.commands import cli
from shuttle_marl.commands.options import RALLY_MODEL, Appearance, Json, RallyModel
from shuttle_marl.court import WatchError
from shuttle_marl.court import scene as scenes
from shuttle_marl.game.court import AREA_WORDS
from shuttle_marl.game.policy import Policy
from shuttle_marl.game.rules import OUTCOMES, REASONS
from shuttle_marl.game.stroke import HEIGHTS, SHOTS, TECHNIQUES
from shuttle_marl.game.tables import Game
from shuttle_marl.recording import export as export_log
from shuttle_marl.recording.header import RecordingError
from shuttle_marl.recording.log_file import Recovery, recoverable_files, unfinished_files
from shuttle_marl.recording.log_file import recover as recover_log
from shuttle_marl.recording.reader import Checked, RallyLog
from shuttle_marl.recording.reader import check as check_log

if TYPE_CHECKING:
    from shuttle_marl.reports.rally import Resolve

File = Annotated[Path, tyro.conf.Positional]
Log = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="LOG")]
Policies = Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=POLICY")]

_APPEARANCE: Final = Appearance()
_HINT: Final = "--policy NAME=POLICY gives the policy for a name in the log"


def info(path: Log, *, json_output: Json = False) -> None:
    """Print the contents of a log.

    Args:
        path: a rally log, or a folder of them.
    """
    with RallyLog(path) as log:
        headers = [file.header for file in log.files]
        facts: dict[str, object] = {
            "path": str(path),
            "files": len(log.files),
            "unfinished": [file.name for file in unfinished_files(path)],
            "rallies": log.n_rallies,
            "strokes": log.n_strokes,
            "batches": len(log.rallies),
            "bytes": log.size,
            "bytes_per_stroke": round(log.size / max(1, log.n_strokes), 3),
            "policies": [player.name for player in log.policies],
            "pairings": len(log.pairings),
            "seeds": None if "seed" in headers[0].columns else list(dict.fromkeys(header.seed for header in headers)),
            "game": headers[0].game,
            "players": [] if headers[0].pair is None else list(headers[0].pair.players),
            "draws": list(dict.fromkeys(header.draws for header in headers)),
            "columns": list(headers[0].columns),
            "software": list(dict.fromkeys(header.software for header in headers)),
        }
    cli.show(facts, json_output)


def check(path: Log, *, model: RallyModel = RALLY_MODEL, replay: bool = True) -> None:
    """Check checksums, numbers and scores of a log and replay every stroke; exit status 1 on errors.

    Args:
        path: a rally log, or a folder of them.
        model: game on which the log was played.
        replay: replay the strokes; needs that game.
    """
    result = check_log(path, model.load_for(path) if replay else None)
    if result.problems:
        raise RecordingError(f"{path}: {'; '.join(result.problems)}")
    how = "replayed with equal outcomes" if result.replayed else "not replayed"
    cli.say(f"{path}: valid; {_amounts(result)}, {how}")


def recover(path: Log, *, out: Path | None = None) -> None:
    """Recover a truncated or damaged log: write everything that can be read to a new log.

    Args:
        path: the log, usually FILE.part, or a folder with unfinished logs.
        out: the new log; default: FILE for FILE.part, NAME.recovered.mcap otherwise.
    """
    if path.is_dir() and out is not None:
        raise RecordingError(f"--out {out}: expected a single log, not the folder {path}; recover its files one by one")
    problems: list[str] = []
    for source in recoverable_files(path) if path.is_dir() else [path]:
        try:
            recovered = recover_log(source, out)
        except RecordingError as error:
            problems.append(str(error))
            continue
        lost = f"; {counted(recovered.lost, 'rally', 'rallies')} lost" if recovered.lost else ""
        cli.say(f"{recovered.path}: {_amounts(recovered)} recovered{lost}")
    if problems:
        raise RecordingError("\n".join(problems))


def export(path: Log, out: File, *, rows: Literal["rallies", "strokes"] = "rallies") -> None:
    """Export a log as a table.

    Args:
        path: a rally log, or a folder of them.
        out: the table; its suffix selects the format: .parquet, .csv or .arrow.
        rows: one row per rally or one row per stroke.
    """
    cli.say(f"{out}: {counted(export_log(path, out, rows), 'row')}")


def show(path: Log, *, rally: int | None = None, pairing: int = 0, match: int | None = None) -> None:
    """Print a rally or all rallies of a match.

    Args:
        path: a rally log, or a folder of them.
        rally: number of the rally in the log.
        pairing: number of the pairing of the match.
        match: number of the match in its pairing.
    """
    if (rally is None) == (match is None):
        raise RecordingError("expected either --rally NUMBER or --match NUMBER")
    with RallyLog(path) as log:
        if rally is not None:
            cli.say(_describe(log, rally))
            return
        numbers = log.numbers_of_match(pairing, match or 0)
        if not len(numbers):
            raise RecordingError(f"{path}: no match {match} of pairing {pairing}; see `info` for how many pairings there are")
        for number in numbers:
            cli.say(_describe(log, int(number)))
        cli.say(f"games: {', '.join(f'{a}-{b}' for a, b in log.points_of_games(int(numbers[0])).values())}")


def scene(
    path: Log,
    *,
    out: Path,
    rally: int | None = None,
    match: int | None = None,
    pairing: int = 0,
    policy: Policies = (),
    appearance: tyro.conf.OmitArgPrefixes[Appearance] = _APPEARANCE,
    model: RallyModel = RALLY_MODEL,
) -> None:
    """Write rallies as a 3D scene for Foxglove or Lichtblick: --rally or --match; by default the longest rally.

    Args:
        path: a rally log, or a folder of them.
        out: the file to write, NAME.mcap.
        rally: number of the rally in the log.
        match: number of the match in its pairing: all its rallies.
        pairing: number of the pairing of the match.
        policy: policy for a name in the log; modules and files are allowed here.
        appearance: appearance of the players.
        model: game of the log.
    """
    cli.check_suffix(out, ".mcap")
    console = cli.console(stderr=True)
    with RallyLog(path) as log:
        numbers = scenes.select(log, rally=rally, match=match, pairing=pairing)
        content, unknown = scenes.write_scene(
            log,
            numbers,
            model.load_for(path),
            hands=appearance.hands,
            athletes=appearance.athletes,
            resolve=_resolver(policy, [player.name for player in log.policies]),
            progress=lambda numbers: cli.progress(numbers, "staging"),
        )
    for name, reason in unknown.items():
        console.print(f"without probabilities of {name}: {reason}", soft_wrap=True)
    if unknown and not policy:
        console.print(_HINT, soft_wrap=True)
    replace_file(out, content)
    size = f"{counted(len(numbers), 'rally', 'rallies')}, {len(content) / 1e6:.1f} MB"
    cli.say(f"{out}: {size}; open it in Foxglove or Lichtblick")


COMMANDS: Final = cli.by_name(info, check, recover, export, show, scene)
main: Final = cli.entry_point(
    COMMANDS, "python -m shuttle_marl.recording", "Read, check, recover and export rally logs, and write 3D scenes."
)


def _amounts(found: Checked | Recovery) -> str:
    return f"{counted(found.rallies, 'rally', 'rallies')}, {counted(found.strokes, 'stroke')}"


def _describe(log: RallyLog, number: int) -> str:
    """One rally as text: players, score, one line per stroke, winner."""
    row = log.rally(number)
    rally = row.row(0, log.catalogue)
    names = [printable(log.policies[i].name) for i in row.policy[0]]
    width, catalogue = max(map(len, names)), rally.catalogue
    lines = [
        f"rally {number}: {names[0]} v {names[1]}, match {rally.match}, rally {rally.number}, "
        f"games {rally.games[0]}-{rally.games[1]}, points {rally.points[0]}-{rally.points[1]}, {names[rally.server]} serves"
    ]
    for i, (seat, stroke, outcome) in enumerate(zip(rally.striker, rally.stroke, rally.outcome, strict=True), start=1):
        shot, area = SHOTS[catalogue.shot[stroke]], AREA_WORDS[catalogue.area[stroke]]
        technique, height = TECHNIQUES[catalogue.technique[stroke]], HEIGHTS[catalogue.height[stroke]]
        lines.append(f"{i:5}  {names[seat]:{width}}  {shot} to {area}, {technique} from {height} the net  [{OUTCOMES[outcome]}]")
    lines.append(f"       {[*names, 'nobody'][row.winner[0]]} wins the rally ({REASONS[row.reason[0]]})")
    return "\n".join(lines)


def _resolver(policies: Sequence[str], names: Sequence[str]) -> "Resolve":
    """Function that resolves the policies of a log: given by the user, else by their names in the log."""
    from shuttle_marl.policy.registry import resolve, resolve_recorded  # noqa: PLC0415

    given: dict[str, str] = {}
    for entry in policies:
        matching = [name for name in names if entry.startswith(f"{name}=")]
        if not matching:
            raise WatchError(f"--policy {entry}: expected NAME=POLICY with a name of the log, which has {', '.join(names)}")
        name = max(matching, key=len)
        given[name] = entry.removeprefix(f"{name}=")

    def resolved(name: str, game: Game) -> Policy:
        if name in given:
            return resolve(given[name], game)
        return resolve_recorded(name, game)

    return resolved
