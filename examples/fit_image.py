"""Fit an image by Gaussians: python examples/fit_image.py PHOTO.jpg OUT.png [--steps 300]."""

import argparse

import numpy as np
import torch
from PIL import Image

import clgs.torch as gsplat


def fit(image: torch.Tensor, count: int, steps: int) -> torch.Tensor:
    """What ``count`` Gaussians look like that were fitted to an image (H, W, 3)."""
    height, width = image.shape[:2]
    generator = torch.Generator().manual_seed(0)
    parameters = {
        "means": torch.rand(count, 3, generator=generator) * 2 - 1,
        "quats": torch.randn(count, 4, generator=generator),
        "scales": torch.full((count, 3), -3.0),
        "opacities": torch.zeros(count),
        "colors": torch.rand(count, 3, generator=generator),
    }
    for parameter in parameters.values():
        parameter.requires_grad_()
    optimizer = torch.optim.Adam(parameters.values(), lr=0.02)
    viewmats = torch.eye(4)[None].clone()
    viewmats[0, 2, 3] = 4.0  # the camera stands 4 units before the Gaussians
    focal = 2.0 * max(width, height)
    intrinsics = torch.tensor([[[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]]])
    for step in range(steps):
        picture, _, _ = gsplat.rasterization(
            parameters["means"],
            parameters["quats"],
            parameters["scales"].exp(),
            parameters["opacities"].sigmoid(),
            parameters["colors"],
            viewmats,
            intrinsics,
            width,
            height,
        )
        loss = (picture[0] - image).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        if step % 50 == 0 or step == steps - 1:
            print(f"step {step}: PSNR {-10 * loss.log10().item():.2f} dB")
    return picture[0].detach()


def main(arguments: list[str] | None = None) -> None:
    """Read a photo, fit it, write the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("photo")
    parser.add_argument("output")
    parser.add_argument("--gaussians", type=int, default=2000)
    parser.add_argument("--steps", type=int, default=300)
    given = parser.parse_args(arguments)
    photo = Image.open(given.photo).convert("RGB")
    photo.thumbnail((400, 400))
    Image.new("RGB", photo.size).save(given.output)  # an error comes before the work
    image = torch.tensor(np.asarray(photo, np.float32) / 255)
    picture = fit(image, given.gaussians, max(given.steps, 1))
    Image.fromarray((picture.clamp(0, 1).numpy() * 255).astype(np.uint8)).save(given.output)


if __name__ == "__main__":
    main()
