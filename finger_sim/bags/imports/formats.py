"""Formats that are read and units of time: what a command line names before anything is imported."""

from __future__ import annotations

from typing import Literal

Format = Literal["csv", "tum", "euroc", "kitti", "bag"]
FORMATS: dict[Format, str] = {
    "csv": "text with a line of column names, t among them",
    "tum": "TUM: timestamp tx ty tz qx qy qz qw [s, m]",
    "euroc": "EuRoC/ASL: timestamp [ns], p x y z [m], q w x y z",
    "kitti": "KITTI: 12 numbers a row, and a file of times with --times",
    "bag": "a rosbag2 folder, an .mcap or .db3 file, or a ROS 1 .bag",
}
"""Formats that are read, and what they look like."""

Clock = Literal["header", "receipt"]
TIME_UNITS = {"s": 1_000_000_000, "ms": 1_000_000, "us": 1_000, "ns": 1}
"""Units of time, in nanoseconds."""
