"""A skin of glowing panels round a tube, its tools' poses, and its truth at the board's nodes.

A pose on a tube: x round it and y along it, on the radius where the camera's coordinates count; the tool's axis is the
radius there. Its depth counts from where it first touches the undeformed skin.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.errors import InputError
from ruffini.sim.bodies.nodes import BoardNodes
from ruffini.sim.bodies.sheet import SheetState
from ruffini.sim.bodies.skin import SkinModel, around
from ruffini.sim.bodies.tool import Grip, ToolContact
from ruffini.sim.indenters import Indenter
from ruffini.sim.optics.conditions import TrayPose
from ruffini.sim.optics.patterns.lattice import Lattice
from ruffini.sim.optics.renderer import Renderer
from ruffini.sim.pose import MAX_TILT_RAD, Pose
from ruffini.sim.settings import TwinSettings
from ruffini.sim.unit import PadError

Array = npt.NDArray[np.float64]

SHOWN_STEP_MM = 2.5  # between lines of nodes that the renderer gets
CLEAR_M = 3e-3  # a panel at rest is left alone while the tool is further away than this
STILL_M = 1e-6  # a panel that moved less is at rest
FRESH_S = 1.0  # so long every frame of a panel that was let go is computed
IDLE_PART = 0.1  # then in steps of this part of the time since: what is left relaxes ever more slowly


@dataclass
class SkinUnit:
    """One simulated skin; panels are made when they are first touched."""

    board: Board
    twin: TwinSettings
    model: SkinModel

    def __post_init__(self) -> None:
        unit, markers = self.twin.unit, self.board.markers
        assert markers is not None  # `parse_twin` sees to it
        self.lattice = Lattice(markers, self.board.pad, unit.lattice_shift_um, unit.lattice_turn_mrad)
        half_a, half_b = np.pi * self.model.chart_m * 1e3, self.model.length_m * 5e2
        self.shown_a_mm = np.linspace(-half_a, half_a, round(2 * half_a / SHOWN_STEP_MM) + 1)
        self.shown_b_mm = np.linspace(-half_b, half_b, round(2 * half_b / SHOWN_STEP_MM) + 1)

    @classmethod
    def build(cls, board: Board, error: PadError, twin: TwinSettings) -> SkinUnit:
        """The skin of [shape], [skin], [light] and board.toml's [pad]; a factor on thickness is the pyramids'.

        Raises
        ------
        InputError
            There is no [skin], its light has no openings, or the factors make a skin that cannot be.
        """
        settings = twin.skin
        if settings is None or twin.light.kind != "electroluminescent":
            raise InputError(f"board {board.name!r} is a tube without [skin] and openings: it cannot be pressed")
        if error.poisson != 1 or not (error.modulus > 0 and error.thickness > 0):
            raise InputError("a skin's rubber is incompressible, and factors on its modulus and thickness are positive")
        settings = settings.model_copy(update={"pyramid_um": round(settings.pyramid_um * error.thickness)})
        model = SkinModel(
            settings, twin.shape.radius_um * 1e-6, board.pad.size_y_um * 1e-6, board.pad.modulus_pa * error.modulus,
            twin.light.aperture_um * 1e-6,
        )  # fmt: skip
        return cls(board, twin, model)

    @property
    def frame_s(self) -> float:
        """Time from frame to frame."""
        return 1e3 / self.board.camera.rate_mhz

    def rig(self) -> SkinRig:
        """The skin before anything ever touched it."""
        return SkinRig(self)

    def renderer(self) -> Renderer:
        """Its camera."""
        return Renderer(self.board, self.twin, self.shown_a_mm, self.shown_b_mm)

    def at_rest(self) -> Array:
        """Displacement of the untouched panels, (n, 3)."""
        return np.zeros((len(self.shown_b_mm) * len(self.shown_a_mm), 3))

    def body_toml(self) -> str:
        """The skin's true numbers that are not in twin.toml."""
        model = self.model
        return (
            f"[pad]\nmodulus_pa = {model.modulus_pa!r}\npyramid_um = {model.settings.pyramid_um}\n"
            f"radius_m = {model.radius_m!r}\nlength_m = {model.length_m!r}\n"
        )


