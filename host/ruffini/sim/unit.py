"""One simulated sensor: a pad that is not quite the board's, and a camera that looks at it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.interpolate import RectBivariateSpline

from ruffini.boards import Board
from ruffini.errors import InputError
from ruffini.sim.cache import cached_compliance
from ruffini.sim.contact import ContactSolver, Indenter, release
from ruffini.sim.finite import FiniteMesh
from ruffini.sim.optics.conditions import TrayPose
from ruffini.sim.optics.renderer import Renderer
from ruffini.sim.pad import PadModel
from ruffini.sim.pose import Pose
from ruffini.sim.response import FiniteResponse, LinearResponse, Response, Tangent
from ruffini.sim.settings import MeshSettings, TwinSettings, load_twin
from ruffini.sim.surface import wrench_of

Array = npt.NDArray[np.float64]
Progress = Callable[[float], None]


@dataclass(frozen=True)
class PadError:
    """The simulated pad's true numbers over the board's, as factors."""

    modulus: float = 1.0
    poisson: float = 1.0
    thickness: float = 1.0


def pad_model(board: Board, error: PadError, mesh: MeshSettings) -> PadModel:
    """The simulated pad of a board.

    Raises
    ------
    InputError
        The factors make a pad that cannot be.
    """
    pad = board.pad
    poisson = pad.poisson_1e4 * 1e-4 * error.poisson
    if not (0 <= poisson < 0.4999 and error.modulus > 0 and error.thickness > 0):
        raise InputError(
            f"a pad with Poisson's ratio {poisson:.4f}, {error.modulus:g} times the modulus and "
            f"{error.thickness:g} times the thickness cannot be simulated: "
            "the factors must be positive and the ratio below 0.4999"
        )
    return PadModel(
        size_x_m=pad.size_x_um * 1e-6,
        size_y_m=pad.size_y_um * 1e-6,
        thickness_m=pad.thickness_um * 1e-6 * error.thickness,
        modulus_pa=pad.modulus_pa * error.modulus,
        poisson=poisson,
        n_cells_x=mesh.cells_x,
        n_cells_y=mesh.cells_y,
    )


@dataclass
class TwinUnit:
    """One simulated sensor: its pad's compliance and its camera's settings."""

    board: Board
    twin: TwinSettings
    model: PadModel
    compliance: Array

    @classmethod
    def build(
        cls,
        board: Board,
        error: PadError | None = None,
        *,
        twin: TwinSettings | None = None,
        progress: Progress = lambda _: None,
    ) -> TwinUnit:
        """Solve the pad's mechanics (seconds), or take them from the cache; `twin` instead of the board's own.

        Raises
        ------
        InputError
            The board has no twin, is no flat pad, or the factors make a pad that cannot be.
        """
        twin = twin or load_twin(board)
        if twin.shape.kind != "plane":
            raise InputError(f"board {board.name!r} is a {twin.shape.kind}: only flat pads can be pressed yet")
        model = pad_model(board, error or PadError(), twin.mesh)
        return cls(board, twin, model, cached_compliance(model, progress=progress))

    @property
    def frame_s(self) -> float:
        """Time from frame to frame."""
        return 1e3 / self.board.camera.rate_mhz

    @cached_property
    def _mesh(self) -> tuple[FiniteMesh, Tangent]:
        """The slab at finite strain and its tangent at rest, once for all touches."""
        mesh = FiniteMesh(self.model)
        return mesh, Tangent(mesh, mesh.at_rest())

    def response(self) -> Response:
        """The pad before anything ever touched it."""
        prony = self.twin.pad.prony()
        if self.twin.pad.strain == "finite":
            mesh, tangent = self._mesh
            return FiniteResponse(mesh, prony, tangent)
        return LinearResponse(self.compliance, prony)

    def solver(self, indenter: Indenter, response: Response | None = None) -> ContactSolver:
        """A contact of an indenter with this pad in its state `response`, or before anything touched it."""
        friction = self.twin.unit.friction_1e3 * 1e-3
        return ContactSolver(self.model, response or self.response(), indenter, friction)

    def rig(self) -> FlatRig:
        """The pad before anything ever touched it."""
        return FlatRig(self)

    def body_toml(self) -> str:
        """The pad's true numbers."""
        model = self.model
        return (
            f"[pad]\nmodulus_pa = {model.modulus_pa!r}\npoisson = {model.poisson!r}\n"
            f"thickness_m = {model.thickness_m!r}\n"
            f"n_nodes_x = {model.shape[1]}\nn_nodes_y = {model.shape[0]}\n"
        )

    def renderer(self, *, has_dots: bool = True) -> Renderer:
        """This unit's camera."""
        return Renderer(self.board, self.twin, self.model.node_x() * 1e3, self.model.node_y() * 1e3, has_dots=has_dots)

    def at_rest(self) -> Array:
        """Displacement of the untouched surface, (n, 3)."""
        return np.zeros((self.model.shape[0] * self.model.shape[1], 3))

    def at_nodes(self, displacement: Array) -> Array:
        """Surface displacement at the board's nodes, (n_y, n_x, 3)."""
        node_x, node_y = self.model.node_x(), self.model.node_y()
        x = np.linspace(node_x[0], node_x[-1], self.board.grid.n_x)
        y = np.linspace(node_y[0], node_y[-1], self.board.grid.n_y)
        return self.at_places(displacement, x, y)

    def at_places(self, displacement: Array, x: Array, y: Array) -> Array:
        """Surface displacement where columns x and rows y cross, metres from the pad's centre, (len(y), len(x), 3)."""
        node_x, node_y = self.model.node_x(), self.model.node_y()
        field = displacement.reshape(*self.model.shape, 3)
        return np.stack([RectBivariateSpline(node_y, node_x, field[:, :, c])(y, x) for c in range(3)], axis=-1)


