"""Random Gaussians and cameras for ``clgs.rasterization``, and the float64 references composed."""

from typing import Any

import numpy as np

from clgs.ops.general.views import pack_camera
from clgs.reference.general import channels, harmonics, views

UPPER = [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]


def scene(
    rng: np.random.Generator,
    count: int = 40,
    cameras: int = 2,
    colors: int = 3,
    sh_degree: int | None = None,
    model: str = "pinhole",
) -> dict[str, Any]:
    """Arguments of ``clgs.rasterization``, by name, of Gaussians in front of the cameras."""
    viewmats = np.tile(np.eye(4), (cameras, 1, 1))
    viewmats[:, :3, :3] += rng.normal(0, 0.05, (cameras, 3, 3))
    viewmats[:, :3, 3] = rng.normal(0, 0.2, (cameras, 3)) + np.array([0, 0, 4.0])
    if model == "fisheye":  # points up to about 70 degrees from the axis
        viewmats[:, 2, 3] -= 1.9
    focal = {"pinhole": 36.0, "ortho": 8.0, "fisheye": 14.0}[model]
    intrinsics = np.array([[focal, 0, 17], [0, 1.1 * focal, 14], [0, 0, 1.0]])
    shape = (count, colors) if sh_degree is None else (count, (sh_degree + 1) ** 2, 3)
    values = {
        "means": rng.uniform(-1.4, 1.4, (count, 3)),
        "quats": rng.normal(size=(count, 4)),
        "scales": 0.15 * 10 ** rng.uniform(-0.4, 0.4, (count, 3)),
        "opacities": rng.uniform(0.05, 0.95, count),
        "colors": rng.uniform(0, 1, shape) if sh_degree is None else rng.normal(0, 0.5, shape),
        "viewmats": viewmats,
        "Ks": np.tile(intrinsics, (cameras, 1, 1)),
    }
    made: dict[str, Any] = {name: value.astype(np.float32) for name, value in values.items()}
    return {**made, "width": 33, "height": 27, "sh_degree": sh_degree}


class Reference:
    """The picture of one camera in float64, and its gradients by the arguments' names."""

    def __init__(
        self, given: dict[str, Any], camera: int, mode: str, antialiased: bool, model: str
    ) -> None:
        wide = {n: v.astype(np.float64) for n, v in given.items() if isinstance(v, np.ndarray)}
        self.given, self.wide, self.mode, self.degree = given, wide, mode, given["sh_degree"]
        self.size = given["width"], given["height"]
        self.packed = pack_camera(wide["viewmats"][camera], wide["Ks"][camera], self.size, 0.01)
        self.lens = views.CameraModel(model, antialiased)
        self.covars = wide.get("covars")
        if self.covars is None:
            self.covars = views.covariances(wide["scales"], wide["quats"])
        self.projected, self.opacity = views.forward(
            wide["means"], self.covars, wide["opacities"], self.packed, self.lens
        )
        self.centre = self.packed[23:].astype(np.float64)
        color = wide["colors"]
        if self.degree is not None:
            color = harmonics.forward(wide["means"], color, self.centre, self.degree)
        depth = self.projected.depth[:, None]
        self.channel = np.concatenate([color] * ("RGB" in mode) + [depth] * (mode != "RGB"), axis=1)
        self.background = np.zeros(self.channel.shape[1])
        if "backgrounds" in wide and "RGB" in mode:
            self.background[: color.shape[1]] = wide["backgrounds"][camera]
        self.layers = channels.layers(self.projected, self.opacity, self.size, 0.999)
        self.image, left = channels.forward(self.layers, self.channel, self.background, self.size)
        self.alpha = 1 - left
        if "ED" in mode:
            self.image[..., -1] /= np.maximum(self.alpha, 1e-10)

    def backward(self, d_image: np.ndarray, d_alpha: np.ndarray) -> dict[str, np.ndarray]:
        wide, d_image, d_alpha = self.wide, d_image.astype(float), d_alpha.astype(float)
        if "ED" in self.mode:
            d_image[..., -1] /= np.maximum(self.alpha, 1e-10)
            d_alpha -= np.where(self.alpha > 0, d_image[..., -1] * self.image[..., -1], 0)
        d = channels.backward(
            self.layers, self.projected, self.opacity, self.channel, self.background,
            d_image, -d_alpha,
        )  # fmt: skip
        d_depth = d.d_channel[:, -1] if self.mode != "RGB" else np.zeros(len(self.opacity))
        made = views.backward(
            wide["means"], self.covars, wide["opacities"], self.packed, self.lens,
            d.d_mean2d, d.d_whitening, d_depth, d.d_opacity,
        )  # fmt: skip
        by_camera, by_mean, turned = made.d_camera, made.d_mean, np.zeros((4, 4))
        shown = d.d_channel.shape[1] - (self.mode != "RGB")
        result = {
            "opacities": made.d_opacity,
            "means2d": d.d_mean2d,
            "absgrad": d.d_absolute,
            "backgrounds": np.einsum("hwx,hw->x", d_image, 1 - self.alpha)[:shown],
        }
        if shown:
            result["colors"] = d.d_channel[:, :shown]
        if shown and self.degree is not None:
            result["colors"], across = harmonics.backward(
                wide["means"], wide["colors"], self.centre, self.degree, result["colors"]
            )
            by_mean = by_mean + across
            matrix = np.eye(4)
            matrix[:3, :3] = self.packed[:9].reshape(3, 3)
            matrix[:3, 3] = self.packed[9:12]
            inverse = np.linalg.inv(matrix)
            by_inverse = np.append(-across.sum(0), 0.0)
            turned -= np.outer(inverse.T @ by_inverse, inverse[:, 3])
        result.update(
            means=by_mean, viewmats=np.append(by_camera, np.zeros((1, 4)), axis=0) + turned
        )
        if "covars" in wide:
            both = made.d_covariance * (2 - np.eye(3))
            result["covars"] = np.triu(both)
        else:
            result["scales"], result["quats"] = views.shape_gradients(
                wide["scales"], wide["quats"], made.d_covariance
            )
        return result
