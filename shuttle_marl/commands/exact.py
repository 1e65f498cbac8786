"""``python -m shuttle_marl.exact COMMAND``: the game solved (``solve``), and policies measured by it, in several ways."""

import contextlib
import functools
import json as json_format
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import tyro
from rich.progress import track

from shuttle_marl.commands import cli
from shuttle_marl.errors import printable
from shuttle_marl.exact.fixed_point import ExactError
from shuttle_marl.game.shipped import Profile, refits_of, resolve_game
from shuttle_marl.policy.foreign import POLICY_TIMEOUT, time_limit

if TYPE_CHECKING:
    from shuttle_marl.exact.away import Spread
    from shuttle_marl.game.tables import Game
    from shuttle_marl.policy.scorecard import Scorecard, Scorer
    from shuttle_marl.rally.record import Rallies

Policies = Annotated[tuple[str, ...], tyro.conf.Positional]
Json = Annotated[bool, tyro.conf.arg(name="json")]
File = Annotated[Path | None, tyro.conf.arg(metavar="FILE")]


def solve(
    *,
    game: str = "default",
    profile: Profile | None = None,
    away: bool = True,
    tolerance: float = 1e-9,
    plot: File = None,
    incoming: str | None = None,
    own: str | None = None,
    json_output: Json = False,
) -> None:
    """Solve the game: what a rally is worth under perfect play, and what perfect play looks like.

    Args:
        game: model whose game is solved: a shipped one or a folder.
        profile: men or women: the game of that discipline alone; default: the average of both.
        away: play the solution in the refits of the game too.
        tolerance: largest error bound of a value that is good enough.
        plot: draw the value of the replies to a stroke over the court into this file (PNG, SVG or PDF).
        incoming: the stroke replied to in the picture, as in smash:middle-left:above:forehand; default: the one that perfect
            players meet most often.
        own: the striker's own last stroke in the picture; default: the mean over all.
        json_output: print JSON.
    """
    from shuttle_marl.exact import least_gain, visits  # noqa: PLC0415  numba
    from shuttle_marl.exact import solve as solve_game  # noqa: PLC0415  numba
    from shuttle_marl.exact.away import of_solution, over  # noqa: PLC0415
    from shuttle_marl.exact.sweeps import warm_up  # noqa: PLC0415
    from shuttle_marl.game.stroke import SHOTS  # noqa: PLC0415

    tables = resolve_game(game, profile)
    strokes = _strokes_to_plot(tables, plot, incoming, own)
    warm_up(tables)
    begun = time.perf_counter()
    solution = solve_game(tables, tolerance=tolerance)
    seconds = time.perf_counter() - begun
    if plot is not None:
        _plot(solution, plot, *strokes)
    others = refits_of(tables) if away else ()
    spreads = over(others, functools.partial(of_solution, solution)) if others else None
    figures = {
        "value_at_serve": solution.value_at_serve,
        "states": tables.n_states,
        "legal_pairs": tables.n_pairs,
        "sweeps": solution.sweeps,
        "residual": solution.residual,
        "error_bound": solution.error_bound,
        "seconds": seconds,
        **_home_and_away({"server_win": (1 + solution.value_at_serve) / 2, "exploitability": 0.0}, spreads),
    }
    if json_output:
        _say(json_format.dumps(figures))
        return
    serving = (1 + solution.value_at_serve) / 2
    seen = visits(*solution.policy)
    ends = seen.endings()
    winners = ends["winner of player 0"] + ends["winner of player 1"]
    rows = {
        "value at the serve": f"{solution.value_at_serve:+.6f}: the server wins {cli.percent(serving)} of the rallies",
        "error bound": f"{solution.error_bound:.1e} (residual {solution.residual:.1e}, contraction {solution.contraction:.5f})",
        "solved in": f"{seconds:.2f} s: {solution.sweeps} sweeps of {tables.n_pairs:,} legal pairs in {tables.n_states:,} states",
        "strokes a rally": f"{seen.rally_length:.2f}",
        "rallies end by": f"winner {cli.percent(winners)}, fault {cli.percent(1 - winners)}",
        "shots": cli.shares(dict(zip(SHOTS, seen.shot_mix(0).tolist(), strict=True))),
        "a rally won adds": f"{least_gain(serving, 1 - serving):.1e} or more to the match win probability, at every score",
    }
    cli.console().print(cli.facts(rows))
    _print_away([("minimax", figures["home"], spreads)], others, asked=away)


