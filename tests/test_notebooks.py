"""The notebooks run without an error, and are stored with outputs that name no machine."""

import json
import re
import runpy
from pathlib import Path

import nbformat
import pytest
from jupyter_client.manager import KernelManager

FOLDER = Path(__file__).resolve().parents[1] / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))

MACHINE_PATH = re.compile(r"(?<![\w.])/(?:home|root|tmp|work|usr|opt|Users|var)/|site-packages|[A-Z]:\\\\")
LARGEST = 400_000


every_notebook = pytest.mark.parametrize("path", NOTEBOOKS, ids=[path.stem for path in NOTEBOOKS])


def code_cells(notebook):
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def test_the_first_output_is_the_tracks_in_a_line_and_a_table():
    cells = code_cells(nbformat.read(FOLDER / "01-smoothing.ipynb", as_version=4))
    shown = next(output.data for cell in cells for output in cell.outputs if "data" in output)
    assert (FOLDER / "02-online.ipynb") in NOTEBOOKS
    assert shown["text/plain"].startswith("TrackSet(6 tracks, 1440 person-frames, ")
    assert shown["text/html"].startswith("<table>")


def test_what_the_first_run_on_a_machine_says_is_not_stored():
    tells = runpy.run_path(str(FOLDER / "execute.py"))["tells_of_compiling"]
    said = "compiling the solver, once on this machine: from 60 s on …\ncompiled in 58 s\n"
    outputs = [("stderr", said), ("stdout", said), ("stderr", "UserWarning\n" + said)]
    made = [nbformat.v4.new_output("stream", name=name, text=text) for name, text in outputs]
    assert [tells(output) for output in made] == [True, False, False]


@pytest.fixture(scope="session")
def kernel():
    """One for all notebooks: to start it takes as long as many of their cells."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("GRAPHTRACK_QUICK", "1")
        manager = KernelManager(kernel_name="python3")
        manager.start_kernel()
    yield manager
    manager.shutdown_kernel(now=True)


@every_notebook
def test_a_notebook_runs_without_error(path, tmp_path, kernel):
    execute = runpy.run_path(str(FOLDER / "execute.py"))["execute"]
    notebook = execute(path, tmp_path, kernel)  # raises for the first cell that fails
    outputs = [output for cell in code_cells(notebook) for output in cell.outputs]
    assert not [output for output in outputs if output.output_type == "error"]
    # A warning would be the first thing that a reader sees.
    assert not [output.text for output in outputs if output.get("name") == "stderr"]


@every_notebook
def test_a_stored_notebook_has_its_outputs_and_no_path_of_a_machine(path):
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    counts = [cell.execution_count for cell in code_cells(notebook)]
    assert counts == list(range(1, len(counts) + 1)), "run all cells in order: make notebooks"
    outputs = [output for cell in code_cells(notebook) for output in cell.outputs]
    assert not [output for output in outputs if output.output_type == "error"]
    assert any("image/png" in output.get("data", {}) for output in outputs)
    # Pictures are base64, in which anything may stand.
    text = [[cell.source, cell.get("metadata")] for cell in notebook.cells]
    text += [[o.get("text"), o.get("traceback"), o.get("metadata")] for o in outputs]
    text += [[words for kind, words in o.get("data", {}).items() if "image" not in kind] for o in outputs]
    found = MACHINE_PATH.search(json.dumps([text, notebook.metadata]))
    assert found is None, found
    assert path.stat().st_size < LARGEST
