"""The doors by which users come in: names, README with its script, and what the package says of itself."""
import json
import re
import textwrap
import tomllib
from pathlib import Path

import numpy as np
import pytest

import fe_el

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text()


def test_dir_lists_the_public_names():
    """All of them, which are there, and none that is loaded beside them."""
    assert set(dir(fe_el)) == {*fe_el.__all__, "__version__", "__doc__"}
    assert all(hasattr(fe_el, name) for name in dir(fe_el))


def test_the_script_of_the_readme_runs(tmp_path, monkeypatch):
    """As it is printed, for three steps: beads fall in air that comes from below, and the ledger is closed."""
    script = textwrap.dedent(README.split("## A script\n\n")[1].split("\n\nA run that")[0])
    assert len(script.splitlines()) <= 32 and "end_time=0.1" in script
    script = script.replace("meshes/", f"{ROOT}/meshes/").replace("end_time=0.1", "end_time=0.003")
    monkeypatch.chdir(tmp_path)
    names = {}
    exec(compile(script, "README.md", "exec"), names)
    beads, coupling = names["beads"], names["coupling"]
    assert len(beads) == 5000 and beads.velocity[:, 2].mean() == pytest.approx(-9.81 * 3e-3, rel=0.1)
    assert coupling.momentum_imbalance < 1e-12 and coupling.solid_volume_error < 1e-12
    assert names["air"].mass_residual() < 1e-6
    assert list((tmp_path / "out" / "script").glob("*.pvd"))


def test_the_readme_is_short_and_names_what_is_there():
    """At most 200 lines; every demo and file that it names exists."""
    assert len(README.splitlines()) <= 200
    named = re.findall(r"`((?:benchmarks/|peers/)?\w+\.py)", README) + re.findall(r"\]\(([\w/]+\.(?:md|png))\)", README)
    places = "", "demos", "demos/benchmarks", "tests"
    missing = [name for name in named if not any((ROOT / place / name).is_file() for place in places)]
    assert len(named) > 30 and not missing


def test_versions_and_names_are_said_once():
    """pyproject.toml, CITATION.cff, CHANGELOG.md and the package agree; the extras hold what the tests import."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    citation, changes = (ROOT / "CITATION.cff").read_text(), (ROOT / "CHANGELOG.md").read_text()
    assert f"version: {project['version']}\n" in citation and f"## {project['version']}\n" in changes
    assert project["authors"][0]["name"] in citation and project["urls"] and project["requires-python"] == ">=3.11"
    assert any("dolfinx" in name for name in project["dependencies"])
    assert any("pytest" in name for name in project["optional-dependencies"]["test"])


def test_a_summary_says_on_what_its_numbers_depend(tmp_path):
    """Versions of dolfinx and PETSc, by whatever name they are installed, of numba and numpy."""
    fe_el.write_summary(tmp_path, a=1.5)
    numbers = json.loads((tmp_path / "summary.json").read_text())
    assert all(re.match(r"\d+\.\d+", numbers["version_" + name]) for name in ("dolfinx", "petsc", "numba", "numpy"))
    assert numbers["version_numpy"] == np.__version__
