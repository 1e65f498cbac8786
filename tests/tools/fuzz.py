"""Fuzz test of every file format that the package reads.

    python -m tests.tools.fuzz [--n 5000] [--seed 0] [--formats log agent …] [--json]

Each case copies valid files, damages or forges one of them, and runs a command on them in a process of its own. Damage is bytes
flipped, overwritten, removed, repeated or cut off. A forgery has valid checksums: JSON values are replaced by values of other
types and sizes and by names that would run code; archives hold pickles with code, and tensors of other kinds and sizes; the file
is replaced by a named pipe, a device, a folder, or a file of a terabyte. The output has the keys:

- ``tried``: cases; ``refused``: exit status 1 or 2 with an error message; ``accepted``: exit status 0.
- ``tracebacks``: another exit status, or a traceback on standard error.
- ``hangs``: no exit within ``--timeout`` seconds.
- ``wrong``: a damaged file that has a checksum was accepted, and the result differs from that of the undamaged file.
- ``code_run``: code in a file was executed.
- ``peak_mb``: largest resident memory of a process [MB].
- ``formats``: the same counts for each format.

Cases that fail are printed, and their files are kept in ``--keep``.
"""

import contextlib
import dataclasses
import functools
import hashlib
import io
import json
import multiprocessing
import os
import random
import resource
import select
import shutil
import signal
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import torch
import tyro

from shuttle_marl.base.files import seal
from shuttle_marl.base.table_files import seal_parquet
from shuttle_marl.commands import analysis, cli, data, dynamics, exact, league, recording, report, scout, suite, training
from shuttle_marl.court.messages import TagRequest
from shuttle_marl.court.tagging import TagFile
from shuttle_marl.game.layout import RALLY_WIDTH
from tests.recording.mutate import Mutator, mutated
from tests.reduced import reduced_model
from tests.waiting import wait_until


def tags_main(arguments: Sequence[str]) -> int:
    """Open the table of a tagged video, and save an input, as ``watch --tag`` does."""

    def command(video: Annotated[Path, tyro.conf.Positional], table: Annotated[Path, tyro.conf.Positional]) -> None:
        file = TagFile(video, table)
        facts = file.facts()
        file.save(TagRequest(id=1, at=len(facts.inputs), after=facts.after, input="{}", first=0, rows=()))
        cli.print_json(file.facts().inputs)

    return cli.run(command, prog="tags", description="", argv=arguments)


Main = Callable[[Sequence[str]], int]
MAIN: Final[dict[str, Main]] = {
    "analysis": analysis.main,
    "data": data.main,
    "dynamics": dynamics.main,
    "exact": exact.main,
    "league": league.main,
    "recording": recording.main,
    "report": report.main,
    "scout": scout.main,
    "suite": suite.main,
    "tags": tags_main,
    "training": training.main,
}
CANARY: Final = "CANARY"
"""File that code in a forged file creates."""
MODULE: Final = "forged_module"
JUNK: Final[tuple[str, ...]] = (
    *("null", "true", "-1", "0", "1.5", str(2**40), str(2**70), "1" + "0" * 400, "1e999", "NaN", '""', '"x"', "[]", "{}", "[1]"),
    *('[[1, "a"], null]', '{"a": {"b": []}}', "[" * 50_000, "[" * 5_000 + "]" * 5_000, json.dumps("a" * 10**6)),
    *(json.dumps(f"{prefix}program:touch {CANARY}") for prefix in ("", "best-response:")),
    *(json.dumps(f"{prefix}{MODULE}:attribute") for prefix in ("", "best-response:")),
    *(
        json.dumps(name)
        for name in ("table:/dev/zero", "agent:../../x", "../../../etc/passwd", "/dev/zero", "\x1b]0;x\x07", "\0")
    ),
    *(json.dumps([name]) for name in (f"program:touch {CANARY}", f"{MODULE}:attribute", "bc", "random")),
)
"""JSON texts that replace a value."""
MEBIBYTE: Final = 1 << 20
_dumps: Final = json.dumps
"""``main`` has an option of the name ``json``."""
TRAINING: Final = (
    "ppo --batch 64 --growth 0 --width 4 --evaluate-every 1 --checkpoint-every 1 --record all --strokes 256 --opponent bc "
    "--game model --out run"
)
LEAGUE_TRAINING: Final = (
    "train --strokes 1500 --rounds 2 --batch 256 --width 8 --workers 1 --pool attacking safe --game model --out run"
)


