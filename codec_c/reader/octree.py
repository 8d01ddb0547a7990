"""Positions of one chunk, as an octree: part 6 of FORMAT.md."""

from __future__ import annotations

import itertools
from collections import defaultdict
from typing import NamedTuple

from .coding import (
    ByteReader,
    Curve,
    State,
    WideRangeDecoder,
    check,
    clamp,
    in_int32,
    mix,
    morton_cell,
)

ONLY = [
    119, 248, 248, 248, 248, 247, 247, 247, 247, 244, 244, 242, 241, 241, 240, 239, 239, 238,
    237, 237, 234, 227, 221, 214, 205, 194, 184, 173, 159, 135, 107, 84, 65, 51, 41, 30, 19, 11,
    6, 5, 5, 5, 5, 5,
]  # fmt: skip
CHILD = [
    [80, 73, 6, 22, 79, 115, 137, 160],
    [77, 66, 7, 20, 66, 121, 137, 160],
    [77, 66, 7, 20, 66, 121, 137, 160],
    [74, 65, 10, 22, 65, 121, 137, 160],
    [73, 67, 12, 22, 53, 118, 137, 160],
    [72, 70, 15, 26, 51, 124, 137, 160],
    [73, 72, 22, 36, 57, 128, 150, 177],
    [76, 76, 28, 47, 60, 127, 152, 194],
    [82, 83, 42, 64, 67, 128, 154, 205],
    [95, 95, 65, 88, 85, 130, 157, 215],
    [113, 122, 97, 121, 116, 147, 170, 221],
    [148, 153, 130, 150, 158, 175, 196, 224],
    [176, 172, 161, 179, 185, 208, 217, 230],
    [195, 203, 207, 207, 220, 222, 226, 230],
    [218, 228, 230, 230, 230, 230, 230, 230],
]
GAIN = [0, 8, 6, 4, 3, 2, 1, 0, 1, 1]
HEIGHT_CLASS = [0, 0, 1, 2, 3, 4, 4, 4] + 14 * [5]
CROWD_CLASS = [0, 1, 2, 3, 4, 4, 5, 5, 5] + 5 * [6] + 13 * [7]
SIBLINGS_CLASS = [0, 0, 1, 2, 2, 3, 3, 3, 3]
TRUST = [0, 1, 1] + 5 * [2] + 12 * [3] + 40 * [4] + 191 * [5]
OUTER_SETS = (4, 2, 1, 6, 5, 3, 7)

SHIFTS = [(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)]  # 13: the node
KEY_STEP = [(x << 44) + (y << 22) + z for x, y, z in SHIFTS]
DIRECTIONS = [d for d in range(27) if d != 13]
ABSENT, UNCODED = -2, -1  # in place of the children of a node around


def cell_key(cell: tuple[int, int, int]) -> int:
    """A key of a cell; the keys of neighbours differ from it by the numbers of KEY_STEP."""
    x, y, z = cell
    return (x + 1 << 44) + (y + 1 << 22) + z + 1


def _outer_direction(c: int, axes: int) -> int:
    """Direction (index of SHIFTS) of the outer cell of child c for a set of axes."""
    direction = 0
    for axis in (4, 2, 1):
        step = 0 if not axes & axis else 1 if c & axis else -1
        direction = 3 * direction + step + 1
    return direction


OUTER = [[(_outer_direction(c, m), c ^ m) for m in OUTER_SETS] for c in range(8)]


def _child_gain(direction: int, other: int, c: int) -> int:
    """Gain of child `other` of the node in a direction for child c of the node."""
    q = 0
    for axis, shift in zip((4, 2, 1), SHIFTS[direction], strict=True):
        q += (2 * shift + bool(other & axis) - bool(c & axis)) ** 2
    return GAIN[q] if q < 10 else 0


