"""The score of random matches by all rules, in every reader, beside an independent count; and small tables of any kind."""

from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from shuttle_marl.commands.data import main
from shuttle_marl.court.recorded import RealRallies
from shuttle_marl.data import DataError, read_matches
from shuttle_marl.data.matches import real_rallies
from shuttle_marl.data.own import import_matches
from shuttle_marl.game.scoring import RULES, RulesName
from shuttle_marl.reports.match import match_report
from shuttle_marl.reports.summary import met
from tests.reduced import reduced_game

TO: dict[str, tuple[int, int, int]] = {
    "21": (21, 30, 2),
    "15": (15, 21, 2),
    "11": (11, 15, 3),
    "21x1": (21, 30, 1),
    "11x3": (11, 15, 2),
}
"""Points, cap, and games that win the match, as the rules are written."""
Rally = tuple[int, int, int]


def played(rules: str, rng: np.random.Generator) -> tuple[list[Rally], list[tuple[int, int]]]:
    """Game, server and winner of each rally of a match, and the final scores: an independent count."""
    points, cap, needed = TO[rules]
    rallies: list[Rally] = []
    ends: list[tuple[int, int]] = []
    server, chance = int(rng.integers(2)), rng.uniform(0.35, 0.65)
    while all(sum(end[who] > end[1 - who] for end in ends) < needed for who in (0, 1)):
        score = [0, 0]
        while max(score) < points or (abs(score[0] - score[1]) < 2 and max(score) < cap):
            winner = int(rng.random() < chance)
            rallies.append((len(ends) + 1, server, winner))
            score[winner] += 1
            server = winner
        ends.append((score[0], score[1]))
    return rallies, ends


def table(rallies: list[Rally], columns: Collection[str], kept: Any = slice(None)) -> str:
    """Lines of a table with some of the columns game, winner, points and score."""
    lines = [",".join(["match,rally,stroke,player,opponent,shot,area", *sorted(columns)])]
    score, game, number = [0, 0], 0, 0
    for k, (of_game, server, winner) in enumerate(rallies):
        if of_game != game:
            game, score, number = of_game, [0, 0], 0
        score[winner] += 1
        number += 1
        strokes = 2 if server == winner else 1  # the serve, and who wins strikes last or the server faults
        told = {"game": str(game), "winner": ("ada", "bea")[winner], "score": f"{score[0]}-{score[1]}"}
        for stroke in range(1, strokes + 1):
            who = server if stroke % 2 else 1 - server
            cells = [told[name] for name in sorted(columns)]
            shot = "short serve" if stroke == 1 else "push"
            line = [
                "club final",
                str(number if "game" in columns else k + 1),
                str(stroke),
                ("ada", "bea")[who],
                ("ada", "bea")[1 - who],
            ]
            lines.append(",".join([*line, shot, "back-left", *cells]))
    head, *rows = lines
    return "\n".join([head, *rows[kept], ""])


def imported(text: str, folder: Path, rules: RulesName | None = None) -> pa.Table:
    (folder / "match.csv").write_text(text)
    (folder / "map.toml").write_text(
        'discipline = "WS"\n[columns]\n' + "".join(f'{name} = "{name}"\n' for name in text.partition("\n")[0].split(","))
    )
    return import_matches(folder / "match.csv", folder / "map.toml", rules).strokes


@pytest.mark.parametrize("rules", TO)
@pytest.mark.parametrize("columns", [("game", "winner"), ("game", "winner", "score"), ("winner",)], ids=" ".join)
def test_every_reader_counts_as_the_rules_are_written(rules: RulesName, columns: tuple[str, ...], tmp_path: Path) -> None:
    assert (RULES[rules].points, RULES[rules].cap, RULES[rules].games) == TO[rules]
    rng = np.random.default_rng([len(columns), *rules.encode()])
    for k in range(4):
        rallies, ends = played(rules, rng)
        named = rules in ("21x1", "11x3") or "game" not in columns or k % 2 == 0
        strokes = imported(table(rallies, columns), tmp_path, rules if named else None)
        first = strokes["player"][0].as_py()
        score = [end if first == "ada" else end[::-1] for end in ends]
        assert set(strokes["rules"].to_pylist()) == {rules}
        games: dict[int, tuple[int, int]] = {}
        for rally in real_rallies(strokes):
            games[rally.number[0]] = rally.after
        assert [*games.values()] == score
        winner = ("ada", "bea")[rallies[-1][2]]
        assert met(strokes, winner, "ada" if winner == "bea" else "bea")[4:] == (1, 1)
        shown = RealRallies(tmp_path / "match.csv", reduced_game(), strokes)
        last = shown.rally(shown.count - 1).score
        assert (*last.finished, last.points[:]) == (*score[:-1], tuple(np.array(score[-1]) - (np.arange(2) == (winner != first))))
        if k == 0:
            report = match_report(strokes, game=reduced_game())
            assert ([*report.score], report.inferred, report.rules) == (score, (), RULES[rules])
            assert report.rallies[-1].after == float(winner == first)