@dataclasses.dataclass(frozen=True)
class Format:
    """Files of a format, and the commands that read them.

    Attributes:
        files: glob patterns of the files to change.
        commands: command lines; each case uses one of them.
        checked: whether the files have checksums, so that damage must be refused or change nothing.
        results: glob patterns of files that hold the result, besides JSON on standard output.
    """

    files: tuple[str, ...]
    commands: tuple[str, ...]
    checked: bool = True
    results: tuple[str, ...] = ()


LOG: Final = Format(
    ("rallies.mcap",),
    (
        "recording check rallies.mcap --game model",
        "recording info rallies.mcap --json",
        "recording show rallies.mcap --match 0",
        "recording export rallies.mcap out.csv",
        "recording export rallies.mcap out.csv --rows strokes",
        "recording recover rallies.mcap --out recovered.mcap",
        "recording scene rallies.mcap --rally 0 --out scene.mcap --game model",
        "analysis rallies.mcap --rallies 50 --game model --json",
        "report rallies.mcap --match 0 --game model --json",
    ),
    results=("out.csv",),
)
FORMATS: Final[dict[str, Format]] = {
    "log": LOG,
    "log_training": LOG,
    "tournament": Format(
        ("config.json", "manifest.json", "pairings.jsonl", "report.json", "rallies.mcap", "results.parquet"),
        ("league --pool bc random attacking --matches 4 --game model --out . --resume", "league report . --out out.html"),
        results=("ranking.csv",),
    ),
    "training": Format(
        ("run/*.json", "run/*.jsonl", "run/*.mcap", "run/checkpoints/*/*", "run/best/*"),
        (f"training {TRAINING} --resume",),
        results=("run/agent/network.safetensors",),
    ),
    "league_training": Format(
        ("run/*.json", "run/*.jsonl", "run/learners/*", "run/tables/*"),
        (f"league {LEAGUE_TRAINING} --resume",),
        results=("run/main.safetensors",),
    ),
    "suite": Format(
        ("run/*.json", "run/*/*"),
        ("suite verify run --game model", "suite board run --game model --out board.md"),
        results=("board.md",),
    ),
    "agent": Format(("agent/*",), ("exact evaluate agent:agent --game model --json",)),
    "table": Format(("main.safetensors",), ("exact evaluate table:main.safetensors --game model --json",)),
    "model": Format(
        ("model/*.safetensors", "model/card.json"),
        (
            "exact solve --game model --json",
            "dynamics card --model model",
            "exact evaluate bc --game model --json",
            "scout viktor-axelsen --game model --json",
        ),
    ),
    "weights": Format(("mine.safetensors",), ("exact evaluate torch:mine.safetensors --game model --json",), checked=False),
    "csv": Format(
        ("strokes.csv", "columns.toml"), ("data import strokes.csv --columns columns.toml --out out.parquet",), checked=False
    ),
    "sportscode": Format(("file.xml",), ("data import file.xml --json", "data validate file.xml --json"), checked=False),
    "tags": Format(("match.inputs.jsonl", "match.csv"), ("tags match.mp4 match.csv",), checked=False),
    "parquet_types": Format(("strokes.parquet",), ("data summary strokes.parquet --json", "data validate strokes.parquet")),
    "parquet": Format(
        ("strokes.parquet",),
        (
            "data summary strokes.parquet --json",
            "data validate strokes.parquet",
            "analysis strokes.parquet --game model --json",
            "report strokes.parquet --game model --json",
        ),
    ),
}


@dataclasses.dataclass(frozen=True)
class Outcome:
    """Result of a command: ``status`` None after a timeout, memory in MB, and what it computed."""

    status: int | None
    error: str
    memory: float
    result: frozenset[str]


