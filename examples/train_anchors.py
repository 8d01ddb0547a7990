"""Train a Voxel-GS scene by a loss of your own: train_anchors.py SCENE.clgs DATA OUT.clgs.

SCENE.clgs comes from ``clgs train DATA``. The loss here: colors where a photo is not masked, depths
that are smooth but at edges of the photo, and bits. Needs ``pip install clgs[torch]``.
"""

import argparse
from pathlib import Path

import numpy as np
import torch
from PIL import Image

import clgs
import clgs.torch as gsplat
from clgs.constants import ALPHA_MAX, HEAD_DIMS
from clgs.data.origin import repose
from clgs.data.view import View
from clgs.files import atomic_write
from clgs.scene.anchors import Anchors, quantize
from clgs.scene.mlps import Mlps, head_slice
from clgs.scene.scene import QuantizedScene
from clgs.train.state.rounding import weight_scales

ANCHORS = {"offset": 2e-3, "feature": 5e-3, "scaling": 2e-3}
MLPS = {"opacity": 2e-4, "color": 5e-4, "covariance": 1e-3}
BITS_WEIGHT = 1e-4


def rounded(scene: QuantizedScene, trained: dict[str, torch.Tensor]) -> list[torch.Tensor]:
    """Positions, offsets, features, scalings and weights as the file has them."""
    position = torch.tensor(scene.dequantize().anchors.position)
    weights = torch.cat([trained[head] for head in HEAD_DIMS])
    return [
        position,
        *(gsplat.quantize(trained[name], getattr(scene.scales, name)) for name in ANCHORS),
        gsplat.quantize(weights, torch.tensor(weight_scales())),
    ]


def draw(
    scene: QuantizedScene, trained: dict[str, torch.Tensor], camera: clgs.Camera
) -> tuple[torch.Tensor, torch.Tensor]:
    """The picture (H, W, 3) and the mean depth of every pixel (H, W)."""
    viewmat, intrinsics = np.eye(4, dtype=np.float32), np.eye(3, dtype=np.float32)
    viewmat[:3, :3], viewmat[:3, 3] = camera.rotation, camera.translation
    intrinsics[[0, 1, 0, 1], [0, 1, 2, 2]] = camera.fx, camera.fy, camera.cx, camera.cy
    near = scene.settings.near
    seen = gsplat.decode_anchors(*rounded(scene, trained), camera, near)
    image, _, _ = gsplat.rasterization(
        *seen[:5],
        torch.tensor(viewmat[None]),
        torch.tensor(intrinsics[None]),
        camera.width,
        camera.height,
        near_plane=near,
        backgrounds=torch.tensor([scene.settings.background]),
        render_mode="RGB+ED",
        alpha_max=ALPHA_MAX,
    )
    return image[0, ..., :3], image[0, ..., 3]


def roughness(depth: torch.Tensor, photo: torch.Tensor) -> torch.Tensor:
    """Mean change of depths between neighbours; at edges of the photo it counts less."""
    depth = depth / depth.detach().mean().clamp(min=1e-6)
    return sum(
        (depth.diff(dim=axis).abs() * (-10 * photo.diff(dim=axis).abs().mean(dim=2)).exp()).mean()
        for axis in (0, 1)
    )


def main(arguments: list[str] | None = None) -> tuple[float, float]:
    """Train and save; returns the mean PSNR of held-out photos before and after, dB."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene", type=Path)
    parser.add_argument("data")
    parser.add_argument("output", type=Path)
    parser.add_argument("--steps", type=int, default=300)
    parser.add_argument("--downscale", type=int, default=0, help="as in training")
    parser.add_argument("--smooth", type=float, default=0.05, help="weight of rough depths")
    parser.add_argument("--picture", type=Path, help="PNG of a held-out depth, before and after")
    given = parser.parse_args(arguments)
    scene = clgs.decode(given.scene.read_bytes())
    data = repose(clgs.load_dataset(given.data, downscale=given.downscale), scene.transform)
    start = scene.dequantize()
    arrays = {name: getattr(start.anchors, name) for name in ANCHORS}
    arrays |= {head: start.mlps.flat[head_slice(head)] for head in MLPS}
    trained = {name: torch.tensor(array, requires_grad=True) for name, array in arrays.items()}

    def photo_of(view: View) -> torch.Tensor:
        planes = view.photo.planes(scene.settings.background)
        return torch.tensor(planes).permute(1, 2, 0) / 255

    @torch.no_grad()
    def look() -> tuple[float, torch.Tensor]:
        found = []
        for view in data.test:
            error = draw(scene, trained, view.camera)[0].clamp(0, 1) - photo_of(view)
            found.append(-10 * error.square().mean().log10().item())
        return sum(found) / len(found), draw(scene, trained, data.test[0].camera)[1]

    before, first_depth = look()
    optimizer = torch.optim.Adam(
        [{"params": [trained[name]], "lr": rate} for name, rate in (ANCHORS | MLPS).items()]
    )
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, given.steps)
    generator = torch.Generator().manual_seed(0)
    for step in range(given.steps):
        view = data.train[torch.randint(len(data.train), (), generator=generator)]
        photo, used = photo_of(view), view.used()
        image, depth = draw(scene, trained, view.camera)
        difference = (image - photo).abs().mean(dim=2)
        colors = (difference if used is None else difference * torch.tensor(used)).mean()
        rough = roughness(depth, photo)
        bits = sum(gsplat.rate(trained[name], getattr(scene.scales, name)) for name in ANCHORS)
        optimizer.zero_grad()
        (colors + given.smooth * rough + BITS_WEIGHT * bits).backward()
        optimizer.step()
        schedule.step()
        if step % 50 == 0 or step == given.steps - 1:
            print(f"step {step}: L1 {colors:.4f}, roughness {rough:.4f}, {bits:.1f} bits/anchor")
    after, last_depth = look()
    *anchors, weights = (one.detach().numpy() for one in rounded(scene, trained))
    integers = quantize(Anchors(*anchors), scene.scales)
    made = QuantizedScene(integers, Mlps(weights), scene.scales, scene.settings, scene.transform)
    atomic_write(given.output, clgs.encode(made))
    sizes = [path.stat().st_size for path in (given.scene, given.output)]
    print(f"held out: PSNR {before:.2f} to {after:.2f} dB; {sizes[0]:,} to {sizes[1]:,} bytes")
    if given.picture:
        depths = torch.cat([first_depth, last_depth], dim=1).numpy()
        light = np.quantile(depths, 0.02) / np.maximum(depths, 1e-6)
        Image.fromarray((255 * light.clip(0, 1)).astype(np.uint8)).save(given.picture)
    return before, after


if __name__ == "__main__":
    main()
