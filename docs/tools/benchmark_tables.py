"""Tables of speed and cost, from ``benchmarks/results/``, where the benchmarks' own ``--json`` output was saved."""

from typing import Any

from benchmarks.machine import machine
from docs.tools.markdown import markdown, saved


def aec() -> str:
    """Speed of PettingZoo's loop, from ``benchmarks/results/aec.json``."""
    result = saved("benchmarks", "aec")
    rows = [
        (
            f"`{e['environment']}`",
            f"{e['steps_per_second']:,.0f}",
            f"{e['slowest']:,.0f} to {e['fastest']:,.0f}",
            f"{e['ratio']:.1f}",
        )
        for e in result["environments"]
    ]
    headings = ("environment", "steps/s", "slowest to fastest turn", "times `connect_four_v3`")
    return f"{markdown(headings, rows, left=('environment',))}\n\n{machine(result)}"


def startup() -> str:
    """CPU time of commands that do nothing yet, from ``benchmarks/results/startup.json``."""
    result = saved("benchmarks", "startup")
    rows = [(f"`{c['command']}`", f"{c['cpu_s']:.2f}") for c in result["commands"]]
    return f"{markdown(('command', 'CPU s'), rows, left=('command',))}\n\n{machine(result)}"


def league() -> str:
    """Speed and memory of tournaments, from ``benchmarks/results/league.json``."""
    result = saved("benchmarks", "league")
    rows = [
        (str(c["pool"]), str(c["workers"]), f"{c['matches_per_s']:,.0f}", f"{c['rating_s']:.1f}", f"{c['memory_mib']:,.0f}")
        for c in result["sampled"]
    ]
    table = markdown(("entrants", "workers", "matches a second", "ratings, s", "memory, MiB"), rows, left=())
    return f"{table}\n\nOdds solved exactly: {result['exact']['pairs_per_s']:.0f} pairs a second. {machine(result)}"


def recording() -> str:
    """Cost of the rally log, from ``benchmarks/results/recording.json``."""
    result = saved("benchmarks", "recording")
    rows = [
        ("CPU time to write a stroke", f"{result['cpu_us_per_stroke']:.3f} µs"),
        ("bytes a stroke of a tournament", f"{result['bytes_per_stroke']:.2f}"),
        ("strokes of a tournament played and recorded a second", f"{result['recorded_strokes_per_s'] / 1e6:.1f} million"),
        (
            "CPU time that recording one rally in a hundred, as training does by default, adds to PPO",
            f"{100 * result['training_overhead']:.1f} %",
        ),
        ("bytes a stroke of training, with probabilities and values", f"{result['training_bytes_per_stroke']:.2f}"),
        ("strokes read a second", f"{result['read_strokes_per_s'] / 1e6:.0f} million"),
        ("strokes played again a second", f"{result['replay_strokes_per_s'] / 1e6:.1f} million"),
        (f"to open the log of {result['rallies']:,} rallies and read one of them", f"{result['find_rally_ms']:.1f} ms"),
    ]
    played = f"{result['strokes']:,} strokes of a tournament. {machine(result)}"
    return f"{markdown(('', 'measured'), rows, left=('',))}\n\n{played}"


def cluster() -> str:
    """Estimated cost and storage of large tournaments, from ``benchmarks/results/throughput.json`` and ``recording.json``."""
    log = saved("benchmarks", "recording")
    played = [row for row in saved("benchmarks", "throughput") if row["what"] == "tournament" and row["threads"] == 1]
    speed = max(row["strokes_per_s"] for row in played)
    size, write = log["bytes_per_stroke"], log["cpu_us_per_stroke"] / 1e6
    rows = [
        (f"10{power}", *map(_time, (n / speed, n / speed / 64)), _size(size * n), _time(write * n), _size(size * n / 1000))
        for n, power in ((10**9, "⁹"), (10**10, "¹⁰"), (10**11, "¹¹"), (10**12, "¹²"))
    ]
    headings = (
        "strokes", f"core time: n / {speed / 1e6:.1f} M", "on 64 cores", f"log of all: {size:.2f} n bytes",
        f"written in {1e6 * write:.4f} n µs", "log of `sample:1000`",
    )  # fmt: skip
    hours, gigabytes = 1e12 / speed / 3600, size * 1000
    return (
        f"Measured on one core ([benchmarks](../benchmarks/README.md)): a tournament from tables plays {speed / 1e6:.1f} million "
        f"strokes a second (`tournament`, one thread), the log takes {size:.2f} bytes a stroke, and its writer takes "
        f"{1e6 * write:.4f} µs for one.\n\n{markdown(headings, rows, left=())}\n\n"
        "The third column assumes that all cores are equally fast and never idle. At assumed prices of 0.05 dollars a core hour "
        f"and 0.02 dollars a gigabyte and month, 10¹² strokes cost {0.05 * hours:.2f} dollars to play, and their complete log "
        f"{0.02 * gigabytes:.0f} dollars a month."
    )


