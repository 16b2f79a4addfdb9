"""Checks of what users give: each returns the argument in its final form, or raises a sentence that says what is allowed."""
from pathlib import Path
from typing import Any

import numpy as np

from fe_el.dolfinx_api import is_of_mesh


def numbers(name: str, value: Any) -> np.ndarray:
    """An array of float; raises ``ValueError`` for text, objects and ragged lists."""
    try:
        a = np.asarray(value)
    except ValueError:  # numpy's own for ragged lists
        a = np.asarray(None)
    if a.dtype.kind not in "iuf":
        raise ValueError(f"The {name} is {_short(value)}; give a number or an array of numbers.")
    return a.astype(float)


def require_positive(name: str, value: Any) -> None:
    """Raise ``ValueError`` unless every value is finite and positive."""
    value = numbers(name, value).ravel()
    bad = value[~(np.isfinite(value) & (value > 0))]
    if len(bad):
        raise ValueError(f"The {name} is {bad[0]:g}; it must be finite and greater than zero.")


def require_not_negative(name: str, value: Any) -> None:
    """Raise ``ValueError`` unless every value is finite and not negative."""
    value = numbers(name, value)
    if not (np.isfinite(value).all() and (value >= 0).all()):
        raise ValueError(f"The {name} is {value.tolist()}; it must be finite and not negative.")


def positive_number(name: str, value: Any) -> float:
    """One finite number above zero, as float."""
    if type(value) is float and 0.0 < value < np.inf:  # the step of every call of a loop
        return value
    if numbers(name, value).ndim:
        raise ValueError(f"The {name} is {_short(value)}; give one number, above zero.")
    require_positive(name, value)
    return float(value)


def not_negative_number(name: str, value: Any) -> float:
    """One finite number, zero or above, as float."""
    if numbers(name, value).ndim:
        raise ValueError(f"The {name} is {_short(value)}; give one number, zero or above.")
    require_not_negative(name, value)
    return float(value)


def finite_number(name: str, value: Any) -> float:
    """One finite number, as float."""
    if numbers(name, value).ndim or not np.isfinite(value):
        raise ValueError(f"The {name} is {_short(value)}; give one finite number.")
    return float(value)


def number_or_function(name: str, value: Any) -> Any:
    """A finite number, or a function that gives one; a class is none."""
    if callable(value) and not isinstance(value, type):
        return value
    if isinstance(value, type):
        raise ValueError(f"The {name} is {_short(value)}; give a finite number, or a function of time.")
    return finite_number(name, value)


def components(name: str, value: Any, dimension: int) -> np.ndarray:
    """As many finite numbers as there are dimensions (d,); of three in two dimensions the last is left out."""
    v = numbers(name, value)
    if v.shape not in ((dimension,), (3,)) or not np.isfinite(v).all():
        raise ValueError(f"The {name} is {_short(v.tolist())}; give {dimension} finite numbers.")
    return v[:dimension].copy()


def function_of_mesh(name: str, value: Any) -> Any:
    """The object itself, if it is a dolfinx Function."""
    if not hasattr(value, "function_space") or not hasattr(value, "x"):
        raise ValueError(f"The {name} is {_short(value)}; pass a dolfinx Function, for instance fluid.velocity.")
    return value


def function_or_class_of(name: str, value: Any, example: str) -> Any:
    """The object itself, if it can be called; a class is refused, as its object was meant."""
    if not callable(value) or isinstance(value, type):
        raise ValueError(f"The {name} is {_short(value)}; pass {example}.")
    return value


def seed_number(value: Any) -> int:
    """A seed of random numbers, as int."""
    return whole_number("seed of the random numbers (seed)", value, 0)


def whole_number(name: str, value: Any, least: int) -> int:
    """One whole number of at least ``least``, as int."""
    if numbers(name, value).ndim or not np.isfinite(value) or value != int(value) or value < least:
        raise ValueError(f"The {name} is {_short(value)}; give a whole number, {least} or more.")
    return int(value)


