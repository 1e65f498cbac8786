"""Limits of sizes, times and counts, and settings of learners: a change of one is a decision, so their list is written down."""

import ast
import dataclasses
import importlib
from pathlib import Path

import shuttle_marl
from shuttle_marl.data.schema import RANGES
from shuttle_marl.dynamics.boosting import PARAMETERS
from shuttle_marl.dynamics.network import QUICK, EnsembleConfig, NetworkSpec
from shuttle_marl.league import LeagueConfig
from shuttle_marl.training import A2CConfig, PPOConfig, SACConfig
from shuttle_marl.training.league.config import LeagueTrainingConfig
from shuttle_marl.training.q_learning import QConfig
from tests import golden

PACKAGE = Path(shuttle_marl.__file__).parent
NAMES = ("MAX", "MOST", "LEAST", "MIN", "LONGEST", "LIMIT")


def test_limits_are_those_that_somebody_decided() -> None:
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        module = ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts)
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.AnnAssign) and (name := ast.unparse(node.target)).lstrip("_").startswith(NAMES):
                found[f"{module}.{name}"] = getattr(importlib.import_module(module), name)
    assert len(found) > 100
    golden.check("limits", found | {"ranges of columns": RANGES})


def test_settings_of_learners_are_those_that_somebody_chose() -> None:
    settings = (PPOConfig, A2CConfig, SACConfig, QConfig, LeagueTrainingConfig, EnsembleConfig, NetworkSpec, LeagueConfig)
    found = {
        setting.__name__: {
            field.name: field.default
            for field in dataclasses.fields(setting)
            if isinstance(field.default, bool | int | float | str | tuple)
        }
        for setting in settings
    }
    golden.check("limits", found | {"trees": PARAMETERS, "quick": dataclasses.asdict(QUICK)})
