"""Runs error.ipynb and keeps its output: `python actors/python/notebooks/make.py`; wants matplotlib."""

import base64
import contextlib
import io
import json
import pathlib

FILE = pathlib.Path(__file__).with_name("error.ipynb")


def run(notebook: dict) -> dict:
    """Runs the cells in order, as a kernel would, and replaces what they left."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    names: dict = {}
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    for count, cell in enumerate(cells, 1):
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            exec(compile("".join(cell["source"]), f"cell {count}", "exec"), names)
        cell["execution_count"], cell["outputs"] = count, []
        if printed.getvalue():
            text = printed.getvalue().splitlines(keepends=True)
            cell["outputs"].append({"output_type": "stream", "name": "stdout", "text": text})
        for number in plt.get_fignums():
            png = io.BytesIO()
            plt.figure(number).savefig(png, format="png", dpi=80, metadata={"Software": None})
            data = {"image/png": base64.b64encode(png.getvalue()).decode(), "text/plain": ["<Figure>"]}
            cell["outputs"].append({"output_type": "display_data", "metadata": {}, "data": data})
        plt.close("all")
    return notebook


if __name__ == "__main__":
    done = run(json.loads(FILE.read_text()))
    FILE.write_text(json.dumps(done, indent=1, ensure_ascii=False) + "\n")