def build(root: Path) -> None:
    """Write valid files of every format, one folder each."""
    model = Path(reduced_model())
    for name in FORMATS:
        (root / name).mkdir()
        if name not in ("csv", "tags", "sportscode"):
            (root / name / "model").symlink_to(model) if name != "model" else shutil.copytree(model, root / name / "model")

    def run(name: str, *commands: str) -> None:
        for command in commands:
            outcome = execute(command, root / name, root / name / ".log", seconds=300, results=())
            assert outcome.status == 0, f"{command}: {outcome.error}"

    run("tournament", "league --pool bc random attacking --matches 4 --game model --out run")
    for path in (root / "tournament" / "run").iterdir():
        path.rename(root / "tournament" / path.name)
    (root / "tournament" / "run").rmdir()
    shutil.copy(root / "tournament" / "rallies.mcap", root / "log")
    run("training", f"training {TRAINING}")
    shutil.copy(root / "training" / "run" / "rallies.mcap", root / "log_training")
    shutil.copytree(root / "training" / "run" / "agent", root / "agent" / "agent")
    shutil.rmtree(max((root / "training" / "run" / "checkpoints").iterdir()))
    unfinished(root / "training" / "run")
    unfinished(root / "tournament")
    league_run = root / "league_training" / "run"
    child = spawn(f"league {LEAGUE_TRAINING}", league_run.parent)
    wait_until(lambda: (league_run / "league.json").exists() and _round(league_run) >= 1, 120, "the first round of the league")
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    shutil.copytree(league_run, root / "table" / "run")
    run("table", f"league {LEAGUE_TRAINING} --resume")
    shutil.copy(root / "table" / "run" / "main.safetensors", root / "table")
    shutil.rmtree(root / "table" / "run")
    (root / "suite" / "card.json").write_text('{"author": "alice"}')
    run("suite", "suite run exploit-v1 --method bc --quick --game model --out run")
    foreign(root)
    run("csv", "data template --out template")
    for path in (root / "csv" / "template").iterdir():
        path.rename(root / "csv" / path.name)
    run("csv", "data import strokes.csv --columns columns.toml --out out.parquet")
    shutil.copy(root / "csv" / "out.parquet", root / "parquet_types" / "strokes.parquet")
    (root / "csv" / "out.parquet").rename(root / "parquet" / "strokes.parquet")
    samples = Path(__file__).parents[1] / "data" / "cases" / "samples_of_each_format"
    shutil.copy(samples / "sportscode.xml", root / "sportscode" / "file.xml")
    (root / "tags" / "match.mp4").write_bytes(bytes(1000))
    run("tags", *["tags match.mp4 match.csv"] * 3)


def _round(folder: Path) -> int:
    """Finished rounds of a league."""
    rounds: int = json.loads((folder / "league.json").read_text())["round"]
    return rounds


def unfinished(folder: Path) -> None:
    """Mark a run as running."""
    manifest = json.loads((folder / "manifest.json").read_text())
    (folder / "manifest.json").write_text(json.dumps({**manifest, "status": "running"}))


def foreign(root: Path) -> None:
    """Write networks of PyTorch and Stable-Baselines3."""
    from shuttle_marl.game.shipped import load_game
    from shuttle_marl.policy import save_network

    strokes = load_game(reduced_model()).n_strokes
    torch.manual_seed(0)
    layers = torch.nn.Sequential(torch.nn.Linear(RALLY_WIDTH, 8), torch.nn.Tanh(), torch.nn.Linear(8, strokes))
    save_network(layers, root / "weights" / "mine.safetensors")


def spawn(command: str, folder: Path, log: Path | None = None, results: Sequence[str] = ()) -> int:
    """Run a command in a fork of this process, in a session and a folder of its own; returns the process number."""
    sys.stdout.flush()
    child = os.fork()
    if child:
        return child
    status = 70
    try:
        os.setsid()
        os.chdir(folder)
        output = os.open(os.devnull if log is None else log.with_suffix(".out"), os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        error = os.open(os.devnull if log is None else log.with_suffix(".err"), os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        os.dup2(output, 1)
        os.dup2(error, 2)
        resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 30, 1 << 30))
        os.fsync = lambda fd: None  # speed: a fork of this process reads what is written
        name, *arguments = command.split()
        try:
            status = MAIN[name](arguments)
        except SystemExit as exit_:
            status = exit_.code if isinstance(exit_.code, int) else 1
        sys.stdout.flush()
        if status == 0 and log is not None:
            log.with_suffix(".result").write_text("\n".join(result_lines(folder, log.with_suffix(".out"), results)))
    except BaseException:
        import traceback

        os.write(2, traceback.format_exc().encode(errors="replace"))
        status = 70
    finally:
        os._exit(status)


