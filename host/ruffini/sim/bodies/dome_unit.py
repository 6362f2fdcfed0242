"""The stereo fingertip's body: a dome, its tools' poses, and its truth at the board's nodes.

A pose on a dome: the sensor is turned under a tool that comes straight down, by roll about x and pitch about y about
the middle of the sphere; then the tool's axis is moved by (x, y), and its depth counts from where it first touches
the undeformed dome.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.errors import InputError
from ruffini.sim.bodies.dome import DomeModel
from ruffini.sim.bodies.nodes import BoardNodes
from ruffini.sim.bodies.settings import DomeSettings
from ruffini.sim.bodies.sheet import SheetState
from ruffini.sim.bodies.tool import Grip, ToolContact
from ruffini.sim.indenters import Indenter
from ruffini.sim.optics.conditions import TrayPose
from ruffini.sim.optics.renderer import Renderer
from ruffini.sim.pose import Pose
from ruffini.sim.settings import TwinSettings
from ruffini.sim.unit import PadError

Array = npt.NDArray[np.float64]

N_SHOWN = 49  # lines of nodes that the renderer gets, each way
MAX_DEPTH = 0.5  # of the radius
MAX_TURN_RAD = 1.1  # of the sensor under the tool: the rim stays clear of it
MAX_ASIDE = 0.9  # of the radius


@dataclass(frozen=True)
class DomeUnit:
    """One simulated fingertip."""

    board: Board
    twin: TwinSettings
    model: DomeModel

    @classmethod
    def build(cls, board: Board, error: PadError, twin: TwinSettings) -> DomeUnit:
        """The dome of [shape], [dome] and board.toml's [pad].

        Raises
        ------
        InputError
            The factors make a dome that cannot be.
        """
        pad, settings = board.pad, twin.dome or DomeSettings()
        poisson = pad.poisson_1e4 * 1e-4 * error.poisson
        if not (0 <= poisson <= 0.5 and error.modulus > 0 and error.thickness > 0):
            raise InputError("a dome's factors must be positive and its Poisson's ratio at most 0.5")
        thickness_m, radius_m = pad.thickness_um * 1e-6 * error.thickness, twin.shape.radius_um * 1e-6
        if thickness_m > radius_m / 5:
            raise InputError(
                f"a wall of {thickness_m * 1e3:.1f} mm is no shell on a radius of {radius_m * 1e3:.0f} mm: "
                "at most a fifth of it"
            )
        return cls(
            board, twin, DomeModel(radius_m, thickness_m, pad.modulus_pa * error.modulus, poisson, settings.cells)
        )

    @property
    def frame_s(self) -> float:
        """Time from frame to frame."""
        return 1e3 / self.board.camera.rate_mhz

    def shown_mm(self) -> Array:
        """Coordinates of the renderer's nodes, along each way from the top."""
        half = np.pi / 2 * self.model.radius_m * 1e3
        return np.linspace(-half, half, N_SHOWN)

    def rig(self) -> DomeRig:
        """The dome before anything ever touched it."""
        return DomeRig(self)

    def renderer(self) -> Renderer:
        """Its cameras."""
        return Renderer(self.board, self.twin, self.shown_mm(), self.shown_mm())

    def at_rest(self) -> Array:
        """Displacement of the untouched dome, (n, 3)."""
        return np.zeros((N_SHOWN**2, 3))

    def body_toml(self) -> str:
        """The dome's true numbers."""
        model = self.model
        return (
            f"[pad]\nmodulus_pa = {model.modulus_pa!r}\npoisson = {model.poisson!r}\n"
            f"thickness_m = {model.thickness_m!r}\nradius_m = {model.radius_m!r}\nn_cells = {model.n_cells}\n"
        )


