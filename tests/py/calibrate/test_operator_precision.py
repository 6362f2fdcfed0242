"""How far an operator's integers may be off: less exact from many nodes on, where a second pass follows."""

from ruffini.boards import find_board
from ruffini.estimators.operator.fit import MANY_NODES, MAX_ERROR, observed_sites, precision_of


def test_only_a_second_pass_over_many_nodes_starts_from_a_less_exact_operator() -> None:
    exact = precision_of(MANY_NODES - 1, has_support=True)
    assert exact == precision_of(10 * MANY_NODES, has_support=False)
    assert exact.programs == exact.on_touches == MAX_ERROR
    loose = precision_of(MANY_NODES, has_support=True)
    assert MAX_ERROR < loose.programs < loose.on_touches


def test_the_dense_pad_alone_has_many_nodes() -> None:
    """Three unknowns a node."""
    assert len(observed_sites(find_board("gelslim-dense"))) >= 3 * MANY_NODES
    for name in ("gelslim", "gelsight-mini", "ftouch", "contact-glitter"):
        assert len(observed_sites(find_board(name))) < 3 * MANY_NODES