def result_lines(folder: Path, output: Path, results: Sequence[str]) -> Iterator[str]:
    """What a command computed, as lines: its JSON without times, the hashes of its files, and the strokes of a recovered log."""
    text = output.read_text(errors="replace")
    if text.startswith(("{", "[")):
        yield json.dumps(without_times(json.loads(text)), sort_keys=True)
    for pattern in results:
        for path in sorted(folder.glob(pattern)):
            yield f"{path.name} {hashlib.sha256(path.read_bytes()).hexdigest()}"
    if (folder / "recovered.mcap").exists():
        from shuttle_marl.recording import RallyLog

        with RallyLog(folder / "recovered.mcap") as log:
            for first, batch in log.batches():
                for i in range(len(batch)):
                    rally = batch.slice(i, i + 1)
                    yield f"rally {first + i} {rally.stroke.tolist()} {rally.policy.tolist()} {rally.winner.tolist()}"


def without_times(value: Any) -> Any:
    """JSON without measured times."""
    if isinstance(value, dict):
        return {name: without_times(part) for name, part in value.items() if "second" not in name}
    return [without_times(part) for part in value] if isinstance(value, list) else value


def execute(command: str, folder: Path, log: Path, *, seconds: float, results: Sequence[str]) -> Outcome:
    """Run a command to its end, or for some seconds."""
    child = spawn(command, folder, log, results)
    handle, poll = os.pidfd_open(child), select.poll()
    poll.register(handle, select.POLLIN)
    in_time = bool(poll.poll(1000 * seconds))
    os.close(handle)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)  # the command, if it hangs, and programs that it left behind
    _, status, usage = os.wait4(child, 0)
    error, lines = "no exit in time", frozenset[str]()
    if in_time:
        error, result = (
            path.read_text(errors="replace") if path.exists() else "" for path in map(log.with_suffix, (".err", ".result"))
        )
        lines = frozenset(result.splitlines())
    for suffix in (".out", ".err", ".result"):
        log.with_suffix(suffix).unlink(missing_ok=True)
    return Outcome(os.waitstatus_to_exitcode(status) if in_time else None, error, usage.ru_maxrss / 1024, lines)


def change(path: Path, rng: random.Random, logs: Path) -> str:
    """Damage or forge a file; returns the kind of change."""
    kinds: list[Callable[[Path, random.Random], None]] = [damage, damage]
    match path.suffix:
        case ".json" | ".jsonl":
            kinds += [forge_json] * 4
        case ".mcap":
            kinds += [lambda path, rng: forge_log(path, rng, logs)] * 2
        case ".safetensors":
            kinds += [forge_safetensors] * 2
        case ".parquet":
            kinds += [forge_parquet, forge_types] * 2
        case ".xml":
            kinds += [forge_text] * 4
        case ".csv" | ".toml":
            kinds += [forge_text] * 3
    kind = rng.choice(kinds) if rng.random() < 0.97 else replace_file
    before = hashlib.sha256(path.read_bytes()).hexdigest()
    kind(path, rng)
    if kind is damage:
        return "damage"
    if path.is_file() and not path.is_symlink() and path.stat().st_size < MEBIBYTE << 5:
        update_checksums(path, before)
    return "forgery"


def damage(path: Path, rng: random.Random) -> None:
    """Change bytes, as a faulty disk or an interrupted copy does."""
    path.write_bytes(mutated(path.read_bytes(), np.random.default_rng(rng.getrandbits(64))))


def replace_file(path: Path, rng: random.Random) -> None:
    """Replace a file by something else, or remove it."""
    path.unlink()
    match rng.randrange(6):
        case 0:
            os.mkfifo(path)
        case 1:
            path.symlink_to("/dev/zero")
        case 2:
            path.mkdir()
        case 3:
            path.write_bytes(b"")
        case 4:
            with path.open("wb") as file:
                file.truncate(1 << 40)
        case _:
            pass


_MOST_JSON = 1 << 26
"""Size of the largest JSON file whose checksums are updated [bytes]; another mutation may have made it larger."""


def update_checksums(path: Path, before: str) -> None:
    """Write the hash of a forged file into the JSON files beside it, and seal those again."""
    after = hashlib.sha256(path.read_bytes()).hexdigest()
    for other in path.parent.glob("*.json"):
        readable = other != path and other.is_file() and not other.is_symlink() and other.stat().st_size <= _MOST_JSON
        if readable and before in (text := other.read_text(errors="replace")):
            other.write_bytes(sealed(text.replace(before, after).encode()))