class DomeRig:
    """A dome under one tool after the other (`rig.Rig`)."""

    def __init__(self, unit: DomeUnit) -> None:
        self.unit, self.frame_s = unit, unit.frame_s
        relaxation = (unit.twin.dome or DomeSettings()).relaxation()
        self.sheet = unit.model.sheet()
        self.state = SheetState(self.sheet, unit.twin.unit.friction_1e3 * 1e-3, relaxation)
        patch = self.sheet.shell.patch
        shown = np.clip(unit.shown_mm() * 1e-3, patch.a.edges[0], patch.a.edges[-1])
        self._to_shown = patch.on_grid(shown, shown)
        self._tool: ToolContact | None = None
        self._rest_points = self.sheet.rest_points()
        self._nodes = BoardNodes(unit.board, self._rest_points[:, :2])
        places, self._at_board = self._board_nodes()
        self._to_board = patch.at_places(*places[self._at_board].T)

    def _board_nodes(self) -> tuple[Array, npt.NDArray[np.bool_]]:
        """Places of the board's nodes on the dome seen from above, (n, 2) metres, and which lie on it, (n,)."""
        pad, grid, radius = self.unit.board.pad, self.unit.board.grid, self.unit.model.radius_m
        x, y = np.meshgrid(
            np.linspace(-pad.size_x_um / 2, pad.size_x_um / 2, grid.n_x) * 1e-6,
            np.linspace(-pad.size_y_um / 2, pad.size_y_um / 2, grid.n_y) * 1e-6,
        )
        away = np.hypot(x, y).ravel()
        on_it = away < 0.999 * radius
        way = np.divide(radius * np.arcsin(np.minimum(away / radius, 1)), away, out=np.ones_like(away), where=away > 0)
        return np.column_stack([x.ravel(), y.ravel()]) * way[:, None], on_it

    @property
    def displacement(self) -> Array:
        return np.asarray(self._to_shown @ (self.state.place - self.sheet.shell.rest))

    @property
    def tray(self) -> TrayPose | None:
        return None

    def take(self, indenter: Indenter) -> None:
        model = self.unit.model
        skin = model.modulus_pa / model.thickness_m
        self._tool = ToolContact(indenter, skin, skin / 3, len(self._rest_points))

    def grip(self, indenter: Indenter, pose: Pose) -> Grip:
        """Where a tool stands at a pose.

        Raises
        ------
        InputError
            It is beside the dome, deeper than the model goes, or the sensor is turned too far.
        """
        radius = self.unit.model.radius_m
        if np.hypot(pose.x_m, pose.y_m) > MAX_ASIDE * radius:
            raise InputError(
                f"the tool at ({pose.x_m * 1e3:.1f}, {pose.y_m * 1e3:.1f}) mm is beside the dome, whose radius is "
                f"{radius * 1e3:.0f} mm: at most {MAX_ASIDE * radius * 1e3:.1f} mm from its axis"
            )
        if np.hypot(pose.roll_rad, pose.pitch_rad) > MAX_TURN_RAD:
            raise InputError(f"the sensor cannot be turned by more than {MAX_TURN_RAD} rad under the tool")
        if pose.depth_m > MAX_DEPTH * radius:
            raise InputError(
                f"depth {pose.depth_m * 1e3:.1f} mm goes beyond the dome's model, "
                f"which holds to {MAX_DEPTH * radius * 1e3:.1f} mm: press less deep"
            )
        lean = replace(pose, turn_rad=0.0).rotation()
        above = lean @ np.array([pose.x_m, pose.y_m, radius]) - [0, 0, radius]
        grip = Grip(above, pose.rotation(), indenter.reach_m)
        assert self._tool is not None
        return grip.lifted(self._tool.deepest(grip, self._rest_points) - pose.depth_m)

    def advance(self, pose: Pose) -> None:
        assert self._tool is not None
        self.state.advance(self._tool, self.grip(self._tool.indenter, pose), self.frame_s)

    def load(self, wrench: Array) -> None:
        raise InputError(f"board {self.unit.board.name!r} has no platform that a connector could load: press its dome")

    def rest(self) -> None:
        self._tool = None
        self.state.free(self.frame_s)

    def wrench(self) -> Array:
        return self.state.wrench()

    def nodal_force(self) -> Array:
        """Each sample's force shared out to the four nodes about its place at rest, seen from above."""
        return self._nodes.shared_out(self.state.force)

    def nodal_displacement(self) -> Array:
        """Zero at nodes beside the dome."""
        grid, shell = self.unit.board.grid, self.sheet.shell
        out = np.zeros((grid.n_y * grid.n_x, 3))
        out[self._at_board] = self._to_board @ (self.state.place - shell.rest)
        return out.reshape(grid.n_y, grid.n_x, 3)

    def nodal_state(self) -> npt.NDArray[np.uint8]:
        return self._nodes.states(self.state.force, self.state.slips)
