"""Tables of experiments: the next stroke, win rates, the matrix over opponents, styles, and the value of strokes."""

from collections.abc import Callable
from typing import Any

from docs.tools.markdown import markdown, saved
from experiments import human as human_play
from experiments import league_training as league_study
from experiments import next_stroke, styles, win_rates
from experiments import self_play as self_play_study


def _made_by(result: dict[str, Any]) -> str:
    commit = result["git"]["commit"][:7] if result["git"] else "no checkout"
    return f"`{' '.join(result['command'])}`, commit {commit}"


def agents() -> str:
    """Match wins of the trained agents, with exact results."""
    result = saved("experiments", "win_rates")
    table = markdown(win_rates.HEADINGS, list(win_rates.table_rows(result)), left=("agent",))
    played = f"{result['seeds']} seeds, {result['matches']:,} matches each, game `{result['game'][:12]}`"
    return f"{table}\n\n{played}: {_made_by(result)}."


def matrix() -> str:
    """Exact match win probabilities against unseen opponents."""
    against = saved("experiments", "win_rates")["exact_match_win_against"]
    opponents = next(iter(against.values()))
    rows = [(agent, *(f"{100 * probability:.1f}" for probability in odds.values())) for agent, odds in against.items()]
    return markdown(("agent", *opponents), rows, left=("agent",))


def self_play(name: str = "self_play") -> str:
    """Exploitability by variant of self-play, from ``experiments/results/NAME.json``."""
    result = saved("experiments", name)
    rows = [(f"`{variant}`", *figures) for variant, *figures in self_play_study.table_rows(result)]
    table = markdown(self_play_study.HEADINGS, rows, left=("variant",))
    return f"{table}\n\nMeans of {result['seeds']} seeds, exact, game `{result['game'][:12]}`: {_made_by(result)}."


def style_figures() -> str:
    """Shot mix of agents with a style, and differences that are not significant."""
    result = saved("experiments", "styles")
    table = markdown(styles.HEADINGS, list(styles.table_rows(result)), left=("style",))
    same = styles.alike(result)
    count = len(result["different"])
    significant = (
        f"All {count} differences between two rows"
        if not same
        else f"{count - len(same)} of {count} differences between two rows"
    )
    but = f" Not: {'; '.join(same)}." if same else ""
    return (
        f"{table}\n\n{significant} in one of the first five columns are significant (adjusted p < 0.05).{but} {_made_by(result)}."
    )


def next_strokes() -> str:
    """Accuracy of next-stroke prediction of the imitator, of the game's clones, and in the paper."""
    result = saved("experiments", "next_stroke")
    table = markdown(
        next_stroke.HEADINGS, next_stroke.table_rows(result, next_stroke.LEAST_PLAYERS), left=next_stroke.HEADINGS[:2]
    )
    fit = result["fit"]
    fitted = f"fitted on {fit['strokes']:,} strokes of {fit['matches']} training matches in {fit['seconds']} s"
    return f"{table}\n\nThe {result['split']} matches; the imitator {fitted}. {_made_by(result)}."


def recipes() -> str:
    """Results of the recipes for other libraries."""
    result = saved("experiments", "recipes")
    rows = []
    for name, found in result["recipes"].items():
        won = found["rally_win_vs_bc"]
        reached = found["printed"] if won is None else f"{100 * won:.1f} % of rallies against `bc`"
        rows.append((f"`{name}`", reached, f"{found['cpu_seconds']:.0f}", f"`{found['game'][:12]}`"))
    table = markdown(("recipe", "reached", "CPU seconds", "game"), rows, left=("recipe", "reached", "game"))
    return f"{table}\n\nPython {result['python']}, one thread of PyTorch: `python -m docs.tools.recipes --save`."


def league_training() -> str:
    """Exploitability of every variant of league training after equal budgets."""
    result = saved("experiments", "league_training")
    table = markdown(league_study.HEADINGS, league_study.table_rows(result), left=("variant",))
    side = f"{result['jobs']} at once on {result['workers']} core each"
    setting = f"{result['budget']} a run, {side}, {result['seeds']} seeds, game `{result['game_hash'][:12]}`"
    return f"{table}\n\n{setting}: {_made_by(result)}."


