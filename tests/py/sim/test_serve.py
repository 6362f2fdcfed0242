"""The live twin on its socket: the bytes, the faults, and the same pictures every time."""

import itertools
import socket
import struct
import time

import numpy as np
import pytest
from hang import HANG_S, until

from ruffini.errors import InputError
from ruffini.sim.contact import Indenter, Pose
from ruffini.sim.scenario import Scenario, load_scenario
from ruffini.sim.serve import Scripted, Steered, TwinServer

MM = 1e-3
N = 12


class Camera:
    """The other end, as firmware/capture/twin_camera.h describes it."""

    def __init__(self, path, mode=b"L"):
        self.socket = socket.socket(socket.AF_UNIX)
        self.socket.settimeout(HANG_S)
        self.socket.connect(str(path))
        magic, version, *self.sizes, n_name = struct.unpack("<4s5I", self.read(24))
        assert (magic, version) == (b"RFTC", 1)
        self.board = self.read(n_name).decode()
        self.socket.sendall(mode)

    def read(self, n):
        data = b""
        while len(data) < n:
            part = self.socket.recv(n - len(data))
            assert part, "the twin went away"
            data += part
        return data

    def frames(self):
        """(number, pixels) until the end."""
        while True:
            magic, n_bytes, number = struct.unpack("<4sIQ", self.read(16))
            assert magic == b"RFTF"
            if n_bytes == 0:
                return
            yield number, np.frombuffer(self.read(n_bytes), np.uint8)


def rest(n=N, **more):
    return Scenario(program="rest", n=n, **more)


def served(unit, scenario, path, mode=b"L"):
    with TwinServer(unit.renderer(), Scripted(unit, scenario), scenario, path):
        return dict(Camera(path, mode).frames())


def test_greeting_and_frames(coarse_unit, tmp_path):
    scenario = rest()
    with TwinServer(coarse_unit.renderer(), Scripted(coarse_unit, scenario), scenario, tmp_path / "twin") as server:
        camera = Camera(tmp_path / "twin")
        frames = dict(camera.frames())
        assert camera.board == coarse_unit.board.name
        assert camera.sizes == [320, 240, 60_000]
        assert list(frames) == list(range(N))
        assert (frames[3].reshape(240, 320, 3) == server.picture(3)).all()
    assert not (tmp_path / "twin").exists()


def test_pictures_that_are_kept_are_the_same_and_come_again_without_end(coarse_unit, tmp_path):
    frames = Scripted(coarse_unit, rest())
    drawn = []

    class Counting(Scenario):
        def picture(self, renderer, frame, *states, **more):
            drawn.append(frame)
            return super().picture(renderer, frame, *states, **more)

    scenario = Counting(program="rest", n=N)
    twin, steps = TwinServer(coarse_unit.renderer(), frames, scenario, tmp_path / "twin"), []
    twin.keep(5, steps.append)
    with twin:
        seen = dict(itertools.islice(Camera(tmp_path / "twin").frames(), 3 * N))
        expected = [twin.picture(i) for i in range(5)]
    assert list(seen) == list(range(3 * N))
    assert all((picture.reshape(240, 320, 3) == expected[i % 5]).all() for i, picture in seen.items())
    assert steps[-1] == 1
    assert drawn == [*range(5), *range(5)], "once each, and again for the comparison"


def test_every_camera_gets_the_same_bits(coarse_unit, tmp_path):
    scenario = rest(fault=[{"kind": "drop", "first_frame": 0, "n_frames": N, "share_1e3": 400}])
    with TwinServer(coarse_unit.renderer(), Scripted(coarse_unit, scenario), scenario, tmp_path / "twin"):
        first, again = (dict(Camera(tmp_path / "twin").frames()) for _ in range(2))
    other = served(coarse_unit, rest(seed=2), tmp_path / "twin")
    assert 0 < len(first) < N
    assert first.keys() == again.keys()
    assert all((first[i] == again[i]).all() for i in first)
    assert (first[next(iter(first))] != other[next(iter(first))]).any()


class ToldClock:
    """Lets frames come one after the other, and notes what it is told."""

    def __init__(self):
        self.told = []

    def next_frame(self):
        number = sum(what == "next" for what in self.told)
        self.told.append("next")
        return number

    def has_drawn(self):
        self.told.append("drawn")

    def without_frames(self):
        self.told.append("without")


@pytest.mark.parametrize("goes_early", [False, True])
def test_the_clock_of_a_camera_in_lockstep_is_told_of_each_frame_and_of_the_end(coarse_unit, tmp_path, goes_early):
    clock = ToldClock()
    with TwinServer(coarse_unit.renderer(), Scripted(coarse_unit, rest()), rest(), tmp_path / "twin") as server:
        server.clock = clock
        server.after_sending = lambda _: clock.told.append("sent")
        camera = Camera(tmp_path / "twin")
        if goes_early:
            next(camera.frames())
            camera.socket.close()
        else:
            assert list(dict(camera.frames())) == list(range(N))
        until(lambda: clock.told[-1:] == ["without"], "the end")
    whole = ["next", "drawn", "sent"] * N + ["next", "without"]
    assert clock.told[:-1] == whole[: len(clock.told) - 1]
    assert goes_early or clock.told == whole