def evaluate(
    policies: Policies,
    *,
    game: str = "default",
    profile: Profile | None = None,
    away: bool = True,
    matches: int = 400,
    seed: int = 0,
    record: str = "all",
    log: File = None,
    policy_timeout: float = POLICY_TIMEOUT,
    json_output: Json = False,
) -> None:
    """Measure policies exactly: against bc, against their best responses, and against perfect play.

    A policy that reads the score has no table over states; it is sampled instead, with 95 % intervals, and its rallies are
    recorded.

    Args:
        policies: names of policies (docs/league.md).
        game: model whose game is played: a shipped one or a folder.
        profile: men or women: the game of that discipline alone; default: the average of both.
        away: play the policies in the refits of the game too.
        matches: matches played out for a policy that is sampled.
        seed: of their draws.
        record: which of their rallies are recorded: all, sample:N (those of one match in N) or none.
        log: the rally log they go into; default: runs/evaluate-SEED.mcap, or the next such name that is free.
        policy_timeout: seconds that a policy may take for one answer; 0 for no limit.
        json_output: print JSON.
    """
    from shuttle_marl.game.policy import reads_score  # noqa: PLC0415
    from shuttle_marl.policy.registry import resolve  # noqa: PLC0415
    from shuttle_marl.policy.scorecard import MOST_MATCHES, Scorer  # noqa: PLC0415  numba

    _check_some(policies)
    if not 1 <= matches <= MOST_MATCHES:
        raise ExactError(f"--matches {matches}: expected a number from 1 to {MOST_MATCHES:,}")
    if not 0 <= seed < 1 << 63:
        raise ExactError(f"--seed {seed}: expected a number from 0 up to 2^63")
    tables = resolve_game(game, profile)
    scorer = Scorer(tables, refits=refits_of(tables) if away else ())
    with time_limit(policy_timeout):
        found = [(name, resolve(name, scorer.game)) for name in policies]
    sampled = list(dict.fromkeys(name for name, policy in found if reads_score(policy)))
    cards: list[Scorecard] = []
    with _recorded(sampled, scorer, seed, record, log) as add:
        watches = {name: functools.partial(add, i) for i, name in enumerate(sampled)} if add is not None else {}
        for name, policy in _progress(found, "policies"):
            watch = watches.pop(name, None)  # a policy that is named twice plays the same matches again
            cards.append(scorer.score(policy, name, matches=matches, seed=seed, watch=watch))
    if json_output:
        _say(json_format.dumps([card.as_json() for card in cards]))
        return
    console = cli.console()
    console.print(cli.scorecards(cards))
    console.print(cli.play(cards))
    best = scorer.reference_best
    console.print(
        f"normalised: 0 is bc, 1 is the best response to bc ({100 * best.rally:.2f} % of rallies). exploitability: what the "
        "best response to the policy gains; it wins half of it above 50 % of rallies. regret: loss against perfect play. "
        "thin: share of its strokes that the data hardly know, with fewer than five real ones behind them."
    )
    _print_away([(card.policy, card.home, card.away) for card in cards if not card.sampled], scorer.refits, asked=away)
    exact = [card.error_bound for card in cards if card.error_bound is not None]
    if exact:
        console.print(f"exact: every figure is within {max(exact):.0e} of the true one.")
    for card in cards:
        if card.sampled:
            name = printable(card.policy)
            console.print(f"{name} reads the score: sampled in {card.matches} matches, 95 % intervals.")


