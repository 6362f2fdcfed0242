"""reproduce.toml: the bench of a board's paper, and every press that it made. Strict.

schema = 1
paper = "its title"
method = "name"              # the package in host/papers
seed = 1
[[published]]                # what the paper prints of its method's errors
name = "normal force"
unit = "N"
value_1e6 = 1080000
where = "Table I"
[rig]                        # what the bench itself gets wrong
depth_noise_um = 50
[[set]]
name = "S1"
part = "judge"               # fit: what the paper's method is fitted on; show: neither
what = "a ball"
indenter = ["sphere"]        # the runs of a set are the product of its lists
radius_um = [3000, 5000]
shore_a = [40, 60]           # rigid without
at_um = [[0, 0]]
depth_um = 600
quick = {radius_um = [3000]} # these lists instead, in the quick subset; {} = as it is, without = left out
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field, ValidationError, model_validator

from ruffini.boards import Board, Section
from ruffini.errors import InputError
from ruffini.files import readable
from ruffini.older_python import tomllib

PAPER_BENCH = "reproduce.toml"
Um = Annotated[int, Field(ge=-200_000, le=200_000)]
Positive = Annotated[int, Field(ge=1, le=200_000)]
Place = Annotated[list[Um], Field(min_length=2, max_length=2)]
Error = Annotated[int, Field(ge=0, le=100_000_000)]
ThreeErrors = Annotated[list[Error], Field(min_length=3, max_length=3)]
MethodName = Annotated[str, Field(pattern=r"^[a-z_]{1,40}$")]
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,40}$")]


class RigSettings(Section):
    """[rig]: errors of what the bench reads, against the truth; noises are standard deviations. Frozen with the twin.

    A gain is drawn for each run and axis (the reference sensor's placement and nonlinearity), noise for each reading;
    lag and crosstalk are the same always.
    """

    force_noise_un: ThreeErrors = Field(default=[0, 0, 0])
    force_gain_1e4: ThreeErrors = Field(default=[0, 0, 0])
    torque_noise_nnm: ThreeErrors = Field(default=[0, 0, 0])
    torque_gain_1e4: ThreeErrors = Field(default=[0, 0, 0])
    crosstalk_1e4: Error = 0  # part of the normal force that is read as tangential, along x and along y
    moment_crosstalk_um: Error = 0  # the same into each moment: an arm
    ring_force_un: Error = 0  # of the force along z when it touches: the bench rings, and less in every frame
    lag_ms: Annotated[int, Field(ge=0, le=1000)] = 0  # of the force readings behind the pictures
    depth_noise_um: Error = 0  # of a run: where the stage took its zero
    shore_noise_1e1: Error = 0  # of a run: the hardness tester
    place_noise_um: Error = 0  # of a run: where a person says that it touched
    displacement_noise_um: ThreeErrors = Field(default=[0, 0, 0])  # of a surface displacement that the paper is given


class MountSettings(Section):
    """[[mount]]: what the reference sensor's sideways channels are off by while this indenter is bolted to it.

    Standard deviations of a zero that is drawn for every run, along x and y, and about each axis.
    """

    indenter: Annotated[str, Field(min_length=1)]
    zero_force_un: Error = 0
    zero_torque_unm: Error = 0


class AgingSettings(Section):
    """[aging]: what 10,000 presses do to the unit; it grows evenly with their number."""

    modulus_loss_1e3: Annotated[int, Field(ge=0, le=900)] = 0
    light_loss_1e3: Annotated[int, Field(ge=0, le=900)] = 0


class WarmthSettings(Section):
    """[warmth]: what a kelvin does to a unit on a tray; what of it is warm, `warmer_mk` of its sets says."""

    springs_1e6: Annotated[int, Field(ge=-100_000, le=100_000)] = 0  # of their stiffness
    sleeve_1e6: Annotated[int, Field(ge=-100_000, le=100_000)] = 0
    rise_nm: Annotated[int, Field(ge=-1_000_000, le=1_000_000)] = 0  # of the tray, unloaded
    thermometer_noise_mk: Error = 0


class SecondSettings(Section):
    """A second rigid indenter on the same holder."""

    indenter: str
    radius_um: Positive
    distance_um: Positive
    lift_um: Um = 0
    turn_mrad: Um = 0  # of the pair, from the first frame on


class Lists(Section):
    """The lists of a set: a run for each of their product."""

    indenter: Annotated[list[str], Field(min_length=1)] | None = None
    radius_um: Annotated[list[Positive], Field(min_length=1)] | None = None
    shore_a: Annotated[list[Annotated[int, Field(ge=0, le=99)]], Field(min_length=1)] | None = None
    at_um: Annotated[list[Place], Field(min_length=1)] | None = None
    shift_um: Annotated[list[Place], Field(min_length=1)] | None = None
    turn_mrad: Annotated[list[Um], Field(min_length=1)] | None = None
    tilt_mrad: Annotated[list[Place], Field(min_length=1)] | None = None  # roll and pitch, from the first frame on
    after: Annotated[list[Annotated[int, Field(ge=0, le=10_000_000)]], Field(min_length=1)] | None = None
    trial: Annotated[list[int], Field(min_length=1)] | None = None
    speed_um_s: Annotated[list[Positive], Field(min_length=1)] | None = None  # down and up; see PressSet


class PressSet(Lists):
    """[[set]]: presses to `depth_um` in even steps of `step_um`; then sideways and turned in `side_steps` frames.

    `after` presses the unit has been pressed before (aging); a `trial` is the same press with another seed. At a speed
    the frames that would stand closer than `step_um` are left out: the recording is so much slower than the camera.
    `drawn` : so many runs instead of the product of the lists, each number drawn evenly between the least and the most
    of its list, each indenter from its own; runs before stay as they are when more are drawn.
    """

    name: Name
    part: Literal["fit", "judge", "show"]
    what: Annotated[str, Field(min_length=1, max_length=200)]
    depth_um: Positive
    step_um: Positive = 100
    side_steps: Annotated[int, Field(ge=1, le=1000)] = 4
    drawn: Annotated[int, Field(ge=1, le=100_000)] | None = None
    hold_frames: Annotated[int, Field(ge=0, le=100_000)] = 0  # at the end, before it returns
    returns: bool = False  # up again as it went down
    friction_1e3: Annotated[int, Field(ge=0, le=2000)] | None = None  # of the twin where absent
    core_1e3: Annotated[int, Field(ge=0, le=999)] = 0  # rigid core of an elastic indenter, over its radius
    skin_1e3: Annotated[int, Field(ge=0, le=999)] = 0  # elastic skin in front of that core
    second: SecondSettings | None = None
    quick: Lists | None = None

    @model_validator(mode="after")
    def _has_something_to_press(self) -> PressSet:
        if self.indenter is None or self.radius_um is None:
            raise ValueError(f"set {self.name!r} needs indenter and radius_um")
        if self.second is not None and self.shore_a is not None:
            raise ValueError(f"set {self.name!r}: two indenters on one holder are rigid, leave shore_a out")
        return self


class HandSet(Section):
    """[[hand]]: each of the 17 loads by hand through a rigid connector (`bodies.connector`), once in every take."""

    name: Name
    part: Literal["fit", "judge", "show"]
    what: Annotated[str, Field(min_length=1, max_length=200)]
    takes: Annotated[int, Field(ge=1, le=1000)]
    frames: Annotated[int, Field(ge=4, le=100_000)]  # of one push and release
    quick_takes: Annotated[int, Field(ge=0, le=1000)] = 0
    peak_un: ThreeErrors = Field(default=[1_000_000, 1_000_000, 8_000_000])  # largest force along each axis
    peak_nnm: ThreeErrors = Field(default=[20_000_000, 20_000_000, 20_000_000])  # and torque about it
    # By how much each take, in turn, is warmer than when its rest was learned.
    warmer_mk: list[Annotated[int, Field(ge=-80_000, le=80_000)]] = Field(default=[])

    @property
    def largest(self) -> npt.NDArray[np.float64]:
        """N and N m, (6,)."""
        return np.array([*(1e-6 * f for f in self.peak_un), *(1e-9 * t for t in self.peak_nnm)])


class Published(Section):
    """[[published]]: what the paper prints of its method's errors, by the names of `reproduce --only method`."""

    name: Annotated[str, Field(min_length=1, max_length=60)]
    unit: Annotated[str, Field(max_length=12)]
    value_1e6: Annotated[int, Field(ge=1)]
    where: Annotated[str, Field(min_length=1, max_length=60)]


class ReproduceSettings(Section):
    """A whole reproduce.toml."""

    schema_version: Annotated[Literal[1], Field(alias="schema")]
    paper: Annotated[str, Field(min_length=1, max_length=200)]
    method: MethodName | None = None
    published: list[Published] = Field(default=[])
    seed: Annotated[int, Field(ge=0, le=2**31)] = 1
    rig: RigSettings = RigSettings()
    mount: list[MountSettings] = Field(default=[])
    aging: AgingSettings = AgingSettings()
    warmth: WarmthSettings | None = None
    set_: Annotated[list[PressSet], Field(alias="set")] = Field(default=[])
    hand: list[HandSet] = Field(default=[])

    @model_validator(mode="after")
    def _names_differ(self) -> ReproduceSettings:
        names = [*(s.name for s in self.set_), *(h.name for h in self.hand)]
        if not names:
            raise ValueError("there is neither a [[set]] nor a [[hand]]")
        if len(set(names)) < len(names):
            raise ValueError("two sets have the same name")
        return self


def load_reproduce(board: Board, bench: str = PAPER_BENCH) -> ReproduceSettings:
    """reproduce.toml, or another bench of that form, beside the board's board.toml.

    Raises
    ------
    InputError
        The board has none, or the file is not as it should be.
    """
    path = (board.folder or Path()) / bench
    if not path.is_file():
        what = "no paper to reproduce" if bench == PAPER_BENCH else f"no bench {bench!r}"
        raise InputError(f"board {board.name!r} has {what}: {path} does not exist")
    try:
        return parse_reproduce(tomllib.loads(readable(path).read_text("utf-8")), str(path))
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"{path}: not TOML: {error}") from error


def parse_reproduce(tree: dict[str, Any], where: str) -> ReproduceSettings:
    """Checked settings; `where` names their source in messages. Raises InputError."""
    try:
        return ReproduceSettings.model_validate(tree)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        kind = {"extra_forbidden": "unknown key, check the spelling or remove it",
                "missing": "key is missing"}.get(first["type"], first["msg"])  # fmt: skip
        raise InputError(f"{where}: {key}: {kind}") from error
