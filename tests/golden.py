"""Figures that tests compare with what was written down when somebody last looked at them.

``GOLDEN=write`` before ``pytest`` stores the figures of the tests that run; the difference shows what a change of code changed.
"""

import json
import math
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

FOLDER = Path(__file__).with_name("golden")


def check(name: str, figures: Mapping[str, Any], close: float = 1e-6) -> None:
    """Compare figures with those of ``golden/NAME.json``: numbers to a ten-thousandth or ``close``, other values exactly."""
    found, path = _plain(dict(figures)), FOLDER / f"{name}.json"
    written = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    if os.environ.get("GOLDEN") == "write":
        rows = (f"{json.dumps(key)}: {json.dumps(value, ensure_ascii=False)}" for key, value in sorted((written | found).items()))
        path.write_text("{\n" + ",\n".join(rows) + "\n}\n", encoding="utf-8")
    elif missing := found.keys() - written.keys():
        pytest.fail(f"{path.name} lacks {', '.join(sorted(missing))}: write it with GOLDEN=write, and look at the difference")
    elif different := [*_differences({key: written[key] for key in found}, found, name, close)]:
        pytest.fail("\n".join(different[:10]))


def weighted_sum(values: Any) -> Any:
    """Sum along the first axis with random weights: what changes anywhere changes it."""
    found = np.asarray(values)
    return np.tensordot(np.random.default_rng(0).normal(size=len(found)), found, 1)


def drawing(svg: str) -> list[Any]:
    """Numbers and colours of a drawing."""
    numbers = np.array([float(x) for x in re.findall(r"(?<![\w#.-])-?\d+\.?\d*(?![\w.-])", svg)])
    return [len(numbers), weighted_sum(numbers), sorted(set(re.findall("#[0-9a-f]{6}\\b", svg)))]


def _plain(value: Any) -> Any:
    """A value of JSON with floats of six digits."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): _plain(each) for key, each in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_plain(each) for each in value]
    return float(f"{value:.6g}") + 0.0 if isinstance(value, float) and math.isfinite(value) else value


def _differences(written: Any, found: Any, where: str, close: float) -> Iterator[str]:
    if isinstance(written, dict) and isinstance(found, dict) and written.keys() == found.keys():
        for key, value in written.items():
            yield from _differences(value, found[key], f"{where}.{key}", close)
    elif isinstance(written, list) and isinstance(found, list) and len(written) == len(found):
        for number, (before, after) in enumerate(zip(written, found, strict=True)):
            yield from _differences(before, after, f"{where}[{number}]", close)
    elif written != (pytest.approx(found, rel=1e-4, abs=close, nan_ok=True) if isinstance(found, float) else found):
        yield f"{where}: {written!r} before, now {found!r}"