def best_response(
    policy: Annotated[str, tyro.conf.Positional],
    *,
    game: str = "default",
    profile: Profile | None = None,
    away: bool = True,
    save: File = None,
    policy_timeout: float = POLICY_TIMEOUT,
    json_output: Json = False,
) -> None:
    """Compute what beats a policy most.

    Args:
        policy: name of a policy (docs/league.md).
        game: model whose game is played: a shipped one or a folder.
        profile: men or women: the game of that discipline alone; default: the average of both.
        away: play the response, as it was computed at home, in the refits of the game too.
        save: write the response as a table; table:FILE is its name from then on.
        policy_timeout: seconds that the policy may take for one answer; 0 for no limit.
        json_output: print JSON.
    """
    from shuttle_marl.exact import best_response as respond  # noqa: PLC0415  numba
    from shuttle_marl.exact import visits  # noqa: PLC0415
    from shuttle_marl.exact.away import of_pair, over  # noqa: PLC0415
    from shuttle_marl.game.stroke import SHOTS  # noqa: PLC0415
    from shuttle_marl.game.tabulated import tabulate  # noqa: PLC0415
    from shuttle_marl.policy.registry import resolve  # noqa: PLC0415

    tables = resolve_game(game, profile)
    with time_limit(policy_timeout):
        opponent = tabulate(resolve(policy, tables), tables, policy)
    answer = respond(opponent)
    odds, seen = answer.value.odds(), visits(answer.policy, opponent)
    mix = [dict(zip(SHOTS, seen.shot_mix(player).tolist(), strict=True)) for player in (0, 1)]
    if save is not None:
        answer.policy.save(save, {"policy": f"best-response:{policy}"})
    others = refits_of(tables) if away else ()
    spreads = over(others, functools.partial(of_pair, answer.policy, opponent)) if others else None
    figures: dict[str, Any] = {
        "policy": policy,
        "rally_win": odds.rally,
        "rally_win_serving": odds.serving,
        "rally_win_receiving": odds.receiving,
        "match_win": odds.match(),
        "exploitability": odds.value,
        "rally_length": seen.rally_length,
        "endings": seen.endings(),
        "shot_mix": mix[0],
        "error_bound": max(answer.value.error_bound, seen.error_bound),
        "saved": None if save is None else str(save),
        **_home_and_away({"rally_win": odds.rally, "match_win": odds.match()}, spreads),
    }
    if json_output:
        _say(json_format.dumps(figures))
        return
    wins = f"{cli.percent(odds.rally)} of rallies ({cli.percent(odds.serving)} serving, {cli.percent(odds.receiving)} receiving)"
    rows = {
        "the best response to": policy,
        "wins": f"{wins}, {cli.percent(odds.match())} of matches",
        "exploitability": f"{odds.value:.6f} (within {answer.value.error_bound:.0e})",
        "strokes a rally": f"{seen.rally_length:.2f}",
        "rallies end by": cli.shares({name.replace("player 0", "the response"): share for name, share in seen.endings().items()})
        .replace("player 1", policy),
        "shots of the response": cli.shares(mix[0]),
        f"shots of {policy}": cli.shares(mix[1]),
    }  # fmt: skip
    if save is not None:
        rows["saved as"] = f"table:{save}"
    cli.console().print(cli.facts(rows))
    _print_away([("the response", figures["home"], spreads)], others, asked=away)