def human() -> str:
    """Strength against likeness along TAU."""
    result = saved("experiments", "human")
    played = f"{result['known']:,} strokes of {result['matches']} matches, split {result['split']}, game `{result['game'][:12]}`."
    return f"{markdown(human_play.HEADINGS, human_play.curve_rows(result), left=())}\n\n{played}"


def human_players() -> str:
    """TAU of single players."""
    result = saved("experiments", "human")
    return markdown(human_play.PLAYER_HEADINGS, human_play.player_rows(result), left=("player",))


def truth_slopes() -> str:
    """Slopes of realised on predicted advantage, over unseen matches."""
    rows = []
    for name, title in (("truth_cross", "average game"), ("truth_profiles", "men's and women's games")):
        result = saved("experiments", name)
        cells = map(_slope, result["decision_slope"].values())
        rows.append((title, *cells, f"{result['value_log_loss']:.5f}"))
    shown = saved("experiments", "truth_cross")
    played = f"{shown['strokes']:,} strokes of {shown['matches']} matches, {shown['cross']} parts; in brackets 95 % intervals."
    headings = ("game", "after 1 stroke", "4", "8", "end of the rally", "log-loss of the value")
    return f"{markdown(headings, rows, left=('game',))}\n\n{played} {_made_by(shown)}."


def truth_limits() -> str:
    """Measured slopes, and those expected of a fit."""
    result = saved("experiments", "truth_limits")
    headings, measured, expected = ["slope"], ["measured"], ["expected of a fit to as many matches"]
    for horizon, found in result["decision_slope"].items():
        headings.append("end of the rally" if horizon == "end" else f"after {horizon}")
        measured.append(_slope(found))
        expected.append(f"{result['attainable'][horizon]['value']:.2f}")
    return markdown(headings, [measured, expected], left=("slope",))


def truth_memory() -> str:
    """Slopes of the residual of the state value on the advantages of earlier strokes."""
    result = saved("experiments", "truth_cross")
    headings = ["strokes ago", *result["memory"]]
    table = markdown(headings, [["slope", *map(_slope, result["memory"].values())]], left=("strokes ago",))
    return f"{table}\n\n{result['matches']} matches; in brackets 95 % intervals. {_made_by(result)}."


def truth_forecasts() -> str:
    """Calibration errors of the forecasts of a stroke's end, and of outcomes drawn with the promised probabilities."""
    found = saved("experiments", "truth_cross")["forecasts"]
    headings = ["expected calibration error", *found]
    rows = [
        ["game", *(f"{errors['ece']:.4f}" for errors in found.values())],
        ["without errors: mean (at most)", *(f"{e['chance']:.4f} ({e['chance_high']:.4f})" for e in found.values())],
        ["strokes", *(f"{errors['strokes']:,}" for errors in found.values())],
    ]
    return markdown(headings, rows, left=("expected calibration error",))


def _slope(found: dict[str, float]) -> str:
    return f"{found['value']:.2f} ({found['low']:.2f} to {found['high']:.2f})"


def truth_calibration() -> str:
    """Slopes on calibrated advantages, in matches that did not fit the factors."""
    result = saved("experiments", "truth_cross")["calibration"]
    headings = ["", *("end of the rally" if name == "end" else f"after {name}" for name in result)]
    rows = [
        ["factor, mean of the parts", *(f"{found['factor']:.2f}" for found in result.values())],
        ["slope on calibrated advantages", *(_slope({**found, "value": found["slope"]}) for found in result.values())],
    ]
    return markdown(headings, rows, left=("",))


