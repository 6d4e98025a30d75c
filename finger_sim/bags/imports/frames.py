"""The pose of one frame in another, out of a bag's transforms: chains of frames, followed both ways."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...arrays import Floats
from ...errors import BagError
from .arrivals import Bag
from .formats import Clock
from .recorded import Recorded
from .samples import TRANSFORM, TRANSFORMS, Sample, clocked, sample
from .turns import between, product, turned, units

STATIC = "/tf_static"
"""Topic of transforms that hold for all times."""
Pair = tuple[str, str]
"""A frame and the frame that it moves, parent and child."""


@dataclass(frozen=True)
class Link:
    """A step along a chain: the transform from `parent` to `child`, or back."""

    pair: Pair
    back: bool


@dataclass(frozen=True)
class Motion:
    """Transforms of a pair of frames at rising times (n,) [ns]: positions (n, 3), unit quaternions (n, 4)."""

    time: NDArray[np.int64]
    position: Floats
    orientation: Floats

    def at(self, wanted: NDArray[np.int64]) -> tuple[Floats, Floats]:
        """Poses at `wanted` times."""
        return between(self.time, self.position, self.orientation, wanted)


def frame_pairs(bag: Bag) -> list[str]:
    """Pairs of frames with their counts, those that move first."""
    moving, still = _collect(bag)
    found = sorted(moving.items(), key=lambda item: -len(item[1]))
    words = [f"{parent} → {child} ({len(samples)} times)" for (parent, child), samples in found]
    return [*words, *(f"{parent} → {child} (static)" for parent, child in still)]


def read_frames(bag: Bag, tf: Pair, clock: Clock | None) -> Recorded:
    """The poses of frame tf[1] in frame tf[0], at the times of the transform between them that comes most often.

    Transforms between two of their own times are interpolated: positions linearly, orientations by slerp.
    Raises BagError for frames that are not there, or not linked, or do not move.
    """
    parent, child = (frame.lstrip("/") for frame in tf)
    moving, still = _collect(bag)
    chain = _chain([*moving, *still], parent, child)
    if chain is None:
        pairs = "; ".join(frame_pairs(bag)) or "no transforms"
        raise BagError(f"{bag.path}: no way from frame {parent!r} to {child!r}; found {pairs}")
    path = " → ".join([parent, *(link.pair[0] if link.back else link.pair[1] for link in chain)])
    timed = [link.pair for link in chain if len(moving.get(link.pair, ())) > 1]
    if not timed:
        raise BagError(f"{bag.path}: {path}: nothing moves along these frames; choose others with --tf")
    choices = [clocked([each.stamp for each in moving[pair]], clock, f"{bag.path}: {_arrow(pair)}") for pair in timed]
    by_header = all(header for header, _ in choices)
    note = next((note for header, note in choices if header == by_header), "")
    motions = {link.pair: _motion(moving.get(link.pair) or [still[link.pair]], by_header) for link in chain}
    densest = max(timed, key=lambda pair: len(motions[pair].time))
    begin = max(int(motions[pair].time[0]) for pair in timed)
    end = min(int(motions[pair].time[-1]) for pair in timed)
    times = motions[densest].time
    times = times[(times >= begin) & (times <= end)]
    if not len(times):
        raise BagError(f"{bag.path}: {path}: its transforms are never known at the same time")
    position, orientation = _composed(chain, motions, times)
    others = f", at the times of {_arrow(densest)}, the others interpolated" if len(timed) > 1 else ""
    refused = sum(each.refusal() is not None for pair in timed for each in moving[pair])
    left = [f"{refused} transforms that are no poses are left out"] if refused else []
    return Recorded(
        format=f"transforms {path}",
        time=[int(time - times[0]) for time in times],
        position=position,
        orientation=orientation,
        places=[f"{bag.path}: {path}, pose {i}" for i in range(1, len(times) + 1)],
        notes=(f"{note}{others}",),
        warnings=(*left, *([bag.warning] if bag.warning else [])),
    )


def _collect(bag: Bag) -> tuple[dict[Pair, list[Sample]], dict[Pair, Sample]]:
    """Transforms by pairs of frames: those that come again, and the newest of each static one."""
    moving: defaultdict[Pair, list[Sample]] = defaultdict(list)
    still: dict[Pair, Sample] = {}
    topics = [each for each in bag.topics if each.type in (*TRANSFORMS, TRANSFORM)]
    for arrival in bag.arrivals(topics):
        several = getattr(arrival.message, "transforms", [arrival.message])
        for each in (sample(arrival.number, arrival.log_time, transform) for transform in several):
            pair = each.frame, each.child
            if arrival.topic.endswith(STATIC):
                still[pair] = each
            else:
                moving[pair].append(each)
    return dict(moving), {pair: each for pair, each in still.items() if pair not in moving}


def _chain(pairs: list[Pair], parent: str, child: str) -> list[Link] | None:
    """The shortest way from `parent` to `child`, up and down the tree; None where there is none."""
    links: defaultdict[str, list[tuple[str, Link]]] = defaultdict(list)
    for pair in pairs:
        links[pair[0]].append((pair[1], Link(pair, back=False)))
        links[pair[1]].append((pair[0], Link(pair, back=True)))
    ways: dict[str, list[Link]] = {parent: []} if parent in links else {}
    waiting = deque(ways)
    while waiting and child not in ways:
        frame = waiting.popleft()
        for other, link in links[frame]:
            if other not in ways:
                ways[other] = [*ways[frame], link]
                waiting.append(other)
    return ways.get(child) or None


def _motion(samples: list[Sample], by_header: bool) -> Motion:
    """The good ones of transforms; of equal times the last."""
    good = {each.stamp if by_header else each.receipt: each for each in samples if each.refusal() is None}
    if not good:
        pair = samples[0].frame, samples[0].child
        raise BagError(f"{_arrow(pair)}: has no good transform: {samples[0].refusal()}")
    return Motion(
        np.array(list(good), dtype=np.int64),
        np.array([each.position for each in good.values()]),
        units(np.array([each.orientation for each in good.values()])),
    )


def _composed(chain: list[Link], motions: Mapping[Pair, Motion], times: NDArray[np.int64]) -> tuple[Floats, Floats]:
    """Poses at the end of a chain: p = p₁ + R₁ p₂, R = R₁ R₂ from link to link."""
    n = len(times)
    position, orientation = np.zeros((n, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (n, 1))
    for link in chain:
        p, q = motions[link.pair].at(times)
        if link.back:
            q = q * [-1.0, -1.0, -1.0, 1.0]
            p = -turned(q, p)
        position = position + turned(orientation, p)
        orientation = product(orientation, q)
    return position, orientation


def _arrow(pair: Pair) -> str:
    return f"{pair[0]} → {pair[1]}"