def holes(
    policy: Annotated[str, tyro.conf.Positional],
    *,
    game: str = "default",
    profile: Profile | None = None,
    top: int = 10,
    policy_timeout: float = POLICY_TIMEOUT,
    json_output: Json = False,
) -> None:
    """List the states in which a policy loses most to its best response.

    Args:
        policy: name of a policy (docs/league.md).
        game: model whose game is played: a shipped one or a folder.
        profile: men or women: the game of that discipline alone; default: the average of both.
        top: number of states to list.
        policy_timeout: seconds that the policy may take for one answer; 0 for no limit.
        json_output: print JSON.
    """
    from shuttle_marl.exact import holes as find  # noqa: PLC0415  numba
    from shuttle_marl.game.tabulated import tabulate  # noqa: PLC0415
    from shuttle_marl.policy.registry import resolve  # noqa: PLC0415

    if top < 1:
        raise ExactError(f"--top {top}: expected a number from 1 on")
    tables = resolve_game(game, profile)
    with time_limit(policy_timeout):
        found = find(tabulate(resolve(policy, tables), tables, policy), top=top)
    if json_output:
        _say(json_format.dumps({"policy": policy, **found.as_json()}))
        return
    console = cli.console()
    console.print(cli.holes(policy, found))
    console.print(
        f"{len(found.holes)} of {found.states:,} states with a loss hold {cli.percent(found.share)} of it. The policy loses "
        f"{found.loss:.5f} a rally to its best response, which gives up {found.given_up:.5f} of perfect play to get it: "
        f"exploitability {found.exploitability:.5f} (within {found.error_bound:.0e}). in self-play, against its best response: "
        "how often it strikes there in a rally, both serving equally often."
    )