def _density_table(direction: int) -> list[int]:
    """The densities that a node in a direction gives to our eight children, by its own children.

    The density of child c is in the 16 bits from bit 16 c on. The index is the node's children as
    bits; -1 stands for a node that is not yet coded.
    """
    table = [0] * 257
    for c in range(8):
        gains = [_child_gain(direction, other, c) for other in range(8)]
        for children in range(256):
            total = sum(g for other, g in enumerate(gains) if children >> other & 1)
            table[children] += total << 16 * c
        table[256] += (sum(gains) + 3) // 6 << 16 * c
    return table


DENSITY = [_density_table(d) for d in range(27)]


def logarithm(x: int) -> int:
    """L(x) of 6.3."""
    e = x.bit_length() - 1
    return 4 * e + (4 * x >> e & 3)


class Node(NamedTuple):
    """A node of a level, and what its decisions need to know of its parent."""

    code: int
    parent_crowd: int = 0  # a class
    parent_children: int = 0  # as bits; 0 for the root


class Around:
    """What is seen around a node (6.3)."""

    def __init__(self, key: int, coded: dict[int, int]) -> None:
        self.nodes = 27 * [ABSENT]
        self.count = 0
        packed = 0
        for d in DIRECTIONS:
            children = coded.get(key + KEY_STEP[d], ABSENT)
            if children != ABSENT:
                self.nodes[d] = children
                self.count += 1
                packed += DENSITY[d][children]
        self.density = [packed >> 16 * c & 0xFFFF for c in range(8)]
        self.crowd = CROWD_CLASS[self.count]

    def outer(self, c: int, count: int) -> tuple[int, ...]:
        """States of the first `count` outer cells of child c: 3 the face cells, 7 all."""
        states = []
        for direction, other in OUTER[c][:count]:
            children = self.nodes[direction]
            states.append(children + 2 if children < 0 else 2 + (children >> other & 1))
        return tuple(states)


