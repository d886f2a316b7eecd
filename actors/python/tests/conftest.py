"""Walks of the bundled box. What is held against the program needs it: FOVEAL, or target/*/foveal in this checkout."""

import os
import pathlib
import subprocess

import pytest

ROOT = pathlib.Path(__file__).resolve().parents[3]


@pytest.fixture(scope="session")
def box() -> pathlib.Path:
    return ROOT / "scenes/box/box.toml"


@pytest.fixture(scope="session", autouse=True)
def cache(tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    """Bakes of one run of the tests, shared by Python and the program."""
    folder = tmp_path_factory.mktemp("cache")
    os.environ["FOVEAL_CACHE"] = str(folder)
    return folder


@pytest.fixture(scope="session")
def program(cache: pathlib.Path):
    """Runs the program and returns what it prints."""
    target = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    named = [os.environ.get("FOVEAL"), target / "debug/foveal", target / "release/foveal"]
    found = next((pathlib.Path(file) for file in named if file and pathlib.Path(file).exists()), None)
    if found is None:
        pytest.skip("the program is not built: cargo build, or name it in FOVEAL")

    def run(*arguments: object) -> str:
        done = subprocess.run([found, *map(str, arguments)], capture_output=True, text=True, timeout=300)
        assert done.returncode == 0, done.stderr
        return done.stdout

    return run
