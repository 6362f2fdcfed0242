"""Pages of the reference, generated: verbs from the command line, messages from the schema, keys of board.toml.

The keys come from the table that tests/py/test_reference.py compares with the firmware's parser.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
PROTO_LINE = re.compile(
    r"^\s*(?:(?P<label>repeated|optional) )?(?P<type>[\w.]+) (?P<name>\w+) = (?P<number>\d+);\s*(?:// ?(?P<note>.*))?$"
)
PROTO_VALUE = re.compile(r"^\s*(?P<name>[A-Z]\w+) = (?P<number>\d+);\s*(?:// ?(?P<note>.*))?$")


def pages() -> dict[str, str]:
    """Text of each generated page by its file's name."""
    return {
        "cli.md": cli(),
        "python.md": python(),
        "messages.md": messages((ROOT / "proto" / "ruffini.proto").read_text()),
        "board-toml.md": board_keys(),
        "flags.md": flags((ROOT / "proto" / "ruffini.proto").read_text()),
    }


# ---- command line ------------------------------------------------------------------------------------


def verbs() -> Iterator[tuple[str, Any, str]]:
    """Name with its groups, click command and panel of the help; hidden ones are former names."""
    import typer

    from ruffini.cli.app import app
    from ruffini.cli.fit import click_command
    from ruffini.estimators.commands import COMMANDS

    def walk(name: str, command: Any, panel: str) -> Iterator[tuple[str, Any, str]]:
        panel = getattr(command, "rich_help_panel", None) or panel
        if not hasattr(command, "commands"):
            yield name, command, panel
            return
        for word, inner in command.commands.items():
            if not inner.hidden:
                yield from walk(f"{name} {word}".strip(), inner, panel)

    yield from walk("", typer.main.get_command(app), "")
    for command in COMMANDS:
        if command.options is not None:
            yield f"cal fit --only {command.name}", click_command(command), "Calibrate"


def cli() -> str:
    rows: dict[str, list[str]] = {}
    details = []
    for name, command, panel in verbs():
        first = cell((command.help or "").strip().split("\n\n")[0])
        rows.setdefault(str(panel), []).append(f"| [`{name}`](#{anchor(name)}) | {first} |")
        details += [
            f"## ruffini {name} {{ #{anchor(name)} }}\n",
            paragraphs(command.help or ""),
            "",
            *options(command),
            "",
        ]
    lines = [
        "# Command line\n",
        "Generated from the commands of `ruffini`. `--json` prints one object on stdout; progress goes to stderr. "
        "[Exit codes](flags.md#exit-codes).\n",
    ]
    for panel, table in rows.items():
        lines += [f"**{panel}**\n", "| verb | purpose |", "| --- | --- |", *table, ""]
    return "\n".join(lines + details)


def options(command: Any) -> list[str]:
    rows = []
    for parameter in command.params:
        if getattr(parameter, "hidden", False) or parameter.name == "help":
            continue
        is_option = parameter.param_type_name == "option"
        names = (
            ", ".join(f"`{o}`" for o in parameter.opts)
            if is_option
            else f"`{parameter.metavar or parameter.name.upper()}`"
        )
        default = parameter.default
        shown = (
            ""
            if default in (None, False, ()) or callable(default) or "Default" in type(default).__name__
            else f"`{default}`"
        )
        need = "required" if parameter.required else shown
        rows.append(f"| {names} | {cell(getattr(parameter, 'help', '') or '')} | {need} |")
    return ["| option | meaning | default |", "| --- | --- | --- |", *rows] if rows else []


def anchor(name: str) -> str:
    return re.sub(r"\W+", "-", name).strip("-")


def cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;")


def paragraphs(text: str) -> str:
    return "\n\n".join(" ".join(part.split()).replace("<", "&lt;") for part in text.strip().split("\n\n"))


# ---- Python ------------------------------------------------------------------------------------------


def python() -> str:
    """Directives of mkdocstrings, for what `import ruffini` offers."""
    import importlib

    import ruffini

    lines = [
        "# Python API\n",
        "Generated from the docstrings. [Python by example](../../host/README.md) is the introduction.\n",
    ]
    names = [name for name in ruffini.__all__ if not name.startswith("_")]
    for name in names:
        home = getattr(importlib.import_module("ruffini"), name).__module__
        lines.append(f"::: {home}.{name}\n")
    for name in result_types():
        lines.append(f"::: ruffini.device.results.{name}\n")
    return "\n".join(lines)


def result_types() -> list[str]:
    from ruffini.device import results

    return [
        n
        for n, v in vars(results).items()
        if isinstance(v, type) and v.__module__ == results.__name__ and not n.startswith("_")
    ]


# ---- wire --------------------------------------------------------------------------------------------


