"""The benchmark suite: tasks with exact scores, runs of methods, and the leaderboard (docs/suite)."""

import dataclasses
import functools
import statistics
from pathlib import Path
from typing import Annotated, Any, Final

import tyro

from shuttle_marl import suite
from shuttle_marl.base.errors import printable
from shuttle_marl.base.files import replace_file
from shuttle_marl.base.runs import read_json
from shuttle_marl.commands import cli
from shuttle_marl.commands.options import File, Json
from shuttle_marl.exact.fixed_point import TOLERANCE
from shuttle_marl.suite.options import SPLITS, Split, SuiteError, SuiteRun

Task = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="TASK")]
_cases: Final = functools.partial(cli.progress, what="cases")
_SHOWN: Final = 20  # refused units that are printed


def list_(*, json_output: Json = False) -> None:
    """List the tasks, and the baselines of each."""
    from shuttle_marl.suite.method import BASELINES, kind_of  # noqa: PLC0415  numba
    from shuttle_marl.suite.results import arena_of  # noqa: PLC0415

    rows: list[dict[str, Any]] = [
        {
            **_described(task),
            "higher_is_better": task.higher_is_better,
            "game": (arena := arena_of(task, "default", "test")).base,
            "budgets": sorted({case.budget for case in task.all_cases(arena)} - {0}),
            "splits": SPLITS,
            "baselines": list(BASELINES[kind_of(name)]),
        }
        for name, task in suite.TASKS.items()
    ]
    lines = (f"{row['task']}: {row['about']}\n  baselines: {', '.join(row['baselines'])}\n" for row in rows)
    cli.show({"tasks": rows}, json_output, *lines)


def _described(task: "suite.Task") -> dict[str, Any]:
    names = ("question", "about", "protocol", "access", "entrance", "metric", "unit", "zero", "not_proved", "optimum", "seeds")
    return {"task": task.name, **{name: getattr(task, name) for name in names}, "hidden": list(task.hidden)}


def show(
    task: Task,
    *,
    split: Split = "test",
    quick: bool = False,
    game: str = "default",
    seed: str | None = None,
    json_output: Json = False,
) -> None:
    """Show a task: what is given, what is scored, how a method is called, and its cases.

    Args:
        task: name of the task.
        split: part of the task.
        quick: the cases of a quick run.
        game: model of the game.
        seed: seed of the split round.
    """
    from shuttle_marl.suite.results import arena_of  # noqa: PLC0415  numba

    found = suite.find_task(task)
    arena = arena_of(found, game, split, quick=quick, seed=seed)
    cases = [case.name for case in found.cases(arena)]
    cli.show({**_described(found), "game": arena.game.hash, "split": split, "cases": cases}, json_output)


def run(config: tyro.conf.OmitArgPrefixes[SuiteRun], *, json_output: Json = False) -> None:
    """Run a method on a task, and write a folder that can be submitted.

    Args:
        config: settings of the run.
    """
    from shuttle_marl.suite.results import RESULTS  # noqa: PLC0415  numba

    folder = suite.run_method(config, cli.console(stderr=True))
    found = read_json(folder / RESULTS, dict[str, Any])
    cli.show({"folder": str(folder), **found}, json_output, cli.named("Scores", found["scores"]))


def verify(
    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FOLDER")],
    *,
    game: str | None = None,
    seed: str | None = None,
    json_output: Json = False,
) -> None:
    """Recompute every score of a run from its policies and answers; exits with 1 if one is refused.

    Args:
        folder: folder of the run.
        game: model of the game; default: the shipped one that the run names. Folders that a run names are not opened.
        seed: seed of the split round.
    """
    from shuttle_marl.suite.results import NOT_VERIFIED  # noqa: PLC0415  numba

    found = suite.verify_run(folder, game, seed, progress=_cases)
    figures = {
        "folder": str(folder),
        "units": found.units,
        "reproduced": 0 if found.refused else found.units,
        "refused": [dataclasses.asdict(each) for each in found.refused],
        "remarks": [] if found.summary is None else found.summary["remarks"],
        "not_verified": list(NOT_VERIFIED),
    }
    lines = [f"refused: {each.case}, seed {each.seed}: {each.reason}" for each in found.refused[:_SHOWN]]
    cli.show(figures, json_output, *lines)
    if found.refused:
        raise SuiteError(f"{folder}: {len(found.refused)} of {found.units} units are refused")


def board(
    folders: Annotated[tuple[Path, ...], tyro.conf.Positional] = (),
    *,
    results: File = None,
    game: str | None = None,
    seed: str | None = None,
    out: File = None,
) -> None:
    """Write the leaderboard from run folders, best method first, with the open gap.

    Folders that are refused, or whose card names no author, are left out with the reason; the exit status is then 1.

    Args:
        folders: run folders.
        results: a file of `python -m experiments.suite`, whose rows are added as they are.
        game: model of the game; default: the shipped one that a run names. Folders that a run names are not opened.
        seed: seed of the split round.
        out: write the board here; default: print it.
    """
    from shuttle_marl.suite.board import render, rows_of  # noqa: PLC0415  numba

    if not folders and results is None:
        raise SuiteError("nothing to show: name run folders, or a file of results with --results")
    left: list[str] = []
    rows = rows_of(folders, results, game=game, seed=seed, progress=_cases, failed=left.append)
    text = render(rows)
    if out is None:
        print(text, end="")  # noqa: T201
    else:
        replace_file(out, text.encode())
    if left:
        raise SuiteError("left out: " + "; ".join(map(printable, left)))


