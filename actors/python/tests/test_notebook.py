"""The notebook runs, and what it keeps is of this code."""

import importlib.util
import json
import pathlib

import pytest

NOTEBOOKS = pathlib.Path(__file__).resolve().parents[1] / "notebooks"


def test_the_notebook_runs():
    pytest.importorskip("matplotlib")
    spec = importlib.util.spec_from_file_location("make", NOTEBOOKS / "make.py")
    make = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(make)
    kept = json.loads((NOTEBOOKS / "error.ipynb").read_text())
    kinds = lambda notebook: [  # noqa: E731
        [output["output_type"] for output in cell.get("outputs", [])] for cell in notebook["cells"]
    ]
    before = kinds(kept)
    assert sum("display_data" in of_cell for of_cell in before) == 2, "python actors/python/notebooks/make.py"
    assert kinds(make.run(kept)) == before