def _time(seconds: float) -> str:
    unit, name = next((unit, name) for unit, name in ((3600, "h"), (60, "min"), (1, "s")) if seconds >= unit or unit == 1)
    value = seconds / unit
    return f"{value:.1f} {name}" if value < 10 else f"{value:.0f} {name}"


def _size(content: float) -> str:
    unit, name = next((unit, name) for unit, name in ((1e12, "TB"), (1e9, "GB"), (1e6, "MB")) if content >= unit or unit == 1e6)
    value = content / unit
    return f"{value:.1f} {name}" if value < 10 else f"{value:.0f} {name}"


def viewer() -> str:
    """Cost of the live court, from ``benchmarks/results/viewer.json``."""
    result = saved("benchmarks", "viewer")
    server, page = result["server_mb"], result["page_mb"]
    rows = [
        ("size of the page", f"{result['bundle_kb']:,.0f} kB, {result['gzipped_kb']:,.0f} kB gzipped"),
        ("a whole match as a site of static files", f"{result['site_mb']:.1f} MB"),
        ("first picture", f"{result['first_picture_s']:.1f} s"),
        ("first picture of a new server without compiled code", f"{result['cold_picture_s']:.1f} s"),
        ("script of a frame, median", f"{result['script_ms_per_frame']:.1f} ms"),
        ("draw calls of a frame in full quality, at most", f"{result['draw_calls']}"),
        ("triangles of a frame in full quality, at most", f"{result['triangles']:,}"),
        ("from the choice of a stroke to the first frame that moves, median", f"{result['turn_ms']:.0f} ms"),
        (f"a rally for {result['viewers']} pages that ask at once, the slowest", f"{result['viewers_slowest_s']:.1f} s"),
        (
            f"memory of the server after the first and the last of {result['matches']} matches",
            f"{server[0]:.0f}, {server[-1]:.0f} MB",
        ),
        ("memory of the page's script after the first and the last of them", f"{page[0]:.0f}, {page[-1]:.0f} MB"),
    ]
    return f"{markdown(('', 'measured'), rows, left=('',))}\n\n{machine(result)}"


def exact_values() -> str:
    """Time of the exact solvers, from ``benchmarks/results/exact_values.json``."""
    result = saved("benchmarks", "exact_values")
    rows = [(row["what"], f"{row['seconds']:.2f}", f"{row['cpu_s']:.2f}") for row in result["solvers"]]
    return f"{markdown(('solver', 'seconds', 'CPU seconds'), rows, left=('solver',))}\n\n{machine(result)}"


def time_to_win() -> str:
    """Seconds until learners reach their targets, from ``benchmarks/results/time_to_win.json``."""
    rows = saved("benchmarks", "time_to_win")
    targets = list(dict.fromkeys(row["target"] for row in rows))
    lines = []
    for learner in dict.fromkeys(row["learner"] for row in rows):
        mine = {row["target"]: row for row in rows if row["learner"] == learner}
        lines.append((learner, *(_seconds(mine[target]) if target in mine else "" for target in targets)))
    ours, theirs = (sorted({r["seeds"] for r in rows if ("shuttle_marl" in r["learner"]) == own}) for own in (True, False))
    others = f", of other projects' {' or '.join(map(str, theirs))}" if theirs not in ([], ours) else ""
    seeds = f"{' or '.join(map(str, ours))} seeds{others}"
    note = f"Median (and slowest) of {seeds}, one thread; `>`: not every seed got there before it was stopped."
    return f"{markdown(('learner', *targets), lines, left=('learner',))}\n\n{note} {rows[0]['machine']}"


def _seconds(row: dict[str, Any]) -> str:
    sign = "" if row["reached"] == row["seeds"] else "> "
    return f"{sign}{row['seconds_median']:.1f} s ({sign}{row['seconds_worst']:.1f})"


def training_speed() -> str:
    """Strokes trained a second, from ``benchmarks/results/training.json``."""
    result = saved("benchmarks", "training")
    rows = [
        (
            name,
            _millions(row["strokes_trained_per_s"]),
            f"{row['strokes_an_iteration']:,}",
            f"{row['distinct_states']:,}",
            f"{100 * row['recording_overhead']:.0f} %",
        )
        for name, row in (("against `bc`", result), ("self-play", result["self_play"]))
    ]
    headings = ("PPO", "million strokes/s", "strokes an iteration", "distinct states in it", "recording all adds")
    return f"{markdown(headings, rows, left=('PPO',))}\n\n{machine(result)}"


