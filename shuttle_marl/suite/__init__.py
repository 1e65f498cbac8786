"""The benchmark suite: tasks with exact scores, methods, runs whose scores anyone recomputes, rounds that rerun committed code.

Names are imported when first used, because the solvers need numba.
"""

from typing import TYPE_CHECKING

from shuttle_marl.base.lazy import lazily

if TYPE_CHECKING:
    from shuttle_marl.suite.exploit import PlayerSetting, Trained
    from shuttle_marl.suite.options import RerunOptions, Resources, SuiteError, SuiteRun, VerifyOptions
    from shuttle_marl.suite.registry import TASKS, find_task
    from shuttle_marl.suite.results import difference, summarise, verify_run
    from shuttle_marl.suite.run import commit, draw_round, rerun, run_method
    from shuttle_marl.suite.task import Task

__all__ = [
    "TASKS",
    "PlayerSetting",
    "RerunOptions",
    "Resources",
    "SuiteError",
    "SuiteRun",
    "Task",
    "Trained",
    "VerifyOptions",
    "commit",
    "difference",
    "draw_round",
    "find_task",
    "rerun",
    "run_method",
    "summarise",
    "verify_run",
]

__getattr__, __dir__ = lazily(__name__)
