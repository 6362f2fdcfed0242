"""Gates on the source tree. Each takes a checkout's root and returns one sentence for every violation."""

from __future__ import annotations

import ast
import functools
import re
import subprocess
import sys
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import tomllib

# What each room of the firmware may include, besides itself. Order of the pipeline, one direction.
FIRMWARE_MAY_INCLUDE: dict[str, set[str]] = {
    "base": set(),
    "board": {"base", "core"},  # the parser refuses what the table of the stages does not allow
    "image": {"base", "board", "store"},
    "solve": {"base", "board", "store"},
    "core": {"base", "board", "image", "solve", "store"},
    "estimators": {"base", "board", "image", "solve", "core", "store"},
    "stages": {"base", "board", "image", "solve", "core", "estimators", "store"},
    "frame_path": {"base", "board", "image", "solve", "core", "estimators", "store"},
    "capi": {"base", "board", "store", "frame_path", "image", "solve", "core", "estimators", "stages"},
    "capture": {"base", "board", "hw"},
    "store": {"base", "board"},
    "hw": {"base", "board"},
    "infer": {"base", "board", "capture"},
    "link": {"base", "board", "store", "infer", "frame_path", "image", "solve", "core", "estimators", "stages"},
    "daemon": {
        "base",
        "board",
        "capture",
        "store",
        "infer",
        "link",
        "hw",
        "frame_path",
        "image",
        "solve",
        "core",
        "estimators",
    },
}
CORE_ROOMS = ("base", "image", "solve", "core", "estimators", "stages", "frame_path")
# These sources are part of the core although their rooms hold more.
CORE_IN_MIXED_ROOMS = ("link/frame_codec", "link/dense_codec", "store/calibration")
# Headers that the core may take from the system: no file, no clock, no thread, no library of floats.
CORE_SYSTEM_HEADERS = {
    "algorithm", "array", "atomic", "bit", "cassert", "charconv", "compare", "concepts", "cstddef", "cstdint",
    "cstdlib", "cstring", "functional", "initializer_list", "iterator", "limits", "memory", "numeric", "optional",
    "span", "string", "string_view", "tuple", "type_traits", "utility", "variant", "vector",
    "arm_neon.h", "cpuid.h", "immintrin.h", "simde/arm/neon.h", "Eigen/Core",
}  # fmt: skip

HOST_ROOTS = ("host/ruffini/", "host/papers/")
# Packages of the host that must not know each other.
HOST_MUST_NOT_IMPORT: dict[str, set[str]] = {
    "fem": {"estimators", "sim", "core", "device", "record", "calibrate", "cli", "demo", "wire"},
    "sim": {"fem", "core", "device", "record", "cli", "demo", "wire"},
    "wire": {"estimators", "sim", "fem", "core", "device", "record", "calibrate", "cli", "demo", "boards"},
    "boards": {"estimators", "sim", "fem", "core", "device", "record", "calibrate", "cli", "demo", "wire"},
    "core": {"sim", "fem", "device", "record", "cli", "demo", "wire"},
    "device": {"sim", "fem", "cli", "demo"},
    "record": {"sim", "fem", "cli", "demo"},
    "calibrate": {"sim", "device", "record", "cli", "demo"},  # it reads the rig's logs
    "estimators": {"sim", "device", "record", "cli", "demo"},
    "auto": {"cli", "demo"},
    "rig": {"fem", "core", "record", "cli", "demo", "bench"},
}

# Names that one release of the standard library happens to bring with another header and the next does not.
STD_HEADERS = {
    "algorithm": "clamp|min|max|minmax|sort|stable_sort|copy|copy_n|fill|fill_n|find|find_if|any_of|all_of|none_of"
    "|count|count_if|nth_element|max_element|min_element|equal|reverse|rotate|lower_bound|upper_bound|transform|unique"
    "|shuffle|is_sorted|for_each|generate",
    "bit": "bit_width|bit_cast|countl_zero|countr_zero|popcount",
    "cmath": "sqrt|lround|llround|round|floor|ceil|hypot|sin|cos|tan|atan2|exp|log|pow|isnan|isfinite|fabs",
    "cstdio": "printf|fprintf|snprintf|fopen|FILE",
    "cstdlib": "abs|getenv",
    "cstring": "memcpy|memset|memcmp|memmove|strlen|strerror",
    "limits": "numeric_limits",
    "memory": "unique_ptr|shared_ptr|make_unique|make_shared",
    "numeric": "accumulate|iota|inner_product|gcd|lcm|partial_sum|midpoint",
    "optional": "optional|nullopt",
    "random": "mt19937|mt19937_64|normal_distribution|uniform_int_distribution|uniform_real_distribution",
    "tuple": "tuple|tie",
}

