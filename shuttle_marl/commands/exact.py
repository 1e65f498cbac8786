"""``python -m shuttle_marl.exact COMMAND``: exact solution of the game, and exact measures of policies."""

import functools
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, Final

import tyro

from shuttle_marl import exact
from shuttle_marl.commands import cli
from shuttle_marl.commands.options import MODEL, File, Json, Model, Policies, Policy, tables_of
from shuttle_marl.exact.fixed_point import ExactError
from shuttle_marl.game.shipped import Estimate, factor_of, least_support, refits_of
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.game.tables import Game

if TYPE_CHECKING:
    from shuttle_marl.exact.occupancy import Hole
    from shuttle_marl.policy.scorecard import Scorecard


AtLeast = Annotated[int | None, tyro.conf.arg(metavar="INT")]
_SCORES: Final = (
    *("policy", "rallies won", "matches won", "normalised", "exploitability", "regret a rally", "strokes a rally", "thin"),
)
_HOLES: Final = ("state", "plays, better", "in self-play", "against its best response", "lost a stroke", "lost a rally")


def solve(*, model: Model = MODEL, away: bool = True, json_output: Json = False) -> None:
    """Solve the game: the value of a rally under perfect play, and statistics of perfect play.

    Args:
        model: the game.
        away: also play the solution in the refits of the game.
    """
    from shuttle_marl.exact.odds import of_solution  # noqa: PLC0415

    tables = model.load()
    with cli.working("solving"):
        solution = exact.solve(tables)
    others, spreads = _in_refits(tables, away, functools.partial(of_solution, solution))
    seen = exact.visits(*solution.policy)
    serving = (1 + solution.value_at_serve) / 2
    home = {"server_win": serving, "exploitability": 0.0}
    figures = {
        "value_at_serve": solution.value_at_serve,
        "server_win": serving,
        "states": tables.n_states,
        "legal_pairs": tables.n_pairs,
        "sweeps": solution.sweeps,
        "residual": solution.residual,
        "error_bound": solution.error_bound,
        "rally_length": seen.rally_length,
        "endings": seen.endings(),
        "shot_mix": _mix(seen, 0),
        **cli.home_and_away_json(home, spreads),
    }
    gain = f"A rally won adds {exact.least_gain(serving, 1 - serving):.1e} or more to the match win probability, at every score."
    cli.show(figures, json_output, gain, *cli.home_and_away([("minimax", home, spreads)], others, asked=away))


def evaluate(policies: Policies, *, model: Model = MODEL, away: bool = True, json_output: Json = False) -> None:
    """Measure policies exactly: against bc, against their best responses, and against perfect play.

    Args:
        policies: names of policies (docs/league.md).
        model: the game.
        away: also play the policies in the refits of the game.
    """
    from shuttle_marl.policy.scorecard import Scorer  # noqa: PLC0415  numba

    _check_some(policies)
    tables = model.load()
    with cli.working("preparing the policies"):
        scorer = Scorer(tables, refits=refits_of(tables) if away else ())
        found = tables_of(policies, tables)
    cards = [scorer.score(policy, name) for name, policy in zip(policies, cli.progress(found, "policies"), strict=True)]
    shots = {card.policy: {"endings": card.endings_vs_bc, "most frequent shots": card.shot_mix_vs_bc} for card in cards}
    cli.show(
        [card.as_json() for card in cards],
        json_output,
        cli.table("Against bc, its best response, and perfect play", _SCORES, map(_scores, cards)),
        cli.named("Rallies against bc", shots),
        f"normalised: 0 is bc, 1 is the best response to bc ({cli.percent(scorer.reference_best.rally)} of rallies). "
        "exploitability: gain of the best response, which wins 50 % of rallies plus half of it. regret: loss against perfect "
        "play. thin: fraction of its strokes with fewer than five real strokes behind them.",
        *cli.home_and_away([(card.policy, card.home, card.away) for card in cards], scorer.refits, asked=away),
        f"exact: every figure is within {max(card.error_bound for card in cards):.0e} of the true one.",
    )