def throughput() -> str:
    """Million strokes a second by batch, from ``benchmarks/results/throughput.json``."""
    rows = [row for row in saved("benchmarks", "throughput") if not {"states", "recovery_ratio"} & set(row)]
    batches = sorted({row["batch"] for row in rows})
    lines = []
    for what, threads in dict.fromkeys((row["what"], row["threads"]) for row in rows):
        mine = {row["batch"]: row for row in rows if (row["what"], row["threads"]) == (what, threads)}
        cells = [_millions(mine[batch]["strokes_per_s"]) if batch in mine else "" for batch in batches]
        lines.append((f"`{what}`", str(threads), *cells, f"{mine[max(mine)]['peak_mb']:.0f}"))
    headings = ("", "threads", *(f"{batch:,}" for batch in batches), "peak MB")
    least, most = (f"{edge(row['load'] for row in rows):.0f}" for edge in (min, max))
    load = least if least == most else f"{least} to {most}"
    return f"{markdown(headings, lines, left=('',))}\n\n{rows[0]['machine']}; processes that wanted a core meanwhile: {load}."


def speed() -> str:
    """The main figures, from ``benchmarks/results/throughput.json`` and ``exact_values.json``."""
    best: dict[str, float] = {}
    for row in saved("benchmarks", "throughput"):
        if not {"states", "recovery_ratio"} & set(row) and row["threads"] == 1 and row["batch"] in (1, 8192):
            best[row["what"]] = row["strokes_per_s"]
    solvers = {row["what"].partition(",")[0]: row["cpu_s"] for row in saved("benchmarks", "exact_values")["solvers"]}
    strokes = (
        ("the kernel alone", "kernel"),
        ("the kernel with observations and masks", "kernel_observed"),
        ("`RallyEnv` in TorchRL's loop", "torchrl"),
        ("a tournament, every stroke kept", "tournament"),
    )
    lines = [(name, f"{best[what] / 1e6:.0f} million strokes a second") for name, what in strokes]
    times = best["aec"] / best["connect_four_v3"]
    lines.append(("`rally_v0` in PettingZoo's loop", f"{times:.1f} times the speed of PettingZoo's `connect_four_v3`"))
    lines.append(("perfect play of the whole game", f"{solvers['minimax']:.2f} s"))
    lines.append(("a best response", f"{solvers['best response']:.2f} s"))
    return f"{markdown(('', 'speed'), lines, left=('', 'speed'))}\n\nOne thread, 8,192 rallies or matches at once."


def throughput_bound() -> str:
    """The kernel beside what its reads alone allow, from ``benchmarks/results/throughput.json``."""
    lines = [
        (
            f"`{row['what']}`",
            str(row["threads"]),
            str(row["bytes_per_stroke"]),
            f"{1e9 / row['bound_per_s']:.1f}",
            f"{1e9 / row['strokes_per_s']:.1f}",
        )
        for row in saved("benchmarks", "throughput")
        if "bound_per_s" in row
    ]
    return markdown(("", "threads", "bytes a stroke", "lower bound, ns", "measured, ns"), lines, left=("",))


def tagging() -> str:
    """Tagging of a film by a script, from ``benchmarks/results/tagging.json``."""
    result = saved("benchmarks", "tagging")
    rows = [
        ("strokes recovered, with place, technique, height, time and score", f"{100 * result['recovered']:.1f} %"),
        ("inputs a stroke, with setup and corners", f"{result['inputs_per_stroke']:.2f}"),
        ("the first suggestion is the shot type", f"{100 * result['first_suggestion']:.0f} %"),
        ("time to save an input, median and 95 %", f"{result['autosave_ms']:.0f} and {result['autosave_ms_95']:.0f} ms"),
        (f"inputs lost when the server was killed, most of {result['kills']} times", str(result["inputs_lost"])),
    ]
    played = f"{result['rallies']} rallies of {result['strokes']} strokes. {machine(result)}"
    return f"{markdown(('', 'measured'), rows, left=('',))}\n\n{played}"