GENERATED = re.compile(r"(\.pb\.(c|h|cc)|_pb2\.pyi?|\.desc|\.(so|a|o|whl)|CMakeCache\.txt)$")
# Written in two halves so that this file passes its own gate.
WORKPLACE = re.compile(
    "|".join(["/wo" + r"rk/\w", r"\.\./sha" + "red", r"\.lib" + "rary/", "/tmp/" + "venv", "/opt/" + "wheels"])
)


def tracked(root: Path) -> list[Path]:
    """Files of the checkout that git knows, or all of them where there is no repository."""
    listed = subprocess.run(["git", "-C", str(root), "ls-files", "-z"], capture_output=True, text=True, check=False)
    if listed.returncode == 0 and (root / ".git").exists():
        return [path for name in listed.stdout.split("\0") if name and (path := root / name).is_file()]
    return [path for path in root.rglob("*") if path.is_file()]


def _text(path: Path) -> str:
    return path.read_text(errors="ignore")


def _sources(root: Path, *folders: str) -> Iterator[Path]:
    for path in tracked(root):
        name = path.relative_to(root).as_posix()
        if name.startswith(folders) and path.suffix in (".h", ".cpp", ".py"):
            yield path


def _room(name: str) -> str:
    """Room of a file below firmware/: its folder, or for files at the top their place in the order."""
    folder, _, rest = name.partition("/")
    if folder == "stages" and rest.endswith("_message.cpp"):
        return "link"  # what a stage adds to the wire's messages: not built into the core
    if rest:
        return folder
    return "frame_path" if folder.startswith("frame_") else "daemon"


def _is_core(name: str) -> bool:
    return _room(name) in CORE_ROOMS or name.startswith(CORE_IN_MIXED_ROOMS)


def firmware_layers(root: Path) -> list[str]:
    """Includes go one way: base <- image, solve <- core <- estimators <- stages, frame_path <- daemon."""
    found = []
    for path in _sources(root, "firmware/"):
        name = path.relative_to(root / "firmware").as_posix()
        room = _room(name)
        if room not in FIRMWARE_MAY_INCLUDE:
            found.append(f"firmware/{name}: room {room!r} has no place in the order: add it to tests/arch")
            continue
        for included in re.findall(r'^#include "([^"]+)"', _text(path), re.M):
            if not (root / "firmware" / included).exists():
                continue
            target = _room(included)
            if name.startswith("stages/") and target == "stages" and included.split("/")[1] != name.split("/")[1]:
                found.append(f"firmware/{name} includes {included}: a stage must not know another one")
            is_allowed = target == room or target in FIRMWARE_MAY_INCLUDE[room]
            if _is_core(name) and room != "base":
                is_allowed = is_allowed and (_is_core(included) or included == "board/settings.h")
            if not is_allowed:
                found.append(f"firmware/{name} includes {included}: {room} must not know {target}")
    return found


# Threads and descriptors: no file of the core includes them.
OF_THE_DAEMON = ("base/mailbox.h", "base/sleepers.h", "base/turnstile.h", "base/unique_fd.h")


def core_headers(root: Path) -> list[str]:
    """The core takes nothing from the system that could call it."""
    found = []
    for path in _sources(root, "firmware/"):
        name = path.relative_to(root / "firmware").as_posix()
        if not _is_core(name) or name in OF_THE_DAEMON:
            continue
        for header in re.findall(r"^#include <([^>]+)>", _text(path), re.M):
            if header not in CORE_SYSTEM_HEADERS:
                found.append(f"firmware/{name} includes <{header}>: the core makes no system call")
    return found


def _reached(root: Path, path: Path, seen: set[Path]) -> set[str]:
    """System headers that a file includes itself or through headers of the project."""
    reached = set()
    for included in re.findall(r'^#include [<"]([^>"]+)[>"]', _text(path), re.M):
        own = next((at for room in ("firmware", "tests/cpp") if (at := root / room / included).is_file()), None)
        if own is None:
            reached.add(included)
        elif own not in seen:
            seen.add(own)
            reached |= _reached(root, own, seen)
    return reached


