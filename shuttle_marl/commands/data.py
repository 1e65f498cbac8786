"""``python -m shuttle_marl.data``: download, convert, summarise and check annotated matches."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Final

import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from shuttle_marl.base.errors import command
from shuttle_marl.base.files import replace_file
from shuttle_marl.commands import cli
from shuttle_marl.commands.options import HandsTold
from shuttle_marl.data import Report, provenance_of, upstream, words, write_parquet
from shuttle_marl.data import validate as check
from shuttle_marl.data.cleaning import clean_matches
from shuttle_marl.data.hands import hands_of, telling_hands
from shuttle_marl.data.own import import_matches
from shuttle_marl.data.schema import DROP_REASONS, Account, DataError
from shuttle_marl.data.table import load_counted, pseudonymous
from shuttle_marl.data.upstream import SPLITS, Split
from shuttle_marl.game.scoring import RulesName

_NOTE = f"The data is not ours. {upstream.LICENCE_NOTE}\nPlease cite, where you use it:\n" + "\n".join(
    f"  {citation}" for citation in upstream.CITATIONS
)


Root = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(name="root")]
File = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(name="file")]


def download(*, out: Path, base_url: str = upstream.BASE_URL, jobs: int = 8) -> None:
    """Download ShuttleSet and ShuttleSet22 at a pinned commit; resumes an interrupted download.

    Args:
        out: Output folder.
        base_url: Base URL of the files.
        jobs: Number of concurrent downloads.
    """
    from shuttle_marl.data.upstream import download as fetch  # noqa: PLC0415  only this command needs the network

    total = len(upstream.manifest())
    columns = (TextColumn("files"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True)) as progress:
        task = progress.add_task("files", total=total)
        fetched = fetch(out, base_url=base_url, jobs=jobs, on_file=lambda done, _: progress.update(task, completed=done))
    cli.say(f"{out}: {total} files, all as published ({fetched} downloaded, {total - fetched} present already)", _NOTE)


def convert(root: Root, *, out: Path, hand: HandsTold = (), overwrite: bool = False) -> None:
    """Clean the raw files and write one Parquet file; prints the dropped rows by reason.

    Args:
        root: Folder with the raw files.
        out: Parquet file to write.
        hand: Hand of a player, such as kento-momota=left. Default: strokes around the head tell it.
        overwrite: Replace an existing file.
    """
    cli.check_free(out, overwrite=overwrite)
    with telling_hands(hand):
        cleaned = clean_matches(root)
    write_parquet(cleaned.strokes, out, account=cleaned.account, provenance=provenance_of(root, cleaned), new=not overwrite)
    cli.show(cleaned.account.as_json(), False, _dropped(cleaned.account))
    cli.say(*_found(cleaned.provenance), f"{out}: {cleaned.strokes.num_rows} strokes", _NOTE)


def import_(
    file: File,
    *,
    columns: Path | None = None,
    rules: RulesName | None = None,
    out: Path | None = None,
    hand: HandsTold = (),
    anonymous: bool = False,
    overwrite: bool = False,
    json: bool = False,
) -> None:
    """Import your own matches from a table or from the file of another program, and write a Parquet file.

    Args:
        file: A CSV file in UTF-8 with a row per stroke; or a game of ShuttleSet, or XML of Sportscode, Dartfish or Nacsport.
        columns: Column map, a TOML file; `data template` writes an example. None: headers and words in any of seven languages.
        rules: Points of a game, and best of how many, such as 15, 11 or 21x1; default: those of the map, or of the scores.
        out: Parquet file to write; None: only read and count.
        hand: Hand of a player, such as "Anna Example=left". Default: that of the column hand, or else strokes
            around the head tell it.
        anonymous: Replace the names of players and matches by pseudonyms.
        overwrite: Replace an existing file.
        json: Print JSON: the format, the numbers of rows, of kept and, by reason, of dropped ones, what was inferred and what the
            file does not have, and warnings; for a refused file, its problems.
    """
    if out is not None:
        cli.check_free(out, overwrite=overwrite)
    try:
        with telling_hands(hand):
            cleaned = import_matches(file, columns, rules)
    except DataError as error:
        if json:
            dropped = {"file refused": error.rows} if error.rows else {}
            told = [str(problem) for problem in error.problems]
            cli.print_json({"rows": error.rows, "kept": 0, "dropped": dropped, "warnings": [], "problems": told})
        raise
    if anonymous:
        cleaned = pseudonymous(cleaned)
    account, about = cleaned.account, cleaned.provenance
    if out is not None:
        write_parquet(cleaned.strokes, out, account=account, provenance=dict(about), new=not overwrite)
    if json:
        counts = {"rows": account.strokes, "kept": account.strokes_kept, "dropped": account.dropped}
        found = {"inferred": about["inferred"], "lost": about["lost"], "warnings": cleaned.warnings}
        cli.print_json({"format": about["format"], **counts, **found})
        return
    cli.say(f"format: {about['format']}")
    cli.show(account.as_json(), False, _dropped(account))
    written = [] if out is None else [f"{out}: {account.strokes_kept} strokes"]
    cli.say(*_found(about), *(f"warning: {warning}" for warning in cleaned.warnings), *written)


def template(*, out: Path) -> None:
    """Write a CSV file and a map of its columns to start from: strokes.csv and columns.toml.

    Args:
        out: Folder for both.
    """
    contents = {name: words.template(name) for name in ("strokes.csv", "columns.toml")}
    for name in contents:
        cli.check_free(out / name)
    for name, content in contents.items():
        replace_file(out / name, content.encode())
    again = command("data", "import", str(out / "strokes.csv"), "--columns", str(out / "columns.toml"))
    cli.say(f"{out}: {', '.join(contents)}; try `{again}`")


def summary(root: Root, *, json: bool = False) -> None:
    """Count matches, rallies and strokes, the rows dropped by reason, and the hands of the players.

    Args:
        root: Folder with the raw files, a Parquet file made by `convert` or `import`, or a CSV file that needs no column map.
        json: Print JSON. `hands` has for each player the hand (right, left or unknown), the number n of overhead strokes around
            the head on a known side, and the share of them on the striker's right, null if there are none.
    """
    strokes, account = load_counted(root)
    players = hands_of(strokes)
    hands = {name: {"hand": player.name, "n": player.n, "share": player.share} for name, player in players.items()}
    others = {name: of for name, of in hands.items() if of["hand"] != "right"}
    table = cli.named("left-handers, and players of unknown hand: strokes around the head, share on the right", others)
    cli.show({**account.as_json(), "hands": hands}, json, _dropped(account), table)


def validate(root: Root, *, splits: tuple[Split, ...] = SPLITS, columns: Path | None = None, json: bool = False) -> None:
    """Check files against the published hashes and read them strictly, or check a file; lists every problem.

    Args:
        root: Folder with the raw files; a Parquet file made by `convert` or `import`; or a file that `import` reads.
        splits: Splits whose files must be present.
        columns: Column map of a file that `import` reads.
        json: Print JSON.
    """
    report = check(root, splits, columns)
    if json:
        values = {
            "problems": [str(problem) for problem in report.problems],
            "notes": report.notes,
            "splits": {split: {"whole": whole, "files": files} for split, (whole, files) in report.splits.items()},
        }
        cli.print_json(values)
    else:
        cli.say(*_told(report))
    if report.problems:
        raise DataError(root, f"{len(report.problems)} problems")


def _found(about: Mapping[str, Any]) -> list[str]:
    return [f"{kind}: {each}" for kind, key in (("inferred", "inferred"), ("not in the file", "lost")) for each in about[key]]


def _dropped(account: Account) -> Table:
    reasons = ((name, n, DROP_REASONS.get(name, "")) for name, n in account.dropped.items())
    return cli.table("dropped rows", ("rows dropped", "rows", "why"), reasons)


def _told(report: Report) -> Iterator[str]:
    yield from map(str, (*report.notes, *report.problems))
    for split, (whole, files) in report.splits.items():
        state = "complete" if whole == files else "incomplete"
        yield f"{split}: {whole} of {files} files as published, {state}"
    if report.account is not None:
        yield f"{report.account.strokes_kept} strokes of {report.account.matches} matches read"
    if not report.problems:
        yield "no problems"


COMMANDS: Final = cli.by_name(download, convert, import_, template, summary, validate)
main: Final = cli.entry_point(
    COMMANDS,
    "python -m shuttle_marl.data",
    "Annotated matches, published ones and your own: download, convert, import, summarise and check them.",
)
