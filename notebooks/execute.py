"""Execute notebooks and store them with their outputs: ``python notebooks/execute.py [NOTEBOOK…]``."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import nbformat
from jupyter_client.manager import KernelManager
from nbclient import NotebookClient

HERE = Path(__file__).parent

FORGET = """%reset -f
import os
import matplotlib.pyplot
os.chdir({folder!r})
matplotlib.pyplot.close("all")
matplotlib.rcdefaults()"""

QUIET = """import warnings
warnings.filterwarnings("ignore", message="not used by")"""
"""Simulated tracks have all channels, also those that a model does not use: notes on these are left out."""


def execute(path: Path, folder: Path, kernel: KernelManager | None = None) -> nbformat.NotebookNode:
    """The notebook at ``path`` with fresh outputs, run in ``folder``; the first error in a cell is raised.

    With a ``kernel`` that is running already its names are forgotten first.
    """
    notebook = nbformat.read(path, as_version=4)
    begin = QUIET if kernel is None else FORGET.format(folder=str(folder)) + "\n" + QUIET
    notebook.cells.insert(0, nbformat.v4.new_code_cell(begin))
    client = NotebookClient(
        notebook,
        timeout=600,
        km=kernel,
        kernel_name="python3",
        record_timing=False,
        resources={"metadata": {"path": str(folder)}},
    )
    client.execute()
    del notebook.cells[0]
    # Output that differs between machines and is of no use to a reader.
    notebook.metadata.pop("language_info", None)
    count = 0
    for cell in notebook.cells:
        if cell.cell_type == "code":
            count += 1
            cell.execution_count = count
            cell.outputs = [output for output in cell.outputs if not tells_of_compiling(output)]
            for output in cell.outputs:
                if "execution_count" in output:
                    output.execution_count = count
    return notebook


def tells_of_compiling(output: nbformat.NotebookNode) -> bool:
    """Return True for an output that only the first run on a machine has."""
    lines = output.get("text", "").splitlines() if output.get("name") == "stderr" else []
    return bool(lines) and all(line.startswith(("compiling ", "compiled in ")) for line in lines)


def main() -> None:
    """Execute the notebooks named on the command line, or all."""
    for path in [Path(name) for name in sys.argv[1:]] or sorted(HERE.glob("*.ipynb")):
        with tempfile.TemporaryDirectory() as folder:
            notebook = execute(path, Path(folder))
        nbformat.write(notebook, path)
        print(f"{path.name}: {path.stat().st_size / 1024:.0f} KiB")


if __name__ == "__main__":
    main()
