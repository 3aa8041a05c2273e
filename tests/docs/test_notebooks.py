"""The notebooks run from top to bottom, and are stored without outputs."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from gcbench.benchmark.results.runs import Results, find_runs

NOTEBOOKS = sorted((Path(__file__).parents[2] / "docs/examples").glob("*.ipynb"))


def test_there_is_a_notebook() -> None:
    assert NOTEBOOKS


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_no_outputs_are_stored(notebook: Path) -> None:
    for cell in json.loads(notebook.read_text())["cells"]:
        assert cell["cell_type"] == "markdown" or not cell["outputs"]
        assert cell.get("execution_count") is None


@pytest.mark.gl
@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
@pytest.mark.ci
def test_it_runs(notebook: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """And the network that it trains is nearer to the truth than no motion."""
    pytest.importorskip("torch", reason="PyTorch is in the extra learn")
    pytest.importorskip("ipykernel", reason="ipykernel runs notebooks")
    nbclient = pytest.importorskip("nbclient", reason="nbclient runs notebooks")
    nbformat = pytest.importorskip("nbformat")
    for name in ("IPYTHONDIR", "JUPYTER_CONFIG_DIR", "JUPYTER_DATA_DIR", "JUPYTER_RUNTIME_DIR"):
        monkeypatch.setenv(name, str(tmp_path / "jupyter"))
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    cells = nbformat.read(notebook, 4)
    nbformat.validate(cells)
    place = {"metadata": {"path": str(tmp_path)}}
    nbclient.NotebookClient(cells, timeout=600, resources=place).execute()
    shown = {kind for cell in cells.cells for output in cell.get("outputs", ())
             for kind in output.get("data", ())}
    assert "text/html" in shown
    scores = Results(tuple(find_runs(tmp_path / "results"))).frame
    final = scores[scores.metric == "final_error"].groupby("method").value.mean()
    assert final["door-network"] < 0.7 * final["hold-still"]