def missing_includes(root: Path) -> list[str]:
    """A file includes the header of each standard name it uses: what works by luck breaks on the next Debian."""
    found = []
    for path in _sources(root, "firmware/", "tests/cpp/"):
        if path.suffix not in (".h", ".cpp"):
            continue
        reached = _reached(root, path, {path})
        if "cmath" in reached:
            reached.add("cstdlib")  # for std::abs, which both declare
        code = re.sub(r"//.*", "", _text(path))
        if "std::" not in code:
            continue
        for header, names in STD_HEADERS.items():
            used = re.search(rf"\bstd::(?:ranges::)?({names})\b", code)
            if used and header not in reached:
                found.append(f"{path.relative_to(root).as_posix()} uses {used[0]} without <{header}>")
    return found


def unbuilt_tests(root: Path) -> list[str]:
    """CMakeLists.txt names each C++ test, or globs its folder: a file that nothing compiles asserts nothing."""
    lists = root / "CMakeLists.txt"
    built = _text(lists) if lists.is_file() else ""
    return [
        f"{name} is compiled by no target of CMakeLists.txt"
        for path in _sources(root, "tests/cpp/")
        if (name := path.relative_to(root).as_posix()).endswith("_test.cpp")
        and name not in built
        and f"{name.rsplit('/', 1)[0]}/*_test.cpp" not in built
    ]


def thread_tests(root: Path) -> list[str]:
    """Under TSan run the device tests that CMakeLists.txt names in THREAD_TESTS: all in which threads run."""
    lists = root / "CMakeLists.txt"
    built = _text(lists) if lists.is_file() else ""
    others = re.search(r"add_executable\(ruffini_device_tests\s([^)]*)\)", built)
    if others is None:
        return (
            ["CMakeLists.txt has no ruffini_device_tests, of which those with threads run under TSan"] if built else []
        )
    found = []
    for name in re.findall(r"tests/cpp/\S+", others[1]):
        test = _text(root / name)
        headers = re.findall(r'^#include "([^"]+)\.h"', test, re.M)
        own = [root / "firmware" / (header + suffix) for header in headers for suffix in (".h", ".cpp")]
        texts = [test, *(_text(path) for path in own if path.is_file())]
        if any(re.search(r"\bstd::(j?thread|async)\b", text) for text in texts):
            found.append(f"{name} has threads: name it in THREAD_TESTS of CMakeLists.txt")
    return found


def shared_module_names(root: Path) -> list[str]:
    """Scripts import their neighbours by file name: of two files of one name, a process sees what it loads first."""
    first: dict[str, str] = {}
    found = []
    for path in sorted(_sources(root, "tests/", "host/examples/")):
        name = path.relative_to(root).as_posix()
        if path.suffix != ".py" or path.match("test_*.py") or path.name == "conftest.py":
            continue
        if (path.parent / "__init__.py").exists():
            continue
        other = first.setdefault(path.stem, name)
        if path.stem in sys.stdlib_module_names:
            found.append(f"{name} hides a module of Python: give it another name")
        elif other != name:
            found.append(f"{name} and {other} are one module to Python: give one of them another name")
    return found


@functools.cache
def _parsed(text: str) -> ast.Module:
    """Not to be changed: every gate that reads the same text gets the same tree."""
    return ast.parse(text)


@functools.cache
def _imports(text: str) -> tuple[str, ...]:
    """What a source imports, in its order."""
    names: list[str] = []
    for node in ast.walk(_parsed(text)):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            names += [f"{node.module}.{alias.name}" for alias in node.names]
    return tuple(names)