def throughput_sizes() -> str:
    """The kernel in games of other sizes, from ``benchmarks/results/throughput.json``."""
    by_game: dict[tuple[Any, ...], dict[str, float]] = {}
    for row in saved("benchmarks", "throughput"):
        if "states" in row:
            game = (row["synthetic"], row["strokes"], row["states"], row["legal_pairs"])
            by_game.setdefault(game, {})[row["what"]] = 1e9 / row["strokes_per_s"]
    lines = [
        (
            "synthetic" if synthetic else "shipped",
            f"{strokes:,}",
            f"{states:,}",
            f"{pairs:,}",
            f"{cost['kernel']:.1f}",
            f"{cost['kernel_observed']:.1f}",
        )
        for (synthetic, strokes, states, pairs), cost in by_game.items()
    ]
    headings = ("game", "catalogue", "states", "legal pairs", "`kernel`, ns", "`kernel_observed`, ns")
    return markdown(headings, lines, left=("game",))


def _millions(speed: float) -> str:
    return f"{speed / 1e6:.1f}" if speed >= 1e6 else f"{speed / 1e6:.3f}"


def _share(value: float) -> str:
    return f"{value:.2f}"


def _percent(value: float) -> str:
    return f"{100 * value:.1f} %"


def staging() -> str:
    """Measures of how natural staged rallies look, from ``benchmarks/results/staging.json``."""
    result = saved("benchmarks", "staging")
    rows = [
        ("racket to shuttle at a contact, worst", f"{1000 * result['contact_max']:.1f} mm", "6 mm"),
        ("slide of a planted foot, worst", f"{1000 * result['slide_max']:.1f} mm", "5 mm"),
        ("speed of a player, greatest", f"{result['speed_max']:.2f} m/s", "6.5 m/s"),
        ("acceleration of a player, greatest", f"{result['acceleration_max']:.2f} m/s²", "12 m/s²"),
        ("joint beyond its limit, worst", f"{result['joint_excess_deg']:.1f}°", "0°"),
        ("shuttle over the net, least", f"{1000 * result['net_clearance_min']:.0f} mm", "10 mm"),
        ("end of a flight to the chosen point, worst", f"{1000 * result['landing_error_max']:.1f} mm", "50 mm"),
        ("strokes that end as they must: in their area, out, in the net", f"{100 * result['ends_as_it_must']:.1f} %", "100 %"),
        ("flight times within the quartiles of their shot type", f"{100 * result['flight_times_in_quartiles']:.1f} %", "90 %"),
        ("speed of the strings, relative to the shuttle's: smash", _share(result["impact_ratio"]["smash"]), "0.45 to 0.75"),
        ("clear", _share(result["impact_ratio"]["clear"]), "0.45 to 0.75"),
        ("drive", _share(result["impact_ratio"]["drive"]), "0.45 to 0.75"),
        ("lift", _share(result["impact_ratio"]["lift"]), "0.45 to 0.75"),
        ("net kill", _share(result["impact_ratio"]["net-kill"]), "0.45 to 0.75"),
        ("fastest instant of the strings after the contact, median", f"{result['impact_peak_ms']:.0f} ms", "within 10 ms"),
        ("cosine between strings and shuttle at the contact, median", _share(result["impact_cosine"]), "0.8"),
        ("the least of the medians by shot type", _share(min(result["impact_cosine_by_shot"].values())), "0.8"),
        (
            "vertical acceleration of the hips around 99 % of the strokes",
            f"{result['vertical_acceleration']:.0f} m/s²",
            "35 m/s²",
        ),
        ("hips sink after a jumped smash, median", f"{100 * result['landing_sink']:.0f} cm", "10 cm"),
        ("clears and drops in the air", " and ".join(_percent(result["airborne"][s]) for s in ("clear", "drop")), "30 %"),
        ("motionless before the serve and after the rally", _percent(result["still_share"]), "5 %"),
        ("step, median", f"{result['step_length']:.2f} m", "0.45 m"),
        ("wrist faster than 2,000°/s", _percent(result["wrist_speed"]), "0.1 %"),
        ("net shots above 1.2 m with a high elbow", _percent(result["net_shot_high_elbow"]), "10 %"),
        ("net shots above 1.2 m with a hanging racket", _percent(result["net_shot_hanging_racket"]), "10 %"),
        ("packed", f"{result['pack_kb_per_s']:.1f} KB a second", "6 KB a second"),
        ("off after unpacking, worst", f"{result['pack_error_mm']:.1f} mm", "2 mm"),
        ("a stroke and its reply put behind an open rally, median", f"{result['continue_ms']:.0f} ms", "50 ms"),
        ("faster than real time, one core", f"{result['realtime']:.0f} times", "40 times"),
    ]
    staged = (
        f"{result['rallies']:,} rallies between imitated players, {result['strokes']:,} strokes, {result['plants']:,} plants of "
        f"a foot, {result['seconds'] / 60:,.0f} minutes. {machine(result)}"
    )
    return f"{markdown(('', 'measured', 'asked for'), rows, left=('',))}\n\n{staged}"
