"""The notebook runs from its first to its last cell."""

from pathlib import Path

NOTEBOOK = Path(__file__).parents[1] / "examples" / "tour.ipynb"


def test_the_tour_runs(fleet, robot, endpoint, place, monkeypatch):
    import nbformat
    from nbclient import NotebookClient

    monkeypatch.setenv("DRIFTLESS_ENDPOINT", endpoint)
    monkeypatch.setenv("DRIFTLESS_RUN", str(place / "out"))
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    NotebookClient(notebook, timeout=120, kernel_name="python3").execute()
    pictures = [
        output
        for cell in notebook.cells
        for output in cell.get("outputs", [])
        if "image/png" in output.get("data", {})
    ]
    assert len(pictures) == 2
