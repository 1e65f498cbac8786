"""Description of the machine, for the results of every benchmark."""

import os
import platform
from typing import Any


def this_machine() -> dict[str, Any]:
    """Python, kind of machine and number of cores of this process."""
    return {"python": platform.python_version(), "machine": platform.machine(), "cores": os.cpu_count()}


def machine(result: dict[str, Any]) -> str:
    """The machine of a result, in words."""
    return f"Python {result['python']}, {result['machine']}, {result['cores']} cores."
