"""What a type checker sees: the package without complaint, and in a user's script what does not fit the public names."""
import ast
import subprocess
import sys
import tomllib
from importlib.util import find_spec
from pathlib import Path

import pytest

import fe_el

PACKAGE = Path(fe_el.__file__).parent

RIGHT = """
import numpy as np

import fe_el

mesh, tags = fe_el.box((1.0, 1.0, 1.0), (4, 4, 4))
air = fe_el.VolumeAveragedNavierStokes(mesh, tags, density=1.2, viscosity=1.8e-5, turbulence=fe_el.Vreman())
air.set_velocity(1, lambda time, position: np.full((len(position), 3), time))
air.set_no_slip([3, 4])
beads = fe_el.Particles(mesh, density=2500.0, gravity=(0, 0, -9.81))
beads.insert_in_box((0, 0, 0), [1, 1, 0.5], 20, diameter=0.1, seed=1)
law = fe_el.LinearSpringDashpot(stiffness=800.0, restitution=0.9, friction=0.1)
contacts = fe_el.Contacts(beads, law, walls=[fe_el.PlaneWall(point=(0, 0, 0), normal=(0, 0, 1))])
coupling = fe_el.Coupling.of(air, beads, [fe_el.Drag(fe_el.drag_laws.beetstra), fe_el.PressureGradient()])
for time in fe_el.time_steps(1e-3, 1.0):
    coupling.to_fluid(1e-3)
    air.advance(1e-3, coupling.fields)
    coupling.to_particles(1e-3)
    beads.advance(1e-3, contacts)
heights: np.ndarray = beads.position[:, 2]
energy: float = beads.kinetic_energy()
version: str = fe_el.__version__
"""

WRONG = """
import fe_el

fe_el.Particels(None, 2500.0)  # attr-defined
beads = fe_el.Particles(None, density="heavy")  # arg-type
beads.insert_at([[0, 0, 0]], diameter=0.1, displacement=None)  # arg-type
beads.step_limit()  # attr-defined
law = fe_el.HertzMindlin(youngs=5e6)  # call-arg
energy: str = beads.kinetic_energy()  # assignment
fe_el.Contacts(law, beads)  # arg-type
"""


@pytest.mark.skipif(find_spec("mypy") is None, reason="mypy is not installed: pip install mypy, or apt install mypy")
def test_mypy_finds_what_is_wrong_and_nothing_else(tmp_path):
    """One run over the package, a script without faults, and one with a fault in every line that names its kind."""
    right, wrong = tmp_path / "right.py", tmp_path / "wrong.py"
    right.write_text(RIGHT)
    wrong.write_text(WRONG)
    run = subprocess.run([sys.executable, "-m", "mypy", "--cache-dir", tmp_path / "cache", "--no-error-summary",
                          "--hide-error-context", "--show-error-codes", "fe_el", right, wrong],
                         cwd=PACKAGE.parent, capture_output=True, text=True)
    wanted = {(k, line.rsplit("# ", 1)[1]) for k, line in enumerate(WRONG.split("\n"), 1) if "# " in line}
    found, others = set(), []
    for line in filter(None, run.stdout.splitlines()):
        place, _, message = line.partition(": error: ")
        if "wrong.py:" in place and message:
            found.add((int(place.rsplit(":", 1)[1]), message.rsplit("[", 1)[1].rstrip("]")))
        elif ": note: " not in line:
            others.append(line)
    assert run.returncode == 1, run.stderr
    assert not others
    assert found == wanted


def test_the_stub_names_what_the_package_loads():
    """The same names from the same modules, and nothing else."""
    found, modules = {}, set()
    for node in ast.parse((PACKAGE / "__init__.pyi").read_text()).body:
        if isinstance(node, ast.ImportFrom):
            (alias,) = node.names
            assert alias.name == alias.asname, f"{alias.name} is not shown to users without 'as {alias.name}'"
            if node.module == "fe_el.coupling":
                modules.add(alias.name)
            else:
                found[alias.name] = node.module.removeprefix("fe_el.")
    assert found == fe_el._HOME
    assert modules == set(fe_el._MODULES)


def test_the_package_brings_its_types():
    """Checkers take the types of an installed package only with its mark."""
    settings = tomllib.loads((PACKAGE.parent / "pyproject.toml").read_text())
    files = settings["tool"]["setuptools"]["package-data"]["fe_el"]
    assert (PACKAGE / "py.typed").is_file() and "py.typed" in files
    assert any((PACKAGE / "__init__.pyi").match(pattern) for pattern in files)
