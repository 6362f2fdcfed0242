"""The site's builder touches only its own folder, and notices a Material that fetches something else."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture
def builder() -> Iterator[Any]:
    sys.path.insert(0, str(DOCS))
    import build_site

    yield build_site
    sys.path.remove(str(DOCS))


def test_a_folder_of_others_is_refused_and_stays(builder: Any, tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("years of work")
    with pytest.raises(SystemExit, match="was not made by this program"):
        builder.make_empty(tmp_path)
    with pytest.raises(SystemExit, match="was not made by this program"):
        builder.make_empty(tmp_path / "thesis.txt")
    assert (tmp_path / "thesis.txt").read_text() == "years of work"


def test_new_empty_and_own_folders_become_empty(builder: Any, tmp_path: Path) -> None:
    builder.make_empty(tmp_path / "new")
    (tmp_path / "empty").mkdir()
    for folder in (tmp_path / "new", tmp_path / "empty"):
        builder.make_empty(folder)
        (folder / "site").mkdir()
        (folder / "site" / "old.html").write_text("")
        builder.make_empty(folder)
        assert [path.name for path in folder.iterdir()] == [builder.MARK]


def test_the_tests_word_of_a_block_is_not_the_sites(
    builder: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Markdown's own parser knows no block with a second word, and would swallow what follows it."""
    monkeypatch.setattr(builder, "ROOT", tmp_path)
    (tmp_path / "a.md").write_text("```sh long\nls a b\n```\n\n## After\n\n  ```console\n  ls c d\n  ```\n")
    assert builder.page("a.md", tmp_path / "pages") == (
        "```sh\nls a b\n```\n\n## After\n\n  ```console\n  ls c d\n  ```\n"
    )


def test_each_text_of_a_board_is_listed_its_readme_first(builder: Any) -> None:
    paths = ["boards/README.md", "boards/b/DESIGN.md", "boards/b/README.md", "boards/a/README.md", "docs/x/y.md"]
    assert builder.boards(paths) == (
        "      - a: boards/a/README.md\n      - b: boards/b/README.md\n      - b, design: boards/b/DESIGN.md\n"
    )


def test_pages_take_their_script_from_the_site(builder: Any, tmp_path: Path) -> None:
    (tmp_path / "assets" / "javascripts").mkdir(parents=True)
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "page.html").write_text('<script src="https://unpkg.com/iframe-worker/shim"></script>')
    (tmp_path / "plain.html").write_text("<p>")
    builder.make_search_local(tmp_path)
    assert (tmp_path / "a" / "page.html").read_text() == (
        '<script src="../assets/javascripts/worker_on_files.js"></script>'
    )
    with pytest.raises(SystemExit, match="no page fetches"):
        builder.make_search_local(tmp_path)