def sealed(content: bytes) -> bytes:
    """A JSON object with a valid checksum, if it had one."""
    try:
        fields = json.loads(content)
    except (ValueError, RecursionError):
        return content
    if isinstance(fields, dict) and "checksum" in fields:
        del fields["checksum"]
        return seal(fields)
    return content


def forge_json(path: Path, rng: random.Random) -> None:
    """Replace or remove one to three values of a JSON file, or of a line of a file of JSON lines."""
    lines = path.read_text().splitlines() if path.suffix == ".jsonl" else [path.read_text()]
    if not lines:
        path.write_text(rng.choice(JUNK))
        return
    number = rng.randrange(len(lines))
    lines[number] = forged_json(lines[number], rng)
    text = "\n".join(lines) + "\n"
    path.write_bytes(
        sealed(text.encode(errors="surrogatepass")) if path.suffix == ".json" else text.encode(errors="surrogatepass")
    )


def forged_json(text: str, rng: random.Random) -> str:
    """JSON with one to three values replaced or removed."""
    if rng.random() < 0.05:
        return rng.choice(JUNK)
    fields = json.loads(text)
    junk = {}
    for i in range(rng.randint(1, 3)):
        places = [place for place in _places(fields) if place[1] != "checksum"]
        if not places:
            break
        container, key = rng.choice(places)
        if rng.random() < 0.15:
            del container[key]
        else:
            # Junk need not be valid JSON, so it is inserted into the text.
            container[key] = mark = f"\x00junk-{i}\x00"
            junk[json.dumps(mark)] = rng.choice(JUNK)
    text = json.dumps(fields)
    for mark, value in junk.items():
        text = text.replace(mark, value)
    return text


def _places(value: Any) -> Iterator[tuple[Any, Any]]:
    """Every container in a JSON value with every key of it."""
    if isinstance(value, dict | list):
        for key, part in list(value.items()) if isinstance(value, dict) else list(enumerate(value)):
            yield value, key
            yield from _places(part)


def forge_log(path: Path, rng: random.Random, folder: Path) -> None:
    """A log with valid checksums and a wrong header, index or message, or one whose content expands to gigabytes."""
    folder.mkdir(exist_ok=True)
    mutator = Mutator(folder, rng.getrandbits(32))
    mutator.make(rng.choice(("message", "index", "head", "bomb", "zeros", "names")))
    shutil.copy(mutator.path, path)


def forge_safetensors(path: Path, rng: random.Random) -> None:
    """Change the header or numbers of a file of tensors."""
    content = path.read_bytes()
    size = int.from_bytes(content[:8], "little")
    header, body = content[8 : 8 + size].decode(), bytearray(content[8 + size :])
    if rng.random() < 0.5:
        header = forged_json(header, rng)
    else:
        for _ in range(rng.randint(1, 4)):
            at = rng.randrange(max(1, len(body) - 8))
            body[at : at + 4] = rng.choice((b"\xff\xff\xff\xff", b"\x00\x00\xc0\x7f", b"\x00\x00\x80\xff", rng.randbytes(4)))
    encoded = header.encode(errors="surrogatepass")
    path.write_bytes(len(encoded).to_bytes(8, "little") + encoded + bytes(body))


def forge_parquet(path: Path, rng: random.Random) -> None:
    """A sealed table with other columns, types or values."""
    table = pq.read_table(path)
    at = rng.randrange(table.num_columns)
    field, column = table.schema.field(at), table.column(at)
    others: list[pa.Array] = [
        pa.nulls(table.num_rows, field.type),
        pa.array([2**62] * table.num_rows),
        pa.array([-1] * table.num_rows, pa.int16()),
        pa.array([float("nan")] * table.num_rows),
        pa.array(["x" * rng.choice((1, 10**4))] * min(table.num_rows, 100) + [""] * max(0, table.num_rows - 100)),
        pa.array([[1]] * table.num_rows),
    ]
    match rng.randrange(4):
        case 0:
            table = table.remove_column(at)
        case 1:
            table = table.set_column(at, field.name, rng.choice(others))
        case 2:
            values = column.to_pylist()
            values[rng.randrange(len(values))] = rng.choice(values)
            table = table.set_column(at, field, pa.array(values, field.type))
        case _:
            metadata = dict(table.schema.metadata or {})
            if metadata:
                name = rng.choice(list(metadata))
                metadata[name] = rng.choice(JUNK).encode()
            table = table.replace_schema_metadata(metadata)
    buffer = io.BytesIO()
    pq.write_table(table, buffer)
    seal_parquet(buffer)
    path.write_bytes(buffer.getvalue())


