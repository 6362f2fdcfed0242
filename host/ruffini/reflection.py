"""Split fields on a rectangular node grid by their parity under the reflections x -> -x, y -> -y.

A uniform slab does not change under these two reflections, so in a basis of even and odd fields
every matrix of it (stiffness, compliance, a stationary prior) falls into four independent blocks of
a quarter of the size: dense factorisation becomes 16 times cheaper. Not in the iFEM papers.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import numpy.typing as npt
import scipy.linalg as la
import scipy.sparse as sp

Array = npt.NDArray[np.float64]


def _parity_basis(n: int, *, even: bool) -> sp.csr_matrix:
    """Orthonormal basis of the even or odd functions on n symmetric points, (n, about n / 2)."""
    half = n // 2
    i = np.arange(half)
    value = np.full(half, np.sqrt(0.5))
    rows = np.concatenate([i, n - 1 - i])
    columns = np.concatenate([i, i])
    values = np.concatenate([value, value if even else -value])
    size = half
    if even and n % 2:
        rows, columns = np.append(rows, half), np.append(columns, half)
        values, size = np.append(values, 1.0), half + 1
    return sp.csr_matrix((values, (rows, columns)), shape=(n, size))


@lru_cache(maxsize=8)  # a fit condenses pads on one grid tens of times
def parity_bases(n_x: int, n_y: int) -> list[sp.csr_matrix]:
    """Bases Q of the four parity classes of a vector field on an n_x by n_y node grid.

    Returns
    -------
    list of four sparse (3 n_x n_y, m) matrices with orthonormal columns which together span all
    fields; node by node, xyz interleaved. The component along a reflected axis changes sign, so its
    parity is the opposite of that of the others.
    """
    bases = []
    for x_even in (True, False):
        for y_even in (True, False):
            blocks = []
            for component in range(3):
                along_x = _parity_basis(n_x, even=x_even != (component == 0))
                along_y = _parity_basis(n_y, even=y_even != (component == 1))
                scalar = sp.kron(along_y, along_x, format="coo")
                rows = 3 * scalar.row + component
                blocks.append(sp.coo_matrix((scalar.data, (rows, scalar.col)), shape=(3 * n_x * n_y, scalar.shape[1])))
            bases.append(sp.hstack(blocks, format="csr"))
    return bases


def dense_from_blocks(bases: list[sp.csr_matrix], blocks: list[Array]) -> Array:
    """The full matrix: sum over the classes of Q A Q^T, (3 n, 3 n)."""
    n = bases[0].shape[0]
    full, row = np.zeros((n, n)), np.empty(n)
    for basis, block in zip(bases, blocks, strict=True):
        # A field's component is in one field of the basis, or in none: no sums, which make a product of matrices slow.
        is_in = np.diff(basis.indptr) > 0
        column, value = np.zeros(n, dtype=np.intp), np.zeros(n)
        column[is_in], value[is_in] = basis.indices, basis.data
        right = np.take(block, column, axis=1)
        right *= value
        for i in np.flatnonzero(is_in):
            full[i] += np.multiply(right[column[i]], value[i], out=row)
    return full


def blocks_from_dense(bases: list[sp.csr_matrix], full: Array) -> list[Array]:
    """The diagonal blocks Q^T A Q of a matrix that does not change under the reflections."""
    return [np.asarray(basis.T @ (basis.T @ full.T).T) for basis in bases]


def spd_inverse(matrix: Array) -> Array:
    """Inverse of a symmetric positive definite matrix by Cholesky (LAPACK potrf, potri)."""
    factor, info = la.lapack.dpotrf(matrix, lower=1, overwrite_a=0)
    if info != 0:
        raise np.linalg.LinAlgError(f"matrix is not positive definite (minor {info})")
    inverse, _ = la.lapack.dpotri(factor, lower=1, overwrite_c=1)
    np.copyto(inverse.T, inverse, where=np.tri(len(inverse), k=-1, dtype=bool))
    return np.asarray(inverse)
