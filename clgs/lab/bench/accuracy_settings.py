"""The settings of which `clgs bench accuracy` measures time and error."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from clgs.errors import UsageError
from clgs.options import PRESETS, Accuracy

PRESET_SWEEP = "preset"
FINE = Accuracy("", alpha_cut=2.0**-16, transmittance_stop=1e-6, inclusive_stop=True)
"""Around which sweeps turn one knob: its error must not drown in those of the others."""

CUTS = (255, 512, 1024, 4096, 16384, 65536)
STOPS = (("1e-6", 1e-6), ("1e-4", 1e-4), ("1e-3", 1e-3), ("1/512", 1 / 512), ("1/255", 1 / 255))
DEGREES = (3, 4, 5, 6)
EXTENTS = (0.0, 1.0, 2.0, 3.0)


@dataclass(frozen=True)
class Setting:
    """One point of the plot: the sweep that it belongs to, its name there, what is truncated."""

    sweep: str
    label: str
    accuracy: Accuracy


def accuracy_settings(sweeps: Sequence[str] = ()) -> list[Setting]:
    """Every preset; and sweeps of one knob, the others as in FINE; ``sweeps`` names some only.

    Raises:
        UsageError: there is no such sweep.
    """
    settings = [*_presets(), *_cuts(), *_stops(), *_degrees(), *_extents(), *_sizes()]
    names = list(dict.fromkeys(one.sweep for one in settings))
    for sweep in sweeps:
        if sweep not in names:
            raise UsageError(f"no sweep {sweep!r}; there are {', '.join(names)}")
    return [one for one in settings if not sweeps or one.sweep in (PRESET_SWEEP, *sweeps)]


def _presets() -> Iterator[Setting]:
    for name, accuracy in PRESETS.items():
        yield Setting(PRESET_SWEEP, name, accuracy)


def _cuts() -> Iterator[Setting]:
    for part in CUTS:
        yield Setting("alpha cut", f"1/{part}", replace(FINE, alpha_cut=1 / part))


def _stops() -> Iterator[Setting]:
    for inclusive in (False, True):
        sweep = f"{'inclusive' if inclusive else 'exclusive'} stop"
        for label, stop in STOPS:
            accuracy = replace(FINE, transmittance_stop=stop, inclusive_stop=inclusive)
            yield Setting(sweep, label, accuracy)


def _degrees() -> Iterator[Setting]:
    for degree in DEGREES:
        yield Setting("exp2 degree", str(degree), replace(FINE, exp2_degree=degree))


def _extents() -> Iterator[Setting]:
    for extent in EXTENTS:
        yield Setting("least extent", f"{extent:g} px", replace(FINE, min_extent=extent))


def _sizes() -> Iterator[Setting]:
    for downscale in (1, 2):
        label = "full" if downscale == 1 else f"1/{downscale}"
        yield Setting("resolution", label, replace(FINE, downscale=downscale))


def without_stop(accuracy: Accuracy) -> Accuracy:
    """The same alpha cut, no stop, the exponential of float32: what stop and degree do differs."""
    return replace(
        accuracy, name="", transmittance_stop=1e-9, inclusive_stop=True, exp2_degree=max(DEGREES)
    )