def forge_types(path: Path, rng: random.Random) -> None:
    """Replace a column by one of any type: of few bytes in the file, and up to gigabytes in memory."""
    table, count = pq.read_table(path), rng.choice((1, 1000, 100_000))
    zeros, size = pa.array(np.zeros(count, np.int8)), rng.choice((1, 10**4, 10**6))
    kinds: list[Callable[[], pa.Array]] = [
        lambda: pa.DictionaryArray.from_arrays(zeros, pa.array([b"x" * size])),
        lambda: pa.DictionaryArray.from_arrays(zeros, pa.array(["x" * size])),
        lambda: pa.ListArray.from_arrays(pa.array([0, *[count] * len(table)], pa.int32()), zeros),
        lambda: pa.FixedSizeListArray.from_arrays(zeros, 1),
        lambda: pa.StructArray.from_arrays([zeros] * 40, [str(i) for i in range(40)]),
        lambda: pa.array([[("a", 1)]] * count, pa.map_(pa.string(), pa.int8())),
        lambda: (
            pa.array([1.5] * count, pa.float16()) if hasattr(pa, "float16") and count == 1 else zeros.cast(pa.decimal128(38, 2))
        ),
        lambda: pa.nulls(count),
        lambda: zeros.cast(pa.int64()).cast(pa.timestamp("ns")),
        lambda: zeros.cast(pa.bool_()),
        lambda: pa.array([b"x" * 16] * count, pa.binary(16)),
        lambda: pa.array(["x"] * count, pa.large_string()),
    ]
    column = rng.choice(kinds)()
    table = (
        pa.table({rng.choice(table.column_names): column}) if len(column) != len(table) else table.set_column(0, "match", column)
    )
    buffer = io.BytesIO()
    # Without its dictionary, a column of long equal values is larger than Arrow can write.
    packed = rng.random() < 0.7 or pa.types.is_dictionary(column.type)
    pq.write_table(table, buffer, compression="zstd", store_schema=rng.random() < 0.5, use_dictionary=packed)
    seal_parquet(buffer)
    path.write_bytes(buffer.getvalue())


def forge_text(path: Path, rng: random.Random) -> None:
    """Replace, repeat or remove words of a text file."""
    words = [
        *(json.loads(text) for text in JUNK[4:10:5]),
        "",
        "nan",
        "1e999",
        "-1",
        '"',
        "\x00",
        "=cmd|' /C calc'!A0",
        "٣",
        "2" * 400,
    ]
    lines = path.read_text().splitlines()
    separator = {".csv": ",", ".toml": "="}.get(path.suffix, rng.choice(("><", '"', ">")))
    for _ in range(rng.randint(1, 5)):
        number = rng.randrange(len(lines))
        cells = lines[number].split(separator)
        cells[rng.randrange(len(cells))] = str(rng.choice(words))
        lines[number] = separator.join(cells)
        if rng.random() < 0.2:
            lines.insert(number, rng.choice(("", lines[number], "x" * 10**5, separator * 300)))
    path.write_text("\n".join(lines))


Expected = dict[tuple[str, str], frozenset[str]]
"""Results of unchanged files, by format and command."""


def fuzz(
    n: int, seed: int, formats: Sequence[str], root: Path, *, timeout: float, jobs: int, keep: Path | None
) -> dict[str, Any]:
    """Run cases and count their outcomes; see the module for the keys."""
    build(root)
    expected: Expected = {}
    for name in formats:
        for command in FORMATS[name].commands:
            folder = root / "case"
            shutil.copytree(root / name, folder, symlinks=True)
            outcome = execute(command, folder, folder / ".log", seconds=300, results=FORMATS[name].results)
            assert outcome.status == 0, f"{name}: {command}: {outcome.error}"
            expected[name, command] = outcome.result
            shutil.rmtree(folder)
    counts: dict[str, Counter[str]] = {name: Counter() for name in formats}
    peak = 0.0
    run = functools.partial(run_case, seed=seed, formats=formats, root=root, expected=expected, timeout=timeout, keep=keep)
    # With more threads, OpenMP would wait for those of the parent, which a fork does not have.
    with multiprocessing.get_context("fork").Pool(jobs, torch.set_num_threads, (1,)) as pool:
        for name, verdicts, memory in pool.imap_unordered(run, range(n)):
            counts[name].update(["tried", *verdicts])
            peak = max(peak, memory)
    keys = ("tried", "refused", "accepted", "tracebacks", "hangs", "wrong", "code_run")
    total = {key: sum(count[key] for count in counts.values()) for key in keys}
    return {
        **total,
        "peak_mb": round(peak),
        "formats": {name: {key: count[key] for key in keys} for name, count in counts.items()},
    }


