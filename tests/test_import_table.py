"""The rooms import only what the architecture allows, and stay small."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[1] / "src" / "openclone"
MAX_FILE_LINES = 400
MAX_FUNCTION_LINES = 60

# Room -> rooms it may import besides itself; `errors` is open to all.
TABLE: dict[str, set[str]] = {
    "spatial": set(),
    "robot": {"spatial"},
    "motion": {"spatial", "robot"},
    "policy": {"spatial", "robot"},
    "training": {"spatial", "robot", "motion", "policy", "odometry"},
    "odometry": {"spatial"},
    "simulation": {"spatial", "robot"},
    "teleop": {"spatial", "robot", "policy", "odometry", "simulation"},
    "evaluation": {
        "spatial", "robot", "motion", "policy", "training", "odometry",
        "simulation", "teleop",
    },
    "viewer": {"spatial", "robot", "teleop"},
    "errors": set(),
    "weights": set(),
}  # fmt: skip
# Rooms that must run on a robot's computer, where no learning framework is installed.
HEAVY = {
    "torch": {"spatial", "policy", "training"},
    "rsl_rl": {"policy", "training"},
    "mink": {"motion"},
    "viser": {"viewer"},
    "mjviser": {"viewer"},
    "av": {"evaluation"},
    "matplotlib": {"evaluation"},
}
FILES = sorted(SOURCE.rglob("*.py"))


def place(path: Path) -> str:
    return str(path.relative_to(SOURCE))


def room_of(path: Path) -> str:
    return path.relative_to(SOURCE).parts[0].removesuffix(".py")


def imported_modules(path: Path, text: str | None = None) -> set[str]:
    """Every module named in an import statement, also inside functions."""
    package = ["openclone", *path.relative_to(SOURCE).parts[:-1]]
    names: set[str] = set()
    for node in ast.walk(ast.parse(text or path.read_text())):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            module = ".".join([*base, *([node.module] if node.module else [])])
            names.add(module)
            names.update(f"{module}.{alias.name}" for alias in node.names)
    return names


def imported_rooms(path: Path) -> set[str]:
    parts = [name.split(".") for name in imported_modules(path)]
    return {item[1] for item in parts if item[0] == "openclone" and len(item) > 1}


def test_every_room_stands_in_the_table() -> None:
    rooms = {room_of(path) for path in FILES} - {"__init__", "cli"}
    assert rooms <= set(TABLE)


@pytest.mark.parametrize("path", FILES, ids=place)
def test_room_imports(path: Path) -> None:
    room = room_of(path)
    rooms = imported_rooms(path) - {"errors", room, "__version__"}
    assert "cli" not in rooms
    if room == "cli":
        return
    assert "viewer" not in rooms
    assert rooms <= TABLE.get(room, set())


@pytest.mark.parametrize("path", FILES, ids=place)
def test_heavy_packages_stay_in_their_rooms(path: Path) -> None:
    packages = {name.partition(".")[0] for name in imported_modules(path)}
    wrong = {name for name in packages & set(HEAVY) if room_of(path) not in HEAVY[name]}
    assert not wrong


def test_the_reader_sees_hidden_imports() -> None:
    """An import inside a function and a relative one count."""
    text = "def f():\n    from ..viewer import app\n    import torch.nn\n"
    names = imported_modules(SOURCE / "motion" / "imaginary.py", text)
    assert {"openclone.viewer.app", "torch.nn"} <= names


@pytest.mark.parametrize("path", FILES, ids=place)
def test_files_and_functions_stay_small(path: Path) -> None:
    text = path.read_text()
    assert len(text.splitlines()) <= MAX_FILE_LINES
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            lines = (node.end_lineno or node.lineno) - node.lineno + 1
            assert lines <= MAX_FUNCTION_LINES, f"{node.name}: {lines} lines"
