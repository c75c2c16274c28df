"""Imports run one way, and heavy libraries stay where they belong; see docs/architecture.md."""

from __future__ import annotations

import ast
from collections import defaultdict
from pathlib import Path

import pytest

from sources import tree_of

REPOSITORY = Path(__file__).resolve().parents[2]
PACKAGE = REPOSITORY / "src" / "cellwise"

BASE = {"errors", "typing", "files", "arguments", "notices", "plotting", "records", "threads"}
BASE |= {"wording"}
TOOLS = {
    "logs",
    "cell",
    "fit",
    "identify",
    "estimate",
    "forecast",
    "diagnose",
    "pack",
    "history",
    "data",
}
MAY_IMPORT = {
    "wording": set(),
    "errors": {"wording"},
    "typing": set(),
    "files": {"errors"},
    "arguments": {"errors", "typing"},
    "progress": set(),
    "records": {"errors"},
    "first_use": BASE | {"cell", "logs", "estimate", "forecast", "diagnose", "data"},
    "threads": set(),
    "notices": {"wording"},
    "plotting": {"arguments", "errors", "typing"},
    "logs": BASE,
    "cell": BASE | {"logs"},
    "printing": BASE | {"cell", "estimate"},
    "fit": BASE | {"logs", "cell"},
    "identify": BASE | {"logs", "cell", "fit"},
    "estimate": BASE | {"logs", "cell"},
    "forecast": BASE | {"logs", "cell", "estimate"},
    "diagnose": BASE | {"logs", "cell", "fit", "identify", "estimate"},
    "pack": BASE | {"logs", "cell", "identify", "estimate", "diagnose"},
    "history": BASE | {"logs", "cell", "fit"},
    "data": BASE | {"logs"},
    "export": BASE | TOOLS | {"printing"},
    "studies": BASE | TOOLS,
    "report": BASE | TOOLS | {"studies"},
    "benchmark": BASE | TOOLS | {"report", "export", "fleet"},
    "datasets": BASE | {"logs", "data"},
    "live": BASE | {"logs", "cell", "estimate", "forecast"},
    "fleet": BASE | {"logs", "cell", "estimate", "diagnose", "pack", "history"},
    "workflows": BASE | TOOLS | {"export", "report", "live"},
    "cli": BASE
    | TOOLS
    | {
        "export",
        "report",
        "benchmark",
        "studies",
        "live",
        "fleet",
        "datasets",
        "first_use",
        "workflows",
    }
    | {"progress"},
}
MODULES = sorted(path for path in PACKAGE.rglob("*.py") if path.parent != PACKAGE) + sorted(
    PACKAGE / f"{name}.py" for name in (*BASE, "data")
)


MOST_MODULES = 15


def part_of(path):
    """First name below the package: a folder, or a module of its own."""
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def imported(path, *, when_run=False):
    """Dotted names of everything a module imports, wherever the import stands.

    ``when_run`` leaves out what only type checkers see.
    """
    tree = tree_of(path)
    left_out = set(for_type_checkers_only(tree)) if when_run else set()
    for node in ast.walk(tree):
        if node in left_out:
            continue
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name(path)}: a relative import"
            if node.module == "cellwise":
                yield from (f"cellwise.{alias.name}" for alias in node.names)
            else:
                yield node.module


def name(path):
    return path.relative_to(PACKAGE).as_posix()


def test_every_part_has_its_rule():
    parts = {part_of(path) for path in PACKAGE.rglob("*.py")} - {"__init__", "__main__"}
    assert parts == set(MAY_IMPORT)


def test_imports_run_one_way():
    for path in MODULES:
        own = part_of(path)
        for dotted in imported(path):
            parts = dotted.split(".")
            if parts[0] != "cellwise":
                continue
            assert len(parts) > 1, f"{name(path)} imports the public face"
            assert parts[1] in {own, *MAY_IMPORT[own]}, f"{name(path)} imports {dotted}"


def dotted_name(path):
    """Name of a module of the package; of a folder for its ``__init__``."""
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def for_type_checkers_only(tree):
    """Import statements below ``if TYPE_CHECKING``."""
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            yield from (inner for line in node.body for inner in ast.walk(line))


def needs(path, modules):
    """Modules of the package that a module imports, at its head or inside a function."""
    tree = tree_of(path)
    left_out = set(for_type_checkers_only(tree))
    for node in ast.walk(tree):
        if node in left_out:
            continue
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in modules)
        elif isinstance(node, ast.ImportFrom):
            for alias in node.names:
                submodule = f"{node.module}.{alias.name}"
                found = submodule if submodule in modules else node.module
                if found in modules:
                    yield found


def circles(graph):
    """Nodes that reach themselves: what remains when everything that needs nobody is taken away.

    Taken away from both ends, so that only what lies on or between circles remains.
    """
    left = {node: set(targets) - {node} for node, targets in graph.items()}
    while True:
        wanted = set().union(*left.values()) if left else set()
        free = {node for node, targets in left.items() if not targets or node not in wanted}
        if not free:
            return left
        left = {n: targets - free for n, targets in left.items() if n not in free}


def test_circles_are_found():
    assert circles({"a": {"b"}, "b": {"c"}, "c": set()}) == {}
    assert set(circles({"a": {"b"}, "b": {"c"}, "c": {"b", "d"}, "d": set()})) == {"b", "c"}