def depth_play() -> str:
    """What policies play, from ``experiments/results/depth.json``."""
    rows = []
    for name, against in saved("experiments", "depth")["policies"].items():
        for opponent, of in against.items():
            most = sorted(of["shots"].items(), key=lambda shot: -shot[1])[:5]
            shots = ", ".join(f"{shot} {100 * share:.0f}" for shot, share in most)
            figures = (str(of["types"]), f"{of['bits']:.2f}", f"{of['length']:.1f}", f"{100 * of['rare']:.2f} %")
            rows.append((f"`{name}`", "itself" if opponent == "self" else f"`{opponent}`", shots, *figures))
    headings = ("policy", "against", "most frequent shots, %", "shot types", "bits", "strokes a rally", "rare")
    return markdown(headings, rows, left=("policy", "against", "most frequent shots, %"))


def depth_lists() -> str:
    """How far policies get that read little, from ``experiments/results/depth.json``."""
    rows = [
        (name.replace("_", " "), f"{of['score']:.3f}", f"{of['exploitability']:z.3f}", f"{100 * of['against_minimax']:.1f} %")
        for name, of in saved("experiments", "depth")["lists"].items()
    ]
    return markdown(("reads", "normalised", "exploitability", "rallies against minimax"), rows, left=("reads",))


def recovery_truth() -> str:
    """What positions change on matches that no fit saw, from ``experiments/results/truth_cross.json``."""
    rows = []
    for effect, of in saved("experiments", "truth_cross")["recovery"].items():
        change = f"{1e5 * of['log_loss_change']:.0f} ({1e5 * of['low']:.0f} to {1e5 * of['high']:.0f})"
        slope = f"{of['slope']:.2f} ({of['slope_low']:.2f} to {of['slope_high']:.2f})"
        rows.append((effect, change, slope, f"{of['strokes']:,}"))
    return markdown(
        ("effect of the position on", "log-loss, 10⁻⁵ nats", "slope", "strokes"), rows, left=("effect of the position on",)
    )


def recovery_depth() -> str:
    """What the hidden position asks of players, from ``experiments/results/depth_recovery.json``."""
    found = saved("experiments", "depth_recovery")
    rows = [
        ("choices of strokes that perfect play mixes", f"{found['mixed']['strokes']:.0%}"),
        ("choices of positions that it mixes", f"{found['mixed']['positions']:.0%}"),
        ("rallies that a best response wins against it made deterministic", f"{found['purified']:.1%}"),
        ("and against the strokes of the other game", f"{found['ignores_position']:.1%}"),
    ]
    return markdown(("perfect play with recovery", ""), rows, left=("perfect play with recovery",))


def truth_shares() -> str:
    """Minimum shares of a legal shot type, from ``experiments/results/truth_shares.json``."""
    rows = []
    for share, of in saved("experiments", "truth_shares")["shares"].items():
        kept = (f"{of['transfer'][who]['kept']:.2f}" for who in ("best_response", "minimax"))
        change = _change(of["against_first"], 1e5, 1)
        rows.append((f"{100 * float(share):g} %", f"{100 * of['illegal']:.1f} %", f"{of['value_log_loss']:.5f}", change, *kept))
    headings = (
        "share",
        "strokes of people that are illegal",
        "log-loss of the value",
        "change, 10⁻⁵",
        "best response",
        "minimax",
    )
    return markdown(headings, rows, left=())


def truth_legality() -> str:
    """Illegal strokes, and differences to the game before."""
    result = saved("experiments", "truth_cross")
    found, change = result["illegal"], result["against"]
    rows = [
        ["strokes of people that are illegal", f"{100 * found['share']:.2f} %"],
        ["the same after a drop met above the net", f"{100 * found['after_drop_above']:.1f} %"],
        ["error of the value there, points", _points(found["value_error"])],
        ["change of the slope at the end", _change(change["slope_end"], 1, 3)],
        *(
            [f"change of the log-loss of {what}, 10⁻⁵", _change(change[f"{name}_log_loss"], 1e5, 1)]
            for name, what in (("value", "the value"), ("fault", "a fault"), ("contact", "the contact of a return"))
        ),
    ]
    return markdown(("figure", "value (95 %)"), rows, left=("figure",))


