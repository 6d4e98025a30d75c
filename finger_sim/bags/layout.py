"""How arrays lie in messages: points of the mesh as a PointCloud2, wrenches in the frame they name; and other names.

Pure NumPy, no ROS: the node and the replay share these layouts, so both write the same bytes.
"""

from __future__ import annotations

from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..physics.rotations import matrix, normalised
from ..scene import Pose

FLOAT = np.dtype("<f4")
"""Type of every point field: FLOAT32, little endian (PointCloud2 `is_bigendian` = False)."""

POINT_NAMES = ("x", "y", "z", "dx", "dy", "dz", "fx", "fy", "fz", "strain")
POINT_DTYPE = np.dtype([(name, FLOAT) for name in POINT_NAMES])
POINT_STEP = POINT_DTYPE.itemsize
"""Bytes of one point (PointCloud2 `point_step`)."""

POINT_FIELDS = tuple((name, i * FLOAT.itemsize) for i, name in enumerate(POINT_NAMES))
"""(name, offset [byte]) of each PointField: position, displacement [m], contact force [N], strain / limit."""

FLOAT32 = 7
"""sensor_msgs/PointField `datatype` of every field."""

_TITLE = ": simulation"

WrenchFrame = Literal["world_aligned", "finger", "world"]
WRENCH_FRAMES: tuple[WrenchFrame, ...] = get_args(WrenchFrame)


def status_name(node: str) -> str:
    """Name of the node's status on /diagnostics, by its full name: as diagnostics are named, "left/finger: title"."""
    return node.removeprefix("/") + _TITLE


def node_of_status(name: str) -> str | None:
    """Full name of the node whose status has that name; None: it is none of finger_sim's."""
    return f"/{name.removesuffix(_TITLE)}" if name.endswith(_TITLE) else None


def node_strain(strain_ratio: NDArray[np.float64], tets: NDArray[np.integer[Any]], nodes: int) -> NDArray[np.float64]:
    """Strain / limit at each node (nodes,): the largest over the tets (T, 4) around it; 0 if none."""
    strain = np.zeros(nodes)
    np.maximum.at(strain, tets.ravel(), np.repeat(strain_ratio, 4))  # NumPy is slow at it in two dimensions
    return strain


def pack_points(
    positions: NDArray[np.float64],
    placed_rest: NDArray[np.float64],
    contact_forces: NDArray[np.float64],
    strain: NDArray[np.float64],
    out: NDArray[np.void] | None = None,
) -> NDArray[np.void]:
    """Points of a `mesh_points` cloud, (n,) of POINT_DTYPE; `.tobytes()` is PointCloud2 `data`.

    positions      : (n, 3) deformed nodes [m], world axes
    placed_rest    : (n, 3) rest nodes moved rigidly with the finger, `place(rest, pose)` [m];
                     displacement = positions − placed_rest
    contact_forces : (n, 3) force of the plane on each node [N], world axes
    strain         : (n,) strain / limit at each node, `node_strain(...)`; 1 = at the limit
    out            : (n,) of POINT_DTYPE to write into instead of a new array
    """
    points = np.empty(len(positions), dtype=POINT_DTYPE) if out is None else out
    flat = points.view(FLOAT).reshape(-1, len(POINT_NAMES))
    flat[:, 0:3] = positions
    flat[:, 3:6] = positions - placed_rest
    flat[:, 6:9] = contact_forces
    flat[:, 9] = strain
    return points


def express_wrench(wrench: ArrayLike, pose: Pose, frame: WrenchFrame) -> NDArray[np.float64]:
    """The same wrench (6,) [N, N·m] in the axes and about the point that `frame` names.

    wrench : force and torque of the plane on the finger, world axes, torque about the finger frame's origin
    pose   : finger frame in the world (p, R)
    frame  : `world_aligned`  world axes, about the finger frame's origin: as given
             `finger`         axes and origin of the finger frame: Rᵀf, Rᵀτ
             `world`          axes and origin of the world: f, τ + p × f
    Raises ValueError for any other frame.
    """
    w = np.array(wrench, dtype=np.float64)
    if frame == "world_aligned":
        return w
    if frame == "finger":
        R = matrix(normalised(pose.orientation))
        return np.concatenate([R.T @ w[:3], R.T @ w[3:]])
    if frame == "world":
        w[3:] += np.cross(np.asarray(pose.position, dtype=np.float64), w[:3])
        return w
    raise ValueError(f"wrench frame: got {frame!r}, allowed: {', '.join(WRENCH_FRAMES)}")


def wrench_frame_id(frame: WrenchFrame, finger_frame: str = "finger", world_frame: str = "world") -> str:
    """The frame_id that tells axes and point of reference of a wrench expressed in `frame`."""
    if frame == "world_aligned":
        return f"{finger_frame}_world_aligned"
    if frame == "finger":
        return finger_frame
    if frame == "world":
        return world_frame
    raise ValueError(f"wrench frame: got {frame!r}, allowed: {', '.join(WRENCH_FRAMES)}")