def finite_vector(name: str, value: Any) -> np.ndarray:
    """Two or three finite numbers as an array (3,); the third is zero if it is left out."""
    v, value = np.zeros(3), numbers(name, value)
    if value.ndim != 1 or value.size not in (2, 3) or not np.isfinite(value).all():
        raise ValueError(f"The {name} is {_short(value.tolist())}; give two or three finite numbers.")
    v[:value.size] = value
    return v


def points(name: str, value: Any) -> np.ndarray:
    """Positions (points, 3) of rows of two or three finite numbers."""
    x = np.atleast_2d(numbers(name, value))
    if x.ndim != 2 or x.shape[1] not in (2, 3) or not len(x) or not np.isfinite(x).all():
        raise ValueError(f"The {name} have shape {x.shape}{'' if np.isfinite(x).all() else ' and are not all finite'}; give "
                         "finite numbers in an array (particles, 2 or 3) with at least one row.")
    return np.column_stack([x, np.zeros(len(x))]) if x.shape[1] == 2 else x.copy()


def per_particle(name: str, value: Any, count: int) -> np.ndarray:
    """An array (count,) of finite positive numbers, from one number or one for each particle."""
    a = numbers(name, value)
    if a.shape not in ((), (1,), (count,)):
        raise ValueError(f"The {name} has shape {a.shape} for {count} particles; give one number or one for each.")
    require_positive(name, a)
    return np.broadcast_to(a, count).copy()


def truth_values(name: str, value: Any, count: int) -> np.ndarray:
    """An array (count,) of bool."""
    try:
        a = np.asarray(value)
    except ValueError:  # numpy's own for ragged lists
        a = np.asarray(None)
    if a.dtype != bool or a.shape != (count,):
        raise ValueError(f"The {name} is {_short(value)}; give one truth value for each of the {count} of this rank.")
    return a


def of_kind(name: str, value: Any, *kinds: type) -> Any:
    """The object itself, if it is of one of the kinds; a class is not."""
    if not isinstance(value, kinds):
        wanted = " or ".join(kind.__name__ for kind in kinds)
        raise ValueError(f"The {name} is {_short(value)}; pass an object of {wanted}"
                         f"{', with its arguments in brackets' if isinstance(value, type) else ''}.")
    return value


def require_particles(particles: Any) -> None:
    """Raise ``ValueError`` unless this is an object of Particles."""
    if not hasattr(particles, "relaxation_rate") or isinstance(particles, type):
        raise ValueError(f"The particles are {_short(particles)}; pass an object of Particles.")


def file_name(name: str, value: Any) -> Path:
    """The name of a file, as a Path."""
    if not isinstance(value, (str, Path)):
        raise ValueError(f"The {name} is {_short(value)}; give its name, a text or a Path.")
    return Path(value)


def require_mesh(mesh: Any) -> None:
    """Raise ``ValueError`` unless this is a mesh, and not the pair that comes with tags."""
    if not hasattr(mesh, "topology") or not hasattr(mesh, "geometry"):
        raise ValueError(f"The mesh is {_short(mesh)}; pass the mesh itself, for instance of mesh, tags = fe_el.box(...).")


def same_mesh(name: str, other: Any, mesh: Any) -> None:
    """Raise ``ValueError`` if tags or a Function belong to another mesh than this."""
    if not is_of_mesh(other, mesh):
        raise ValueError(f"The {name} belong to another mesh; pass those of the same mesh as the rest.")


def require_tags(name: str, tags: Any, mesh: Any) -> None:
    """Raise ``ValueError`` unless these are tags of facets of this mesh."""
    if not hasattr(tags, "indices") or not hasattr(tags, "values"):
        raise ValueError(f"The {name} are {_short(tags)}; pass the facet tags that come with the mesh.")
    if tags.dim != mesh.topology.dim - 1:
        raise ValueError(f"The {name} are tags of entities of dimension {tags.dim}; pass those of the facets, "
                         f"of dimension {mesh.topology.dim - 1}.")
    same_mesh(name, tags, mesh)


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) < 80 else text[:77] + "..."