class FlatRig:
    """A flat pad under one indenter after the other (`rig.Rig`); it remembers them as long as its gel does."""

    def __init__(self, unit: TwinUnit) -> None:
        self.unit, self.frame_s = unit, unit.frame_s
        self.solver: ContactSolver | None = None
        self._pad = unit.response()
        self._pose: Pose | None = None

    @property
    def displacement(self) -> Array:
        return self.solver.displacement if self.solver else self._pad.surface

    @property
    def tray(self) -> TrayPose | None:
        return None

    def take(self, indenter: Indenter) -> None:
        release(self._pad, 0.0)
        self.solver, self._pose = self.unit.solver(indenter, self._pad), None

    def advance(self, pose: Pose) -> None:
        assert self.solver is not None
        if pose == self._pose and not self.unit.twin.pad.is_relaxing:
            return  # nothing moves
        self.solver.advance(pose, self.frame_s)
        self._pose = pose

    def load(self, wrench: Array) -> None:
        raise InputError(f"board {self.unit.board.name!r} has no platform that a connector could load: press its pad")

    def rest(self) -> None:
        self.solver = None
        release(self._pad, self.frame_s)

    def wrench(self) -> Array:
        if self.solver is None:
            return np.zeros(6)
        moved = self.solver.displacement if self._pad.moves_the_arm else None
        return wrench_of(self.unit.model, self.solver.nodal_force, moved)

    def nodal_state(self) -> npt.NDArray[np.uint8]:
        grid, (n_y, n_x) = self.unit.board.grid, self.unit.model.shape
        if self.solver is None:
            return np.zeros((grid.n_y, grid.n_x), np.uint8)
        rows, columns = (np.rint(np.linspace(0, n - 1, m)).astype(int) for n, m in ((n_y, grid.n_y), (n_x, grid.n_x)))
        return np.asarray(self.solver.contact_state.reshape(n_y, n_x)[np.ix_(rows, columns)])

    def nodal_force(self) -> Array:
        grid = self.unit.board.grid
        return self.solver.forces_on_grid(grid.n_x, grid.n_y) if self.solver else np.zeros((grid.n_y, grid.n_x, 3))

    def nodal_displacement(self) -> Array:
        return self.unit.at_nodes(self.displacement)