def frontier(task: Task, *, opponent: str, game: str = "default", json_output: Json = False) -> None:
    """Show what the best can reach against an opponent: score against exploitability in points, by the restriction.

    Args:
        task: exploit-v1 or exploit-entrance-v1.
        opponent: name of a policy, such as bc.
        game: model of the game.
    """
    from shuttle_marl.suite.exploit import Exploit  # noqa: PLC0415  numba
    from shuttle_marl.suite.results import arena_of  # noqa: PLC0415
    from shuttle_marl.suite.task import frontier as points_of  # noqa: PLC0415

    found = suite.find_task(task)
    if not isinstance(found, Exploit):
        raise SuiteError(f"{task} has no frontier of an opponent; exploit-v1 has")
    arena = arena_of(found, game, "test")
    points = points_of(arena, arena.policy(opponent), tolerance=TOLERANCE)
    rows = {f"p = {each['p']:g}": {name: value for name, value in each.items() if name != "p"} for each in points}
    cli.show(points, json_output, cli.named(f"Restricted responses to {opponent}, in points", rows))


def figure(
    task: Task, *, out: Path, results: Path = Path("experiments/results/suite.json"), split: Split = "test", game: str = "default"
) -> None:
    """Draw exploitability against score: the exact frontier, and every row at each budget, as means over the opponents.

    Args:
        task: exploit-v1 or exploit-entrance-v1.
        out: PNG, SVG or PDF.
        results: a file of `python -m experiments.suite`.
        split: part of the task.
        game: model of the game.
    """
    from shuttle_marl.reports import charts  # noqa: PLC0415  numba

    charts.check_format(out)
    charts.save(charts.tradeoff(*_tradeoff(task, results, split, game)), out)


def _tradeoff(
    task: str, results: Path, split: Split, game: str
) -> tuple[list[tuple[float, float, float]], dict[str, list[tuple[int, float, float]]]]:
    """The frontier of a task, as a mean over its opponents, and every row, for :func:`shuttle_marl.reports.charts.tradeoff`.

    Raises:
        SuiteError: the task has no frontier, or the file has no rows of it.
    """
    from shuttle_marl.suite.board import Results, called  # noqa: PLC0415  numba
    from shuttle_marl.suite.exploit import Exploit, opponent_of  # noqa: PLC0415
    from shuttle_marl.suite.results import arena_of, read  # noqa: PLC0415
    from shuttle_marl.suite.task import frontier as points_of  # noqa: PLC0415

    if not isinstance(found := suite.find_task(task), Exploit):
        raise SuiteError(f"{task} has no frontier; exploit-v1 has")
    arena, kept = arena_of(found, game, split), read(results, Results)
    opponents = {case.options["opponent"]: opponent_of(arena, case) for case in found.cases(arena)}
    rows = [row for row in kept.rows if (row["task"], row["split"], row["game"]) == (task, split, arena.base)]
    if not rows:
        raise SuiteError(f"{results}: no rows of {task} in this game")
    known = kept.frontiers.get(task, {}) if split == "test" else {}
    points = [known.get(name) or points_of(arena, opponent, tolerance=TOLERANCE) for name, opponent in opponents.items()]
    names = ("p", "exploitability", "score")
    mean = [tuple(statistics.fmean(point[name] for point in at) for name in names) for at in zip(*points, strict=True)]
    methods: dict[str, list[tuple[int, float, float]]] = {}
    for row in sorted(rows, key=lambda row: (called(row), row["budget"] or 0)):
        budget = 0 if row["kind"] == "reference" else row["budget"] or 0
        place = (budget, row["scores"]["exploitability"]["value"], row["scores"]["score"]["value"])
        if place not in (before := methods.setdefault(called(row), [])):
            before.append(place)
    return mean, methods  # type: ignore[return-value]


def new_submission(task: Task, *, author: str, out: Path = Path()) -> None:
    """Write a template of a method, at most 40 lines that run as they are, and a card.

    Args:
        task: name of the task.
        author: your name on boards.
        out: folder.
    """
    from shuttle_marl.suite.run import new_submission as write  # noqa: PLC0415  numba

    cli.say(f"run it in {out} with\n  {write(task, out, author)}")


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
    """Write the logs of offline and evaluate as Parquet files or Minari data sets.

    Args:
        task: name of the task.
        out: folder.
        split: part of the task.
        seeds: number of seeds, from 0; default: that of the task.
        quick: the smallest cases only.
        minari: write Minari data sets of the learner's strokes instead; the version of a data set is the seed.
        game: model of the game.
    """
    from shuttle_marl.suite.results import write_data  # noqa: PLC0415  numba

    cli.show(write_data(task, out, split, game, seeds, quick=quick, minari=minari), json_output)


COMMANDS: Final = cli.by_name(list_, show, run, verify, board, frontier, figure, new_submission, data)
main: Final = cli.entry_point(COMMANDS, "python -m shuttle_marl.suite", __doc__ or "")
