"""The levels of an octree, for reading (FORMAT.md on ANCH); same bytes as the C coder."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field
from itertools import product

from clgs.reference.codec.coding import (
    MIN_PROBABILITY,
    WEIGHT_ONE,
    Curve,
    State,
    WideCoder,
    code_mixed,
)

LIMIT, SHIFT, WEIGHT_LIMIT = 250, 13, 4 * WEIGHT_ONE
GAIN = {1: 8, 2: 6, 3: 4, 4: 3, 5: 2, 6: 1, 8: 1, 9: 1}
"""What a child gains by a point, by the square of their distance in cells."""

MIRRORS = (4, 2, 1, 6, 5, 3, 7)
TRUST = (1, 3, 8, 20, 60)
BALANCE = 12
ALONE, CONFIDENCE = 248, 20
# fmt: off
ONLY = [
    119, 248, 248, 248, 248, 247, 247, 247, 247, 244, 244, 242, 241, 241, 240, 239, 239, 238, 237,
    237, 234, 227, 221, 214, 205, 194, 184, 173, 159, 135, 107, 84, 65, 51, 41, 30, 19, 11, 6, 5,
    5, 5, 5, 5,
]
CHILD = [
    [80, 73, 6, 22, 79, 115, 137, 160], [77, 66, 7, 20, 66, 121, 137, 160],
    [77, 66, 7, 20, 66, 121, 137, 160], [74, 65, 10, 22, 65, 121, 137, 160],
    [73, 67, 12, 22, 53, 118, 137, 160], [72, 70, 15, 26, 51, 124, 137, 160],
    [73, 72, 22, 36, 57, 128, 150, 177], [76, 76, 28, 47, 60, 127, 152, 194],
    [82, 83, 42, 64, 67, 128, 154, 205], [95, 95, 65, 88, 85, 130, 157, 215],
    [113, 122, 97, 121, 116, 147, 170, 221], [148, 153, 130, 150, 158, 175, 196, 224],
    [176, 172, 161, 179, 185, 208, 217, 230], [195, 203, 207, 207, 220, 222, 226, 230],
    [218, 228, 230, 230, 230, 230, 230, 230],
]
# fmt: on

Cell = tuple[int, int, int]


@dataclass
class Node:
    """A cell of a level that holds points."""

    parent: int = 0  # class of the nodes around its parent
    family: int = 0  # its parent's occupancy; bit c: child c xor its own number
    points: list[Cell] = field(default_factory=list)  # encoder: the leaves below it
    occupancy: int | None = None  # bit c: child c exists; None: not yet coded


def code_levels(
    coder: WideCoder, depth: int, leaves: list[Cell] | None, count: int | None = None
) -> list[Cell]:
    """Code the levels from the root down; ``leaves`` are known to the encoder only. All points."""
    model, whole = _Model(coder), []
    level = {(0, 0, 0): Node(points=leaves or [])}
    for height in range(depth, 0, -1):
        for cell, node in level.items():
            path = model.code_node(level, cell, node, height)
            if path is not None:
                node.occupancy = 0
                whole.append(_extend(cell, path, height))
        level = _children(level, height)
        if count is not None and len(level) + len(whole) > count:
            raise ValueError("the stream holds what no encoder writes")
    return whole + list(level)


def _children(level: dict[Cell, Node], height: int) -> dict[Cell, Node]:
    children = {}
    for cell, node in level.items():
        occupancy = node.occupancy or 0
        parent = _crowd(len(_around(level, cell)))
        below = defaultdict(list)
        for point in node.points:
            below[_number(point, height - 1)].append(point)
        for child in _numbers(occupancy):
            family = sum(1 << (other ^ child) for other in _numbers(occupancy))
            children[_child(cell, child)] = Node(parent, family, below[child])
    return children


class _Model:
    """States, weights and curves; each comes into being when first used."""

    def __init__(self, coder: WideCoder) -> None:
        self.coder = coder
        self.states: dict[tuple[object, ...], State] = {}
        self.weights: dict[tuple[object, ...], list[int]] = {}
        self.curves: dict[tuple[object, ...], Curve] = defaultdict(Curve)

    def state(self, probability: int, *key: object) -> State:
        """The state of ``key``; at first ``probability`` / 256, or 0 for one of even odds."""
        if key not in self.states:
            count = CONFIDENCE if probability else 1
            self.states[key] = State(LIMIT, (probability or 128) << 14, count)
        return self.states[key]

    def mix(self, name: str, bit: int, states: list[State], *curve: int) -> int:
        """Code ``bit``; the weights are chosen by what the first two states have seen."""
        trust = tuple(sum(state.count >= least for least in TRUST) for state in states[:2])
        even = [WEIGHT_ONE // len(states)] * len(states)
        weights = self.weights.setdefault((name, *trust), even)
        use = self.curves[(name, *curve)]
        return code_mixed(self.coder, bit, states, weights, SHIFT, use, WEIGHT_LIMIT)

    def code_node(self, level: dict[Cell, Node], cell: Cell, node: Node, height: int) -> int | None:
        """Code ``cell``: its occupancy, or the path to its only point, which is returned."""
        around = _around(level, cell)
        numbers = {_number(point, height - 1) for point in node.points}
        occupancy = sum(1 << number for number in numbers)
        if not around and node.parent > 0:
            path = self.code_alone(node, height)
            if path is not None:
                return path
        site = _Site(node, around, min(height, 4) - 1 if height <= 4 else 4 + (height > 7))
        only = 0
        if around or height > 1:
            only = self.code_only(site, int(len(numbers) == 1))
        if not only:
            node.occupancy = self.code_children(site, occupancy)
        elif height == 1 and len(around) <= 3:
            node.occupancy = 1 << self.coder.plain(max(occupancy, 1).bit_length() - 1, 3)
        else:
            node.occupancy = 1 << self.code_place(site, max(occupancy, 1).bit_length() - 1)
        return None

    def code_alone(self, node: Node, height: int) -> int | None:
        """Code whether the node holds one point, and the path to it, 16 bits at a time."""
        kind = min(height, 4) - 1 if height <= 4 else 4 + (height > 7)
        state = self.state(ALONE, "alone", kind, node.parent)
        p = min(max(state.p >> 6, MIN_PROBABILITY), 65536 - MIN_PROBABILITY)
        bit = self.coder.code(int(len(node.points) == 1), p)
        state.update(bit)
        if not bit:
            return None
        known = 0
        for level in reversed(range(height)):
            known = known << 3 | (_number(node.points[0], level) if node.points else 0)
        path, left = 0, 3 * height
        while left > 0:
            step = min(left, 16)
            left -= step
            path = path << step | self.coder.plain(known >> left & (1 << step) - 1, step)
        return path

    def code_only(self, site: _Site, bit: int) -> int:
        """Code whether the node has one child only."""
        node, total = site.node, _logarithm(1 + sum(site.density))
        siblings = sum(node.family.bit_count() >= least for least in (2, 3, 5))
        states = [
            self.state(ONLY[total], "only", site.kind, node.parent, siblings, total),
            self.state(0, "family", site.kind, _crowd(len(site.around)), node.family),
        ]
        return self.mix("only", bit, states, site.kind)

    def code_place(self, site: _Site, child: int) -> int:
        """Code the number of the only child, a bit an axis."""
        number = 0
        for axis in range(3):
            halves = [
                [c for c in range(8) if c >> 2 - axis == 2 * number + upper] for upper in (0, 1)
            ]
            lower, upper = (sum(site.density[c] for c in half) for half in halves)
            balance = _logarithm(1 + upper) - _logarithm(1 + lower)
            balance = min(max(balance, -BALANCE), BALANCE)
            first = 128 + min(max(13 * balance, -26), 26)
            octaves = _logarithm(1 + lower + upper) // 4
            faces = (site.outer(halves[0][0])[:3], site.outer(halves[1][-1])[:3])
            states = [
                self.state(first, "half", site.kind, axis, balance, octaves),
                self.state(0, "faces", axis, number, *faces),
            ]
            bit = self.mix("half", child >> 2 - axis & 1, states, site.kind, axis)
            number = 2 * number + bit
        return number

    def code_children(self, site: _Site, occupancy: int) -> int:
        """Code which children exist, of which there are two at least."""
        coded, prefix, full = 0, 1, 0
        for child in range(8):
            bit = 1
            if full + 8 - child > 2:
                near, outer = _logarithm(1 + site.density[child]), site.outer(child)
                first = CHILD[min(near // 2, 14)][full]
                states = [
                    self.state(0, "child faces", outer[:3], prefix),
                    self.state(0, "child outer", outer, full),
                    self.state(first, "child", site.kind, near, child, full),
                ]
                bit = self.mix("child", occupancy >> child & 1, states, site.kind, child, full)
            coded |= bit << child
            prefix = 2 * prefix + bit
            full += bit
        return coded


class _Site:
    """What is known around a node that is coded."""

    def __init__(self, node: Node, around: dict[Cell, Node], kind: int) -> None:
        self.node, self.around, self.kind = node, around, kind
        self.density = [
            sum(_gain(step, other, child) for step, other in around.items()) for child in range(8)
        ]

    def outer(self, child: int) -> tuple[int, ...]:
        """States of the seven outer cells of a child: 0 no node there, 1 one not yet coded.

        2 or 3: the child of that node that touches ours is empty or full.
        """
        states = []
        for mirror in MIRRORS:
            step = tuple((1 if child >> a & 1 else -1) if mirror >> a & 1 else 0 for a in (2, 1, 0))
            other = self.around.get((step[0], step[1], step[2]))
            if other is None:
                states.append(0)
            elif other.occupancy is None:
                states.append(1)
            else:
                states.append(2 + (other.occupancy >> (child ^ mirror) & 1))
        return tuple(states)


def _gain(step: Cell, other: Node, child: int) -> int:
    """What ``child`` of a node gains by the node ``step`` away from it."""
    occupancy = 255 if other.occupancy is None else other.occupancy
    total = 0
    for number in _numbers(occupancy):
        there, own = _child(step, number), _child((0, 0, 0), child)
        square = sum((a - b) ** 2 for a, b in zip(there, own, strict=True))
        total += GAIN.get(square, 0)
    return (total + 3) // 6 if other.occupancy is None else total


def _around(level: dict[Cell, Node], cell: Cell) -> dict[Cell, Node]:
    """The nodes in the 26 cells around ``cell``, by the step to them."""
    found: dict[Cell, Node] = {}
    for x, y, z in product((-1, 0, 1), repeat=3):
        there = (cell[0] + x, cell[1] + y, cell[2] + z)
        if (x, y, z) != (0, 0, 0) and there in level:
            found[x, y, z] = level[there]
    return found


def _crowd(around: int) -> int:
    """Nodes around in classes: 0, 1, 2, 3, 4-5, 6-8, 9-13, more."""
    return sum(around >= least for least in (1, 2, 3, 4, 6, 9, 14))


def _logarithm(value: int) -> int:
    """Logarithm in quarters of an octave, linear within one."""
    octave = value.bit_length() - 1
    return 4 * octave + ((value << 2 >> octave) & 3)


def _number(point: Cell, level: int) -> int:
    """Child that holds ``point``, ``level`` levels above the leaves."""
    x, y, z = (axis >> level & 1 for axis in point)
    return 4 * x + 2 * y + z


def _numbers(occupancy: int) -> list[int]:
    return [child for child in range(8) if occupancy >> child & 1]


def _child(cell: Cell, child: int) -> Cell:
    x, y, z = cell
    return 2 * x + (child >> 2), 2 * y + (child >> 1 & 1), 2 * z + (child & 1)


def _extend(cell: Cell, path: int, height: int) -> Cell:
    """The leaf at the end of a path of ``height`` child numbers."""
    for level in reversed(range(height)):
        cell = _child(cell, path >> 3 * level & 7)
    return cell