@dataclass
class _Panel:
    """One panel in time."""

    unit: SkinUnit
    number: int
    state: SheetState = field(init=False)
    tool: ToolContact | None = field(init=False, default=None)
    free_s: float = field(init=False, default=0.0)  # since it was let go
    owed_s: float = field(init=False, default=0.0)  # of it, not computed yet

    def __post_init__(self) -> None:
        unit, model = self.unit, self.unit.model
        sheet = model.sheet(self.number)
        self.rest_points = sheet.rest_points()
        x, y, z = self.rest_points.T
        # Not the principal angle: a panel's own angles go on beyond half a turn.
        middle = np.mean(model.span(self.number))
        angle = middle + np.arctan2(y * np.cos(middle) - x * np.sin(middle), x * np.cos(middle) + y * np.sin(middle))
        self.places = np.column_stack([angle * model.chart_m, z])
        da, db, _ = unit.lattice.nearest(*(self.places.T * 1e3).astype(np.float32))
        in_base = np.maximum(np.abs(da), np.abs(db)) < model.base_m * 5e2
        bed = model.bed(sheet, in_base.reshape(sheet.touch_areas.shape))
        self.state = SheetState(sheet, unit.twin.unit.friction_1e3 * 1e-3, foundation=bed)
        self.nodes = BoardNodes(unit.board, self.places)
        edges_a, edges_b = sheet.shell.patch.a.edges, sheet.shell.patch.b.edges
        a, b = unit.shown_a_mm * 1e-3, np.clip(unit.shown_b_mm * 1e-3, edges_b[0], edges_b[-1])
        self.columns = np.flatnonzero((a >= edges_a[0]) & (a <= edges_a[-1]))
        self._to_shown = sheet.shell.patch.on_grid(a[self.columns], b)

    def press(self, tool: ToolContact, grip: Grip, duration_s: float) -> None:
        """One step under a tool."""
        self._catch_up()
        self.free_s = 0.0
        self.state.advance(tool, grip, duration_s)

    def leave(self, duration_s: float) -> None:
        """A time in which nothing touches it."""
        self.tool = None
        self.free_s += duration_s
        self.owed_s += duration_s
        if self.owed_s >= IDLE_PART * (self.free_s - FRESH_S):
            self._catch_up()

    def _catch_up(self) -> None:
        if self.owed_s:
            self.state.free(self.owed_s)
        self.owed_s = 0.0

    @property
    def moved(self) -> Array:
        return np.asarray(self.state.place - self.state.model.shell.rest)

    def shown(self) -> Array:
        """Displacement at the renderer's nodes over this panel, (n_b, columns, 3)."""
        return np.asarray((self._to_shown @ self.moved).reshape(-1, len(self.columns), 3))


