"""How many bytes a stage must move and how many operations it must make, by formula.

Bytes: every input read once and every output written once, as if caches were perfect and nothing
were read twice. Operations: of the useful work only, counting an FMA as two and an exponential by
its polynomial; pairs of pixel and Gaussian that contribute nothing count as none. Both are lower
bounds, so that the share of the limit that follows is one, too.
"""

from __future__ import annotations

from dataclasses import dataclass

from clgs.lab.bench.device_limits import DeviceLimits
from clgs.lab.bench.frame_counts import count_frame
from clgs.lab.observe import blend_decisions
from clgs.opencl.device import Device
from clgs.render.frame import DeviceScene, Frame


@dataclass(frozen=True)
class Counts:
    """Sizes of one render, and of the stages that are timed by themselves.

    A anchors, V visible, N neural Gaussians, I entries of tile lists, B blended pairs of pixel and
    Gaussian, P pixels, M trained numbers; E elements given to the stages timed by themselves.
    """

    A: int
    V: int
    N: int
    I: int  # noqa: E741 - the letter of ARCHITECTURE.md
    B: int
    P: int
    M: int
    E: int


Terms = dict[str, int]
"""Factor of each letter of Counts."""


@dataclass(frozen=True)
class Formula:
    """Bytes and operations of a stage as sums of factors times counts."""

    bytes: Terms
    flops: Terms

    def evaluate(self, counts: Counts) -> tuple[int, int]:
        """Bytes and operations."""
        return _sum(self.bytes, counts), _sum(self.flops, counts)

    def text(self) -> str:
        """For people: "64 I + 20 P B, 30 B flop"."""
        return f"{_text(self.bytes)} B, {_text(self.flops)} flop"


def _sum(terms: Terms, counts: Counts) -> int:
    return sum(factor * getattr(counts, letter) for letter, factor in terms.items())


def _text(terms: Terms) -> str:
    return " + ".join(f"{factor:,} {letter}" for letter, factor in terms.items()) or "0"


FORMULAS: dict[str, Formula] = {
    # position, scaling in; an index out; a transform and a box
    "cull": Formula({"A": 36, "V": 4}, {"A": 40}),
    # 53 inputs in, twice; 110 rows out; 53 * 150 + 50 * 110 multiply-adds
    "mlp forward": Formula({"V": 4 * (53 + 53 + 110)}, {"V": 26_900}),
    # inputs, outputs and their gradients in, that of the feature out; twice the multiply-adds, and
    # those of the hidden layers again
    "mlp backward": Formula({"V": 4 * (53 + 110 + 110 + 50)}, {"V": 69_700}),
    # 110 outputs, offsets, scaling, position in; 14 floats and a slot out
    "neural forward": Formula({"V": 4 * (110 + 39), "N": 60}, {"N": 60}),
    # 14 gradients, outputs, offsets in; d_output, d_offset, d_scaling out
    "neural backward": Formula({"N": 60, "V": 4 * (220 + 39), "A": 4 * 36}, {"N": 150}),
    # 11 floats in, 8 out
    "project forward": Formula({"N": 76}, {"N": 200}),
    # 10 floats, 5 gradients and 5 of the projection in; 10 gradients out
    "project backward": Formula({"N": 120}, {"N": 500}),
    # 9 floats in; the Gaussian and the row of an entry out; one test of ellipse against tile
    "tiles": Formula({"N": 36, "I": 8}, {"I": 40}),
    # 9 floats per Gaussian, once per entry, in; colour, transmittance, contributor out
    "blend forward": Formula({"I": 36, "P": 20}, {"B": 36}),
    # the same in; a row of moments of 36 bytes out and in again; 9 gradients out
    "blend backward": Formula({"I": 36 + 72, "P": 20, "N": 36}, {"B": 72}),
    # picture and photo in; separable windows of 11 taps over 5 maps
    "loss forward": Formula({"P": 3 * (4 + 1)}, {"P": 3 * 2 * 2 * 11 * 5}),
    # the same in, the gradient out; windows over 3 maps
    "loss backward": Formula({"P": 3 * (4 + 1 + 4)}, {"P": 3 * 2 * 2 * 11 * 3}),
    # parameter, gradient, two moments in; all but the gradient out
    "adam": Formula({"M": 28}, {"M": 14}),
    # a number in and out
    "scan": Formula({"E": 8}, {"E": 1}),
    # key and value in and out
    "sort": Formula({"E": 16}, {}),
    "quantize": Formula({"E": 8}, {"E": 5}),
    # a number in; about two exponentials
    "rate": Formula({"E": 4}, {"E": 40}),
}
"""By the stage names of the training step's profile."""


def count_work(device: Device, frame: Frame, scene: DeviceScene, elements: int) -> Counts:
    """The counts of a render; blended pairs are those that the blend kernel itself reports."""
    shape = (3, frame.view.size[1], frame.view.size[0])
    made = blend_decisions(device, frame.blended, device.zeros(shape))[0]
    counts = count_frame(device, frame)
    return Counts(
        A=len(scene.anchors),
        V=counts.visible,
        N=counts.gaussians,
        I=counts.intersections,
        B=int(made.contributed.sum()),
        P=frame.view.size[0] * frame.view.size[1],
        M=sum(array.size for name, array in scene.items() if name != "position"),
        E=elements,
    )


@dataclass(frozen=True)
class Share:
    """Bytes and operations of a stage, the rates reached, and the larger share of a limit."""

    bytes: int
    flops: int
    gigabytes_per_second: float
    gigaflops: float
    of_limit: float
    bound: str


def share_of_limit(
    name: str, counts: Counts, milliseconds: float, limits: DeviceLimits
) -> Share | None:
    """How near a stage comes to the device's limits; None without a formula."""
    formula = FORMULAS.get(name)
    if formula is None or milliseconds <= 0:
        return None
    moved, made = formula.evaluate(counts)
    rate, speed = 1e3 * moved / milliseconds, 1e3 * made / milliseconds
    by_memory, by_arithmetic = rate / limits.bytes_per_second, speed / limits.flops_per_second
    bound = "copy" if by_memory > by_arithmetic else "FMA"
    return Share(moved, made, rate / 1e9, speed / 1e9, max(by_memory, by_arithmetic), bound)


def formula_lines() -> dict[str, str]:
    """Every formula as text, by stage; the letters are those of Counts."""
    return {name: formula.text() for name, formula in FORMULAS.items()}
