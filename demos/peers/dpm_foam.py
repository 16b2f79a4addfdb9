"""Cases for OpenFOAM's DPMFoam to compare with: parcels or beads in a box of cubes, written, run and read back."""
import re
import shutil
import subprocess
import time
from pathlib import Path

import numpy as np

from demos.peers.ico_foam import HEAD, block_mesh, call, environment, field

SCHEMES = """ddtSchemes { default Euler; }
gradSchemes { default Gauss linear; }
divSchemes
{
    default none;
    div(alphaPhi.air,U.air) Gauss linearUpwindV unlimited;
    div(((alpha.air*nuEff.air)*dev2(T(grad(U.air))))) Gauss linear;
}
laplacianSchemes { default Gauss linear corrected; }
interpolationSchemes { default linear; }
snGradSchemes { default corrected; }
"""
SOLUTION = """solvers
{
    p { solver GAMG; tolerance 1e-06; relTol 0.01; smoother GaussSeidel; }
    pFinal { solver GAMG; tolerance 1e-06; relTol 0; smoother GaussSeidel; }
    "U.air.*" { solver smoothSolver; smoother symGaussSeidel; tolerance 1e-06; relTol 0; }
}
PIMPLE { nCorrectors 2; nNonOrthogonalCorrectors 0; momentumPredictor yes; pRefCell 0; pRefValue 0; }
"""
AVERAGE = """functions
{
    velocity { type volFieldValue; libs ("libfieldFunctionObjects.so"); regionType all; operation weightedVolAverage;
        weightField alpha.air; fields (U.air); writeFields no; log no; writeControl timeStep; writeInterval 1; }
    uniform { type readFields; libs ("libfieldFunctionObjects.so"); fields (HdotGradH); }
}
"""


def installed():
    """Whether DPMFoam can be run; Debian's package is ``openfoam``."""
    return shutil.which("DPMFoam") is not None


def _cloud(density, coupling, forces, injections, interaction, collisions):
    """kinematicCloudProperties; injections: (name, parcel's number of particles, velocity, diameter)."""
    models = "\n".join(
        f"{name} {{ type manualInjection; massTotal 0; parcelBasisType fixed; nParticle {count:.10g}; SOI 0; "
        f"positionsFile \"{name}\"; "
        f"U0 (0 0 {velocity:.10g}); sizeDistribution "
        f"{{ type fixedValue; fixedValueDistribution {{ value {diameter:.10g}; }} }} }}"
        for name, count, velocity, diameter in injections)
    return f"""solution {{ active true; coupled true; transient yes; cellValueSourceCorrection off; maxCo 0.3;
  interpolationSchemes {{ rho.air cell; U.air cellPoint; mu.air cell; alpha.air cell; HdotGradH cell; }}
  integrationSchemes {{ U Euler; }} averagingMethod basic; sourceTerms {{ schemes {{ U {coupling} 1; }} }} }}
constantProperties {{ parcelTypeId 1; rhoMin 1e-15; minParcelMass 1e-20; rho0 {density:g};
  youngsModulus 1e6; poissonsRatio 0.3;
  constantVolume true; alphaMax 0.9; }}
subModels {{ particleForces {{ ErgunWenYuDrag {{ alphac alpha.air; }} {forces} }}
  injectionModels {{ {models} }}
  dispersionModel none; {interaction} heatTransferModel none; surfaceFilmModel none; stochasticCollisionModel none;
  radiation off;
  {collisions} }}
cloudFunctions {{ }}
"""