def _change(found: dict[str, float], scale: float, digits: int) -> str:
    value, low, high = (f"{scale * found[name]:+.{digits}f}" for name in ("value", "low", "high"))
    return f"{value} ({low} to {high})"


def truth_told_apart() -> str:
    """Features by which trees tell simulated rallies from real ones."""
    found = saved("experiments", "truth_cross")["two_sample_auc"]["gives_away"]
    rows = [
        (name, f"{100 * each['gain']:.0f} %", f"{each['simulated']:.3f}", f"{each['real']:.3f}", f"{each['difference']:+.3f}")
        for name, each in found.items()
    ]
    headings = ("feature", "part of the gain", "simulated", "real", "difference, standard deviations")
    return markdown(headings, rows, left=("feature",))


def truth_shots() -> str:
    """Predicted and realised advantages of shot types, and errors of the value after them."""
    result = saved("experiments", "truth_cross")
    rows = []
    for shot, found in result["promised_realised"].items():
        realised, error = found["realised"], result["value_error"].get(shot, {}).get("own")
        rows.append((shot, f"{found['promised']:+.2f}", _points(realised), "" if error is None else _points(error)))
    headings = ("shot type", "predicted", "realised", "error of the value after it")
    return f"{markdown(headings, rows, left=('shot type',))}\n\nIn points, per cent of rallies; in brackets 95 % intervals."


def _points(found: dict[str, float]) -> str:
    return f"{found['points']:+.1f} ({found['low']:+.1f} to {found['high']:+.1f})"


def truth_figures() -> str:
    """Other results of the comparison with real matches, cross-fitted and on the validation matches."""
    columns = [saved("experiments", name) for name in ("truth_cross", "truth_profiles", "truth_validation")]

    def of(figure: Callable[[dict[str, Any]], str]) -> list[str]:
        return [figure(result) for result in columns]

    def auc(figure: str) -> list[str]:
        found = [result.get(figure) for result in columns]
        return ["" if each is None else "{value:.3f} ({real_against_real:.3f})".format(**each) for each in found]

    rows = [
        ["slope at the end of the rally", *of(lambda r: _slope(r["decision_slope"]["end"]))],
        ["AUC, simulated from real rallies", *auc("two_sample_auc")],
        *([["the same with `bc:history`", *remembered]] if any(remembered := auc("two_sample_auc_history")) else []),
        ["strokes of people that are illegal", *of(lambda r: f"{100 * r['illegal']['share']:.2f} %")],
        ["rally length, KS", *of(lambda r: "{ks:.3f} ({ks_real:.3f})".format(**r["rally_length"]))],
    ]
    for name in columns[0]["divergence"]:
        rows.append([
            f"divergence of {name}, bits",
            *of(lambda r, name=name: "{value:.4f} ({real_against_real:.4f})".format(**r["divergence"][name])),  # type: ignore[misc]
        ])  # fmt: skip
    rows.append(["`random` against `bc`, rallies", *of(lambda r: f"{100 * r['random_vs_bc']:.1f} %")])
    for name in columns[0]["support"]:
        shown = f"strokes of {name.replace('_', ' ')} with fewer than five real ones"
        rows.append([shown, *of(lambda r, name=name: f"{100 * r['support'][name]:.0f} %")])  # type: ignore[misc]
    for name, found in columns[0].get("transfer", {}).items():
        transfer = f"{100 * found['home']:.1f} to {100 * found['away']:.1f} %; {found['kept']:.2f} of the edge"
        rows.append([f"{name.replace('_', ' ')}, own game to other game", transfer, "", ""])
    headings = (
        "figure",
        "average game, cross-fitted",
        "men's and women's, cross-fitted",
        "men's and women's, validation matches",
    )
    return markdown(headings, rows, left=("figure",))