def _scores(card: "Scorecard") -> tuple[cli.Figure, ...]:
    figures = card.normalised_score, card.exploitability, card.regret_per_rally, f"{card.rally_length_vs_bc:.2f}"
    return card.policy, card.rally_win_vs_bc, card.match_win_vs_bc, *figures, card.thin_vs_bc


def best_response(
    policy: Policy,
    *,
    model: Model = MODEL,
    at_least: AtLeast = None,
    away: bool = True,
    save: File = None,
    json_output: Json = False,
) -> None:
    """Compute the best response to a policy.

    Args:
        policy: name of a policy (docs/league.md).
        model: the game.
        at_least: real strokes in the data behind every stroke of the response; default: 20 in models of own data, else 0.
        away: also play the response in the refits of the game.
        save: write the response as a table, which is named table:FILE.
    """
    from shuttle_marl.exact.odds import of_pair  # noqa: PLC0415

    tables = model.load()
    least = _least(tables, at_least)
    with cli.working("solving"):
        (opponent,) = tables_of([policy], tables)
        answer = exact.best_response(opponent, at_least=least)
        odds, seen = answer.value.odds(), exact.visits(answer.policy, opponent)
    factor = factor_of(tables)
    expected = None if factor is None else Estimate(*(0.5 + part for part in factor.scaled(odds.rally - 0.5)))
    if save is not None:
        answer.policy.save(save, {"policy": f"best-response:{policy}"})
    others, spreads = _in_refits(tables, away, functools.partial(of_pair, answer.policy, opponent))
    home = {"rally_win": odds.rally, "match_win": odds.match()}
    figures: dict[str, Any] = {
        "policy": policy,
        **home,
        "rally_win_serving": odds.serving,
        "rally_win_receiving": odds.receiving,
        "expected_rally_win": None if expected is None else expected._asdict(),
        "exploitability": odds.value,
        "rally_length": seen.rally_length,
        "endings": seen.endings(),
        "shot_mix": _mix(seen, 0),
        "shot_mix_of_policy": _mix(seen, 1),
        "at_least": least,
        "error_bound": max(answer.value.error_bound, seen.error_bound),
        "saved": None if save is None else str(save),
        **cli.home_and_away_json(home, spreads),
    }
    notes = (
        f"player 0 is the response, player 1 {policy}.",
        "expected: the part of the edge over 50 % that unseen matches realise, docs/truth.md." if expected is not None else "",
        f"saved as table:{save}" if save is not None else "",
    )
    cli.show(figures, json_output, *notes, *cli.home_and_away([("the response", home, spreads)], others, asked=away))


def holes(policy: Policy, *, model: Model = MODEL, top: int = 10, at_least: AtLeast = None, json_output: Json = False) -> None:
    """List the states in which a policy loses most to its best response.

    Args:
        policy: name of a policy (docs/league.md).
        model: the game.
        top: number of states to list.
        at_least: real strokes in the data behind every better stroke; default: 20 in models of own data, else 0.
    """
    if top < 1:
        raise ExactError(f"--top {top}: expected 1 or more")
    tables = model.load()
    least = _least(tables, at_least)
    with cli.working("solving"):
        found = exact.holes(*tables_of([policy], tables), top=top, at_least=least)
    factor = factor_of(tables)
    cli.show(
        {"policy": policy, "at_least": least, **found.as_json()},
        json_output,
        cli.table(f"Largest losses of {policy} to its best response", _HOLES, map(_hole, found.holes)),
        "loss: of the policy in a rally to its best response, which gives up a part of perfect play in exchange. share: part of "
        "the loss in the states above. in self-play, against its best response: expected visits of the policy in a rally, with "
        f"each player serving half of the rallies. Better strokes have at least {least} real ones behind them where a state has "
        "any such (--at-least N sets the number).",
        ""
        if factor is None
        else f"In matches that no fit used, {cli.written('share', factor)} of a predicted advantage was "
        "realised (docs/truth.md).",
    )


