"""The whole data path: frames in, forces out, as the stages of firmware/core/stages.cpp run them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from mirror.board import Board, observed_nodes
from mirror.camera_map import CameraMap
from mirror.depth_gauge import DepthGauge
from mirror.displacement import displacement
from mirror.dot_templates import DotTemplates
from mirror.dots import detect_dots
from mirror.estimators import contact_areas, moved_arms, wrench
from mirror.field_repair import repaired_nodes
from mirror.finite_strain import FiniteStrain
from mirror.fixed import I64, Saturations
from mirror.light import Light, grey, grey_of_rest, relative_change, rest_image
from mirror.markers import Lattice
from mirror.photometric import NO_LEVEL, Bend, cell_slope, marker_mask, unmix_of_cells
from mirror.poisson import poisson
from mirror.program import Program
from mirror.relaxation import Relaxation
from mirror.shear_modes import node_places
from mirror.solve import Noise, contact_mask, frame_threshold, linear_force
from mirror.spread import is_explained, is_rim_pressed
from mirror.steady_field import SteadyField
from mirror.support import SupportTables, residual, support_force

Tensors = dict[str, npt.NDArray[np.generic]]


@dataclass(frozen=True)
class Outcome:
    """What one frame left behind, raw integers."""

    change: I64
    markers: I64
    slope: I64
    depth: I64
    displacement: I64
    mask: I64
    force: I64
    wrench: list[int]
    contact_areas: list[int]


class FramePath:
    """Kinds operator, support and photometric are required; camera, gauge, finite strain, relaxation may be there."""

    def __init__(self, board: Board, tensors: Tensors, metadata: dict[str, str]) -> None:
        self.board = board
        self.saturations = Saturations()
        self._lattice = Lattice(board)
        self._operator = Program(tensors, metadata, "operator")
        self._support = SupportTables(
            Program(tensors, metadata, "support.normal"),
            Program(tensors, metadata, "support.project"),
            tensors["support.scale"].astype(np.int32),
            int(metadata["support.shear_noise"]),
        )
        self._places = node_places(board)
        self._camera_map = CameraMap(tensors, metadata, board) if "camera.rays" in tensors else None
        self._gauge = DepthGauge(tensors, metadata) if "gauge.weight" in tensors else None
        has_finite_strain = "finite_strain.extension" in tensors
        self._finite_strain = FiniteStrain(tensors, metadata) if has_finite_strain else None
        self._spread = tensors["support.spread"].astype(np.int64).ravel() if "support.spread" in tensors else None
        self._spread_limit = int(np.ravel(tensors.get("support.spread_limit", 0))[0])
        frames = board["contact"].get("steady_frames", 1)
        self.steady = SteadyField(self._places, frames) if frames > 1 else None
        self._relaxation = None
        if "relaxation.part" in tensors:
            part, time_ms = (tensors[f"relaxation.{name}"].astype(np.int32) for name in ("part", "time_ms"))
            self._relaxation = Relaxation(part, time_ms, len(self._places))
        self._dark = tensors["dark.image"].astype(np.int64) if "dark.image" in tensors else None
        self.is_light_steady, self.is_explained = True, True
        self._n_drifting, self._was_touched = 0, False
        self._noise: Noise | None = None
        if "contact.noise_un" in tensors:
            steps = [max(int(v) // board["field"]["force_lsb_un"], 1) for v in tensors["contact.noise_un"]]
            self._noise = (steps[0], steps[1])
        self._unmix = unmix_of_cells(board, tensors["photometric.unmix"].astype(np.int16))
        self._slope = tensors["photometric.slope"].astype(np.int16)
        self._bend: Bend | None = None
        if "photometric.bend" in tensors:
            lattice, axis = tensors["photometric.bend"], tensors["photometric.bend_axis"]
            self._bend = Bend(lattice.astype(np.int16), axis.astype(np.int32))
        self._is_balanced = int(np.ravel(tensors.get("photometric.balance", 0))[0]) == 1

    def learn(self, frames: npt.NDArray[np.uint8]) -> int:
        """Rest from untouched frames; number of markers found."""
        rest = rest_image(frames)
        self.light = Light(rest, self._dark, self._is_balanced)
        n_found = self._lattice.learn(detect_dots(self.board, grey_of_rest(rest)))
        self._templates = DotTemplates(self.board, rest, self._lattice.rows)
        return n_found

    def process(self, frame: npt.NDArray[np.uint8], capture_us: int) -> Outcome:
        board, saturations = self.board, self.saturations
        change = relative_change(frame, self.light.rest8, self.light.reciprocal)
        self._lattice.assign(detect_dots(board, grey(frame)))
        self._lattice.finish(self._templates.refine(frame, self._lattice.rows))
        markers = self._lattice.rows.copy()
        before = self.light.gain.copy()
        self.light.follow(change, markers)
        has_settled = bool((np.abs(self.light.gain - before) < 32).all())
        self._n_drifting = 0 if has_settled or self._is_balanced else self._n_drifting + 1
        self.is_light_steady = self._n_drifting < 8 or self._was_touched
        level = self.light.level if self._is_balanced else NO_LEVEL
        mask = marker_mask(board, markers)
        slope = cell_slope(board, change, mask, self._unmix, self._slope, self._bend, level)
        seen_from = board
        if self._camera_map is not None:
            slope, seen_from = self._camera_map.rectify(slope), self._camera_map.ideal
        depth = poisson(seen_from, slope, saturations)
        u = displacement(board, markers, depth, saturations, self._camera_map)
        if self._gauge is not None:
            u, depth = self._gauge.lifted(board, u, depth, saturations)
        is_off = self.light.is_off
        if self._is_balanced:
            is_off = not self.light.level_is_sure or self.light.map.is_off
        force, mask = self.solve(u, is_off=is_off)
        self._was_touched = bool(mask.any())
        if self._relaxation is not None and not is_off:  # a frame with FLAG_LIGHT is not remembered
            force = self._relaxation.run(capture_us, mask, force, saturations)
        return Outcome(
            change, markers, slope, depth, u, mask, force,
            self._wrench(u, force), contact_areas(board, mask, force),
        )  # fmt: skip

    def _wrench(self, u: I64, force: I64) -> list[int]:
        total = wrench(self.board, force)
        if self._finite_strain is None:
            return total
        arms = moved_arms(self.board, force, u, self.saturations)
        return [*total[:3], *(t + a for t, a in zip(total[3:], arms, strict=True))]

    def solve_given(self, u: I64) -> tuple[I64, I64]:
        """As `solve`, of nodes (n_nodes, 3) from outside, which are repaired first."""
        return self.solve(repaired_nodes(self.board, u)[0])

    def solve(self, u: I64, *, is_off: bool = False) -> tuple[I64, I64]:
        """Force steps (n_nodes, 3) and contact mask of one displacement field; is_off: of a frame with FLAG_LIGHT."""
        board = self.board
        force = linear_force(self._operator, u, self.saturations)
        shape = (len(observed_nodes(board, "y")), len(observed_nodes(board, "x")))
        threshold = max(board["contact"]["threshold_un"] // board["field"]["force_lsb_un"], 1)
        mask = contact_mask(force, shape, threshold, board["contact"]["min_nodes"], self._noise, self.is_light_steady)
        beyond = None
        if self._finite_strain is not None and mask.any():
            beyond = self._finite_strain.force(u, self.saturations)
            force = self.saturations.int32(force.reshape(-1, 3) + beyond)
            mask = contact_mask(
                force, shape, threshold, board["contact"]["min_nodes"], self._noise, self.is_light_steady
            )
        usual = threshold
        threshold = frame_threshold(force, threshold, self._noise, self.is_light_steady)
        solved, self._explained = support_force(
            self._support, self._places, u, beyond, mask, force, threshold, self.saturations
        )
        self._solved_u = u
        if self._spread is not None:
            linear = solved.reshape(-1, 3) - (0 if beyond is None else beyond.reshape(-1, 3))
            is_pressed = int(-force.reshape(-1, 3)[:, 2].min()) > usual // 4
            self.is_explained = is_explained(self._places, u, linear, self._spread, self._spread_limit, is_pressed)
            is_covered = 16 * np.count_nonzero(mask) > 5 * mask.size
            if board["depth"]["gauge"] == "margin" and (is_covered or is_rim_pressed(solved, shape, threshold)):
                self.is_explained = False
        if self.steady is not None:
            if is_off or not self.is_explained:  # a flagged frame is not remembered
                self.steady.forget()
            else:
                solved = self.steady.run(
                    mask, self._support.project.times(u.ravel()).reshape(-1, 3), solved, self.saturations
                )
        return solved, mask

    def residual(self) -> I64:
        """What the forces of the last `solve` leave unexplained, (n_nodes, 3) in 1/64 standard deviation."""
        return residual(self._support, self._solved_u, self._explained, Saturations())