def host_layers(root: Path) -> list[str]:
    """Packages of the host that must not know each other do not import each other."""
    found = []
    for path in _sources(root, *HOST_ROOTS):
        top = path.relative_to(root / "host").parts[0]
        is_method = top == "papers" and path.name == "method.py"  # a reference that ours is judged by
        for name in _imports(_text(path)):
            if top == "ruffini" and name.partition(".")[0] == "papers":
                found.append(f"{path.relative_to(root)} imports {name}: the product must not know host/papers")
            if is_method and name.partition(".")[0] == "ruffini":
                found.append(f"{path.relative_to(root)} imports {name}: a paper's method must know nothing of ours")
    for path in _sources(root, "host/ruffini/"):
        parts = path.relative_to(root / "host" / "ruffini").parts
        package = parts[1] if parts[:2] == ("calibrate", "auto") else parts[0]  # `cal auto` plays all of them
        for name in _imports(_text(path)):
            parts = name.split(".")
            if parts[0] == "ruffini" and len(parts) > 1 and parts[1] in HOST_MUST_NOT_IMPORT.get(package, set()):
                found.append(f"{path.relative_to(root)} imports {name}: {package} must not know {parts[1]}")
    return found


def _module(root: Path, path: Path) -> str:
    """Dotted name of a module below host/."""
    name = ".".join(path.relative_to(root / "host").with_suffix("").parts)
    return name.removesuffix(".__init__")


def import_cycles(root: Path) -> list[str]:
    """No module of the host imports itself through others.

    Imports at the top, inside functions and for type checkers count alike; that a module's import also runs the
    `__init__` of the packages around it does not.
    """
    paths = {_module(root, path): path for path in _sources(root, *HOST_ROOTS)}
    graph: dict[str, set[str]] = {}
    for module, path in paths.items():
        named = {name if name in paths else name.rpartition(".")[0] for name in _imports(_text(path))}
        graph[module] = (named & paths.keys()) - {module}
    try:
        tuple(TopologicalSorter(graph).static_order())
    except CycleError as error:
        return [f"import cycle: {' <- '.join(error.args[1])}: move what both need to a module of its own"]
    return []


def board_names(root: Path) -> list[str]:
    """No source of firmware or host names a board: a board is a folder."""
    boards = [path.parent.name for path in (root / "boards").glob("*/board.toml")]
    found = []
    for path in _sources(root, "firmware/", "host/ruffini/"):
        text = _text(path).lower()
        for board in boards:
            name = board.lower()
            if name in text and re.search(rf"(?<![\w-]){re.escape(name)}(?![\w-])", text):
                found.append(f"{path.relative_to(root)} names the board {board!r}: take it from the board's folder")
    return found


def test_module_names(root: Path) -> list[str]:
    """The test folders are no packages: pytest cannot collect two modules of one name."""
    first: dict[str, Path] = {}
    names = sorted(path.relative_to(root) for path in tracked(root) if path.match("test_*.py"))
    return [
        f"{path} has the name of {other}: give it one of its own"
        for path in names
        if (other := first.setdefault(path.name, path)) != path
    ]


def workplace_paths(root: Path) -> list[str]:
    """No file names a path of the machine that it was written on."""
    text = {".h", ".cpp", ".py", ".md", ".toml", ".txt", ".cmake", ".proto", ".options", ".yml", ".json", ""}
    return [
        f"{path.relative_to(root)} names a path of this workplace: {match.group(0)}"
        for path in tracked(root)
        if path.suffix in text and (match := WORKPLACE.search(_text(path)))
    ]


def generated_files(root: Path) -> list[str]:
    """What the build makes is not in git."""
    return [
        f"{path.relative_to(root)} is generated: remove it from git"
        for path in tracked(root)
        if GENERATED.search(path.name)
    ]


def readme_commands(root: Path) -> list[str]:
    """Each `make` verb of README.md exists, and the first block is the two commands."""
    readme, verbs = _text(root / "README.md"), set(re.findall(r"^([a-z0-9-]+):", _text(root / "Makefile"), re.M))
    blocks = re.findall(r"^```sh\n(.*?)^```", readme, re.M | re.S)
    found = []
    if not blocks or blocks[0].split("\n")[:-1] != ["make run", "make test"]:
        found.append("README.md: the first ```sh block is not `make run` and `make test`")
    for verb in re.findall(
        r"^(?:sudo )?make ([a-z0-9-]+)", "\n".join(re.findall(r"^```\w*\n(.*?)^```", readme, re.M | re.S)), re.M
    ):
        if verb not in verbs:
            found.append(f"README.md: `make {verb}` is not in the Makefile")
    return found


