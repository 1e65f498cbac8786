"""Counts what is wrong in the published files: the numbers of the datasheet.

    python datasets/measure_traps.py FOLDER

FOLDER holds the download. Only the matches of the train and validation splits are counted, also where the test matches are
there.
"""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from shuttle_marl.base.arrays import I64, Bools
from shuttle_marl.commands import cli
from shuttle_marl.data import split_of, upstream
from shuttle_marl.data.cleaning import (
    MIRRORED,
    arrange,
    broken_rallies,
    clean_game,
    corrected_label,
    heights_unreliable,
    outcomes,
    rally_starts,
    sides,
    with_corrected_letters,
)
from shuttle_marl.data.schema import REASONS
from shuttle_marl.data.shuttleset import RawGame, list_matches, read_game
from shuttle_marl.game import court

Measures = dict[str, Bools]
"""Yes or no by name, each over rows, rallies or games."""


def measure(root: Path) -> Iterator[tuple[str, int, int]]:
    """Yield (what, how often, out of how many)."""
    matches = [m for m in list_matches(root) if m.present and split_of(m.name) in ("train", "validation")]
    games = [read_game(match, path) for match in matches for path in match.games()]
    yield from _copies(root, matches_here={m.name for m in matches})
    collected: dict[str, list[Bools]] = {}
    for raw in games:
        for measures in (_order(raw), *(_of_game(arrange(raw)[0]))):
            for name, values in measures.items():
                collected.setdefault(name, []).append(np.atleast_1d(values))
    for name, parts in collected.items():
        values = np.concatenate(parts)
        yield name, int(values.sum()), len(values)


def _copies(root: Path, matches_here: set[str]) -> Iterator[tuple[str, int, int]]:
    """Matches that stand in both data sets, and the rows of the second copy."""
    names: dict[str, list[Path]] = {}
    for path in upstream.manifest():
        match = upstream.match_of(path)
        if match in matches_here and (root / path).is_file():
            names.setdefault(match, []).append(root / path)
    both = {name for name, files in names.items() if len({file.parents[1] for file in files}) == 2}
    yield "matches in both data sets", len(both), len(names)
    second = [file for name in both for file in names[name] if "ShuttleSet22" in file.parts]
    rows = {file: file.read_bytes().count(b"\n") - 1 for files in names.values() for file in files}
    yield "rows of second copies", sum(rows[file] for file in second), sum(rows.values())


def _order(raw: RawGame) -> Measures:
    """Faults in the order of rows."""
    _, repeated = arrange(raw)
    return {
        "games with a rally in the wrong place": np.array(bool((np.diff(raw["rally"]) < 0).any())),
        "rows that stand there twice": np.arange(len(raw)) < repeated,
    }


def _of_game(raw: RawGame) -> Iterator[Measures]:
    first = rally_starts(raw)
    number = np.cumsum(first) - 1
    fixed = with_corrected_letters(raw, first)
    yield {"rallies in which A and B are exchanged": (fixed["by_a"] != raw["by_a"])[first]}
    raw = fixed
    ends = np.flatnonzero(np.r_[first[1:], True])
    unknown = raw["shot"] < 0
    yield {
        "rows of unknown shot type": unknown,
        "rallies with one": np.bincount(number, weights=unknown) > 0,
        "rallies in which it is the serve alone": (np.bincount(number, weights=unknown) == 1) & unknown[first],
        "rows with flaw": raw["flaw"],
        "of these, of unknown shot type": unknown[raw["flaw"]],
        "rows of broken rallies": broken_rallies(raw, first),
        "serves annotated above the net": (raw["height"] == 1)[(raw["shot"] >= 0) & (raw["shot"] < 2)],
        "strokes both backhand and around the head": raw["backhand"] & raw["around_head"],
        "games of unreliable contact heights": np.array(heights_unreliable(raw, first)),
        "games with both players in one half in a fifth of the rows": np.array(raw.broken_homography),
    }
    yield from _ends_of_rallies(raw, first, ends)
    yield from _places(raw, first, number)


