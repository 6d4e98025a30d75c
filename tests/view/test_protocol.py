"""What is packed, against an independent decoder."""

from __future__ import annotations

import math

import numpy as np
from numpy.testing import assert_allclose
from view.decoder import decode_frame, decode_topology

from finger_sim.view.protocol import CONTACT, SAMPLE, Frame, Picture, Topology, pack_topology

RANDOM = np.random.default_rng(1)


def test_a_topology_with_all_that_a_scene_knows() -> None:
    """Every array comes back; a free axis is NaN; flags are padded to whole words."""
    rest, triangles = RANDOM.random((7, 3)), RANDOM.integers(0, 7, (9, 3)).astype(np.int32)
    tets, axes = RANDOM.integers(0, 7, (4, 4)).astype(np.int32), RANDOM.random((4, 3, 3))
    flags, limits = np.arange(7, dtype=np.uint8), np.array([[1.05, 0.95], [np.nan, 0.75], [1.02, np.nan]])
    got = decode_topology(pack_topology(3, Topology(rest, triangles, tets, flags, axes, limits)))
    assert (got.generation, got.known, got.flags) == (3, 3, list(range(7)))
    assert_allclose(got.rest, rest, rtol=1e-6)
    assert got.triangles.tolist() == triangles.tolist()
    assert got.tets.tolist() == tets.tolist()
    assert_allclose(got.axes, axes, rtol=1e-6)
    assert_allclose(got.limits, limits, rtol=1e-6)


def test_a_topology_of_which_only_the_surface_is_known() -> None:
    """No flag is set, no tetrahedra, no axes."""
    got = decode_topology(pack_topology(1, Topology(RANDOM.random((4, 3)), np.array([[0, 1, 2]], np.int32))))
    assert (got.known, len(got.tets), got.axes) == (0, 0, None)


def test_a_frame_with_everything() -> None:
    """Each number stands where the protocol says."""
    nodes = 6
    picture = Picture(
        time=1234.5, positions=RANDOM.random((nodes, 3)).astype(np.float32),
        strain=np.array([0.0, 0.5, 1.0, 1.5, 1.99, 80.0], np.float32),
        pose=np.arange(7.0), command=np.arange(7.0) + 10, plane=np.arange(7.0) + 20, wrench=np.arange(6.0) + 30,
        device=np.arange(6.0) + 40, centre=np.arange(3.0) + 50, friction=0.5, depth=0.002, status=144, virtual=True,
        contacts=np.array([(2, (1.0, 2.0, 3.0), 1), (5, (4.0, 5.0, 6.0), 0)], CONTACT),
    )  # fmt: skip
    samples = np.array([(-0.01, 1.0, 2.0, 3.0, 4.0), (0.0, 5.0, 6.0, 7.0, 8.0)], SAMPLE)
    got = decode_frame(Frame(2, 77, picture).message(samples.tobytes()))
    assert (got.generation, got.seq, got.time, got.status) == (2, 77, 1234.5, 144)
    assert got.flags == 1 | 2 | 4 | 8
    wanted = [*range(7), *range(10, 17), *range(20, 27), *range(30, 36), *range(40, 46), *range(50, 53), 0.5, 0.002]
    assert_allclose(got.floats, wanted, rtol=1e-6)
    assert_allclose(got.positions, picture.positions)
    assert got.strain == [0, 64, 128, 192, 255, 255]
    assert got.contacts == [(2, (1.0, 2.0, 3.0), 1), (5, (4.0, 5.0, 6.0), 0)]
    assert_allclose(got.samples, [(-0.01, 1, 2, 3, 4), (0, 5, 6, 7, 8)], rtol=1e-6)
    assert decode_frame(Frame(2, 77, picture).message(b"", restart=True)).flags == 1 | 2 | 4 | 8 | 16


def test_a_frame_of_which_little_is_known() -> None:
    """What is not known is NaN, and has no flag."""
    bare = Picture(0.0, np.zeros((3, 3), np.float32), np.zeros(3, np.float32))
    got = decode_frame(Frame(1, 1, bare).message(b""))
    assert got.flags == 0
    assert all(math.isnan(number) for number in got.floats[:37])
    assert got.floats[37] == 0.0