def seeded_bugs(root: Path) -> list[str]:
    """Each bug of `make mutants` still has its place in the source, or it would be planted by nobody."""
    plan = root / "tests/mutants/seeded_bugs.toml"
    bugs = tomllib.loads(plan.read_text())["bug"] if plan.is_file() else []
    return [
        f"{plan.relative_to(root)}, {bug['name']!r}: its text is {n} times in {bug['file']}"
        for bug in bugs
        if (n := _text(root / bug["file"]).count(bug["find"])) != 1
    ]


ASKED = {"stages", "kinds", "stage", "tensors", "only", "program"}  # what stands for stages, kinds or programs
TESTS = {"isdisjoint", "issubset", "issuperset", "intersection", "difference", "count", "index", "startswith", "get"}
OWN_PROGRAMS = ("sim/", "cli/sim.py", "rig/program.py")  # programs are named here; those of the twin are others
REST = "rest"  # program of the twin that is called as a kind of a calibration is


def stage_names(root: Path) -> list[str]:
    """No module of the host outside estimators/ compares stages, kinds of a calibration or programs with a name.

    Seen are comparisons, set operations, `match`, loops over names and tables that are looked up by them, of the stages
    themselves or of a name that was given their value, with a word or with a constant of any module that holds it.
    """
    host = root / "host/ruffini"
    tables = [root / "firmware/core/stages.cpp", host / "calibrate/container.py", host / "rig/program.py"]
    text = "".join(_text(path) for path in [*tables, *host.glob("estimators/*/command.py")] if path.is_file())
    names = re.findall(
        r'(?<!features = {)\.name = "(\w+)"|^    "(\w+)": Kind\(|\b(?:Program|Command)\(\s*"(\w+)"', text, re.M
    )
    known = {name for row in names for name in row if name} - {"log"}  # a log of touches, more often than the program
    programs = {REST, *re.findall(r'\bProgram\(\s*"(\w+)"', text)}
    trees = {
        path: _parsed(_text(path))
        for path in _sources(root, "host/ruffini/")
        if path.suffix == ".py" and not path.is_relative_to(host / "estimators")
    }
    constants = {
        name: words & known
        for path, tree in trees.items()
        if path.name != "container.py"  # whose KINDS are the table itself
        for name, words in _constants(tree).items()
    }
    found = []
    for path, tree in trees.items():
        others = programs if path.relative_to(host).as_posix().startswith(OWN_PROGRAMS) else set()
        asked = _aliases(tree)
        for node in ast.walk(tree):
            if _is_test(node) and _names_in(node) & asked and (words := (_words_in(node, constants) & known) - others):
                found.append(
                    f"{path.relative_to(root)}:{node.lineno} tests for the stage {sorted(words)[0]!r}: ask the board "  # type: ignore[attr-defined]
                    "for a slot (Board.writes), the estimators (ruffini.estimators.table) or the program (PROGRAMS)"
                )
    return found


def _is_test(node: ast.AST) -> bool:
    if isinstance(node, ast.For):  # over names that are written there
        return isinstance(node.iter, ast.Tuple | ast.List | ast.Set)
    if isinstance(node, ast.Subscript):
        return isinstance(node.value, ast.Name | ast.Attribute)
    is_call = isinstance(node, ast.Call) and getattr(node.func, "attr", "") in TESTS
    return is_call or isinstance(node, ast.Compare | ast.BinOp | ast.Match)


def _parts(node: ast.AST) -> Iterator[ast.AST]:
    """The nodes of an expression; of a `match` those of its subject and patterns, not of what its cases do."""
    if isinstance(node, ast.For):
        yield from (*ast.walk(node.target), *ast.walk(node.iter))
    elif isinstance(node, ast.Match):
        for part in (node.subject, *(case.pattern for case in node.cases)):
            yield from ast.walk(part)
    else:
        yield from ast.walk(node)


def _names_in(node: ast.AST) -> set[str]:
    """Names and attributes, and keys that are looked up."""
    parts = [*_parts(node)]
    names = {n.attr for n in parts if isinstance(n, ast.Attribute)} | {n.id for n in parts if isinstance(n, ast.Name)}
    keys = [n.slice for n in parts if isinstance(n, ast.Subscript)]
    keys += [n.args[0] for n in parts if isinstance(n, ast.Call) and getattr(n.func, "attr", "") == "get" and n.args]
    return names | {key.value for key in keys if isinstance(key, ast.Constant) and isinstance(key.value, str)}


