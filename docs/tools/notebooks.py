"""Executes tutorials as notebooks for the site: ``python -m docs.tools.notebooks [NAME …]``.

The pages in ``docs/tutorials/`` are their own text form (jupytext): ``python`` blocks become cells of Python, ``bash run`` blocks
cells of a shell, in one folder. The site shows the notebooks in ``docs/notebooks/``, which git ignores, if there are any.
"""

import os
import re
import sys
import sysconfig
import tempfile
from pathlib import Path
from typing import Annotated, Final

import tyro

from docs.tools.markdown import ROOT
from docs.tools.site import NOTEBOOKS
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.commands import cli

NAMES: Final = ("five_minutes", "solved", "own_loop")  # tutorials that the site shows as notebooks
_LIMIT: Final = 1200  # time limit of a cell [s]
_DOWNLOAD: Final = (
    "[Download](<path:{}.ipynb>) this notebook to run it in Jupyter, or upload it to Colab; its first cell installs the package."
)
_FILE: Final = re.compile(r"^```python\n# (\w+\.py)\n", re.MULTILINE)


def text_form(name: str) -> str:
    """A tutorial as jupytext reads it.

    Links are relative to the folder of the notebooks, and a block that is saved as a file writes it.

    Raises:
        ShuttleError: there is no such tutorial.
    """
    path = ROOT / "docs" / "tutorials" / f"{name}.md"
    if not path.is_file():
        raise ShuttleError(f"no tutorial {name!r}; there are {', '.join(NAMES)}")
    text = path.read_text(encoding="utf-8").replace("```bash run\n", "```bash\n")
    text = _FILE.sub(lambda match: f"```python\n%%writefile {match[1]}\n", text)
    text = re.sub(r"\]\((?!https?:|#|\.\./)([^)]+\.md)", r"](../tutorials/\1", text)
    return f"---\njupyter:\n  kernelspec:\n    display_name: Python 3\n    language: python\n    name: python3\n---\n\n{text}"


def main(names: Annotated[tuple[str, ...], tyro.conf.Positional] = NAMES) -> None:
    """Execute tutorials.

    Args:
        names: of the tutorials.
    """
    import jupytext  # noqa: PLC0415  the extra notebooks is only needed here
    from nbclient import NotebookClient  # noqa: PLC0415
    from nbformat.v4 import new_code_cell, new_markdown_cell  # noqa: PLC0415

    # Cells of a shell find the programs of this environment.
    os.environ["PATH"] = f"{sysconfig.get_path('scripts')}{os.pathsep}{os.environ['PATH']}"
    # The kernel sets FORCE_COLOR, with which they would print control codes of a terminal.
    os.environ["TTY_COMPATIBLE"] = "0"
    os.environ["COLUMNS"] = "100"
    NOTEBOOKS.mkdir(parents=True, exist_ok=True)
    for name in names:
        notebook = jupytext.reads(text_form(name), fmt="md")
        if name == "own_loop":  # run as a program, as the page says
            place = next(i for i, cell in enumerate(notebook.cells) if cell.source.startswith("%%writefile own_loop.py"))
            notebook.cells.insert(place + 1, jupytext.reads("```python\n%%bash\npython own_loop.py\n```\n", fmt="md").cells[0])
        with tempfile.TemporaryDirectory(prefix="notebook-") as folder:
            resources = {"metadata": {"path": folder}}
            NotebookClient(notebook, timeout=_LIMIT, resources=resources, coalesce_streams=True).execute()
        for cell in notebook.cells:
            if cell.cell_type == "code":  # progress that is not shown leaves empty lines
                cell.outputs = [output for output in cell.outputs if output.get("text", "-").strip()]
        # Not executed here: the package is installed.
        title, _, notebook.cells[0].source = notebook.cells[0].source.partition("\n\n")
        introduction = f"{title} (notebook)\n\n{_DOWNLOAD.format(name)}"
        notebook.cells[:0] = [new_markdown_cell(introduction), new_code_cell("%pip install -q 'shuttle-marl[train]'")]
        jupytext.write(notebook, Path(NOTEBOOKS / f"{name}.ipynb"))
        sys.stdout.write(f"{name}: {sum(cell.cell_type == 'code' for cell in notebook.cells)} cells\n")


if __name__ == "__main__":
    sys.exit(cli.run(main, prog="python -m docs.tools.notebooks", description="Execute the tutorials as notebooks."))
