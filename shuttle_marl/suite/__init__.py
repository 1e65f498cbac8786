"""The benchmark suite: tasks with exact scores, methods, and runs whose scores anyone recomputes.

Names are imported when first used, because the solvers need numba.
"""

from typing import TYPE_CHECKING

from shuttle_marl.base.extras import lazily

if TYPE_CHECKING:
    from shuttle_marl.suite.exploit import Trained
    from shuttle_marl.suite.options import SuiteRun
    from shuttle_marl.suite.results import TASKS, find_task, verify_run
    from shuttle_marl.suite.run import run_method
    from shuttle_marl.suite.task import Task

__all__ = ["TASKS", "SuiteRun", "Task", "Trained", "find_task", "run_method", "verify_run"]

__getattr__, __dir__ = lazily(__name__)