def _words_in(node: ast.AST, constants: dict[str, set[str]]) -> set[str]:
    """Words of an expression; of a tensor's name, KIND.NAME, its kind."""
    texts = {n.value for n in _parts(node) if isinstance(n, ast.Constant) and isinstance(n.value, str)}
    words = {text.partition(".")[0] for text in texts}
    return words.union(*(constants.get(name, set()) for name in _names_in(node)))


def _assigned(tree: ast.AST) -> Iterator[tuple[ast.expr, ast.expr]]:
    """Each target, and the expression that it takes its value or its values from."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Assign):
            yield from ((target, node.value) for target in node.targets)
        elif isinstance(node, ast.AnnAssign | ast.NamedExpr) and node.value is not None:
            yield node.target, node.value
        elif isinstance(node, ast.For | ast.comprehension):
            yield node.target, node.iter


def _constants(tree: ast.Module) -> dict[str, set[str]]:
    """Text in the constants of a module, by name: literals, and the keys and words of tables."""
    literal = (ast.Constant, ast.Set, ast.List, ast.Tuple, ast.Starred, ast.Name, ast.expr_context)
    found = dict[str, set[str]]()
    for node in tree.body:
        for target, value in _assigned(node):
            value = value.args[0] if _is_set_of(value) else value  # type: ignore[attr-defined]
            parts = [value]
            if isinstance(value, ast.Dict):
                parts = [key for key in value.keys if key] + [
                    one for one in value.values if isinstance(one, ast.Constant)
                ]
            inner = [node for part in parts for node in ast.walk(part)]
            if isinstance(target, ast.Name) and target.id.isupper() and all(isinstance(n, literal) for n in inner):
                found[target.id] = {n.value for n in inner if isinstance(n, ast.Constant) and isinstance(n.value, str)}
    return found


def _is_set_of(value: ast.expr) -> bool:
    return isinstance(value, ast.Call) and getattr(value.func, "id", "") in ("set", "frozenset") and bool(value.args)


def _aliases(tree: ast.Module) -> set[str]:
    """ASKED, and names that are given the value of one of them, or of a part of it."""
    asked, before = set(ASKED), set[str]()
    pairs = [
        (target.id, _names_in(value))
        for target, value in _assigned(tree)
        if isinstance(target, ast.Name) and _is_plain(value)
    ]
    while asked != before:
        before = set(asked)
        asked |= {name for name, names in pairs if names & asked}
    return asked


def _is_plain(value: ast.expr) -> bool:
    """True of a name, an attribute, or a set, list or part of one: not of what a function makes of it."""
    made = [n for n in ast.walk(value) if isinstance(n, ast.Call)]
    return all(getattr(n.func, "id", "") in ("set", "frozenset", "list", "tuple", "sorted") or
               getattr(n.func, "attr", "") in ("get", "split") for n in made)  # fmt: skip


STAGE_ROW = re.compile(
    r'\.name = "(?P<name>\w+)",\s*\.reads = \{(?P<reads>[^}]*)\},\s*\.reads_if_written = \{(?P<optional>[^}]*)\},\s*'
    r"(?:\.needs_one = true,\s*)?\.writes = \{(?P<writes>[^}]*)\},\s*\.amends = \{(?P<amends>[^}]*)\},\s*"
    r'\.sections = "(?P<sections>[^"]*)",\s*\.kind = "(?P<kind>[^"]*)",\s*\.part_of = "(?P<part>[^"]*)"'
)


def stage_drawing(root: Path) -> list[str]:
    """Each row of the stages' table in core/stages.cpp is drawn in firmware/README.md."""
    table, readme = root / "firmware/core/stages.cpp", root / "firmware/README.md"
    if not table.is_file():
        return []
    drawn = readme.read_text().splitlines()
    rows = list(STAGE_ROW.finditer(_text(table)))
    n_rows = len(re.findall(r"(?<!features = {)\.name = ", _text(table)))
    found = [] if len(rows) == n_rows else [f"{len(rows)} of {n_rows} rows of core/stages.cpp can be read"]
    for row in rows:
        slots = [re.sub(r"\bk(\w+)", r"\1", row[column]) for column in ("reads", "optional", "writes", "amends")]
        line = "| " + " | ".join([row["name"], *slots, row["sections"], row["kind"], row["part"]]) + " |"
        if re.sub(r" +", " ", line) not in drawn:
            found.append(
                f"firmware/README.md does not draw the stage {row['name']!r}: its row is {re.sub(r' +', ' ', line)}"
            )
    return found


