"""Start-up and speed of the page of this checkout against those of a release.

    python -m benchmarks.against [RELEASE] [--repeat N] [--limit RATIO] [--json]

RELEASE is a commit or tag; without it, the newest tag. Both are measured in alternation, by the benchmarks of this checkout: CPU
time of imports and ``--help``, time to the first picture, and from a stroke to the first frame that moves. Ratios of the smallest
values are printed, and one above RATIO fails. Without a release there is nothing to compare.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Annotated, Any, Final

import tyro
from rich.console import Console

from shuttle_marl.base.errors import ShuttleError

_ROOT: Final = Path(__file__).parents[1]
_STARTUP: Final = ("python -c import shuttle_marl", "python -m shuttle_marl --help", "python -m shuttle_marl.league --help")
_PAGE: Final = ("first_picture_s", "turn_ms")


def _output(*command: str, cwd: Path) -> str:
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False)
    if done.returncode:
        raise ShuttleError(f"{' '.join(command)} in {cwd}: {done.stderr.strip()[-300:]}")
    return done.stdout


def measure(folder: Path) -> dict[str, float]:
    """Figures of the package in a folder, which has the benchmarks too."""

    def benchmark(name: str, *arguments: str) -> Any:
        return json.loads(_output(sys.executable, "-m", f"benchmarks.{name}", *arguments, "--json", cwd=folder))

    startup = {timing["command"]: timing["cpu_s"] for timing in benchmark("startup", "--repeat", "3")["commands"]}
    page = benchmark("viewer", "--quick")
    return {**{name: startup[name] for name in _STARTUP}, **{name: page[name] for name in _PAGE}}


def compare(before: Path, repeat: int) -> dict[str, float]:
    """Ratios of the figures of this checkout to those of another."""
    runs = [(measure(before), measure(_ROOT)) for _ in range(repeat)]
    return {name: round(min(new[name] for _, new in runs) / min(old[name] for old, _ in runs), 3) for name in runs[0][0]}


def main(
    release: tyro.conf.Positional[str | None] = None,
    *,
    repeat: int = 3,
    limit: float = 1.5,
    as_json: Annotated[bool, tyro.conf.arg(name="json")] = False,
) -> int:
    """Compare and print; 1 if a ratio is above the limit.

    Args:
        release: commit or tag; default: the newest tag.
        repeat: measurements of each checkout.
        limit: largest ratio.
        as_json: print JSON.
    """
    tags = _output("git", "tag", "--sort=-creatordate", cwd=_ROOT).split()
    if release is None and not tags:
        print("there is no release to compare with")
        return 0
    with tempfile.TemporaryDirectory() as folder:
        before = Path(folder) / "before"
        _output("git", "worktree", "add", "--detach", str(before), release or tags[0], cwd=_ROOT)
        try:
            release_folder = Path(folder) / "measured"
            release_folder.mkdir()
            (release_folder / "shuttle_marl").symlink_to(before / "shuttle_marl")
            (release_folder / "benchmarks").symlink_to(_ROOT / "benchmarks")
            ratios = compare(release_folder, repeat)
        finally:
            _output("git", "worktree", "remove", "--force", str(before), cwd=_ROOT)
    Console(soft_wrap=True).print(json.dumps(ratios) if as_json else "\n".join(f"{k}: {v}" for k, v in ratios.items()))
    return int(max(ratios.values()) > limit)


if __name__ == "__main__":
    sys.exit(tyro.cli(main))