def test_no_module_imports_itself_through_others():
    modules = {dotted_name(path): path for path in PACKAGE.rglob("*.py")}
    graph = {one: set(needs(path, modules)) for one, path in modules.items()}
    assert len(graph) > 250
    assert circles(graph) == {}


@pytest.mark.parametrize("root", ["src/cellwise", "benchmarks", "tests"])
def test_a_folder_holds_at_most_fifteen_modules(root):
    folders = [REPOSITORY / root, *(p for p in (REPOSITORY / root).rglob("*") if p.is_dir())]
    for folder in folders:
        modules = [path for path in folder.glob("*.py") if path.stem != "__init__"]
        relative = folder.relative_to(REPOSITORY).as_posix()
        assert len(modules) <= MOST_MODULES, relative


def test_numba_stays_in_the_kernels():
    for path in MODULES:
        if any(dotted.split(".")[0] == "numba" for dotted in imported(path)):
            own = part_of(path)
            assert own in ("cell", "estimate", "forecast", "identify", "diagnose"), name(path)
            assert own not in ("identify", "diagnose") or path.stem.endswith("_kernels"), name(path)


@pytest.mark.parametrize(("library", "folder"), [("matplotlib", "report"), ("pyarrow", "logs")])
def test_libraries_stay_in_their_folder(library, folder):
    for path in MODULES:
        if any(dotted.split(".")[0] == library for dotted in imported(path, when_run=True)):
            assert part_of(path) == folder, name(path)


def test_kernels_do_not_raise():
    """What compiled code has to say it says in status bits or return values."""
    for path in MODULES:
        if path.stem == "kernels" or path.stem.endswith("_kernels"):
            tree = tree_of(path)
            assert not any(isinstance(node, ast.Raise) for node in ast.walk(tree)), name(path)


def test_assert_is_for_tests():
    for path in MODULES:
        tree = tree_of(path)
        assert not any(isinstance(node, ast.Assert) for node in ast.walk(tree)), name(path)


def test_the_generator_of_the_embedded_data_shares_no_code_with_cellwise():
    for path in (REPOSITORY / "datasets" / "generator").rglob("*.py"):
        for node in ast.walk(tree_of(path)):
            named = [alias.name for alias in getattr(node, "names", ())]
            roots = {n.split(".")[0] for n in (getattr(node, "module", None) or "", *named)}
            assert not (isinstance(node, ast.Import | ast.ImportFrom) and "cellwise" in roots), path


def test_kernels_are_compiled_in_one_place():
    """A cache that cannot be written to is looked after there, and nowhere else."""
    home = PACKAGE / "cell" / "compiled.py"
    others = [name(p) for p in PACKAGE.rglob("*.py") if "njit(cache" in p.read_text() and p != home]
    assert others == []


COMPILED = {"inline", "kernel", "rows", "cached"}
MOST_ARGUMENTS = 12


def kernels_of(path):
    """Functions that numba compiles: by their decorator, and all of the fixed step."""
    fixed = path.parent == PACKAGE / "estimate" / "fixed"
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.FunctionDef):
            calls = [d.func if isinstance(d, ast.Call) else d for d in node.decorator_list]
            if fixed or COMPILED & {d.id for d in calls if isinstance(d, ast.Name)}:
                yield node


def test_kernels_take_records_not_long_lists_of_arguments():
    found = [(path, f) for path in MODULES for f in kernels_of(path)]
    assert len(found) > 200
    too_many = {
        f"{name(path)}: {f.name}": count
        for path, f in found
        if (count := len([*f.args.posonlyargs, *f.args.args, *f.args.kwonlyargs])) > MOST_ARGUMENTS
    }
    assert too_many == {}


COMPUTING = {"cell", "estimate", "export", "fit", "forecast", "live", "printing"}
# Functions of these that a command calls by itself: files, names, settings, lines and words.
OF_A_COMMAND = {
    "assumed_text", "check_cells_in_series", "check_soc0", "is_plan", "list_stock",
    "make_estimator", "named_model", "plan_of_log", "power_settings", "read_model", "read_patch",
    "read_plan",    "read_sensor", "seen_by", "state_row", "write_model",
}  # fmt: skip


def test_commands_compose_and_compute_nothing():
    """A command calls one function of a station or of `workflows`, and prints what it gives."""
    called = set()
    for path in (PACKAGE / "cli").rglob("*.py"):
        dotted = imported(path)
        assert not any(one.split(".")[0] in ("numpy", "scipy") for one in dotted), name(path)
        for node in ast.walk(tree_of(path)):
            parts = (getattr(node, "module", None) or "").split(".")
            if (
                isinstance(node, ast.ImportFrom)
                and parts[0] == "cellwise"
                and parts[1] in COMPUTING
            ):
                called |= {one.name for one in node.names if one.name[0].islower()}
    assert called == OF_A_COMMAND, "what a command composes belongs to workflows"


def test_a_class_name_stands_for_one_class():
    places = defaultdict(list)
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(tree_of(path)):
            if isinstance(node, ast.ClassDef):
                places[node.name].append(path.relative_to(PACKAGE).as_posix())
    assert {name: paths for name, paths in places.items() if len(paths) > 1} == {}
