"""The C++ consumer as somebody else's project finds it: installed, by CMake's find_package and by pkg-config."""

from __future__ import annotations

import io
import os
import re
import shutil
import subprocess
import tarfile
import tempfile
from pathlib import Path

import pytest
from kept import kept

import ruffini

ROOT = Path(__file__).parents[3]
# WRENCH of 1 mN that presses, from proto/vectors: "wrench and how sure it is".
VECTORS = ROOT / "proto" / "vectors" / "frames.txt"

PROGRAM = """
#include <ruffini/client.h>

#include <cstdio>
#include <variant>

int main() {
  ruffini::client::Decoder decoder;
  uint8_t byte = 0;
  while (std::fread(&byte, 1, 1, stdin) == 1) {
    for (const auto& packet : decoder.feed(&byte, 1)) {
      std::printf("%.4f N\\n", std::get<ruffini::client::Wrench>(packet.message).force_n[2].value);
    }
  }
}
"""
PROJECT = f"""
cmake_minimum_required(VERSION 3.16)
project(somebody LANGUAGES CXX)
find_package(ruffini_client {ruffini.__version__} REQUIRED)
add_executable(newtons main.cpp)
target_link_libraries(newtons PRIVATE ruffini::client)
"""


def run(*command: str | Path, cwd: Path, **more: str) -> str:
    """Its output; what it complained of where it fails."""
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, env={**os.environ, **more}, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def installed(sources: Path, commands: str, tools: str) -> bytes:
    """What `commands` install from a copy of the sources alone, as a tar; `tools`: versions of what they use."""
    with tempfile.TemporaryDirectory() as folder, io.BytesIO() as out:
        root = Path(folder)
        shutil.copytree(sources, root / "host" / "cpp")
        run("bash", "-euc", commands, cwd=root, CXXFLAGS="-Werror")
        with tarfile.open(fileobj=out, mode="w") as archive:
            archive.add(root / "out" / "prefix", ".")
        return out.getvalue()


@pytest.fixture(scope="module")
def prefix(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """host/cpp, built and installed by the commands of its README, word for word, then moved as whoever packs it does.

    Rebuilt if a source file, the command or a tool changes.
    """
    moved = tmp_path_factory.mktemp("package") / "moved"
    (commands,) = re.findall(r"```sh\n(.*?)```", (ROOT / "host" / "cpp" / "README.md").read_text(), re.S)
    tools = "".join(run(tool, "--version", cwd=ROOT) for tool in ("c++", "cmake"))
    with tarfile.open(fileobj=io.BytesIO(kept(installed, ROOT / "host" / "cpp", commands, tools))) as archive:
        archive.extractall(moved)
    return moved


def says(program: Path) -> str:
    """What the program makes of the golden wrench."""
    (golden,) = [line for line in VECTORS.read_text().splitlines() if line.startswith("wrench and how sure")]
    data = bytes.fromhex(golden.split(" | ")[1])
    return subprocess.run([program], input=data, capture_output=True, check=True).stdout.decode()


def test_a_project_finds_it_with_cmake(prefix: Path, tmp_path: Path) -> None:
    (tmp_path / "main.cpp").write_text(PROGRAM)
    (tmp_path / "CMakeLists.txt").write_text(PROJECT)
    run("cmake", "-S", ".", "-B", "build", f"-DCMAKE_PREFIX_PATH={prefix}", cwd=tmp_path)
    run("cmake", "--build", "build", cwd=tmp_path)
    assert says(tmp_path / "build" / "newtons") == "-0.0010 N\n"


def test_a_compiler_finds_it_with_pkg_config(prefix: Path, tmp_path: Path) -> None:
    (tmp_path / "main.cpp").write_text(PROGRAM)
    where = str(next(prefix.rglob("pkgconfig")))
    flags = run("pkg-config", "--cflags", "--libs", "ruffini_client", cwd=tmp_path, PKG_CONFIG_PATH=where).split()
    run("c++", "-std=c++17", "main.cpp", "-o", "newtons", *flags, cwd=tmp_path)
    assert says(tmp_path / "newtons") == "-0.0010 N\n"
    version = run("pkg-config", "--modversion", "ruffini_client", cwd=tmp_path, PKG_CONFIG_PATH=where)
    assert version.strip() == ruffini.__version__


def test_pkg_config_finds_a_multiarch_installation(tmp_path: Path) -> None:
    """Debian's own folder of libraries is one level deeper."""
    libraries = "lib/x86_64-linux-gnu"
    run("cmake", "-S", ROOT / "host" / "cpp", "-B", "build", f"-DCMAKE_INSTALL_LIBDIR={libraries}", cwd=tmp_path)
    folder = tmp_path / "usr" / libraries / "pkgconfig"
    folder.mkdir(parents=True)
    shutil.copy(tmp_path / "build" / "ruffini_client.pc", folder)
    prefix = run("pkg-config", "--variable=prefix", "ruffini_client", cwd=tmp_path, PKG_CONFIG_PATH=str(folder))
    assert Path(prefix.strip()).resolve() == tmp_path / "usr"
