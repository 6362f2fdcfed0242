"""twin.toml: what does not fit together is refused, with the key that is wrong."""

import pytest

from ruffini.boards import find_board
from ruffini.errors import InputError
from ruffini.sim.settings import parse_twin

PINS = "[pins]\nn = 1\npitch_um = 9\nlength_um = 0\nradius_um = 9\nlevel = 9\n"
CASES = [
    ("gelslim", '[shape]\nkind = "dome"\n', "shape: Value error, radius_um belongs to"),
    ("gelslim", '[shape]\nkind = "plane"\nradius_um = 3\n', "radius_um belongs to"),
    ("gelslim", '[lens]\nmodel = "radtan"\ncoefficients_1e6 = [1, 2, 3, 4]\n', "must be k1 k2 p1 p2 k3"),
    ("gelslim", '[lens]\nmodel = "fisheye"\ncoefficients_1e6 = [1, 2, 3, 4, 5]\n', "or k1 k2 k3 k4"),
    ("gelslim", '[lens]\nmodel = "mirror"\ncoefficients_1e6 = [1, 2, 3, 4]\n', "lens.model"),
    ("gelslim", "[gel]\nindex_1e3 = 900\n", "gel.index_1e3"),
    ("gelslim", "[[view]]\n[[view]]\n[[view]]\n", "3 views do not share 320 columns"),
    ("gelslim", PINS + "[gel]\nindex_1e3 = 1400\n", "refracts"),
    ("gelslim", "[wear]\ndead_leds = [-1]\n", "wear.dead_leds.0"),
    ("gelslim", "[[warming]]\nlamp = 3\nloss_1e3 = 9\ntime_s = 9\n", "lamp must be below 3"),
    ("gelslim", 2 * "[[warming]]\nlamp = 1\nshare_1e3 = 501\nloss_1e3 = 9\ntime_s = 9\n", "1 is more than 1000"),
    ("gelslim", "[[warming]]\nlamp = 1\nloss_1e3 = 9\ntime_s = 0\n", "warming.0.time_s"),
    ("eltac", "[[warming]]\nlamp = 0\nplace_um = [0, 0, 0]\nloss_1e3 = 9\ntime_s = 9\n", "sheet is everywhere"),
    ("gelslim", "[mesh]\ncells_x = 1\ncells_y = 4\n", "mesh.cells_x"),
    ("gelslim", "[sparkle]\nn = 1\n", "sparkle: unknown key"),
    ("contact-glitter", "[dots]\ndarkness_1e3 = 500\nblur_um = 50\n", r"lattice of \[markers\]"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "more", "words"), CASES)
def test_what_does_not_fit_is_refused(name, more, words):
    board = find_board(name)
    text = (board.folder / "twin.toml").read_text()
    parse_twin(text, "t", board)
    with pytest.raises(InputError, match=words):
        parse_twin(text + "\n" + more, "t", board)


def test_unknown_light_names_the_kinds():
    board = find_board("gelslim")
    text = (board.folder / "twin.toml").read_text().replace('"rgb_leds"', '"laser"')
    with pytest.raises(InputError, match="'rgb_leds', 'white_ring', 'electroluminescent'"):
        parse_twin(text, "t", board)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("radius_um = 40000", "radius_um = 2000", "thinner than its radius"),
        ("window_um = 2000", "window_um = -1", "window_um"),
        ("window_index_1e3 = 1490", "window_index_1e3 = 990", "window_index_1e3"),
        ('kind = "tube"\nradius_um = 40000', 'kind = "plane"', r"is the wall of \[shape\]"),
    ],
)
def test_a_wall_that_cannot_be_is_refused(old, new, words):
    board = find_board("eltac")
    text = (board.folder / "twin.toml").read_text()
    assert old in text
    with pytest.raises(InputError, match=words):
        parse_twin(text.replace(old, new), "t", board)