# Messages of proto/ruffini.proto that say something of a frame, and their parts.
RESULT_MESSAGES = (
    "Wrench|Field|Residual|Depth|Contacts|Contact|Slip|SkinTouch|ToolTouch|ContactModel|Helmholtz|Markers|Learned|Image"
)
RESULT_UNIT = re.compile(r"_(un|um|nm|urad|upx|1e\d|um2_k|unmm)$|_lsb_|_un_um$")
STAMPED = ("wire", "device", "record", "api")  # packages that put messages in the order of their frames
RESULT_READERS = ("host/ruffini/wire/", "host/ruffini/device/results.py")


def raw_results(root: Path) -> list[str]:
    """Results of the stream are read in one module, host/ruffini/device/results.py; all others have its types."""
    schema = root / "proto/ruffini.proto"
    if not schema.is_file():
        return []
    bodies = re.findall(rf"^message (?:{RESULT_MESSAGES}) {{(.*?)^}}", _text(schema), re.S | re.M)
    named = re.findall(r"^  (?:repeated )?\w+ (\w+) = \d+;", "".join(bodies), re.M)
    trees = {path: _parsed(_text(path)) for path in _sources(root, "host/ruffini/") if path.suffix == ".py"}
    # Settings and rows of the core have some fields of the same name.
    others = {
        node.target.id
        for tree in trees.values()
        for part in ast.walk(tree)
        if isinstance(part, ast.ClassDef)
        for node in part.body
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name)
    }
    raw = {name for name in named if RESULT_UNIT.search(name)} - others
    found = []
    for path, tree in trees.items():
        name = path.relative_to(root).as_posix()
        if name.startswith(RESULT_READERS):
            continue
        refused = raw if name.split("/")[2] in STAMPED else raw | {"stamp"}
        found += [
            f"{name} reads {node.attr!r} of a message: take it from ruffini.device.results"
            for node in ast.walk(tree)
            if isinstance(node, ast.Attribute) and node.attr in refused
        ]
    return found


# Phrases that make a reader stop, each with what to write; grown from reviews.
AVOIDED = {
    r"how sure": "uncertainty, confidence, quality",
    r"\bdoubtful": "low-confidence",
    r"\blent\b": "forwarded, borrowed",
    r"\b(?:is|are|was|be|not) told\b": "is reported, measured, distinguished",
    r"\bwhat is left\b": "the residual, the rest",
    r"\bby itself\b": "automatically, alone",
    r"\bwhom\b": "the noun that is meant",
    r"\bverdict": "validity, result",
    r"\bgraded\b": "quality",
    r"\bfor who (?:has|wants|asks)\b": "for users who",
    r"\bwhat (?:it|its results|they) (?:is|are) worth\b": "validity and flags",
    r"\banew\b": "again",
    r"\bwhoever\b": "the noun that is meant",
}
DIVIDER = re.compile(r"\s*\|[ :|-]+\|$")


def _texts(root: Path) -> list[Path]:
    return [path for path in tracked(root) if path.suffix == ".md"]


def plain_words(root: Path) -> list[str]:
    """The texts avoid the phrases of AVOIDED."""
    return [
        f"{path.relative_to(root)}:{number}: {match[0]!r}: write {better}"
        for path in _texts(root)
        for number, line in enumerate(_text(path).splitlines(), 1)
        for phrase, better in AVOIDED.items()
        if (match := re.search(phrase, line, re.I))
    ]


def whole_tables(root: Path) -> list[str]:
    """Each table has a heading, and no blank line inside, which would end it."""
    found = []
    for path in _texts(root):
        lines = re.sub(r"^ *```.*?^ *```$", lambda m: "\n" * m[0].count("\n"), _text(path), flags=re.M | re.S).split(
            "\n"
        )
        for i, line in enumerate(lines):
            is_first = re.match(r" {0,3}\|", line) and not (i and re.match(r" *\|", lines[i - 1]))
            if is_first and not DIVIDER.match("".join(lines[i + 1 : i + 2])):
                found.append(f"{path.relative_to(root)}:{i + 1}: a row without a table: remove the blank line above it")
    return found