class Octree:
    """Decodes the payload of one octree."""

    def __init__(self, payload: bytes) -> None:
        self.coder = WideRangeDecoder(payload)
        self.states: dict[tuple, State] = {}
        self.curves: dict[tuple, Curve] = defaultdict(Curve)
        self.weights: dict[tuple, list[int]] = {}

    def points(self, depth: int, n: int) -> list[int]:
        """The Morton codes of the n points, ascending."""
        level = [Node(0)]
        ended: list[int] = []
        for h in range(depth, 0, -1):
            coded = {cell_key(morton_cell(node.code)): UNCODED for node in level}
            below: list[Node] = []
            for key, node in zip(list(coded), level, strict=True):
                around = Around(key, coded)
                children = self.children(node, h, around)
                if children is None:
                    ended.append(node.code << 3 * h | self.coder.plain(3 * h))
                    continue
                coded[key] = children
                for c in range(8):
                    if children >> c & 1:
                        below.append(Node(node.code << 3 | c, around.crowd, children))
                check(len(below) <= n - len(ended), f"more points than {n}")
            level = below
        points = sorted(ended + [node.code for node in level])
        check(len(points) == n, f"{len(points)} points instead of {n}")
        self.coder.finish()
        return points

    def state(self, key: tuple, first: int = 128, n: int = 1) -> State:
        """The state of a context; P is first 2^14 * first."""
        state = self.states.get(key)
        if state is None:
            state = self.states[key] = State(250, first << 14, n)
        return state

    def decide(self, kind: str, states: list[State], curve: tuple) -> int:
        """A decision of kind only, half or child."""
        selected = (kind, TRUST[states[0].n], TRUST[states[1].n])
        weights = self.weights.get(selected)
        if weights is None:
            weights = self.weights[selected] = len(states) * [65536 // len(states)]
        return mix(self.coder, states, weights, 13, self.curves[curve], 1 << 18)

    def children(self, node: Node, h: int, around: Around) -> int | None:
        """The children of a node as bits; None if it ends."""
        height = HEIGHT_CLASS[h]
        if around.count == 0 and node.parent_crowd > 0 and self.alone(height, node.parent_crowd):
            return None
        if not (around.count == 0 and h == 1) and self.only(node, height, around):
            if h == 1 and around.count <= 3:
                return 1 << self.coder.plain(3)
            return 1 << self.only_child(height, around)
        children = so_far = 0
        for c in range(8):
            left_out = so_far + 8 - c <= 2
            bit = 1 if left_out else self.child(c, children, so_far, height, around)
            children |= bit << c
            so_far += bit
        return children

    def alone(self, height: int, parent_crowd: int) -> int:
        """The decision `alone?`."""
        state = self.state(("alone", height, parent_crowd), 248, 20)
        bit = self.coder.decode(clamp(state.p >> 6, 16, 65520))
        state.update(bit)
        return bit

    def only(self, node: Node, height: int, around: Around) -> int:
        """The decision `only?`."""
        own = node.code & 7
        siblings = SIBLINGS_CLASS[node.parent_children.bit_count()]
        family = sum((node.parent_children >> (p ^ own) & 1) << p for p in range(8))
        log = logarithm(1 + sum(around.density))
        states = [
            self.state(("only 1", height, node.parent_crowd, siblings, log), ONLY[log], 20),
            self.state(("only 2", height, around.crowd, family)),
        ]
        return self.decide("only", states, ("only", height))

    def only_child(self, height: int, around: Around) -> int:
        """The number of the only child, by three decisions `half?`."""
        first, last = 0, 7  # children left
        for axis in range(3):
            middle = (first + last + 1) // 2
            lower = sum(around.density[first:middle])
            upper = sum(around.density[middle : last + 1])
            balance = clamp(logarithm(1 + upper) - logarithm(1 + lower), -12, 12)
            log = logarithm(1 + lower + upper) // 4
            start = 128 + clamp(13 * balance, -26, 26)
            faces = around.outer(first, 3) + around.outer(last, 3)
            states = [
                self.state(("half 1", height, axis, balance, log), start, 20),
                self.state(("half 2", axis, first, faces)),
            ]
            if self.decide("half", states, ("half", height, axis)):
                first = middle
            else:
                last = middle - 1
        return first

    def child(self, c: int, so_far_bits: int, so_far: int, height: int, around: Around) -> int:
        """The decision `child c?`."""
        log = logarithm(1 + around.density[c])
        outer = around.outer(c, 7)
        first = CHILD[min(log // 2, 14)][so_far]
        states = [
            self.state(("child 1", outer[:3], c, so_far_bits)),
            self.state(("child 2", outer, so_far)),
            self.state(("child 3", height, log, c, so_far), first, 20),
        ]
        return self.decide("child", states, ("child", height, c, so_far))


def decode_octree(
    data: bytes, n: int, corner: tuple[list[int], int] | None = None
) -> list[list[int]]:
    """n positions in Morton order; `corner` is the origin and the depth that mode 3 needs."""
    if n == 0:
        check(not data, "bytes without points")
        return []
    check(n <= 32768 * len(data), f"too many points for {len(data)} bytes")
    reader = ByteReader(data)
    (mode,) = reader.fields("B")
    check(mode in (0, 2) or (mode == 3 and corner is not None), f"an octree of mode {mode}")
    if mode == 3 and corner is not None:
        origin, depth = corner
    else:
        (depth,) = reader.fields("B")
        if mode == 0:
            origin = list(reader.fields("3i"))
        else:
            origin = [reader.varint(shortest=True) for _ in range(3)]
    check(depth <= 21, f"an octree of depth {depth}")
    if mode == 0:
        check(reader.left == 8 * n, "bare codes of a wrong length")
        codes = list(reader.fields(f"{n}Q"))
        check(all(a < b for a, b in itertools.pairwise(codes)), "bare codes do not ascend")
        check(codes[-1] < 8**depth, "a bare code of 8^depth or more")
    else:
        codes = Octree(reader.rest()).points(depth, n)
    positions = [[o + v for o, v in zip(origin, morton_cell(code), strict=True)] for code in codes]
    check(all(in_int32(v) for p in positions for v in p), "a position outside of int32")
    return positions