def messages(schema: str) -> str:
    """A table for each message and enumeration of the schema, with the comments that stand at its lines."""
    found: dict[str, tuple[str, list[str]]] = {}  # columns and lines of each, in the schema's order
    names: list[str] = []  # of what is open, from the outside; a oneof has no name of its own
    comment: list[str] = []
    for line in schema.splitlines():
        text = line.strip()
        if opened := re.match(r"(message|enum|oneof) (\w+) \{(.*)", text):
            names.append(opened[2] if opened[1] != "oneof" else "")
            if opened[1] != "oneof":
                columns = "value | number" if opened[1] == "enum" else "field | number, type"
                table = [f"| {columns} | meaning |", "| --- | --- | --- |"]
                found[".".join(names)] = (" ".join(comment), table)
                table += [row(f"{one};") for one in re.findall(r"\w+ \w+ = \d+", opened[3])]
            if "}" in opened[3]:
                names.pop()
        elif text == "}":
            names.pop()
        elif names and (shown := row(line)):
            found[".".join(name for name in names if name)][1].append(shown)
        comment = [*comment, text.removeprefix("//").strip()] if text.startswith("//") and "----" not in text else []
    lines = [
        "# Messages\n",
        "Generated from `proto/ruffini.proto`. Framing, units and rules: [wire](../../proto/README.md).\n",
    ]
    for name, (about, table) in found.items():
        rows = table if len(table) > 2 else ["No fields."]
        lines += [f"## {name}\n", *([cell(about), ""] if about else []), *rows, ""]
    return "\n".join(lines)


def row(line: str) -> str:
    if field := PROTO_LINE.match(line):
        kind = " ".join(part for part in (field["label"], field["type"]) if part)
        return f"| `{field['name']}` | {field['number']}, {kind} | {cell(field['note'] or '')} |"
    if value := PROTO_VALUE.match(line):
        return f"| `{value['name']}` | {value['number']} | {cell(value['note'] or '')} |"
    return ""


def flags(schema: str) -> str:
    """Flags with their symptom and remedy from host/README.md, validities, health, replies, exit codes."""
    symptoms = [
        linked(line)
        for line in (ROOT / "host" / "README.md").read_text().splitlines()
        if line.startswith("|") and "FLAG_" in line
    ]
    bodies = {name: body for name, body in re.findall(r"^enum (\w+) \{\n(.*?)^\}", schema, re.M | re.S)}
    lines = ["# Exit codes and flags\n", "## Exit codes\n", "| code | meaning |", "| --- | --- |", *exit_codes(), ""]
    for name in ("FlagBit", "Validity", "HealthBit", "ReplyCode"):
        lines += [f"## {name}\n", "| value | number | meaning |", "| --- | --- | --- |"]
        lines += [shown for line in bodies[name].splitlines() if (shown := row(line))] + [""]
    lines += ["## Flags: what to do\n", "| flags | cause and remedy |", "| --- | --- |", *symptoms, ""]
    return "\n".join(lines)


def exit_codes() -> list[str]:
    """From the help of the command line."""
    from ruffini.cli.app import app

    listed = str(app.info.epilog).removeprefix("Exit codes: ").rstrip(".").split(", ")
    return [f"| {one.split(' ', 1)[0]} | {one.split(' ', 1)[1]} |" for one in listed]


# ---- board.toml --------------------------------------------------------------------------------------

READS = re.compile(r'\.(?:integer|text|texts|choice|places|integers)\("(\w+)"')
OPENS = re.compile(r'\b(?:section|section_or)\("(\w+)"|\bsection_of_stages\(\s*in, board, "(\w+)"')
THREAD = re.compile(r'\bread_thread\(in, "(\w+)", (true|false)')


def parsed_keys() -> set[str]:
    """Keys that the firmware's parser asks for, as section.key."""
    found = set()
    for name in ("parse.cpp", "read_hardware.cpp"):
        text = (ROOT / "firmware" / "board" / name).read_text()
        opened = [(match.start(), match[1] or match[2]) for match in OPENS.finditer(text)]
        for match in READS.finditer(text):
            found.add(f"{[section for at, section in opened if at < match.start()][-1]}.{match[1]}")
        for match in THREAD.finditer(text):
            found |= {f"threads.{match[1]}_cpus"} | ({f"threads.{match[1]}_priority"} if match[2] == "true" else set())
    return found


def documented_keys() -> set[str]:
    """Keys of the page, as section.key."""
    found, section = set(), ""
    for line in board_keys().splitlines():
        section = line.removeprefix("## ") if line.startswith("## ") else section
        if cells := re.match(r"\| ((?:`\w+`(?:, )?)+) \|", line):
            found |= {f"{section}.{key}" for key in re.findall(r"`(\w+)`", cells[1])}
    return found


def board_keys() -> str:
    """The table of boards/README.md, a section each, so that a key can be searched and linked."""
    lines = [
        "# Keys of board.toml\n",
        "From the table in [boards](../../boards/README.md#boardtoml), which a test compares with the parser. "
        "Every key is required unless its line says otherwise. The unit ends the name: `_mpx` is 1/1000 pixel, "
        "`_mhz` 1/1000 Hz, `_un` micronewton, `_1e3` 1/1000.\n",
    ]
    table = (ROOT / "boards" / "README.md").read_text().partition("\n## board.toml\n")[2].partition("\n## ")[0]
    for line in table.splitlines():
        if opened := re.match(r"\| \*\*`\[(\w+)\]`\*\* \| \|(.*)\|$", line):
            about = linked(opened[2].strip())
            lines += ["", f"## {opened[1]}\n", *([about, ""] if about else []), "| key | range | meaning |"]
            lines.append("| --- | --- | --- |")
        elif re.match(r"\| `\w+`", line) and len(lines) > 2:
            lines.append(linked(line))
        elif lines[-1].startswith("|") and not line.startswith("|"):
            break
    return "\n".join(lines) + "\n"


def linked(text: str) -> str:
    """Links of boards/README.md, or of another folder's to a third one, as seen from docs/reference/."""
    return re.sub(
        r"\]\((?!https?:)([^)]+)\)",
        lambda m: f"](../../boards/{m[1]})" if not m[1].startswith("../") else f"](../{m[1]})",
        text,
    )
