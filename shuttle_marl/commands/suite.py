"""The benchmark suite: tasks with exact scores, runs of methods, rounds of committed code, and the leaderboard (docs/suite)."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import tyro
from rich.progress import track

from shuttle_marl import suite
from shuttle_marl.base.errors import printable
from shuttle_marl.base.files import replace_file
from shuttle_marl.commands import cli
from shuttle_marl.commands.options import File, Json
from shuttle_marl.exact.fixed_point import TOLERANCE
from shuttle_marl.suite.options import NOTHING_GIVEN, Beacon, RerunOptions, Resources, Split, SuiteError, SuiteRun, VerifyOptions

Task = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="TASK")]
Folder = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FOLDER")]
Folders = Annotated[tuple[Path, ...], tyro.conf.Positional]
_FRONTIER: Final[tuple[Literal["score", "exploitability", "gain"], ...]] = ("score", "exploitability", "gain")
_RESOURCES: Final = Resources()
_SHOWN: Final = 20
"""Refused units that are printed."""


def list_tasks(*, json_output: Json = False) -> None:
    """List the tasks, and the baselines of each.

    Args:
        json_output: print JSON.
    """
    from shuttle_marl.suite.method import BASELINES, kind_of  # noqa: PLC0415  numba
    from shuttle_marl.suite.registry import arena_of  # noqa: PLC0415

    rows: list[dict[str, Any]] = [
        {
            **_described(task),
            "higher_is_better": task.higher_is_better,
            "optimum": task.optimum,
            "game": arena_of(task, "default", "test").base,
            "splits": list(task.splits),
            "seeds": task.seeds,
            "baselines": list(BASELINES[kind_of(name)]),
        }
        for name, task in suite.TASKS.items()
    ]
    if json_output:
        cli.print_json({"tasks": rows})
        return
    out = cli.console()
    for row in rows:
        out.print(f"{row['task']}: {row['about']}", soft_wrap=True)
        out.print(f"  baselines: {', '.join(row['baselines'])}\n", soft_wrap=True)


def _described(task: "suite.Task") -> dict[str, Any]:
    parts = {name: getattr(task, name) for name in ("about", "protocol", "access", "entrance", "metric", "unit", "zero")}
    return {"task": task.name, **parts, "hidden": list(task.hidden)}


def show(
    task: Task,
    *,
    split: Split = "test",
    quick: bool = False,
    game: str = "default",
    beacon: Beacon = None,
    json_output: Json = False,
) -> None:
    """Show a task: what is given, what is scored, how a method is called, and its cases.

    Args:
        task: name of the task.
        split: part of the task.
        quick: the cases of a quick run.
        game: model of the game.
        beacon: randomness of the beacon of a round, for the split round.
        json_output: print JSON.
    """
    from shuttle_marl.suite.registry import arena_of  # noqa: PLC0415  numba

    found = suite.find_task(task)
    arena = arena_of(found, game, split, quick=quick, beacon=beacon)
    cases = found.cases(arena)
    fields: dict[str, Any] = {
        **_described(found),
        "optimum": found.optimum,
        "seeds": found.seeds,
        "game": arena.game.hash,
        "split": split,
        "cases": [case.name for case in cases],
    }
    if json_output:
        cli.print_json(fields)
        return
    fields["hidden"] = ", ".join(fields["hidden"])
    rows = {name: str(value) for name, value in fields.items() if name != "cases" and value not in (None, "")}
    cli.console().print(cli.facts({**rows, f"{len(cases)} cases": ", ".join(fields["cases"])}))


def run(config: tyro.conf.OmitArgPrefixes[SuiteRun], *, json_output: Json = False) -> None:
    """Run a method on a task, and write a folder that can be submitted.

    Args:
        config: settings of the run.
        json_output: print JSON.
    """
    folder = suite.run_method(config, cli.console(stderr=True))
    _print_summary(folder, config.beacon, config.game, json_output=json_output)


def verify(folder: Folder, *, given: tyro.conf.OmitArgPrefixes[VerifyOptions] = NOTHING_GIVEN, json_output: Json = False) -> None:
    """Recompute every score of a run from its policies and answers; exits with 1 if one is refused.

    Args:
        folder: folder of the run.
        given: what the verification reads besides the folder.
        json_output: print JSON.
    """
    from shuttle_marl.suite.results import NOT_VERIFIED, verify_run  # noqa: PLC0415  numba

    found = verify_run(folder, given, progress=_progress)
    remarks = [] if found.summary is None else found.summary["remarks"]
    if json_output:
        cli.print_json(
            {
                "folder": str(folder),
                "units": found.units,
                "reproduced": 0 if found.refused else found.units,
                "refused": [dataclasses.asdict(each) for each in found.refused],
                "remarks": remarks,
                "not_verified": list(NOT_VERIFIED),
            }
        )
    else:
        out = cli.console()
        for each in found.refused[:_SHOWN]:
            out.print(printable(f"refused: {each.case}, seed {each.seed}: {each.reason}"), soft_wrap=True)
        if not found.refused:
            out.print(f"{found.units} units reproduced. Not verified: {', '.join(NOT_VERIFIED)}.", soft_wrap=True)
        if remarks:
            out.print(f"remarks: {'; '.join(remarks)}", soft_wrap=True)
    if found.refused:
        raise SuiteError(f"{folder}: {len(found.refused)} of {found.units} units are refused")


def board(
    folders: Folders = (),
    *,
    reran: tuple[Path, ...] = (),
    results: File = None,
    check: bool = True,
    given: tyro.conf.OmitArgPrefixes[VerifyOptions] = NOTHING_GIVEN,
    out: File = None,
    html: bool = False,
) -> None:
    """Write the leaderboard from run folders in two classes, rerun and self-reported, best method first, with the open gap.

    Folders that are refused, or differ from a rerun of the same code, are left out with the reason; the exit status is then 1.

    Args:
        folders: run folders.
        reran: folders of `suite rerun` that you trust, such as your own.
        results: a file of `python -m experiments.suite`, whose rows are added as they are.
        check: verify the folders; entries that are not verified are marked.
        given: what the verification reads besides the folders.
        out: write the board here; default: print it.
        html: write HTML instead of Markdown.
    """
    from shuttle_marl.suite.board import render, rows_of  # noqa: PLC0415  numba

    if not (folders or reran) and results is None:
        raise SuiteError("nothing to show: name run folders, or a file of results with --results")
    left: list[str] = []
    rows = rows_of(folders, results, reran=reran, check=check, given=given, progress=_progress, failed=left.append)
    text = render(rows, "html" if html else "md")
    if out is None:
        print(text, end="")  # noqa: T201
    else:
        replace_file(out, text.encode())
    if left:
        raise SuiteError("left out: " + "; ".join(map(printable, left)))


def frontier(task: Task, *, opponent: str, game: str = "default", json_output: Json = False) -> None:
    """Show what the best can reach against an opponent: score against exploitability in points, by the restriction.

    Args:
        task: exploit-v0 or exploit-entrance-v0.
        opponent: name of a policy, such as bc.
        game: model of the game.
        json_output: print JSON.
    """
    from shuttle_marl.suite.exploit import Exploit  # noqa: PLC0415  numba
    from shuttle_marl.suite.frontier import frontier as points_of  # noqa: PLC0415
    from shuttle_marl.suite.registry import arena_of  # noqa: PLC0415

    found = suite.find_task(task)
    if not isinstance(found, Exploit):
        raise SuiteError(f"{task} has no frontier of an opponent; exploit-v0 has")
    arena = arena_of(found, game, "test")
    points = points_of(arena, arena.policy(opponent), tolerance=TOLERANCE)
    if json_output:
        cli.print_json(points)
        return
    rows = {f"p = {each['p']:g}": ", ".join(f"{name} {each[name]:.3f}" for name in _FRONTIER) for each in points}
    cli.console().print(cli.facts(rows))


def new_submission(task: Task, *, out: Path = Path(), language: Literal["python", "perl", "apart"] = "python") -> None:
    """Write a template of a method, at most 40 lines that run as they are, and a card.

    Args:
        task: name of the task.
        out: folder.
        language: language of the template; apart: Python for a round, which runs without this package.
    """
    from shuttle_marl.suite.registry import new_submission as write  # noqa: PLC0415  numba

    cli.console().print(f"run it in {out} with\n  {write(task, out, language)}", soft_wrap=True)


def data(
    task: Task,
    *,
    out: Path,
    split: Split = "dev",
    seeds: int | None = None,
    quick: bool = False,
    minari: bool = False,
    game: str = "default",
    json_output: Json = False,
) -> None:
    """Write the logs of offline and evaluate as Parquet files or Minari data sets, or the positions of text as JSON lines.

    Args:
        task: name of the task.
        out: folder.
        split: part of the task.
        seeds: number of seeds, from 0; default: that of the task.
        quick: the smallest cases only.
        minari: write Minari data sets of the learner's strokes instead; the version of a data set is the seed.
        game: model of the game.
        json_output: print the hashes of the logs as JSON.
    """
    from shuttle_marl.suite.registry import write_data  # noqa: PLC0415  numba

    hashes = write_data(task, out, split, game, seeds, quick=quick, minari=minari)
    if json_output:
        cli.print_json(hashes)
    else:
        cli.console().print(cli.facts(hashes))


def commit(
    folder: Folder,
    *,
    task: str,
    method: str,
    author: str,
    beacon: int | None = None,
    out: Path = Path("commitment.json"),
    json_output: Json = False,
) -> None:
    """Commit to code before a round is drawn: its hash, which the author publishes.

    Args:
        folder: folder of the code, with everything that it needs besides Python and installed libraries.
        task: name of the task.
        method: MODULE:ATTRIBUTE in that folder.
        author: name on the board.
        beacon: announced round of the beacon; the commitment then counts in no other one.
        out: file of the commitment.
        json_output: print JSON.
    """
    from shuttle_marl.suite.run import write  # noqa: PLC0415  numba

    if out.resolve().is_relative_to(folder.resolve()):
        raise SuiteError(f"{out}: would change the code that is committed to; name a file outside with --out")
    found = suite.commit(folder, task=task, method=method, author=author, beacon=beacon)
    write(out, found)
    fields = {"file": str(out), "hash": found.hash}
    cli.print_json(fields) if json_output else cli.console().print(cli.facts(fields))


def draw(
    commitments: Folders, *, beacon: int, randomness: str, out: Path = Path("round.json"), json_output: Json = False
) -> None:
    """Draw a round after commitments, from a public beacon that appeared after them.

    Args:
        commitments: files of `suite commit`.
        beacon: number of a round of the chain quicknet of https://drand.love that was announced before it appeared.
        randomness: randomness that the beacon published, 64 hexadecimal digits.
        out: file of the round.
        json_output: print JSON.
    """
    from shuttle_marl.suite.run import BEACON, write  # noqa: PLC0415  numba

    found = suite.draw_round(commitments, beacon=beacon, randomness=randomness)
    write(out, found)
    fields = {"file": str(out), "beacon": f"{BEACON}/{beacon}", "entries": str(len(found.commitments))}
    cli.print_json(fields) if json_output else cli.console().print(cli.facts(fields))


def rerun(
    round_file: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="ROUND")],
    folder: Folder,
    *,
    asked: tyro.conf.OmitArgPrefixes[RerunOptions],
    resources: tyro.conf.OmitArgPrefixes[Resources] = _RESOURCES,
    json_output: Json = False,
) -> None:
    """Rerun committed code on a round: apart from this package, without a network, as another user, in a container or namespaces.

    Args:
        round_file: file of `suite round`.
        folder: folder of the code.
        asked: the entry.
        resources: settings of the run.
        json_output: print JSON.
    """
    from shuttle_marl.suite.run import rerun as again  # noqa: PLC0415  numba

    made = again(round_file, folder, asked, resources, cli.console(stderr=True))
    _print_summary(made, asked.randomness, resources.game, json_output=json_output)


def _print_summary(folder: Path, beacon: str | None, game: str | None, *, json_output: bool) -> None:
    from shuttle_marl.suite.board import with_interval  # noqa: PLC0415  numba

    found = suite.summarise(folder, beacon, game)
    if json_output:
        cli.print_json({"folder": str(folder), **found})
        return
    rows = {"task": f"{found['task']}, {found['split']}", "method": found["method"], "seeds": str(found["seeds"])}
    for name, each in found["scores"].items():
        rows[name] = with_interval(each)
    rows["seconds"] = f"{found['seconds']:.1f}"
    rows["folder"] = str(folder)
    cli.console().print(cli.facts(rows))
    if found["remarks"]:
        cli.console().print(f"remarks: {'; '.join(found['remarks'])}", soft_wrap=True)


def _progress(units: Sequence[Any]) -> Any:
    return track(units, "cases", console=cli.console(stderr=True), transient=True)


COMMANDS: Final[dict[str, cli.Command]] = {
    "list": list_tasks,
    "show": show,
    "run": run,
    "verify": verify,
    "board": board,
    "frontier": frontier,
    "new-submission": new_submission,
    "data": data,
    "commit": commit,
    "round": draw,
    "rerun": rerun,
}


main: Final = cli.entry_point(COMMANDS, "python -m shuttle_marl.suite", __doc__ or "")
