"""``python -m shuttle_marl.data``: download, convert, summarise and check annotated matches."""

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Final

import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from shuttle_marl.base.errors import command, printable
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
    sys.stdout.write(
        f"{out}: {total} files, all as published ({fetched} downloaded, {total - fetched} present already)\n{_NOTE}\n"
    )


def convert(root: Root, *, out: Path, hand: HandsTold = (), overwrite: bool = False) -> None:
    """Clean the raw files and write one Parquet file; prints the dropped rows by reason.

    Args:
        root: Folder with the raw files.
        out: Parquet file to write.
        hand: Hand of a player, such as kento-momota=left; may be repeated. Default: strokes around the head tell it.
        overwrite: Replace an existing file.
    """
    cli.check_free(out, overwrite=overwrite)
    with telling_hands(hand):
        cleaned = clean_matches(root)
    write_parquet(cleaned.strokes, out, account=cleaned.account, provenance=provenance_of(root, cleaned), new=not overwrite)
    _show(cleaned.account)
    _show_found(cleaned.provenance)
    sys.stdout.write(f"{out}: {cleaned.strokes.num_rows} strokes\n{_NOTE}\n")


def import_own(
    file: File,
    *,
    columns: Path | None = None,
    out: Path | None = None,
    hand: HandsTold = (),
    anonymous: bool = False,
    overwrite: bool = False,
    json: bool = False,
) -> None:
    """Import your own matches from a table or from the file of another program, and write a Parquet file.

    Args:
        file: A CSV file in UTF-8 with a row per stroke; or a file of ShuttleSet, BadmintonDB, ELAN, Sportscode, or of a program
            that recognises strokes in videos (JSON). The content tells which.
        columns: Column map, a TOML file; `data template` writes an example. None: headers and words in any of seven languages.
        out: Parquet file to write; None: only read and count.
        hand: Hand of a player, such as "Anna Example=left"; may be repeated. Default: that of the column hand, or else strokes
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
            cleaned = import_matches(file, columns)
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
    sys.stdout.write(f"format: {about['format']}\n")
    _show(account)
    _show_found(about)
    for warning in cleaned.warnings:
        sys.stdout.write(f"warning: {printable(warning)}\n")
    if out is not None:
        sys.stdout.write(f"{printable(str(out))}: {account.strokes_kept} strokes\n")


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
    sys.stdout.write(f"{printable(str(out))}: {', '.join(contents)}; try `{command('data', 'import')}`\n")


def summary(root: Root, *, json: bool = False) -> None:
    """Count matches, rallies and strokes, the rows dropped by reason, and the hands of the players.

    Args:
        root: Folder with the raw files, a Parquet file made by `convert` or `import`, or a CSV file that needs no column map.
        json: Print JSON. `hands` has for each player the hand (right, left or unknown), the number n of overhead strokes around
            the head on a known side, and the share of them on the striker's right, null if there are none.
    """
    strokes, account = load_counted(root)
    players = hands_of(strokes)
    if json:
        hands = {name: {"hand": player.name, "n": player.n, "share": player.share} for name, player in players.items()}
        cli.print_json({**account.as_json(), "hands": hands})
        return
    _show(account)
    rows = [(name, p.name, p.n, "" if p.share is None else p.share) for name, p in players.items() if p.name != "right"]
    if rows:
        headings = ("player", "hand", "around the head", "share on the right")
        cli.tell(cli.table("left-handers, and players of unknown hand", headings, rows))


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
        _show_report(report)
    if report.problems:
        raise DataError(root, f"{len(report.problems)} problems")


def _show_found(about: Mapping[str, Any]) -> None:
    for kind, sentences in (("inferred", about["inferred"]), ("not in the file", about["lost"])):
        for sentence in sentences:
            sys.stdout.write(f"{kind}: {printable(sentence)}\n")


def _show_report(report: Report) -> None:
    for line in (*report.notes, *report.problems):
        sys.stdout.write(f"{printable(str(line))}\n")
    for split, (whole, files) in report.splits.items():
        state = "complete" if whole == files else "incomplete"
        sys.stdout.write(f"{split}: {whole} of {files} files as published, {state}\n")
    if report.account is not None:
        sys.stdout.write(f"{report.account.strokes_kept} strokes of {report.account.matches} matches read\n")
    if not report.problems:
        sys.stdout.write("no problems\n")


def _show(account: Account) -> None:
    counts = {"rallies": (account.rallies, account.rallies_kept), "strokes": (account.strokes, account.strokes_kept)}
    rows = ((name, n, kept, kept / max(n, 1)) for name, (n, kept) in counts.items())
    cli.tell(cli.table(f"{account.matches} matches", ("", "total", "kept", "share"), rows))
    if account.dropped:
        reasons = ((name, n, DROP_REASONS.get(name, "")) for name, n in account.dropped.items())
        cli.tell(cli.table("dropped rows", ("rows dropped", "rows", "why"), reasons))
    if account.area_agreement is not None:
        cli.tell(f"areas computed from the coordinates agree with {account.area_agreement:.1%} of the labels")


COMMANDS: Final[dict[str, cli.Command]] = {
    "download": download,
    "convert": convert,
    "import": import_own,
    "template": template,
    "summary": summary,
    "validate": validate,
}


main: Final = cli.entry_point(
    COMMANDS,
    "python -m shuttle_marl.data",
    "Annotated matches, published ones and your own: download, convert, import, summarise and check them.",
)
