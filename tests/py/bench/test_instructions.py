"""The document's table of instructions is made of the counts."""

import re
import sys
from pathlib import Path

ROOT = Path(__file__).parents[3]
sys.path.append(str(ROOT / "tests" / "bench"))

import instructions  # noqa: E402
from instructions import (  # noqa: E402
    ENERGY_SECTION,
    FRAMES,
    SECTION,
    STAGES,
    Stretch,
    columns,
    document_rows,
    energy_columns,
    energy_rows,
)


def counts(markers):
    """Frames of two sizes; stage markers has so many instructions in a touched frame of the second."""
    small = {stage: Stretch(100_000, 2_000, 0, 3_000, 1_000) for stage in STAGES}
    large = {**small, "markers": Stretch(markers, 4_000, 0, 5_000, 2_600)}
    return {"320x240": dict.fromkeys(FRAMES, small), "640x480": {**dict.fromkeys(FRAMES, small), "touched": large}}


def test_a_row_has_both_sizes_and_the_last_one_sums_all_stages():
    *shown, frame = document_rows(counts(1_500_000))
    assert shown == ["| markers | 100 | 100 | 1.00 | 2 | 3; 1 | 100 | 1,500 | 0.07 | 4 | 5; 3 |"]
    assert frame == "| **frame** | 1,100 | 1,100 | 1.00 | 22 | 33; 11 | 1,100 | 2,500 | 0.44 | 24 | 35; 13 |"


def test_a_stage_that_takes_little_has_no_row():
    assert [row.split(" ")[1] for row in document_rows(counts(690_000))] == ["**frame**"]


def test_the_document_has_the_table_that_is_written():
    text = (ROOT / "docs/results/accuracy.md").read_text()
    head = f"| {' | '.join(columns(counts(0)))} |"
    assert head in text[text.index(SECTION) :]
    row = f"{document_rows(counts(0))[-1]} at | date |"
    replaced = instructions.with_row(text, row, SECTION, columns(counts(0)))
    assert row in replaced
    assert len(re.findall(r"^\| \*\*frame\*\* ", replaced, re.M)) == 1


# 0.835 nJ of an instruction and 20.8 nJ of a line: 1.5 M and 2,600 are 1.25 and 0.05 mJ.
def test_energy_is_of_instructions_and_of_lines_from_memory():
    *shown, frame = energy_rows(counts(1_500_000))
    assert shown == ["| markers | 0.10 | 3 | 6 | 0% | 1.31 | 39 | 78 | 3% |"]
    assert frame == "| **frame** | 1.15 | 34 | 69 | 3% | 2.35 | 70 | 141 | 6% |"


def test_the_document_has_the_table_of_energy():
    text = (ROOT / "docs/results/accuracy.md").read_text()
    row = f"{energy_rows(counts(0))[-1]} at | date |"
    assert row in instructions.with_row(text, row, ENERGY_SECTION, energy_columns(counts(0)))
