"""Static condensation of the slab onto its surface, plane by plane from the bonded bottom.

With node planes 1 (surface), 2, ..., n and force on plane 1 only, the planes n, n-1, ..., 3 are
eliminated one after the other, K'_kk = K_kk - K_k,k+1 K'_k+1,k+1^-1 K_k+1,k, each in the four parity
classes of `reflection`. This is the condensation of the iFEM 2.0 paper, eq. (1), done exactly.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp

from ruffini.errors import InputError
from ruffini.fem.slab import Slab, assemble_layer
from ruffini.reflection import parity_bases, spd_inverse

Array = npt.NDArray[np.float64]
Progress = Callable[[float], None]


@dataclass(frozen=True)
class CondensedSlab:
    """The two-plane system of iFEM: K_11 U_1 + K_12 U_2 = F_1, K_12^T U_1 + K'_22 U_2 = 0.

    Each list has one entry per parity class; `bases[i]` is (3 n, m_i).
    """

    slab: Slab
    bases: list[sp.csr_matrix]
    k_11: list[Array]
    k_12: list[sp.csr_matrix]
    k_22: list[Array]  # condensed: planes 3 and below are inside


def condense(slab: Slab, *, b_bar: bool = True, progress: Progress = lambda _: None) -> CondensedSlab:
    """Condense all planes below the second one into it.

    Cost: about n_layers (3 n)^3 / 16 multiplications for n surface nodes, memory a few (3 n)^2 / 16
    doubles.

    Raises
    ------
    InputError
        The elements are so degenerate that the stiffness is singular in double precision.
    """
    with _singular_is_refused(slab):
        return _condense(slab, b_bar, progress)


def _condense(slab: Slab, b_bar: bool, progress: Progress) -> CondensedSlab:
    layer = assemble_layer(slab, b_bar=b_bar)
    bases = parity_bases(slab.n_x, slab.n_y)
    k_11, k_12, k_22 = [], [], []
    for i, q in enumerate(bases):
        upper = (q.T @ layer.upper @ q).tocsr()
        coupling = (q.T @ layer.coupling @ q).tocsr()
        inner = (upper + q.T @ layer.lower @ q).toarray()
        schur = inner  # plane n: its own stiffness; plane n + 1 is bonded
        for plane in range(slab.n_layers - 2):
            schur = inner - coupling @ (coupling @ spd_inverse(schur)).T
            progress((i + (plane + 1) / slab.n_layers) / len(bases))
        k_11.append(upper.toarray())
        k_12.append(coupling)
        k_22.append((schur + schur.T) / 2)
    progress(1.0)
    return CondensedSlab(slab, bases, k_11, k_12, k_22)


def surface_stiffness(condensed: CondensedSlab) -> list[Array]:
    """S = K_11 - K_12 K'_22^-1 K_21 per parity class: force at the surface from displacement."""
    with _singular_is_refused(condensed.slab):
        return [
            k_11 - k_12 @ (k_12 @ spd_inverse(k_22)).T
            for k_11, k_12, k_22 in zip(condensed.k_11, condensed.k_12, condensed.k_22, strict=True)
        ]


@contextmanager
def _singular_is_refused(slab: Slab) -> Iterator[None]:
    try:
        yield
    except np.linalg.LinAlgError as error:
        raise InputError(
            f"the finite elements of this pad are singular ({error}): elements of "
            f"{' x '.join(f'{1e3 * h:.3g}' for h in slab.step_m)} mm are no mesh, change [grid] or [pad] in board.toml"
        ) from error
