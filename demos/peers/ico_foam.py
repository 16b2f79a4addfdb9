"""Cases for OpenFOAM's icoFoam (PISO) to compare with: a box of cubes, written, run and read back."""
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np

from fe_el.parallel.failures import environment_outside_mpirun

HEAD = "FoamFile {{ version 2.0; format ascii; class {}; object {}; }}\n"
SCHEMES = """ddtSchemes {{ default {ddt}; }}
gradSchemes {{ default Gauss linear; }}
divSchemes {{ default Gauss linear; }}
laplacianSchemes {{ default Gauss linear corrected; }}
interpolationSchemes {{ default linear; }}
snGradSchemes {{ default corrected; }}
"""
SOLUTION = """solvers
{
    p { solver GAMG; smoother GaussSeidel; tolerance 1e-06; relTol 0.01; }
    pFinal { solver GAMG; smoother GaussSeidel; tolerance 1e-06; relTol 0; }
    U { solver smoothSolver; smoother symGaussSeidel; tolerance 1e-06; relTol 0; }
}
PISO { nCorrectors 2; nNonOrthogonalCorrectors 0; pRefCell 0; pRefValue 0; }
"""
SETTINGS = {"WM_PROJECT_DIR": "/usr/share/openfoam", "FOAM_SIGFPE": "false", "OMP_NUM_THREADS": "1"}  # of Debian's package


def installed():
    """Whether icoFoam can be run; Debian's package is ``openfoam``."""
    return shutil.which("icoFoam") is not None


def block_mesh(lengths, number, patches):
    """blockMeshDict of a box; patches: name -> (type, further entries, faces as in 'x- y+')."""
    x, y, z = lengths
    faces = {"x-": "(0 4 7 3)", "x+": "(1 2 6 5)", "y-": "(0 1 5 4)", "y+": "(3 7 6 2)", "z-": "(0 3 2 1)",
             "z+": "(4 5 6 7)"}
    corners = " ".join(f"({a} {b} {c})" for a, b, c in
                       [(0, 0, 0), (x, 0, 0), (x, y, 0), (0, y, 0), (0, 0, z), (x, 0, z), (x, y, z), (0, y, z)])
    boundary = "\n".join(f"{name} {{ type {kind}; {more} faces ({' '.join(faces[f] for f in where.split())}); }}"
                         for name, (kind, more, where) in patches.items())
    return (f"scale 1; vertices ({corners}); blocks (hex (0 1 2 3 4 5 6 7) ({number[0]} {number[1]} {number[2]}) "
            f"simpleGrading (1 1 1)); edges (); boundary (\n{boundary}\n);\n")


def field(kind, name, dimensions, inner, boundary):
    """Text of a field's file; boundary: patch -> condition."""
    rows = "\n".join(f"{patch} {{ {text} }}" for patch, text in boundary.items())
    return HEAD.format(kind, name) + f"dimensions {dimensions}; internalField {inner}; boundaryField {{\n{rows}\n}}\n"


def write_case(folder, lengths, number, patches, viscosity, dt, steps, initial="uniform (0 0 0)", ddt="Euler", ranks=1):
    """Write a case.

    Args:
        patches: name -> (type, further mesh entries, faces, velocity condition, pressure condition).
        initial: OpenFOAM's text of the initial velocity.
    """
    folder = Path(folder)
    shutil.rmtree(folder, ignore_errors=True)
    for part in ("system", "constant", "0"):
        (folder / part).mkdir(parents=True)

    def put(name, text, kind="dictionary"):
        (folder / name).write_text(HEAD.format(kind, Path(name).name) + text if kind == "dictionary" else text)
    put("system/blockMeshDict", block_mesh(lengths, number, {k: v[:3] for k, v in patches.items()}))
    put("system/controlDict",
        f"application icoFoam; startFrom startTime; startTime 0; stopAt endTime; endTime {steps * dt:.12g}; "
        f"deltaT {dt:.12g}; writeControl timeStep; writeInterval {steps}; writeFormat ascii; writePrecision 12; "
        "timePrecision 12; runTimeModifiable no;\n")
    put("system/fvSchemes", SCHEMES.format(ddt=ddt))
    put("system/fvSolution", SOLUTION)
    put("system/decomposeParDict", f"numberOfSubdomains {ranks}; method simple; coeffs {{ n ({ranks} 1 1); }}\n")
    put("constant/transportProperties", f"nu [0 2 -1 0 0 0 0] {viscosity:.12g};\n")
    put("0/U", field("volVectorField", "U", "[0 1 -1 0 0 0 0]", initial, {k: v[3] for k, v in patches.items()}), "field")
    put("0/p", field("volScalarField", "p", "[0 2 -2 0 0 0 0]", "uniform 0", {k: v[4] for k, v in patches.items()}), "field")


def vectors(values):
    """OpenFOAM's text of a list of vectors (cells, 2)."""
    return f"nonuniform List<vector> {len(values)} (\n" + "\n".join(f"({a:.14g} {b:.14g} 0)" for a, b in values) + "\n)"


def environment():
    """Variables that OpenFOAM runs with, without those of an mpirun around this."""
    return environment_outside_mpirun() | SETTINGS


def call(command, folder):
    """Run a part of OpenFOAM; returns what it printed."""
    done = subprocess.run(command, cwd=folder, env=environment(), capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)} failed in {folder}: {(done.stderr or done.stdout)[-400:]}")
    return done.stdout


def run(folder, ranks=1):
    """Mesh and run a case; returns the seconds of CPU at the end of each step, to 0.01 s.

    Raises:
        RuntimeError: if a part of OpenFOAM fails, with its last words.
    """
    parallel = ["mpirun", "--oversubscribe", "--allow-run-as-root", "-n", str(ranks)]
    commands = [["blockMesh"]] + ([["decomposePar"], [*parallel, "icoFoam", "-parallel"]] if ranks > 1 else [["icoFoam"]])
    for command in commands:
        text = call(command, folder)
    return np.array([float(t) for t in re.findall(r"ExecutionTime = (\S+) s", text)])


def final_velocity(folder, cells):
    """Cell velocities (cells, 2) of the last time of a serial run."""
    last = max((p for p in Path(folder).iterdir() if re.fullmatch(r"[\d.e+-]+", p.name)), key=lambda p: float(p.name))
    text = (last / "U").read_text().split("internalField")[1].split("boundaryField")[0]
    found = re.findall(r"\(([-\d.e+]+) ([-\d.e+]+) ([-\d.e+]+)\)", text)
    return np.array(found, float)[:cells, :2]
