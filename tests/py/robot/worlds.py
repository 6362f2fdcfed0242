"""Worlds of the tests: a pad that looks up, and something on it."""

from __future__ import annotations

BOARD = "gelslim"
WITHOUT_Z = "gelsight-mini"  # a board that does not measure it


def lying(geom: str, *, above_m: float, step_s: float = 1e-3, mass: float = 0.1, friction: float = 0.6) -> str:
    """A pad in a fixed finger, face up at z = 0, and a free body of one geom `above_m` over it."""
    return f"""<mujoco><option timestep="{step_s}" integrator="implicitfast"/><worldbody>
    <body name="finger"><geom type="box" size=".01 .008 .01" pos="0 0 -.015"/><site name="pad"/></body>
    <body name="object" pos="0 0 {above_m}"><freejoint/><geom {geom} mass="{mass}" friction="{friction} .005 .0001"/>
    </body></worldbody></mujoco>"""


def scale(geom: str, *, step_s: float = 1e-3, friction: float = 0.6) -> str:
    """The same object on rails: it is pushed by motors x, y, z; MuJoCo's sensors measure what the finger carries."""
    return f"""<mujoco><option timestep="{step_s}" integrator="implicitfast" gravity="0 0 0"/><worldbody>
    <body name="finger"><geom type="box" size=".01 .008 .01" pos="0 0 -.015"/><site name="pad"/></body>
    <body name="object" pos="0 0 .0151"><joint name="x" type="slide" axis="1 0 0" damping="5"/>
    <joint name="y" type="slide" axis="0 1 0" damping="5"/><joint name="z" type="slide" axis="0 0 1" damping="5"/>
    <geom {geom} mass="0.2" friction="{friction} .005 .0001"/></body></worldbody>
    <actuator><motor joint="x"/><motor joint="y"/><motor joint="z"/></actuator>
    <sensor><force site="pad"/><torque site="pad"/></sensor></mujoco>"""


def standing(*, above_m: float, mass: float = 0.2) -> str:
    """A finger whose pad looks down stands on a plane, or is `above_m` over it."""
    return f"""<mujoco><option timestep=".001" integrator="implicitfast"/><worldbody>
    <geom type="plane" size="1 1 .1"/><body name="finger" pos="0 0 {above_m}">
    <joint type="slide" axis="0 0 1" damping="5"/>
    <geom type="box" size=".01 .008 .005" pos="0 0 .01" mass="{mass}" contype="0" conaffinity="0"/>
    <site name="pad" zaxis="0 0 -1"/></body></worldbody></mujoco>"""
