"""The rasteriser for JAX: ``clgs.rasterization`` with gradients, on any OpenCL device.

The picture is drawn in a callback on the host (``jax.pure_callback``), so that it works under
``jit``, ``grad`` and ``vmap``. A callback keeps nothing: the backward pass draws once more.
"""

from __future__ import annotations

from functools import partial
from inspect import signature
from typing import Any

import jax
import numpy as np
import numpy.typing as npt

from clgs.render.rasterization import rasterization as rasterization_of_numpy
from clgs.render.splat_arguments import check_arguments, checked_lens

SIGNATURE = signature(rasterization_of_numpy)

Static = tuple[tuple[str, Any], ...]
"""The arguments that are no arrays, by name."""


def rasterization(
    means: jax.Array,
    quats: jax.Array | None,
    scales: jax.Array | None,
    opacities: jax.Array,
    colors: jax.Array,
    viewmats: jax.Array,
    Ks: jax.Array,  # noqa: N803  the field's name of intrinsics
    width: int,
    height: int,
    *,
    backgrounds: jax.Array | None = None,
    covars: jax.Array | None = None,
    **others: Any,
) -> tuple[jax.Array, jax.Array]:
    """Draw Gaussians as cameras see them; see :func:`clgs.rasterization` for the arguments.

    ``others``, such as ``sh_degree`` and ``render_mode``, are hashable and no arrays. There are
    gradients by all arrays but ``Ks``, for which they are zeros.

    Returns:
        colors (..., C, H, W, X) and alphas (..., C, H, W, 1), float32.

    Raises:
        NotImplementedError, TypeError, ValueError: as :func:`clgs.rasterization`.
        jax.errors.JaxRuntimeError: a number of a traced array cannot be used; names it, when drawn.
    """
    arrays = {
        "means": means,
        "quats": None if covars is not None else quats,
        "scales": None if covars is not None else scales,
        "opacities": opacities,
        "colors": colors,
        "viewmats": viewmats,
        "Ks": Ks,
        "backgrounds": backgrounds,
        "covars": covars,
    }
    hosts = {name: _shown(array) for name, array in arrays.items()}
    bound = SIGNATURE.bind(**hosts, width=width, height=height, **others)
    bound.apply_defaults()
    checked_lens(bound.arguments)
    settings = {name: bound.arguments[name] for name in ("sh_degree", "render_mode")}
    check_arguments(**hosts, **settings).check_values()
    static = (("width", width), ("height", height), *sorted(others.items()))
    given = {name: array for name, array in arrays.items() if array is not None}
    result: tuple[jax.Array, jax.Array] = _draw(static, given)
    return result


def _shown(array: Any) -> Any:
    """The numbers of an array; of one that is traced, whose numbers come later, its shape alone."""
    if not isinstance(array, jax.core.Tracer):
        return np.asarray(array) if isinstance(array, jax.Array) else array
    square = array.ndim > 1 and array.shape[-1] == array.shape[-2]
    return np.broadcast_to(np.eye(array.shape[-1]) if square else 1.0, array.shape).astype(
        array.dtype
    )


@partial(jax.custom_vjp, nondiff_argnums=(0,))
def _draw(static: Static, given: dict[str, jax.Array]) -> Any:
    options = dict(static)
    mode, degree = options.get("render_mode", "RGB"), options.get("sh_degree")
    shown = (3 if degree is not None else given["colors"].shape[-1]) if "RGB" in mode else 0
    pictures = *given["viewmats"].shape[:-2], options["height"], options["width"]
    shapes = (
        jax.ShapeDtypeStruct((*pictures, shown + (mode != "RGB")), np.float32),
        jax.ShapeDtypeStruct((*pictures, 1), np.float32),
    )
    return jax.pure_callback(partial(_forward, options), shapes, given, vmap_method="sequential")


def _keep(static: Static, given: dict[str, jax.Array]) -> Any:
    return _draw(static, given), given


def _gradients(static: Static, given: dict[str, jax.Array], d: Any) -> Any:
    shapes = {name: jax.ShapeDtypeStruct(one.shape, np.float32) for name, one in given.items()}
    backward = partial(_backward, dict(static))
    return (jax.pure_callback(backward, shapes, given, *d, vmap_method="sequential"),)


_draw.defvjp(_keep, _gradients)


def _forward(options: dict[str, Any], given: dict[str, Any]) -> tuple[npt.NDArray[Any], ...]:
    return rasterization_of_numpy(**_arrays(given), **options)[:2]


def _backward(
    options: dict[str, Any], given: dict[str, Any], d_colors: Any, d_alphas: Any
) -> dict[str, npt.NDArray[Any]]:
    record = rasterization_of_numpy(**_arrays(given), **options)[2]["record"]
    made = record.backward(np.asarray(d_colors), np.asarray(d_alphas))
    return {
        n: made[n] if n in made else np.zeros(one.shape, np.float32) for n, one in given.items()
    }


def _arrays(given: dict[str, Any]) -> dict[str, Any]:
    """NumPy's views of JAX's arrays, and None for those that are not given."""
    none = {"quats": None, "scales": None, "backgrounds": None, "covars": None}
    return {**none, **{name: np.asarray(array) for name, array in given.items()}}