class SkinRig:
    """A skin under one tool after the other (`rig.Rig`)."""

    def __init__(self, unit: SkinUnit) -> None:
        self.unit, self.frame_s = unit, unit.frame_s
        self._panels: dict[int, _Panel] = {}
        self._indenter: Indenter | None = None
        self._probe: ToolContact | None = None

    @property
    def displacement(self) -> Array:
        out = np.zeros((len(self.unit.shown_b_mm), len(self.unit.shown_a_mm), 3))
        for panel in self._panels.values():
            out[:, panel.columns] = panel.shown()
        return out.reshape(-1, 3)

    @property
    def tray(self) -> TrayPose | None:
        return None

    def _tool(self, indenter: Indenter, n_points: int) -> ToolContact:
        model = self.unit.model
        shear = model.modulus_pa / 3 / model.cover_m
        return ToolContact(indenter, model.cover_pa_m, shear, n_points, model.cover_m, model.settings.relaxation())

    def take(self, indenter: Indenter) -> None:
        self._indenter, self._probe = indenter, self._tool(indenter, 0)
        for panel in self._panels.values():
            panel.tool = None

    def _rest_near(self, pose: Pose) -> Array:
        """Undeformed skin about a pose, dense enough to tell where a tool touches first, (n, 3)."""
        reach = min(2 * self._reach_m(), self.unit.model.length_m)
        t = np.linspace(-reach, reach, 81)
        a, b = np.meshgrid(pose.x_m + t, np.clip(pose.y_m + t, *(self.unit.model.length_m / 2 * np.array([-1, 1]))))
        return around(a / self.unit.model.chart_m, b, self.unit.model.radius_m).reshape(-1, 3)

    def _reach_m(self) -> float:
        assert self._indenter is not None
        return self._indenter.reach_m

    def grip(self, pose: Pose) -> Grip:
        """Where the tool stands at a pose.

        Raises
        ------
        InputError
            It is beside the skin, deeper than the skin is thick, or tilted too far.
        """
        model = self.unit.model
        if abs(pose.y_m) > model.length_m / 2:
            raise InputError(
                f"the tool at y = {pose.y_m * 1e3:.1f} mm is beside the skin, which ends at "
                f"+-{model.length_m * 5e2:.1f} mm"
            )
        deepest = model.cover_m + (model.settings.pyramid_um - model.settings.squeezed_um) * 1e-6
        if pose.depth_m > deepest:
            raise InputError(
                f"depth {pose.depth_m * 1e3:.2f} mm goes through the skin, which gives way by "
                f"{deepest * 1e3:.2f} mm: press less deep"
            )
        if np.hypot(pose.roll_rad, pose.pitch_rad) > MAX_TILT_RAD:
            raise InputError(f"a tool on the skin can be tilted by at most {MAX_TILT_RAD} rad")
        angle = pose.x_m / model.chart_m
        out = np.array([np.cos(angle), np.sin(angle), 0.0])
        axes = np.column_stack([[-np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0], out])
        grip = Grip(model.radius_m * out + [0, 0, pose.y_m], axes @ pose.rotation(), self._reach_m())
        assert self._probe is not None
        return grip.lifted(self._probe.deepest(grip, self._rest_near(pose)) - pose.depth_m)

    def advance(self, pose: Pose, duration_s: float | None = None) -> None:
        """One frame, or a step of another duration."""
        assert self._indenter is not None
        grip, step_s = self.grip(pose), self.frame_s if duration_s is None else duration_s
        for number in range(self.unit.model.settings.n_panels):
            if self._is_near(grip, number):
                if number not in self._panels:
                    self._panels[number] = _Panel(self.unit, number)
                panel = self._panels[number]
                if panel.tool is None:
                    panel.tool = self._tool(self._indenter, len(panel.rest_points))
                panel.press(panel.tool, grip, step_s)
            elif number in self._panels:
                self._leave_alone(number, step_s)

    def _is_near(self, grip: Grip, number: int) -> bool:
        """Whether the tool may touch a panel."""
        model = self.unit.model
        begin, end = model.span(number)
        angle, along = np.meshgrid(
            np.linspace(begin, end, 61), np.linspace(-model.length_m / 2, model.length_m / 2, 81)
        )
        assert self._probe is not None
        return self._probe.deepest(grip, around(angle, along, model.radius_m).reshape(-1, 3)) > -CLEAR_M

    def _leave_alone(self, number: int, duration_s: float) -> None:
        """A time in which nothing touches a panel; forget it when it is at rest."""
        panel = self._panels[number]
        panel.leave(duration_s)
        if np.abs(panel.moved).max() < STILL_M:
            del self._panels[number]

    def load(self, wrench: Array) -> None:
        raise InputError(f"board {self.unit.board.name!r} has no platform that a connector could load: press its skin")

    def rest(self) -> None:
        for number in list(self._panels):
            self._leave_alone(number, self.frame_s)

    def wrench(self) -> Array:
        return np.asarray(sum((panel.state.wrench() for panel in self._panels.values()), start=np.zeros(6)))

    def nodal_force(self) -> Array:
        """Each sample's force shared out to the four nodes about its place at rest; x y z of the pad's frame."""
        out = np.zeros((self.unit.board.grid.n_y, self.unit.board.grid.n_x, 3))
        for panel in self._panels.values():
            out += panel.nodes.shared_out(panel.state.force)
        return out

    def nodal_displacement(self) -> Array:
        """Of the panels; x y z of the pad's frame."""
        from scipy.interpolate import RectBivariateSpline

        unit, grid = self.unit, self.unit.board.grid
        shown = self.displacement.reshape(len(unit.shown_b_mm), len(unit.shown_a_mm), 3)
        a = np.linspace(unit.shown_a_mm[0], unit.shown_a_mm[-1], grid.n_x)
        b = np.linspace(unit.shown_b_mm[0], unit.shown_b_mm[-1], grid.n_y)
        parts = [
            RectBivariateSpline(unit.shown_b_mm, unit.shown_a_mm, shown[:, :, c], kx=1, ky=1)(b, a) for c in range(3)
        ]
        return np.stack(parts, axis=-1)

    def nodal_state(self) -> npt.NDArray[np.uint8]:
        out = np.zeros((self.unit.board.grid.n_y, self.unit.board.grid.n_x), np.uint8)
        for panel in self._panels.values():
            np.maximum(out, panel.nodes.states(panel.state.force, panel.state.slips), out=out)
        return out
