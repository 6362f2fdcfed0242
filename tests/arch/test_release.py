"""`make release` in a repository of its own: what it refuses, and what a release then consists of."""

from __future__ import annotations

import os
import shutil
import subprocess
from importlib.machinery import SourceFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
LOADER = SourceFileLoader("release", str(ROOT / ".ci/release"))
release = module_from_spec(spec_from_loader("release", LOADER))
LOADER.exec_module(release)

MADE_BY_STUBS = """
wheels: ; test "$$RUFFINI_RELEASE" = 1 && mkdir -p build/wheels && \\
  for machine in x86_64 aarch64; do echo wheel > build/wheels/ruffini-7.8.9-py3-none-manylinux_2_31_$$machine.whl; done
deb: ; mkdir -p build/deb && echo deb > build/deb/ruffini_7.8.9_amd64.deb
arm64: ; mkdir -p build/deb-arm64 && echo deb > build/deb-arm64/ruffini_7.8.9_arm64.deb
"""


# Neither a hook's repository nor a person's settings.
NAMES = ("GIT_AUTHOR_NAME", "GIT_AUTHOR_EMAIL", "GIT_COMMITTER_NAME", "GIT_COMMITTER_EMAIL")
ENVIRONMENT = {name: value for name, value in os.environ.items() if not name.startswith("GIT_")}
ENVIRONMENT |= {"GIT_CONFIG_GLOBAL": "/dev/null", "GIT_CONFIG_NOSYSTEM": "1"} | dict.fromkeys(NAMES, "test")


def git(root: Path, *words: str) -> None:
    subprocess.run(["git", "-C", str(root), *words], check=True, capture_output=True, env=ENVIRONMENT)


def run(root: Path, *words: str) -> tuple[int, str]:
    command = [str(root / ".ci/release"), *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=ENVIRONMENT)
    return done.returncode, done.stderr


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """Version 7.8.9, committed and tagged, its changelog closed."""
    root = tmp_path / "checkout"
    for name in [*release.STATED, ".ci/release"]:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(ROOT / name, root / name)
    (root / "CHANGELOG.md").write_text("# Changelog\n\n## 7.8.9 (2026-11-26)\n\nAll.\n\n## 0.1.0\n")
    (root / "Makefile").write_text(MADE_BY_STUBS)
    (root / ".gitignore").write_text("/build/\n")
    assert run(root, "version", "7.8.9") == (0, "")
    git(root, "init")
    git(root, "add", "-A")
    git(root, "commit", "-m", "7.8.9")
    git(root, "tag", "v7.8.9")
    return root


def test_the_tree_states_one_version() -> None:
    assert release.disagreements(ROOT) == []


def test_a_version_is_written_to_every_file_and_to_nothing_else(checkout: Path) -> None:
    assert all(said == {"7.8.9"} for said in release.stated(checkout).values())
    for name in release.STATED:
        before, after = (ROOT / name).read_text().splitlines(), (checkout / name).read_text().splitlines()
        changed = [(a, b) for a, b in zip(before, after, strict=True) if a != b]
        assert 1 <= len(changed) <= 2, name
        assert all("7.8.9" in b for _, b in changed)


def test_what_is_no_release_is_refused_in_one_sentence_each(checkout: Path) -> None:
    assert run(checkout, "check") == (0, "")
    path = checkout / "host/pyproject.toml"
    path.write_text(path.read_text().replace("7.8.9", "7.8.8"))
    (checkout / "CHANGELOG.md").write_text("# Changelog\n\n## 7.8.9 (in preparation)\n")
    (checkout / "host/ruffini/left_over.py").touch()
    git(checkout, "config", "status.showUntrackedFiles", "no")
    git(checkout, "tag", "-d", "v7.8.9")
    code, text = run(checkout, "make")
    assert code == 1
    for sentence in (
        "host/pyproject.toml states 7.8.8 and host/ruffini/version.py 7.8.9: run make version",
        'CHANGELOG.md begins with "7.8.9 (in preparation)": close the section as "7.8.9 (YYYY-MM-DD)"',
        "3 files are not committed",
        "no tag v7.8.9: git tag -s v7.8.9",
    ):
        assert sentence in text
    assert not (checkout / "build").exists()
    git(checkout, "tag", "v7.8.9", "HEAD")
    git(checkout, "commit", "-am", "after it")
    assert "no tag v7.8.9" in run(checkout, "check")[1], "of another commit"
    assert run(checkout, "version", "7.8") == (2, "release: '7.8' is no version: make version NEW=X.Y.Z\n")


def test_a_release_is_all_that_was_made_with_its_checksums(checkout: Path) -> None:
    assert run(checkout, "make")[0] == 0
    out = checkout / "build/release"
    assert sorted(path.name for path in out.iterdir()) == [
        "SHA256SUMS", "ruffini-7.8.9-py3-none-manylinux_2_31_aarch64.whl",
        "ruffini-7.8.9-py3-none-manylinux_2_31_x86_64.whl",
        "ruffini-7.8.9.tar.gz", "ruffini_7.8.9_amd64.deb", "ruffini_7.8.9_arm64.deb",
    ]  # fmt: skip
    subprocess.run(["sha256sum", "--check", "--strict", "SHA256SUMS"], cwd=out, check=True, capture_output=True)
    assert len((out / "SHA256SUMS").read_text().splitlines()) == 5
    assert (out.parent / "changes.md").read_text() == "All.\n"
    listed = subprocess.run(["tar", "tf", "ruffini-7.8.9.tar.gz"], cwd=out, capture_output=True, text=True, check=True)
    assert "ruffini-7.8.9/CMakeLists.txt" in listed.stdout.splitlines()


@pytest.mark.parametrize(
    ("stubs", "sentence"),
    [
        (MADE_BY_STUBS.replace("> build/deb/", "> build/wheels/"), "build/deb/*.deb: nothing was made"),
        (MADE_BY_STUBS.replace("deb: ;", "deb: ; false &&"), "make deb failed: see above; nothing in build/release is"),
    ],
)
def test_a_part_that_is_not_made_ends_it(checkout: Path, stubs: str, sentence: str) -> None:
    (checkout / "Makefile").write_text(stubs)
    git(checkout, "commit", "-am", "spoilt")
    git(checkout, "tag", "-f", "v7.8.9")
    code, text = run(checkout, "make")
    assert (code, sentence in text) == (1, True)
    assert not (checkout / "build/release/SHA256SUMS").exists()