def stroke_value() -> str:
    """Players ranked by value added, from ``experiments/results/stroke_value.json``."""
    result = saved("experiments", "stroke_value")
    groups = []
    for kind, title in (("MS", "men"), ("WS", "women")):
        rows = [
            (
                p["player"],
                str(p["matches"]),
                f"{p['strokes']:,}",
                *(
                    f"{100 * p[name]:+.2f} ({100 * p[low]:+.2f} to {100 * p[high]:+.2f})"
                    for name, low, high in (("value", "low", "high"), ("decision", "decision_low", "decision_high"))
                ),
                "{low:+.2f} to {high:+.2f}".format(**{part: 100 * value for part, value in p["away"]["value"].items()}),
            )
            for p in result["players"]
            if p["discipline"] == kind
        ]
        headings = (title, "matches", "strokes", "points by 100 strokes", "by decisions", "points, in a refit")
        groups.append(markdown(headings, rows, left=(title,)))
    played = (
        f"{result['valued']:,} of {result['strokes']:,} strokes have a value; in brackets 95 % intervals over matches. In a "
        "refit: 95 % interval for the same strokes, valued in one more refit of the game."
    )
    return "\n\n".join([*groups, played])


def _with_interval(found: dict[str, float]) -> str:
    """A difference of log-losses and its interval, in units of 10⁻⁵."""
    return f"{1e5 * found['mean']:+.0f} ({1e5 * found['low']:+.0f} to {1e5 * found['high']:+.0f})"


def advice_results() -> str:
    """Promised and realised gains of advised strokes in unseen matches, from ``experiments.advice``."""
    result = saved("experiments", "advice")
    rows = [
        (
            name.replace("_", " "),
            f"{result[name]['n']:,}",
            f"{100 * result[name]['promised']:+.2f}",
            f"{100 * result[name]['realised']:+.2f} ({100 * result[name]['low']:+.2f} to {100 * result[name]['high']:+.2f})",
        )
        for name in ("advised", "not_advised")
    ]
    table = markdown(
        ("strokes in situations with advice", "number", "promised", "realised"), rows, left=("strokes in situations with advice",)
    )
    return (
        f"{table}\n\nRallies won of 100, above the probability before the stroke; {result['advice']} pieces of advice for "
        f"{result['matches']} {result['split']} matches ({', '.join(f'{shot} {n}' for shot, n in result['shots'].items())}); in "
        f"brackets 95 % intervals. {_made_by(result)}."
    )


def pair_results() -> str:
    """Log-losses of results of rallies, from ``experiments.pairs --cross``."""
    result = saved("experiments", "pairs_cross")
    rows = [
        (name.replace("_", "-"), f"{loss:.5f}", _with_interval(result["difference"][name]) if name != "coin" else "")
        for name, loss in result["results"].items()
    ]
    table = markdown(("prediction", "log-loss", "against a coin, 10⁻⁵"), rows, left=("prediction",))
    slope = result["calibration"]
    return (
        f"{table}\n\n{result['rallies']:,} rallies of {result['matches']} matches, {result['cross']} parts; in brackets 95 % "
        f"intervals. Slope of the results on the pair's log-odds {slope['slope']:.2f} ({slope['low']:.2f} to "
        f"{slope['high']:.2f}); correlation of predicted and real shares {result['correlation']:.2f}. {_made_by(result)}."
    )


def pair_strokes() -> str:
    """Differences of log-losses of strokes by the players' offsets, from ``experiments.pairs --cross``."""
    components = saved("experiments", "pairs_cross")["components"]
    subsets = ("both_seen", "one_unseen", "update")
    rows = []
    for name, found in components.items():
        each = [{**one, "mean": one["difference"]} for one in (found, *(found[subset] for subset in subsets))]
        slope = found["offset"]
        cells = (f"{found['average']:.4f}", *map(_with_interval, each))
        rows.append((name, *cells, f"{slope['slope']:.2f} ({slope['low']:.2f} to {slope['high']:.2f})"))
    headings = ("component", "log-loss", "offsets, 10⁻⁵", "both players known", "one unknown", "updated, later games", "slope")
    return markdown(headings, rows, left=("component",))
