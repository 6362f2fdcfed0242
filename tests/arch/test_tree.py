"""The tree keeps its own rules, and each rule catches a violation that is planted."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import tree_gates

REPO = Path(__file__).parents[2]
Gate = Callable[[Path], list[str]]
PROGRAM_ROWS = (
    'ALL = (Program("balls"), Program("indenters"))\nINDENTERS = "indenters"\nBY_STAGE = ("balls", INDENTERS)\n'
)
SKIN_ROW = '{.name = "skin", .reads = {}'
README = "```sh\nmake run\nmake test\n```\n"

# Gate, planted files, and a word that its sentence must have.
PLANTED: list[tuple[Gate, dict[str, str], str]] = [
    (
        tree_gates.firmware_layers,
        {"firmware/base/a.h": '#include "image/b.h"\n', "firmware/image/b.h": ""},
        "base must not know image",
    ),
    (
        tree_gates.firmware_layers,
        {"firmware/solve/a.cpp": '#include "link/b.h"\n', "firmware/link/b.h": ""},
        "solve must not know link",
    ),
    (
        tree_gates.firmware_layers,
        {"firmware/image/a.cpp": '#include "store/slot_store.h"\n', "firmware/store/slot_store.h": ""},
        "image must not know store",
    ),
    (
        tree_gates.firmware_layers,
        {"firmware/core/a.cpp": '#include "stages/skin/b.h"\n', "firmware/stages/skin/b.h": ""},
        "core must not know stages",
    ),
    (
        tree_gates.firmware_layers,
        {"firmware/stages/slip/a.cpp": '#include "stages/skin/b.h"\n', "firmware/stages/skin/b.h": ""},
        "a stage must not know another one",
    ),
    (tree_gates.firmware_layers, {"firmware/vision/a.cpp": ""}, "no place in the order"),
    (tree_gates.core_headers, {"firmware/image/a.cpp": "#include <fstream>\n"}, "<fstream>"),
    (tree_gates.core_headers, {"firmware/store/calibration.cpp": "#include <unistd.h>\n"}, "<unistd.h>"),
    (tree_gates.missing_includes, {"tests/cpp/a.cpp": "int a = std::clamp(1, 2, 3);\n"}, "<algorithm>"),
    (
        tree_gates.unbuilt_tests,
        {
            "CMakeLists.txt": "GLOB X tests/cpp/stages/*_test.cpp)\n tests/cpp/a_test.cpp\n",
            "tests/cpp/a_test.cpp": "",
            "tests/cpp/b_test.cpp": "",
            "tests/cpp/stages/c_test.cpp": "",
        },
        "tests/cpp/b_test.cpp is compiled by no target",
    ),
    (
        tree_gates.thread_tests,
        {
            "CMakeLists.txt": "add_executable(ruffini_device_tests\n  tests/cpp/a_test.cpp\n  tests/cpp/b_test.cpp)\n",
            "tests/cpp/a_test.cpp": "std::this_thread::yield();\n",
            "tests/cpp/b_test.cpp": '#include "hw/b.h"\n',
            "firmware/hw/b.cpp": "std::thread worker;\n",
        },
        "tests/cpp/b_test.cpp has threads",
    ),
    (
        tree_gates.shared_module_names,
        {"tests/bench/run.py": "", "tests/hostile/run.py": ""},
        "tests/hostile/run.py and tests/bench/run.py are one module",
    ),
    (tree_gates.shared_module_names, {"tests/vm/queue.py": ""}, "tests/vm/queue.py hides a module of Python"),
    (tree_gates.host_layers, {"host/ruffini/sim/a.py": "from ruffini.fem import slab\n"}, "sim must not know fem"),
    (tree_gates.host_layers, {"host/ruffini/cli/a.py": "def f():\n    import papers.b\n"}, "must not know host/papers"),
    (tree_gates.host_layers, {"host/papers/b/method.py": "import ruffini.fem\n"}, "must know nothing of ours"),
    (tree_gates.host_layers, {"host/ruffini/fem/a.py": "def f():\n    import ruffini.sim.pad\n"}, "must not know sim"),
    (
        tree_gates.import_cycles,
        {
            "host/ruffini/a.py": "from ruffini.room import b\n",
            "host/ruffini/room/b.py": "def f():\n    from ruffini.c import x\n",
            "host/ruffini/c.py": "if TYPE_CHECKING:\n    import ruffini.a\n",
        },
        "import cycle",
    ),
    (tree_gates.board_names, {"boards/toy/board.toml": "", "firmware/a.cpp": 'if (board == "toy") {}\n'}, "'toy'"),
    (
        tree_gates.stage_names,
        {
            "firmware/core/stages.cpp": SKIN_ROW,
            "host/ruffini/rig/a.py": 'def f(board):\n    return "skin" in board.pipeline.stages\n',
            "host/ruffini/estimators/skin/stage.py": 'def f(board):\n    return "skin" in board.pipeline.stages\n',
        },
        "host/ruffini/rig/a.py:2 tests for the stage 'skin'",
    ),
    (
        tree_gates.stage_names,
        {
            "firmware/core/stages.cpp": SKIN_ROW,
            "host/ruffini/sim/a.py": 'def f(board):\n    return "skin" in board.pipeline.stages\n',
        },
        "host/ruffini/sim/a.py:2 tests for the stage 'skin'",
    ),
    (
        tree_gates.stage_names,
        {
            "firmware/core/stages.cpp": SKIN_ROW,
            "host/ruffini/cli/a.py": 'def f(stages):\n    return {"skin"}.isdisjoint(stages)\n',
        },
        "host/ruffini/cli/a.py:2 tests for the stage 'skin'",
    ),
    *(
        (
            tree_gates.stage_names,
            {"firmware/core/stages.cpp": SKIN_ROW, "host/ruffini/cli/a.py": "\n".join(lines)},
            f"host/ruffini/cli/a.py:{at} tests for the stage 'skin'",
        )
        for at, lines in (
            (3, ("def f(board):", "    used = set(board.pipeline.stages)", '    return "skin" in used')),
            (2, ("def f(file):", '    return any(kind == "skin" for kind in file.kinds)')),
            (3, ("def f(file):", '    for one in file.metadata["kinds"].split(","):', '        return one == "skin"')),
            (3, ('OF_SKINS = frozenset({"skin"})', "def f(file):", "    return OF_SKINS & set(file.kinds)")),
            (2, ("def f(stage):", "    match stage:", '        case "skin" | "slip":', "            return 1")),
            (2, ("def f(file):", '    return "skin.light" in file.tensors')),
        )
    ),
    *(
        (
            tree_gates.stage_names,
            {
                "host/ruffini/estimators/skin/command.py": 'COMMAND = Command("skin", former_verb="touch")\n',
                "host/ruffini/rig/program.py": PROGRAM_ROWS,
                "host/ruffini/cli/a.py": "\n".join(lines),
            },
            f"host/ruffini/cli/a.py:{at} tests for the stage '{name}'",
        )
        for at, name, lines in (
            (3, "skin", ('OLD = {"touch": "skin"}', "def f(only):", "    return only in OLD")),
            (3, "skin", ('GONE = {("skin", "--method"): "x"}', "def f(stage):", '    return GONE.get((stage, "-"))')),
            (3, "skin", ('FITS = {"skin": print}', "def f(stage):", "    return FITS[stage]")),
            (2, "skin", ("def f(app):", '    for stage in ("skin", "touch"):', "        app.add(stage)")),
            (2, "indenters", ("def f(task):", '    return task.program == "indenters"')),
            (3, "indenters", ('BOLTED = ("nothing", INDENTERS)', "def f(program):", "    return program == INDENTERS")),
            (2, "balls", ("def f(program):", "    return program in BY_STAGE")),
        )
    ),
    (tree_gates.test_module_names, {"tests/a/test_x.py": "", "tests/b/test_x.py": ""}, "of its own"),
    (tree_gates.workplace_paths, {"tests/a.py": 'open("/wo' + 'rk/main/x")\n'}, "workplace"),
    (tree_gates.generated_files, {"host/ruffini/ruffini_pb2.py": ""}, "generated"),
    (
        tree_gates.readme_commands,
        {"README.md": README + "```sh\nmake coffee\n```\n", "Makefile": "run:\ntest:\n"},
        "make coffee",
    ),
    (
        tree_gates.seeded_bugs,
        {
            "tests/mutants/seeded_bugs.toml": "[[bug]]\nname = 'b'\nfile = 'firmware/a.cpp'\nfind = 'x;'\n",
            "firmware/a.cpp": "x; x;",
        },
        "2 times in firmware/a.cpp",
    ),
    (tree_gates.readme_commands, {"README.md": "```sh\nmake test\n```\n", "Makefile": "test:\n"}, "first"),
    (
        tree_gates.stage_drawing,
        {
            "firmware/core/stages.cpp": '{.name = "skin", .reads = {kDepth}, .reads_if_written = {}, '
            '.writes = {kSkin}, .amends = {}, .sections = "skin", .kind = "", .part_of = ""}',
            "firmware/README.md": "| skin | | | Skin | | skin | | |\n",
        },
        "does not draw the stage 'skin'",
    ),
    (
        tree_gates.raw_results,
        {
            "proto/ruffini.proto": "message Contact {\n  sint64 force_x_un = 5;\n  bool slip = 6;\n}\n",
            "host/ruffini/ros/a.py": "def f(m, c): return m.force_x_un, c.slip\n",
            "host/ruffini/device/results.py": "def f(m): return m.force_x_un, m.stamp\n",
        },
        "host/ruffini/ros/a.py reads 'force_x_un' of a message",
    ),
    (tree_gates.plain_words, {"a.md": "How sure it is.\n"}, "write uncertainty"),
    (tree_gates.whole_tables, {"a.md": "| a |\n| --- |\n| b |\n\n| c |\n"}, "a.md:5"),
]
# Nothing of these is a violation.
HARMLESS: list[tuple[Gate, dict[str, str]]] = [
    (
        tree_gates.stage_names,
        {
            "firmware/core/stages.cpp": SKIN_ROW,
            "host/ruffini/calibrate/container.py": 'KINDS = {\n    "wrench": Kind(),\n}\nx = kinds - KINDS.keys()\n',
            "host/ruffini/cli/a.py": 'def f(kinds, organ):\n    n = len(kinds)\n    return n and organ == "skin"\n',
            "host/ruffini/rig/program.py": PROGRAM_ROWS + 'def f(program):\n    return program == "balls"\n',
            "host/ruffini/sim/a.py": 'def f(program):\n    return program == "balls"\n',
            "host/ruffini/cli/c.py": "def f(program):\n    return PROGRAMS[program].is_by_stage\n",
            "host/ruffini/cli/b.py": 'from ruffini.cli import skin\n\nVERBS = {"skin": skin}\ntitle = "skin" + ": "\n',
        },
    ),
]
GATES: list[Gate] = list(dict.fromkeys(gate for gate, _, _ in PLANTED))


@pytest.mark.parametrize("gate", GATES, ids=lambda gate: gate.__name__)
def test_tree_keeps_its_rules(gate: Gate) -> None:
    assert gate(REPO) == []


@pytest.mark.parametrize(("gate", "files", "sentence"), PLANTED)
def test_planted_violation_is_caught(gate: Gate, files: dict[str, str], sentence: str, tmp_path: Path) -> None:
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    found = gate(tmp_path)
    assert len(found) == 1
    assert sentence in found[0]


@pytest.mark.parametrize(("gate", "files"), HARMLESS)
def test_what_is_no_violation_passes(gate: Gate, files: dict[str, str], tmp_path: Path) -> None:
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    assert gate(tmp_path) == []
