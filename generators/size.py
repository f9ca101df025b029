#!/usr/bin/env python3
"""Where the lines are: modules, lines of code, docstrings and comments, functions and one-importer modules of each room.

    python generators/size.py            the table
    python generators/size.py --names    and the names: modules with one importer, classes whose name is used twice
    python generators/size.py --json     the same for machines

Code lines are lines with a token that is neither a docstring, a comment nor a line break. A room is a folder of `model`,
`fmu_build` or `cosim` (files directly in them count as a room of their own), `trajectories`, or `src`; benchmarks aren't counted,
not even the hard cases and peers, which a wheel has. C is counted in
lines of all `.c` and `.h` files of the four folders, tests in lines of `tests/**/*.py` and `tests/**/*.[ch]`.
"""

from __future__ import annotations

import ast
import io
import json
import statistics
import sys
import tokenize
from collections import Counter, defaultdict
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
FOLDERS = ("trajectories", "model", "fmu_build", "cosim", "src")
SKIPPED = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}


def room(path: Path) -> str:
    """The room of a module, by its path below the project."""
    parts = path.parts
    return "/".join(parts[:2]) if parts[0] in ("model", "fmu_build", "cosim") and len(parts) > 2 else parts[0]


def docstring_lines(tree: ast.AST) -> set[int]:
    """Numbers of the lines of all docstrings."""
    lines: set[int] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) and node.body:
            first = node.body[0]
            if (
                isinstance(first, ast.Expr)
                and isinstance(first.value, ast.Constant)
                and isinstance(first.value.value, str)
            ):
                lines |= set(range(first.lineno, (first.end_lineno or first.lineno) + 1))
    return lines


def body_length(node: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Lines of a function without its head and docstring."""
    body = [each for each in node.body if not (isinstance(each, ast.Expr) and isinstance(each.value, ast.Constant))]
    return (node.end_lineno or 0) - body[0].lineno + 1 if body else 0


def parse(root: Path = ROOT) -> tuple[dict[str, str], dict[str, str], dict[str, ast.Module]]:
    """Each module's room, text and syntax tree."""
    rooms: dict[str, str] = {}
    texts: dict[str, str] = {}
    for folder in FOLDERS:
        for path in sorted((root / folder).rglob("*.py")):
            relative = path.relative_to(root)
            parts = relative.with_suffix("").parts
            name = ".".join(parts[1:]) if folder == "src" else "flexfmu." + ".".join(parts)
            name = name.removesuffix(".__init__")
            rooms[name] = room(relative)
            texts[name] = path.read_text(encoding="utf-8")
    return rooms, texts, {name: ast.parse(text) for name, text in texts.items()}


def shared_names(trees: dict[str, ast.Module]) -> tuple[list[str], dict[str, list[str]]]:
    """Modules with one importer, and classes whose name is used twice with their modules."""
    classes: dict[str, list[str]] = defaultdict(list)
    importers: dict[str, set[str]] = defaultdict(set)
    # the front door imports names at their first use: its stubs list them
    stubs = {"flexfmu." + path.stem: path for path in (ROOT / "src" / "flexfmu").glob("*.pyi")}
    doors = ((name, ast.parse(path.read_text(encoding="utf-8"))) for name, path in stubs.items())
    for name, tree in (*trees.items(), *doors):
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef):
                classes[node.name] += [] if node.name.startswith("_") else [name]
            elif isinstance(node, ast.ImportFrom) and (node.module or "").startswith("flexfmu"):
                for each in node.names:
                    target = f"{node.module}.{each.name}"
                    importers[target if target in trees else str(node.module)].add(name)
            elif isinstance(node, ast.Import):
                for each in node.names:
                    importers[each.name].add(name)
    single = sorted(name for name in trees if len(importers[name]) == 1)
    return single, {name: homes for name, homes in sorted(classes.items()) if len(homes) > 1}


def measure(root: Path = ROOT) -> dict[str, Any]:
    """The figures of each room, their totals, and the names of modules with one importer and of classes whose name is used twice."""
    modules, texts, trees = parse(root)
    single, twice = shared_names(trees)
    rooms: dict[str, Counter[str]] = defaultdict(Counter)
    functions: dict[str, list[int]] = defaultdict(list)
    for name, text in texts.items():
        tree, count = trees[name], rooms[modules[name]]
        docs = docstring_lines(tree)
        code: set[int] = set()
        comments: set[int] = set()
        for token in tokenize.generate_tokens(io.StringIO(text).readline):
            if token.type == tokenize.COMMENT:
                comments.add(token.start[0])
            elif token.type not in SKIPPED:
                code |= set(range(token.start[0], token.end[0] + 1))
        code -= docs
        count.update(modules=1, lines=len(text.splitlines()), code=len(code), docs=len(docs), comments=len(comments))
        count["one_importer"] += name in single
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                functions[modules[name]].append(body_length(node))
            count["classes"] += isinstance(node, ast.ClassDef)
    table = {}
    for where, count in sorted(rooms.items()):
        lengths = sorted(functions[where]) or [0]
        table[where] = {
            **{key: count[key] for key in ("modules", "lines", "code", "docs", "comments", "classes", "one_importer")},
            "median_function": statistics.median(lengths),
            "p90_function": lengths[int(0.9 * (len(lengths) - 1))],
        }
    total = {
        key: sum(each[key] for each in table.values())
        for key in ("modules", "lines", "code", "classes", "one_importer")
    }

    def lines(folders: tuple[str, ...], suffixes: tuple[str, ...]) -> int:
        files = (path for folder in folders for path in (root / folder).rglob("*") if path.suffix in suffixes)
        return sum(len(path.read_text(encoding="utf-8", errors="replace").splitlines()) for path in files)

    total["c_lines"] = lines(FOLDERS, (".c", ".h"))
    total["test_lines"] = lines(("tests",), (".py", ".c", ".h"))
    total["class_names_used_twice"] = len(twice)
    return {"rooms": table, "total": total, "one_importer": single, "class_names_used_twice": twice}


def main() -> None:
    """Print the table."""
    result = measure()
    if "--json" in sys.argv:
        print(json.dumps(result, indent=1))
        return
    keys = (
        "modules",
        "lines",
        "code",
        "docs",
        "comments",
        "classes",
        "one_importer",
        "median_function",
        "p90_function",
    )
    print(f"{'room':26}" + "".join(f"{key.replace('_function', ' fn').replace('_', ' '):>13}" for key in keys))
    for where, count in result["rooms"].items():
        print(f"{where:26}" + "".join(f"{count[key]:13g}" for key in keys))
    print("total: " + ", ".join(f"{key.replace('_', ' ')} {value}" for key, value in result["total"].items()))
    if "--names" in sys.argv:
        print("one importer:", *result["one_importer"], sep="\n  ")
        print("class names used twice:")
        print(*(f"  {name}: {', '.join(homes)}" for name, homes in result["class_names_used_twice"].items()), sep="\n")


if __name__ == "__main__":
    main()