def test_a_stall_is_a_gap_in_the_numbers(coarse_unit, tmp_path):
    scenario = rest(fault=[{"kind": "stall", "first_frame": 4, "n_frames": 5}])
    assert list(served(coarse_unit, scenario, tmp_path / "twin")) == [0, 1, 2, 3, 9, 10, 11]


@pytest.mark.parametrize(
    ("fault", "is_so"),
    [
        ({"kind": "lens_cap"}, lambda p, ref: p.max() < 8),
        ({"kind": "over_exposure", "factor_1e3": 4000}, lambda p, ref: (p == 255).mean() > 0.3),
        ({"kind": "led_off", "leds": [0]}, lambda p, ref: p[..., 0].mean() < 0.5 * ref[..., 0].mean()),
        ({"kind": "light_leak", "level_1e3": 800}, lambda p, ref: p[:, :9].mean() > 1.5 * ref[:, :9].mean()),
        ({"kind": "torn_gel", "x_um": 0, "y_um": 0, "radius_um": 900}, lambda p, ref: (p > ref + 40).mean() > 0.003),
    ],
)
def test_optical_faults_begin_and_end_as_scripted(coarse_unit, tmp_path, fault, is_so):
    scenario = rest(6, fault=[{**fault, "first_frame": 2, "n_frames": 2}])
    frames = served(coarse_unit, scenario, tmp_path / "twin")
    pictures = [frames[i].reshape(240, 320, 3).astype(float) for i in range(6)]
    assert [bool(is_so(p, pictures[0])) for p in pictures] == [False, False, True, True, False, False]


def test_paced_frames_keep_the_rate_and_skip_what_is_late(coarse_unit, tmp_path):
    scenario = rest(40)
    with TwinServer(coarse_unit.renderer(), Scripted(coarse_unit, scenario), scenario, tmp_path / "twin"):
        camera = Camera(tmp_path / "twin", b"P")
        start, numbers = time.monotonic(), []
        for number, _ in camera.frames():
            numbers.append(number)
            if number == 10:
                time.sleep(0.25)  # fills the socket: 15 periods, or more on a busy computer
    took_s = time.monotonic() - start
    assert took_s + 0.02 >= 39 / 60  # only from below: a busy computer may be late
    assert numbers == sorted(set(numbers))
    assert len(numbers) < 38


def test_steered_ball_goes_where_it_is_told_at_its_speed(coarse_unit):
    steered = Steered(coarse_unit, Indenter("sphere", 3 * MM))
    assert not steered.states(0)[0].any()
    steered.move_to(Pose(MM, 0, 0.5 * MM))
    depths = [-steered.states(i)[0][:, 2].min() / MM for i in range(4)]
    assert depths[0] < 0.42  # 20 mm/s at 60 Hz, on this coarse mesh
    assert depths[1] > depths[0] + 0.05
    assert depths[-1] == pytest.approx(0.5, abs=0.08)
    assert -2 < steered.wrench[2] < -0.1


def test_steered_ball_stays_when_it_is_sent_off_the_pad(coarse_unit, capsys):
    steered = Steered(coarse_unit, Indenter("sphere", 3 * MM))
    steered.move_to(Pose(0, 0, 0.3 * MM))
    for i in range(3):
        steered.states(i)[0]
    force = steered.wrench[2]
    steered.move_to(Pose(0, 0, 3.9 * MM))
    before = [steered.states(i)[0] for i in range(20)][-1]
    assert (steered.states(21)[0] == before).all()
    assert steered.wrench[2] <= force
    assert capsys.readouterr().err


def test_a_socket_in_use_is_refused_and_a_dead_one_replaced(coarse_unit, tmp_path):
    frames = Scripted(coarse_unit, rest(1))
    with (
        TwinServer(coarse_unit.renderer(), frames, rest(1), tmp_path / "twin"),
        pytest.raises(InputError, match="another twin serves there"),
    ):
        TwinServer(coarse_unit.renderer(), frames, rest(1), tmp_path / "twin")
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(str(tmp_path / "twin"))
    assert len(served(coarse_unit, rest(1), tmp_path / "twin")) == 1
    with pytest.raises(InputError, match="choose another --socket"):
        TwinServer(coarse_unit.renderer(), frames, rest(1), tmp_path / "no" / "folder")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('program = "dance"', "program"),
        ("n = 0", "n: "),
        ('[[fault]]\nkind = "smoke"\nfirst_frame = 0\nn_frames = 1', "fault"),
        ('[[fault]]\nkind = "stall"\nfirst_frame = 0', "fault.0.n_frames: key is missing"),
        ('[[fault]]\nkind = "stall"\nfirst_frame = 0\nn_frames = 1\nleds = [1]', "unknown key"),
        ("seed = ", "not TOML"),
    ],
)
def test_bad_scenarios_are_refused(tmp_path, text, words):
    (tmp_path / "s.toml").write_text(f"schema = 1\n{text}\n")
    with pytest.raises(InputError, match=words):
        load_scenario(tmp_path / "s.toml")


def test_missing_scenario_is_named(tmp_path):
    with pytest.raises(InputError, match=r"s\.toml: cannot be read"):
        load_scenario(tmp_path / "s.toml")
