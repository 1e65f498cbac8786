"""Description of the machine, for the results of every benchmark."""

import os
import platform
from typing import Any


def this_machine() -> dict[str, Any]:
    """Python version, architecture and number of cores available to this process."""
    return {"python": platform.python_version(), "machine": platform.machine(), "cores": os.cpu_count()}


def machine(result: dict[str, Any]) -> str:
    """Description of the machine of a result."""
    return f"Python {result['python']}, {result['machine']}, {result['cores']} cores."
