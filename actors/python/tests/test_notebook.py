"""The notebook runs, and what it keeps is of this code."""

import ast
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
    ran = make.run(kept)
    assert kinds(ran) == before
    # Curves, not lines of two points: frames that each policy took.
    [said] = [out["text"] for cell in ran["cells"] for out in cell.get("outputs", []) if "frames until" in str(out.get("text"))]
    frames = ast.literal_eval("".join(said).split("}")[0] + "}")
    assert len(frames) == 3 and all(count >= 4 for count in frames.values()), frames