def _ends_of_rallies(raw: RawGame, first: Bools, ends: I64) -> Iterator[Measures]:
    before = np.vstack([[0, 0], raw["score"][ends[:-1]]])
    gained = raw["score"][ends] - before
    scorer = np.where((gained == [1, 0]).all(1), 0, np.where((gained == [0, 1]).all(1), 1, -1))
    given = raw["winner"][ends]
    serves_next = np.r_[np.where(raw["by_a"][first][1:], 0, 1), -1]
    known = (serves_next >= 0) & (scorer >= 0)
    outcome, _ = outcomes(raw, first)
    yield {
        "rallies without annotated winner": given < 0,
        "of these, the score tells": (scorer >= 0)[given < 0],
        "rallies whose scorer serves next": (scorer == serves_next)[known],
        "annotated winners that contradict the score": (given != scorer)[(given >= 0) & (scorer >= 0)],
        "rallies of unknown outcome": outcome[ends] == 3,
    }


def _places(raw: RawGame, first: Bools, number: I64) -> Iterator[Measures]:
    side, contradicted = sides(raw, first)
    side_a = np.where(raw["by_a"], side, -side)[first]
    known = side_a[side_a != 0]
    landing = raw["landing"]
    own = landing[:, 1] * side > 0
    x, y = (landing * np.where(side[:, None] > 0, [1.0, -1.0], [-1.0, 1.0])).T
    area = court.area_of(x, y)
    label = corrected_label(raw, own_half=own)
    labelled = (area >= 0) & (label >= 0) & (side != 0)
    agrees = (area == label)[labelled]
    source, numbers = MIRRORED
    if raw.match.source == source and raw.match.number in numbers:
        as_given = corrected_label(raw, own_half=own ^ (landing[:, 1] > 0))
        lower = labelled & (landing[:, 1] > 0)
        yield {
            "labels of matches 9 to 20, lower half, that agree as given": (area == as_given)[lower],
            "and once mirrored": (area == label)[lower],
        }
    yield {"labels that agree, all matches, corrected": agrees}
    if (raw.match.source, raw.match.number, raw.game) == ("ShuttleSet", 3, 1):
        mirrored = 3 * (area // 3) + 2 - area % 3
        yield {
            "labels that agree, match 3 game 1": agrees,
            "of the others, mirrored": (mirrored == label)[labelled & (area != label)],
        }
    yield {
        f"games {raw.game} in which the players change ends": np.array(bool((known[1:] != known[:-1]).any())),
        "rows whose side contradicts their rally": contradicted,
        "strokes with a landing": area >= 0,
        "net faults labelled front": np.isin(raw["label_area"], (1, 2, 7))[(raw["reason"] == REASONS.index("net"))],
        "out faults labelled outside": (raw["label_area"] > 9)[(raw["reason"] == REASONS.index("out"))],
    }
    replies = np.flatnonzero(~first)
    gap = raw["hit"][replies] - landing[replies - 1]
    both = ~np.isnan(gap[:, 0])
    yield {
        "contact points equal to the landing before": np.asarray((np.abs(gap[both]) < 1e-6).all(axis=1)),
        "frames that do not rise within a rally": (np.diff(raw["frame"]) <= 0)[number[1:] == number[:-1]],
    }
    strokes, _ = clean_game(raw)
    yield {"strokes kept whose time is null": strokes["frame"].is_null().to_numpy()}


def main(root: Annotated[Path, tyro.conf.Positional], *, markdown: bool = False) -> None:
    """Print the counts.

    Args:
        root: Folder of the download.
        markdown: Print rows of a Markdown table.
    """
    rows = [(what, f"{count:,}", f"{total:,}", f"{count / max(total, 1):.2%}") for what, count, total in measure(root)]
    if markdown:
        sys.stdout.write("".join(f"| {' | '.join(row)} |\n" for row in rows))
        return
    table = Table("what", "count", "of", "share")
    for row in rows:
        table.add_row(*row)
    Console().print(table)


if __name__ == "__main__":
    sys.exit(cli.run(main, prog="datasets/measure_traps.py", description=__doc__ or ""))
