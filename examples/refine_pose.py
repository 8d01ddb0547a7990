"""Find the pose of one camera by gradients: python examples/refine_pose.py [SPLATS.ply].

A picture is drawn of splats, random ones by default. Then the camera is displaced, and moved back
by the gradient of the difference with respect to its matrix. ``--picture FILE.png``: how far the
pictures are from the first one before and after.
"""

import argparse

import numpy as np
import torch
from PIL import Image

import clgs
import clgs.torch as gsplat


def turned(viewmat: torch.Tensor, twist: torch.Tensor) -> torch.Tensor:
    """The viewmat after a small turn (radians) and shift (scene units) of the camera, (6,)."""
    x, y, z, *_ = twist
    zero = torch.zeros(())
    rows = [[zero, -z, y, twist[3]], [z, zero, -x, twist[4]], [-y, x, zero, twist[5]], [zero] * 4]
    generator = torch.stack([torch.stack(list(row)) for row in rows])
    return torch.linalg.matrix_exp(generator) @ viewmat


def random_splats() -> dict[str, torch.Tensor]:
    """Gaussians in a ball."""
    generator = torch.Generator().manual_seed(0)
    return {
        "means": torch.randn(400, 3, generator=generator) * 0.7,
        "quats": torch.randn(400, 4, generator=generator),
        "scales": torch.rand(400, 3, generator=generator) * 0.1 + 0.02,
        "opacities": torch.rand(400, generator=generator) * 0.8 + 0.1,
        "colors": torch.rand(400, 3, generator=generator),
    }


def read_splats(path: str) -> dict[str, torch.Tensor]:
    """The splats of a file, moved and scaled to a ball around the origin."""
    stored = clgs.load_splats(path).gaussians
    centre = np.median(stored.mean, axis=0)
    scale = 1.5 / np.quantile(np.abs(stored.mean - centre), 0.9)
    colors = np.maximum(0.5 + 0.28209479 * stored.sh[:, 0], 0)
    arrays = {
        "means": (stored.mean - centre) * scale,
        "quats": stored.rotation,
        "scales": np.exp(stored.log_scale) * scale,
        "opacities": 1 / (1 + np.exp(-stored.opacity)),
        "colors": colors,
    }
    return {name: torch.tensor(value, dtype=torch.float32) for name, value in arrays.items()}


def main(arguments: list[str] | None = None) -> float:
    """Displace, refine, and print the error of the pose; returns its last value."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("splats", nargs="?")
    parser.add_argument("--steps", type=int, default=150)
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument("--picture")
    given = parser.parse_args(arguments)
    splats = read_splats(given.splats) if given.splats else random_splats()
    size, steps = given.size, max(given.steps, 1)
    intrinsics = torch.tensor([[[1.2 * size, 0, size / 2], [0, 1.2 * size, size / 2], [0, 0, 1]]])

    def draw(viewmat: torch.Tensor) -> torch.Tensor:
        return gsplat.rasterization(
            **splats, viewmats=viewmat[None], Ks=intrinsics, width=size, height=size
        )[0]

    true = torch.eye(4)
    true[2, 3] = 4.0
    photo = draw(true)
    begin = turned(true, torch.tensor([0.02, -0.03, 0.02, 0.05, 0.04, -0.05]))
    twist = torch.zeros(6, requires_grad=True)
    optimizer = torch.optim.Adam([twist], lr=3e-3)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
    for step in range(steps):
        viewmat = turned(begin, twist)
        loss = (draw(viewmat) - photo).abs().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
        error = (viewmat - true).norm().item()
        if step % 25 == 0 or step == steps - 1:
            print(f"step {step}: L1 {loss.item():.5f}, error of the matrix {error:.5f}")
    if given.picture:
        off = [(draw(each).detach() - photo).abs() for each in (begin, viewmat)]
        shown = torch.cat([photo, *off], dim=2)[0].clamp(0, 1) * 255
        Image.fromarray(shown.numpy().astype(np.uint8)).save(given.picture)
    return error


if __name__ == "__main__":
    main()