def _hole(hole: "Hole") -> tuple[cli.Figure, ...]:
    def real(number: float | None) -> str:
        return "" if number is None else f"\n{number:,.0f} real strokes"

    better = "" if hole.best == hole.played else f"\n{hole.best} {cli.percent(hole.best_share)}{real(hole.best_real)}"
    played = f"{hole.played} {cli.percent(hole.played_share)}{real(hole.played_real)}{better}"
    seen = f"{hole.in_self_play:.2g}", f"{hole.against_best_response:.2g}"
    return hole.description.replace(", ", "\n", 2), played, *seen, hole.regret, f"{hole.loss:.5f}"


def crossplay(policies: Policies, *, model: Model = MODEL, json_output: Json = False) -> None:
    """Compute the win probability of every policy against every other.

    Args:
        policies: names of policies (docs/league.md).
        model: the game.
    """
    _check_some(policies)
    tables = model.load()
    entrants = tables_of(cli.progress(policies, "tables"), tables)
    with cli.working("playing the pairs"):
        odds = exact.crossplay(entrants)
    figures = {
        "policies": list(policies),
        "rally_win_serving": odds.serving.tolist(),
        "rally_win_receiving": odds.receiving.tolist(),
        "rally_win": odds.rally.tolist(),
        "match_win": odds.match().tolist(),
        "error_bound": odds.error_bound,
    }
    cli.show(
        figures,
        json_output,
        cli.matrix("Matches won by the row against the column", policies, figures["match_win"]),
        cli.matrix("Rallies won by the row against the column", policies, figures["rally_win"]),
    )


def _least(game: Game, at_least: int | None) -> int:
    if at_least is not None and at_least < 0:
        raise ExactError(f"--at-least {at_least}: expected 0 or more")
    return least_support(game) if at_least is None else at_least


def _in_refits(
    game: Game, asked: bool, figures: "Callable[[Game], Mapping[str, float]]"
) -> "tuple[Sequence[Game], dict[str, Estimate] | None]":
    """The refits of a game, and figures in them; none unless asked for."""
    from shuttle_marl.exact.odds import over  # noqa: PLC0415

    refits = refits_of(game) if asked else ()
    with cli.working("playing the refits"):
        return refits, over(refits, figures) if refits else None


def _mix(seen: exact.Visits, player: int) -> dict[str, float]:
    return dict(zip(SHOTS, seen.shot_mix(player).tolist(), strict=True))


def _check_some(policies: Sequence[str]) -> None:
    if not policies:
        raise ExactError("no policy given; name one or more, for example: bc attacking minimax")


def depth(policies: Policies = (), *, model: Model = MODEL, json_output: Json = False) -> None:
    """Describe the play of policies beside that of people, and how far policies get that read little of the state.

    Args:
        policies: names of policies (docs/league.md); default: perfect play, the best response to bc, bc, the agents of the
            package, and human:0.05 and human:0.02.
        model: the game.
    """
    from shuttle_marl.policy.scorecard import POLICIES, depth  # noqa: PLC0415  numba

    tables, console = model.load(), cli.console(stderr=True)
    found = depth(tables, policies or POLICIES, report=lambda line: console.print(line, markup=False))
    played = {f"{name} against {other}": of for name, against in found["policies"].items() for other, of in against.items()}
    people = {"people": found["people"]} if found["people"] else {}
    cli.show(
        found,
        json_output,
        cli.named("Play", played | people),
        cli.named("Best policies that read", {cli.words(name): of for name, of in found["lists"].items()}),
        "impossible: legal strokes at the net that are met in the back third. types, kinds: shot types above 2 %, and pairs of a "
        "shot type and a target area above 1 %. smash after lift: fraction of its replies to a lift from above. net runs: part "
        "of its net shots in runs of three or more cross-court ones. rare: fraction of its strokes of a shot type that bc plays "
        "there in less than 1 % of cases. people: in the matches of the fit. score: 0 is bc, 1 its best response.",
        "mixed: choices of strokes and of positions in which perfect play mixes. purified, ignores position: rallies that a best "
        "response wins against its most likely choices, and against perfect play of the game without recovery."
        if "mixed" in found
        else "",
    )


COMMANDS: Final = cli.by_name(solve, evaluate, best_response, holes, crossplay, depth)
main: Final = cli.entry_point(
    COMMANDS,
    "python -m shuttle_marl.exact",
    "Exact solution of the game, and policies measured against it; every result states its error bound.",
)
