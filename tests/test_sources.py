"""What the sources promise to who reads and changes them, read from their syntax trees."""
import ast
from pathlib import Path

import fe_el

ROOT = Path(fe_el.__file__).parent
FILES = {str(path.relative_to(ROOT)): path.read_text() for path in sorted(ROOT.rglob("*.py"))}
TREES = {name: ast.parse(text) for name, text in FILES.items()}
OF_OTHERS = {"_replace", "_cpp_object", "_getvalue", "_addressof", "_sizeof"}  # public in spite of their name


def nodes(*kinds):
    """Nodes of some kinds in all files, with the names of these."""
    return [(name, node) for name, tree in TREES.items() for node in ast.walk(tree) if isinstance(node, kinds)]


def imported(tree):
    """Modules that a file imports."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            yield from (node.module, *(f"{node.module}.{name.name}" for name in node.names))
        elif isinstance(node, ast.Import):
            yield from (name.name for name in node.names)


def test_files_are_short():
    """At most 300 lines."""
    assert not {name: len(text.splitlines()) for name, text in FILES.items() if len(text.splitlines()) > 300}


def test_functions_take_at_most_ten_arguments():
    """Of a constructor, whose arguments users give by name, those count that it cannot do without."""
    many = []
    for file, function in nodes(ast.FunctionDef):
        a = function.args
        number = len([x for x in (*a.posonlyargs, *a.args, *a.kwonlyargs) if x.arg not in ("self", "cls")])
        if number - (len(a.defaults) if function.name == "__init__" else 0) > 10:
            many.append(f"{file}: {function.name} takes {number}; group them in a record")
    assert not many


def nameless(node):
    """Whether this is a tuple of more than four things that may be arrays."""
    maybe = ast.Name, ast.Attribute, ast.Subscript, ast.Call, ast.Starred
    return isinstance(node, ast.Tuple) and len(node.elts) > 4 and all(isinstance(e, maybe) for e in node.elts)


def makes_array(node):
    """Whether an expression makes an array, or is a part or a view of one."""
    function = ast.unparse(node.func) if isinstance(node, ast.Call) else ""
    return (function.startswith(("np.empty", "np.zeros", "np.ones", "np.full", "np.arange"))
            or function.endswith((".copy", ".view", ".astype", ".reshape"))
            or isinstance(node, ast.Subscript) and isinstance(node.slice, ast.Slice))


def arrays_made_in(function):
    """Names to which a function gives arrays."""
    for node in ast.walk(function):
        for target in node.targets if isinstance(node, ast.Assign) else ():
            several = isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple)
            for name, value in zip(target.elts, node.value.elts) if several else ((target, node.value),):
                if makes_array(value):
                    yield ast.unparse(name)


def test_more_than_four_arrays_travel_by_name():
    """No function is given or gives back more than four nameless things at once, nor does one take a record apart by place.

    Compiled loops may give back more numbers, but no arrays.
    """
    faults = [f"{file}:{call.lineno} hands over a tuple" for file, call in nodes(ast.Call)
              if any(map(nameless, (*call.args, *(k.value for k in call.keywords))))]
    for file, assignment in nodes(ast.Assign):
        for target in assignment.targets:
            apart = isinstance(target, ast.Tuple) and len(target.elts) > 4
            if apart and isinstance(assignment.value, (ast.Name, ast.Attribute)):
                faults.append(f"{file}:{assignment.lineno} takes a record apart")
            if isinstance(target, ast.Attribute) and nameless(assignment.value):
                faults.append(f"{file}:{assignment.lineno} keeps a tuple")
    for file, function in nodes(ast.FunctionDef):
        compiled = any(word in ast.unparse(d) for d in function.decorator_list for word in ("njit", "part", "by_dimension"))
        made = set(arrays_made_in(function))
        for node in ast.walk(function):
            if isinstance(node, (ast.Return, ast.Yield)) and isinstance(node.value, ast.Tuple):
                arrays = [e for e in node.value.elts if not compiled or ast.unparse(e) in made or makes_array(e)]
                if len(arrays) > 4:
                    faults.append(f"{file}: {function.name} gives back a tuple")
    assert not faults


def test_what_begins_with_an_underscore_is_used_at_home_only():
    """No attribute of another object that begins with one underscore, and no such name of another file."""
    faults = [f"{file}:{node.lineno} {ast.unparse(node)}" for file, node in nodes(ast.Attribute)
              if node.attr.startswith("_") and not node.attr.endswith("__") and node.attr not in OF_OTHERS
              and not (isinstance(node.value, ast.Name) and node.value.id in ("self", "cls"))]
    faults += [f"{file} imports {name}" for file, tree in TREES.items() for name in imported(tree)
               if name.startswith("fe_el.") and any(part.startswith("_") for part in name.split("."))]
    assert not faults


def test_folders_import_what_they_may():
    """Fluid and particles do not know each other, coupling does not know the fluid, particles know no dolfinx."""
    never = {"particles": ("fe_el.fluid", "fe_el.coupling", "dolfinx"), "fluid": ("fe_el.particles", "fe_el.coupling"),
             "coupling": ("fe_el.fluid",), "nodes": ("fe_el.fluid", "fe_el.coupling", "fe_el.particles"),
             "parallel": ("fe_el.fluid", "fe_el.coupling", "fe_el.particles", "fe_el.mesh", "dolfinx")}
    faults = [f"{file} imports {module}" for file, tree in TREES.items() for module in imported(tree)
              for other in never.get(Path(file).parts[0], ()) if f"{module}.".startswith(other + ".")]
    assert not faults
