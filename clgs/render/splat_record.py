"""The gradients of a call of ``clgs.rasterization``."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.opencl.lent import on_host
from clgs.ops.general import harmonics, views
from clgs.render import channel_picture
from clgs.render.splat_arguments import Floats, SplatArguments

SMALLEST_ALPHA = 1e-10
"""Expected depths are divided by no less."""

BY_CAMERA = ("viewmats", "backgrounds", "means2d", "absgrad")
"""Gradients that each camera has of its own."""


@dataclass(frozen=True)
class RecordedView:
    """One picture: of which Gaussians, by which camera, and what was drawn.

    harmonics: (N, K, 3) on the device, None if colors are colors; image (H, W, X) and alpha
    (H, W, 1) as they were returned.
    """

    splats: views.Splats
    camera: DeviceArray
    harmonics: DeviceArray | None
    drawn: channel_picture.Drawn
    image: Floats
    alpha: Floats


@dataclass(frozen=True)
class Record:
    """What the gradients of a call of :func:`rasterization` need.

    lent: the arguments that lie on the device, by their names; views: batches first.
    """

    device: Device
    given: SplatArguments
    lens: views.CameraModel
    sh_degree: int | None
    render_mode: str
    absgrad: bool
    size: tuple[int, int]
    lent: dict[str, DeviceArray]
    views: list[RecordedView]

    def backward(self, d_colors: Floats, d_alphas: Floats | None = None) -> dict[str, Floats]:
        """Gradients of ``sum(d_colors * colors) + sum(d_alphas * alphas)``.

        Args:
            d_colors: (..., C, H, W, X) float32, of NumPy or pyopencl.
            d_alphas: (..., C, H, W, 1) float32; None for zeros.

        Returns:
            Gradients by the names of the arguments: means, quats and scales or covars, opacities,
            colors, viewmats, backgrounds; "means2d" (..., C, N, 2) per pixel, and with ``absgrad``
            "absgrad" of the same shape. Those by covars are in the upper triangles.

        Raises:
            ValueError, TypeError: an array has the wrong shape or dtype.
        """
        given = self.given
        b, c, n = len(given.means), given.viewmats.shape[1], given.means.shape[1]
        width, height = self.size
        x = given.backgrounds.shape[-1]
        d_colors, d_alphas = (
            on_host(self.device, name, value)
            for name, value in (("d_colors", d_colors), ("d_alphas", d_alphas))
        )
        d_image = _checked("d_colors", d_colors, (*given.batch, c, height, width, x))
        d_image = d_image.reshape(b, c, height, width, x)
        d_alpha = np.zeros((b, c, height, width), np.float32)
        if d_alphas is not None:
            _checked("d_alphas", d_alphas, (*given.batch, c, height, width, 1))
            d_alpha = d_alphas.reshape(d_alpha.shape)
        colors = given.colors.shape[1:]
        shapes: dict[str, tuple[int, ...]] = {"means": (n, 3), "opacities": (n,), "colors": colors}
        shapes |= (
            {"quats": (n, 4), "scales": (n, 3)} if given.covars is None else {"covars": (n, 6)}
        )
        shapes |= {"viewmats": (c, 4, 4), "backgrounds": (c, x), "means2d": (c, n, 2)}
        if self.absgrad:
            shapes["absgrad"] = (c, n, 2)
        parts: dict[str, list[list[Floats]]] = {name: [[] for _ in range(b)] for name in shapes}
        for at, (batch, number) in enumerate(product(range(b), range(c))):
            given_d = d_image[batch, number], d_alpha[batch, number]
            for name, array in self._view_gradients(self.views[at], *given_d).items():
                own = parts[name][batch]
                if number and not (name in BY_CAMERA or (name == "colors" and colors[0] > 1)):
                    own[0] += array
                else:
                    own.append(array)
        sums = {name: _joined(parts[name], (b, *shape)) for name, shape in shapes.items()}
        return self._in_shape(sums)

    def _view_gradients(
        self, view: RecordedView, d_image: Floats, d_alpha: Floats
    ) -> dict[str, Any]:
        """What one picture contributes, by the names of :meth:`backward`."""
        device, drawn, given = self.device, view.drawn, self.given
        if "ED" in self.render_mode:
            divisor = np.maximum(view.alpha[..., 0], SMALLEST_ALPHA)
            d_image, d_alpha = d_image.copy(), d_alpha.copy()
            d_image[..., -1] /= divisor
            free = view.alpha[..., 0] > SMALLEST_ALPHA
            d_alpha -= np.where(free, d_image[..., -1] * view.image[..., -1], 0)
        shared = device.share(d_image), device.share(-d_alpha)  # alive until the downloads
        d = channel_picture.backward(device, drawn, *shared, self.absgrad)
        made = views.backward(
            device, view.splats, view.camera, self.lens, drawn.projected, d, want_camera=True
        )
        assert made.d_camera is not None
        result = {
            "means": device.hand_over(made.d_mean),
            "covars" if given.covars is not None else "scales": device.hand_over(made.d_shape),
            "opacities": device.hand_over(made.d_opacity),
            "means2d": device.hand_over(d.d_mean2d),
            "backgrounds": np.einsum("hwx,hw->x", d_image, 1 - view.alpha[..., 0]),
        }
        if made.d_rotation is not None:
            result["quats"] = device.hand_over(made.d_rotation)
        if d.d_absolute is not None:
            result["absgrad"] = device.hand_over(d.d_absolute)
        d_matrix = np.zeros((4, 4))
        d_matrix[:3] = device.hand_over(made.d_camera).sum(axis=2, dtype=np.float64)
        if not drawn.projected.color.shape[1]:
            pass  # depth alone
        elif view.harmonics is None or self.sh_degree is None:
            result["colors"] = device.hand_over(d.d_color)
        else:
            d_sh, by_direction = harmonics.backward(
                device, view.splats.mean, view.harmonics, view.camera, self.sh_degree,
                drawn.projected.color, d.d_color,
            )  # fmt: skip
            turned = device.hand_over(by_direction)
            result["colors"] = device.hand_over(d_sh)
            result["means"] += turned
            # The camera's centre is the column of its matrix's inverse.
            camera, d_centre = device.download(view.camera), -turned.sum(0, np.float64)
            rotation, centre = camera[:9].reshape(3, 3).astype(np.float64), camera[23:26]
            across = np.append(np.linalg.solve(rotation.T, d_centre), centre @ d_centre)
            d_matrix -= np.outer(across, np.append(centre, 1.0))
        result["viewmats"] = d_matrix
        return result

    def _in_shape(self, sums: dict[str, Floats]) -> dict[str, Floats]:
        """The gradients in the shapes of the arguments."""
        given = self.given
        if given.covars is not None:
            rows = sums["covars"]
            sums["covars"] = np.zeros((*rows.shape[:2], 3, 3), np.float32)
            sums["covars"][:, :, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]] = rows
        if given.shared_colors:
            sums["colors"] = sums["colors"][:, 0]
        shades = np.zeros((*sums["backgrounds"].shape[:2], given.channels), np.float32)
        if "RGB" in self.render_mode:
            shades[:] = sums["backgrounds"][..., : given.channels]
        sums["backgrounds"] = shades
        return {name: a.reshape(*given.batch, *a.shape[1:]) for name, a in sums.items()}


def _joined(parts: list[list[Floats]], shape: tuple[int, ...]) -> Floats:
    """The parts of all batches as one float32 array; zeros if there are none; one is not copied."""
    whole = [one for batch in parts for one in batch]
    if not whole:
        return np.zeros(shape, np.float32)
    if len(whole) == 1:
        return np.asarray(whole[0], np.float32).reshape(shape)
    return np.array(whole, np.float32).reshape(shape)


def _checked(name: str, array: Any, shape: tuple[int, ...]) -> Floats:
    if not isinstance(array, np.ndarray) or array.dtype != np.float32:
        raise TypeError(f"{name}: give a NumPy array of float32")
    if array.shape != shape:
        raise ValueError(f"{name}: shape is {array.shape}, expected {shape}")
    return np.ascontiguousarray(array)
