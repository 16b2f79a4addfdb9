"""Every public name says in its signature what it takes and gives: for editors, type checkers and readers."""
import functools
import inspect

import fe_el

MODULES = "drag_laws", "time_scales", "schemes", "mapping"


def functions_of(cls):
    """The constructor, public methods and properties of a class that fe_el itself defines, inherited ones too."""
    for name in dir(cls):
        home = next(c for c in cls.__mro__ if name in c.__dict__)
        if not home.__module__.startswith("fe_el") or name.startswith("_") and name != "__init__":
            continue
        member = home.__dict__[name]
        if isinstance(member, property):
            accessors = member.fget, member.fset
        elif isinstance(member, functools.cached_property):
            accessors = (member.func,)
        else:
            accessors = (getattr(member, "__func__", member),)
        yield from (f for f in accessors if inspect.isfunction(f) and "<locals>" not in f.__qualname__)  # not compiled loops


def public_functions():
    """Of all public names but the modules."""
    for name in fe_el.__all__:
        thing = getattr(fe_el, name)
        if inspect.isclass(thing):
            yield from functions_of(thing)
        elif name not in MODULES:
            yield thing


def missing(function):
    """Its parameters without annotation, and ``return``."""
    wanted = [name for name, p in inspect.signature(function).parameters.items() if name not in ("self", "cls")]
    return [name for name in (*wanted, "return") if name not in function.__annotations__]


def faults_of(functions):
    """What is missing, by function."""
    return {f"{f.__module__}.{f.__qualname__}": missing(f) for f in functions if missing(f)}


def test_public_classes_and_functions_are_annotated():
    """All parameters and what is given back."""
    assert not faults_of(public_functions())


def test_public_modules_are_annotated():
    """Their functions written in Python, compiled ones having no say in it, and their classes."""
    found = []
    for module in (getattr(fe_el, name) for name in MODULES):
        for name, thing in vars(module).items():
            if not name.startswith("_") and getattr(thing, "__module__", None) == module.__name__:
                found += functions_of(thing) if inspect.isclass(thing) else [thing] if inspect.isfunction(thing) else []
    assert found
    assert not faults_of(found)