def crossplay(
    policies: Policies,
    *,
    game: str = "default",
    profile: Profile | None = None,
    away: bool = False,
    policy_timeout: float = POLICY_TIMEOUT,
    json_output: Json = False,
) -> None:
    """Compute the odds of every policy against every other.

    Args:
        policies: names of policies (docs/league.md).
        game: model whose game is played: a shipped one or a folder.
        profile: men or women: the game of that discipline alone; default: the average of both.
        away: play all pairs in the refits of the game too, which takes nine times as long.
        policy_timeout: seconds that a policy may take for one answer; 0 for no limit.
        json_output: print JSON.
    """
    import numpy as np  # noqa: PLC0415

    from shuttle_marl.exact import crossplay as play_all  # noqa: PLC0415  numba
    from shuttle_marl.exact.away import moved, of_all_pairs, over  # noqa: PLC0415
    from shuttle_marl.game.tabulated import tabulate  # noqa: PLC0415
    from shuttle_marl.policy.registry import resolve  # noqa: PLC0415

    _check_some(policies)
    tables = resolve_game(game, profile)
    with time_limit(policy_timeout):
        entrants = [tabulate(resolve(name, tables), tables, name) for name in _progress(policies, "tables")]
    pairs = iter(_progress(range(len(policies) * (len(policies) + 1) // 2), "pairs"))
    begun = time.perf_counter()
    odds = play_all(entrants, progress=lambda: next(pairs))
    seconds = time.perf_counter() - begun
    for _ in pairs:
        pass
    others = refits_of(tables) if away else ()
    home, spreads = of_all_pairs(odds), None
    if others:  # one after the other: a cross-play takes all cores
        spreads = over(others, lambda refit: of_all_pairs(play_all([moved(each, refit) for each in entrants])), at_once=1)
    if json_output:
        figures = {
            "policies": list(policies),
            "rally_win_serving": odds.serving.tolist(),
            "rally_win_receiving": odds.receiving.tolist(),
            "rally_win": odds.rally.tolist(),
            "match_win": odds.match().tolist(),
            "error_bound": odds.error_bound,
            "seconds": seconds,
            **_home_and_away({name: np.asarray(figure).tolist() for name, figure in home.items()}, spreads),
        }
        _say(json_format.dumps(figures))
        return
    console = cli.console()
    console.print(cli.matrix("Matches won by the row against the column", policies, odds.match()))
    console.print(cli.matrix("Rallies won by the row against the column", policies, odds.rally))
    shares = np.asarray(home["match_share"])
    _print_away(
        [(name, {"match_share": shares[i]}, None if spreads is None else {"match_share": spreads["match_share"].at(i)})
         for i, name in enumerate(policies)],
        others, asked=away,
    )  # fmt: skip
    console.print(f"exact: every probability of a rally is within {odds.error_bound:.0e} of the true one; {seconds:.1f} s")


_NO_REFITS: Final = "The model has no refits on resampled matches, so there are no figures away from home."


def _home_and_away(home: Mapping[str, Any], away: "Mapping[str, Spread] | None") -> dict[str, Any]:
    return {"home": home, "away": None if away is None else {name: figure.as_json() for name, figure in away.items()}}


def _print_away(rows: "Sequence[cli.Headlines]", refits: "Sequence[Game]", *, asked: bool) -> None:
    """The table of figures at home and away, where it was asked for, or why there is none."""
    if not asked or not rows:
        return
    console = cli.console()
    if not refits:
        console.print(_NO_REFITS)
        return
    console.print(cli.home_and_away(rows))
    console.print(
        f"away: policies as they were tabulated at home, in {len(refits)} refits of the game on resampled matches: mean, and\n"
        "95 % interval for one more refit. The best response behind exploitability knows the refit."
    )


@contextlib.contextmanager
def _recorded(
    sampled: Sequence[str], scorer: "Scorer", seed: int, record: str, log: Path | None
) -> "Iterator[Callable[[int, Rallies], None] | None]":
    """Recorder of the matches of policies that are sampled; None if there is nothing to record."""
    from shuttle_marl.policy.scorecard import REFERENCE  # noqa: PLC0415  numba
    from shuttle_marl.recording import Player, Sampling  # noqa: PLC0415
    from shuttle_marl.recording.recorder import free_name, sampled_log  # noqa: PLC0415

    if not Sampling.parse(record).every or not sampled:
        yield None
        return
    path = log or free_name(Path("runs") / f"evaluate-{seed}.mcap")
    opponent = Player(name=REFERENCE, hash=scorer.reference.hash)
    with sampled_log(path, sampled, opponent, scorer.game, seed=seed, record=record) as add:
        yield add
    cli.console(stderr=True).print(printable(f"{path}: the rallies of {', '.join(sampled)}"), soft_wrap=True)


def _strokes_to_plot(game: "Game", path: Path | None, incoming: str | None, own: str | None) -> tuple[int | None, int | None]:
    """Check what is to be drawn before anything is computed; catalogue indices of the incoming and of one's own stroke."""
    from shuttle_marl.analysis import pictures  # noqa: PLC0415

    if path is None:
        if incoming is not None or own is not None:
            raise ExactError("--incoming and --own choose what is drawn; name the picture with --plot FILE")
        return None, None
    pictures.check_format(path)
    chosen = tuple(None if name is None else pictures.stroke_index(game, name) for name in (incoming, own))
    if chosen[0] is not None:
        pictures.edges_of(game, chosen[0], chosen[1])
    return chosen[0], chosen[1]


def _plot(solution: Any, path: Path, incoming: int | None, own: int | None) -> None:
    from shuttle_marl.analysis import pictures  # noqa: PLC0415
    from shuttle_marl.exact import visits  # noqa: PLC0415  numba

    if incoming is None:
        import numpy as np  # noqa: PLC0415

        tables = solution.games[0]
        there = tables.incoming(np.arange(tables.n_states))
        seen = np.bincount(there, visits(*solution.policy).states[0], tables.n_strokes + 1)
        incoming = int(seen[: tables.n_strokes].argmax())
    pictures.save(pictures.best_replies(solution, incoming, own), path)


def _check_some(policies: Sequence[str]) -> None:
    if not policies:
        raise ExactError("no policy given; name one or more, for example: bc attacking minimax")


def _progress(things: Any, what: str) -> Any:
    return track(things, what, console=cli.console(stderr=True), transient=True)


def _say(line: str) -> None:
    sys.stdout.write(line + "\n")


COMMANDS: Final[dict[str, cli.Command]] = {
    "solve": solve,
    "evaluate": evaluate,
    "best-response": best_response,
    "holes": holes,
    "crossplay": crossplay,
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    description = "The game solved exactly, and policies measured against the solution; every result states its error bound."
    return cli.run(COMMANDS, prog="python -m shuttle_marl.exact", description=description, argv=argv)