def write_case(folder, lengths, number, patches, dt, steps, gas, gravity, particle_density, clouds, coupling="semiImplicit",
               forces="gravity;",
               initial=0.0, interaction="patchInteractionModel none;", collisions="collisionModel none;", uniform=0.0):
    """Write a case.

    Args:
        patches: name -> (type, further mesh entries, faces, velocity condition, pressure condition).
        gas: density [kg/m^3] and viscosity [Pa s].
        gravity: vertical; DPMFoam applies it to the gas, and with the force ``gravity`` to the particles.
        clouds: name -> (positions (n, 3), diameter, particles in a parcel, vertical velocity).
        initial: vertical velocity of the gas.
        uniform: vertical component of a uniform field that the force ``paramagnetic`` reads.
    """
    folder = Path(folder)
    shutil.rmtree(folder, ignore_errors=True)
    for part in ("system", "constant", "0"):
        (folder / part).mkdir(parents=True)

    def put(name, text, kind="dictionary"):
        (folder / name).write_text(HEAD.format(kind, Path(name).name) + text)
    put("system/blockMeshDict", block_mesh(lengths, number, {k: v[:3] for k, v in patches.items()}))
    put("system/controlDict",
        f"application DPMFoam; startFrom startTime; startTime 0; stopAt endTime; endTime {steps * dt:.12g}; "
        f"deltaT {dt:.12g}; writeControl timeStep; writeInterval 1000000; writeFormat binary; timePrecision 12; "
        f"runTimeModifiable no;\n{AVERAGE}")
    put("system/fvSchemes", SCHEMES)
    put("system/fvSolution", SOLUTION)
    put("constant/g", f"dimensions [0 1 -2 0 0 0 0]; value (0 0 {gravity:.12g});\n", "uniformDimensionedVectorField")
    put("constant/transportProperties",
        f"continuousPhase air; rho.air {gas[0]:.12g}; transportModel Newtonian; nu {gas[1] / gas[0]:.12g};\n")
    put("constant/turbulenceProperties.air", "simulationType laminar;\n")
    put("constant/kinematicCloudProperties", _cloud(particle_density, coupling, forces, [
        (name, count, velocity, diameter) for name, (_, diameter, count, velocity) in clouds.items()], interaction,
                                                    collisions))
    for name, (position, *_) in clouds.items():
        put(f"constant/{name}", "(\n" + "\n".join(f"({a:.12g} {b:.12g} {c:.12g})" for a, b, c in position) + "\n)\n",
            "vectorField")
    for name, kind, dimensions, inner, column in (
            ("U.air", "volVectorField", "[0 1 -1 0 0 0 0]", f"uniform (0 0 {initial:.12g})", 3),
            ("p", "volScalarField", "[0 2 -2 0 0 0 0]", "uniform 0", 4),
            ("HdotGradH", "volVectorField", "[0 0 0 0 0 0 0]", f"uniform (0 0 {uniform:.12g})", None)):
        conditions = {k: v[column] if column else "type cyclic;" if v[0] == "cyclic" else "type zeroGradient;" for k,
                      v in patches.items()}
        (folder / "0" / name).write_text(field(kind, name, dimensions, inner, conditions))


def run(folder, fastest=np.inf, limit=600.0):
    """Mesh and run a case.

    Returns:
        Dictionary of arrays, one value a step: ``time``, ``seconds`` of wall time, ``sub_steps`` of the particles,
            ``parcels``,
        vertical mean velocities ``gas`` and ``particles``; and ``stopped``, why it ended early, or ``None``: a mean velocity
        above ``fastest`` [m/s], ``limit`` seconds, or an error of DPMFoam's.
    """
    call(["blockMesh"], folder)
    start, stopped, columns = time.perf_counter(), None, {k: [] for k in ("time", "clock", "sub_steps", "parcels", "mass",
                                                                          "momentum")}
    with open(Path(folder) / "log", "w") as log, subprocess.Popen(
            ["DPMFoam"], cwd=folder, env=environment(), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
                                                                  bufsize=1) as process:
        for line in process.stdout:
            log.write(line)
            for key, pattern in (("time", r"^Time = (\S+)"), ("parcels", r"Current number of parcels += (\S+)"),
                                 ("sub_steps", r"^ *(\d+) move-collide"),
                                 ("mass", r"Current mass in system += (\S+)"),
                                 ("momentum", r"Linear momentum += \(\S+ \S+ (\S+)\)")):
                if found := re.search(pattern, line):
                    columns[key].append(float(found[1]))
            if line.startswith("ExecutionTime"):
                columns["clock"].append(time.perf_counter() - start)
                if not abs(columns["momentum"][-1]) < fastest * columns["mass"][-1]:
                    stopped = f"mean velocity above {fastest:g} m/s"
            if columns["clock"] and time.perf_counter() - start > limit:
                stopped = f"above {limit:g} s"
            if stopped:
                process.kill()
    n = len(columns["clock"])
    stopped = stopped or (f"DPMFoam failed, see {folder}/log" if process.returncode else None)
    files = sorted((Path(folder) / "postProcessing/velocity").glob("*/volFieldValue.dat"))
    gas = [float(v) for f in files for v in re.findall(r"(?m)^[^#]*\(\S+ \S+ (\S+)\)", f.read_text())]
    return {"stopped": stopped, "time": np.array(columns["time"][:n]), "seconds": np.diff(columns["clock"], prepend=0.0),
            "sub_steps": np.array(columns["sub_steps"][:n]), "parcels": np.array(columns["parcels"][:n]),
            "gas": np.array(gas[:n]),
            "particles": np.array(columns["momentum"][:n]) / np.array(columns["mass"][:n])}
