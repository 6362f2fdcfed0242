"""The static site: pages from the tracked texts and the generated reference, built by MkDocs.

The pages are the repository's own texts at their own paths, so that their links work here and there alike. Files that
they link to (pictures, sources, examples) are copied beside them. A link to a folder goes to its README.md, or becomes
plain text if there is none.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import reference

ROOT = Path(__file__).resolve().parents[1]
TEXT_ROOTS = ("boards/", "docs/", "firmware/", "host/", "proto/", "tests/README.md")
WORKER = "worker_on_files.js"
FETCHED = "https://unpkg.com/iframe-worker/shim"
MARK = ".made-by-build-site"
LINK = re.compile(r"(!?\[(?:[^\]\[]|\[[^\]]*\])*\])\((?!https?:|mailto:|#)([^)\s#]+)(#[^)\s]*)?\)")
TESTS_WORD = re.compile(r"^( *```\w+) \w.*$", re.M)
BLOCK = re.compile(r"(^ *```.*?^ *```$)", re.M | re.S)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path, help="folder to make: pages/ and site/")
    out = parser.parse_args().out.resolve()
    make_empty(out)
    for path in texts():
        write(out / "pages" / path, page(path, out / "pages"))
    for name, text in reference.pages().items():
        write(out / "pages" / "docs" / "reference" / name, text)
    config = (ROOT / "docs" / "mkdocs.yml").read_text().replace("SOURCES", str(ROOT / "host"))
    config = config.replace("BOARDS\n", boards(texts()))
    write(out / "mkdocs.yml", config)
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--config-file", str(out / "mkdocs.yml")]
    done = subprocess.run(command, env={**os.environ, "NO_MKDOCS_2_WARNING": "1"}, check=False)
    if done.returncode:
        raise SystemExit("docs: the pages named above have broken links or are missing from nav in docs/mkdocs.yml")
    make_search_local(out / "site")
    print(out / "site" / "index.html")


def make_empty(out: Path) -> None:
    """An empty folder; what an earlier build left there is removed, anything else is refused."""
    if out.exists() and not (out / MARK).is_file() and (not out.is_dir() or any(out.iterdir())):
        raise SystemExit(f"docs: {out} was not made by this program: give a new or an empty folder, or remove it first")
    shutil.rmtree(out, ignore_errors=True)
    write(out / MARK, "The next build removes this folder.\n")


def make_search_local(site: Path) -> None:
    """Replace the script that Material fetches from the network, for pages opened as files, by our own."""
    shutil.copyfile(ROOT / "docs" / WORKER, site / "assets" / "javascripts" / WORKER)
    fetching = [path for path in site.rglob("*.html") if FETCHED in path.read_text()]
    if not fetching:
        raise SystemExit(f"docs: no page fetches {FETCHED}: see what this version of Material fetches for its search")
    for path in fetching:
        place = os.path.relpath(site / "assets" / "javascripts" / WORKER, path.parent)
        path.write_text(path.read_text().replace(FETCHED, place))


def tracked() -> list[str]:
    return subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout.splitlines()


def texts() -> list[str]:
    """Paths of the pages."""
    return [
        p
        for p in tracked()
        if p.endswith(".md") and ("/" not in p or p.startswith(TEXT_ROOTS)) and (ROOT / p).is_file()
    ]


def boards(paths: list[str]) -> str:
    """Entries of nav for the texts of each board, its README first."""
    pages = sorted((p for p in paths if p.startswith("boards/") and p.count("/") == 2),
                   key=lambda p: (Path(p).parent, Path(p).name != "README.md", p))  # fmt: skip
    titles = [Path(p).parent.name + ("" if p.endswith("/README.md") else f", {Path(p).stem.lower()}") for p in pages]
    return "".join(f"      - {title}: {path}\n" for title, path in zip(titles, pages, strict=True))


def page(path: str, pages: Path) -> str:
    """The text, its links mended and what they lead to copied; blocks of code stay as they are.

    A second word after a block's language is for the tests that run it: Markdown's own parser takes no such block.
    """
    parts = BLOCK.split(TESTS_WORD.sub(r"\1", (ROOT / path).read_text()))
    return "".join(part if i % 2 else LINK.sub(lambda m: mended(path, pages, m), part) for i, part in enumerate(parts))


def mended(path: str, pages: Path, match: re.Match[str]) -> str:
    text, target, anchor = match[1], match[2], match[3] or ""
    at = (ROOT / path).parent / target
    if at.is_dir():
        if not (at / "README.md").is_file():
            return text[1:-1]
        return f"{text}({target.rstrip('/')}/README.md{anchor})"
    if at.is_file() and at.suffix != ".md":
        copy = pages / at.resolve().relative_to(ROOT)
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(at, copy)
    return match[0]


def write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


if __name__ == "__main__":
    main()
