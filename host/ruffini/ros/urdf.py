"""A board's frames as URDF: the pad's, which all messages are in, and the camera's behind it."""

from __future__ import annotations

from xml.sax.saxutils import quoteattr

from ruffini.boards import Board


def urdf(board: Board, name: str) -> str:
    """A robot of one sensor, to be included where it is mounted: fix a joint to its link `NAME_base`.

    NAME_base and NAME_pad are the same place, the centre of the undeformed pad's surface, z out of the pad. Boards with
    one camera behind a flat pad have NAME_camera_optical_frame, z forward, and the pad as a box.
    """
    is_flat = board.skin is None and not board.writes("tool_touch")
    pad, camera = board.pad, board.camera
    shape = ""
    if is_flat:
        size = f"{pad.size_x_um * 1e-6:.6g} {pad.size_y_um * 1e-6:.6g} {pad.thickness_um * 1e-6:.6g}"
        box = f'<origin xyz="0 0 {-pad.thickness_um * 0.5e-6:.6g}"/><geometry><box size="{size}"/></geometry>'
        shape = f"\n    <visual>{box}</visual>\n    <collision>{box}</collision>\n  "
    lines = [
        '<?xml version="1.0"?>',
        f"<!-- {board.board.product.replace('--', '-')} -->",
        f"<robot name={quoteattr(name)}>",
        f'  <link name="{name}_base"/>',
        f'  <link name="{name}_pad">{shape}</link>',
        *_joint(name, "pad", "base", 0.0),
    ]
    if is_flat:
        lines += [f'  <link name="{name}_camera_optical_frame"/>']
        lines += _joint(name, "camera_optical_frame", "pad", -camera.standoff_um * 1e-6)
    return "\n".join([*lines, "</robot>", ""])


def _joint(name: str, child: str, parent: str, z_m: float) -> list[str]:
    return [
        f'  <joint name="{name}_{child}_joint" type="fixed">',
        f'    <parent link="{name}_{parent}"/><child link="{name}_{child}"/><origin xyz="0 0 {z_m:.6g}"/>',
        "  </joint>",
    ]