@pytest.mark.parametrize("tables", [150, pytest.param(2000, marks=pytest.mark.slow)])
def test_no_small_table_hangs_or_gets_a_wrong_score(tables: int, tmp_path: Path) -> None:
    """Tables with gaps, without columns, and by wrong rules are refused with a problem, or counted as the winners count."""
    rng = np.random.default_rng(tables)
    refused = 0
    for _ in range(tables):
        rallies, _ends = played(str(rng.choice([*TO])), rng)
        end = len(rallies) if rng.random() < 0.5 else int(rng.integers(1, len(rallies) + 1))
        share = rng.choice([0.7, 1.0])
        part = [each for each in rallies[max(0, end - 25) : end] if rng.random() < share] or rallies[:1]
        columns = {name for name in ("game", "winner", "score") if rng.random() < 0.6}
        rules = None if rng.random() < 0.7 else str(rng.choice([*RULES]))
        try:
            strokes = imported(table(part, columns), tmp_path, rules)  # type: ignore[arg-type]
        except DataError:
            refused += 1
            continue
        found = [*real_rallies(strokes)]
        truth = [("ada", "bea")[winner] for *_, winner in part]
        if share == 1 or "winner" in columns:  # else the servers after gaps, which the numbers do not show, tell others
            told = [rally.players[rally.winner] if rally.winner is not None else None for rally in found]
            wrong = [k for k, (name, winner) in enumerate(zip(told, truth, strict=True)) if name not in (None, winner)]
            assert not wrong, table(part, columns)
        if "winner" in columns or {"game", "score"} <= columns:
            won = {(game, who): sum(each[::2] == (game, who) for each in part) for game, *_ in part for who in (0, 1)}
            counted = {(r.number[0], ("ada", "bea").index(r.players[seat])): r.after[seat] for r in found for seat in (0, 1)}
            assert {key: points for key, points in counted.items() if "game" in columns} == (won if "game" in columns else {})
            assert sum(counted.values()) == len(part)
        result = met(strokes, "ada", "bea")
        assert result.matches <= 1
    assert refused < 0.6 * tables


def test_a_score_that_the_rules_do_not_allow_is_refused(tmp_path: Path) -> None:
    rallies, _ = played("21", np.random.default_rng(1))
    text = table(rallies, {"game", "winner", "score"})
    with pytest.raises(DataError, match="give other --rules"):
        imported(text, tmp_path, "11")
    strokes = imported(text, tmp_path)
    assert set(strokes["rules"].to_pylist()) == {"21"}
    with pytest.raises(DataError, match="give other --rules"):
        read_matches(tmp_path / "match.csv", tmp_path / "map.toml", "15")


def test_a_game_after_the_end_of_a_match_does_not_change_its_rules_silently(tmp_path: Path) -> None:
    games = [(1, 0, 0)] * 21 + [(2, 0, 0)] * 21 + [(3, 0, 1)] * 21  # the third is of practice
    imported(table(games, ("game", "winner")), tmp_path)
    with pytest.warns(UserWarning, match=r"the rules are 21x5, by the scores, and not those of the sport, 21, 15, 11: are all"):
        read_matches(tmp_path / "match.csv", tmp_path / "map.toml")


def test_a_column_names_the_rules(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rallies, _ = played("15", np.random.default_rng(5))

    def told(name: str, columns: Collection[str] = ("game", "winner")) -> pa.Table:
        head, *rows = table(rallies, columns).splitlines()
        return imported("\n".join([f"{head},rules", *(f"{row},{name}" for row in rows), ""]), tmp_path)

    assert set(told("15")["rules"].to_pylist()) == {"15"}
    assert set(told("15.0")["rules"].to_pylist()) == {"15"}, "as a spreadsheet writes it"
    assert told("15", ("winner",))["game"].to_pylist()[-1] == rallies[-1][0], "they number the games"
    file = tmp_path / "match.parquet"
    pq.write_table(told("21"), file)
    with pytest.warns(UserWarning, match=r"a game ends \d+-\d+, before anybody has won it by the rules 21: by 15 none does"):
        read_matches(file)
    assert main(["validate", str(file)]) == 0
    assert "by 15 none does; give other --rules" in capsys.readouterr().out
    with pytest.raises(DataError, match=r"unknown rules '16'; map it in \[values.rules\] to one of 21, 15, 11"):
        told("16")