def _special(folder: str, names: list[str]) -> list[str]:
    """Names of files that cannot be copied."""
    paths = {name: Path(folder) / name for name in names}
    return [name for name, path in paths.items() if path.is_fifo() or (path.is_file() and path.stat().st_size > MEBIBYTE << 8)]


def run_case(
    number: int, *, seed: int, formats: Sequence[str], root: Path, expected: Expected, timeout: float, keep: Path | None
) -> tuple[str, list[str], float]:
    """Change files, and run a command on them; the format, the counts that the case adds to, and the memory [MB]."""
    rng, name = random.Random(f"{seed} {number}"), formats[number % len(formats)]
    format_, folder, log = FORMATS[name], root / f"case-{number}", root / f"log-{number}"
    shutil.copytree(root / name, folder, symlinks=True)
    (folder / f"{MODULE}.py").write_text(f"from pathlib import Path\nPath('{CANARY}').touch()\ndef attribute(states): ...\n")
    paths = sorted({path for pattern in format_.files for path in folder.glob(pattern) if path.is_file()})
    logs = root / f"log-{number}.logs"
    kinds = [change(path, rng, logs) for path in rng.sample(paths, min(len(paths), rng.choice((1, 1, 1, 2))))]
    kind, command = "forgery" if "forgery" in kinds else "damage", rng.choice(format_.commands)
    outcome = execute(command, folder, log, seconds=timeout, results=format_.results)
    verdicts = judge(outcome, expected[name, command], partial="recover" in command, checked=kind == "damage" and format_.checked)
    verdicts += ["code_run"] if list(folder.rglob(CANARY)) else []
    if {*verdicts} - {"accepted", "refused"}:
        print(f"case {number} of {name} ({kind}): {' '.join(verdicts)}: {command}", file=sys.stderr)
        print("\n".join(outcome.error.splitlines()[-3:])[:600], file=sys.stderr, flush=True)
        if keep is not None:
            shutil.copytree(folder, keep / str(number), symlinks=True, ignore=_special, dirs_exist_ok=True)
    shutil.rmtree(folder)
    shutil.rmtree(logs, ignore_errors=True)
    return name, verdicts, outcome.memory


def judge(outcome: Outcome, expected: frozenset[str], *, partial: bool, checked: bool) -> list[str]:
    """Names of the counts that an outcome adds to; a log that was recovered has a part of its rallies."""
    if outcome.status is None:
        return ["hangs"]
    if "Traceback (most recent call last)" in outcome.error or outcome.status not in (0, 1, 2):
        return ["tracebacks"]
    if outcome.status:
        return ["refused" if "error" in outcome.error or "usage" in outcome.error else "tracebacks"]
    equal = outcome.result <= expected if partial else outcome.result == expected
    return ["accepted", "wrong"] if checked and not equal else ["accepted"]


def main(
    n: int = 5000,
    seed: int = 0,
    formats: tuple[str, ...] = tuple(FORMATS),
    timeout: float = 30.0,
    jobs: int = 2,
    keep: Path | None = None,
    json: bool = False,
) -> None:
    """Fuzz the readers of all file formats.

    Args:
        n: number of cases, divided equally between the formats.
        seed: random seed.
        formats: formats to test.
        timeout: seconds after which a command hangs.
        jobs: number of processes.
        keep: folder for the files of failed cases.
        json: print the counts as JSON.
    """
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
        result = fuzz(n, seed, formats, Path(folder), timeout=timeout, jobs=jobs, keep=keep)
    print(_dumps(result) if json else "\n".join(f"{name}: {value}" for name, value in result.items()))
    failed = any(result[key] for key in ("tracebacks", "hangs", "wrong", "code_run"))
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    tyro.cli(main)
