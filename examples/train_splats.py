"""Train ordinary splats with gsplat's DefaultStrategy: python examples/train_splats.py DATA OUT.

DATA is a folder that ``clgs train`` reads, such as one of COLMAP. OUT receives splats.ply and
state.pt; a second call goes on from there. Needs ``pip install clgs[torch] gsplat``.
"""

import argparse
import time
from pathlib import Path

import torch

import clgs
import clgs.torch as gsplat
from clgs.exports.splats.ply import encode_ply
from clgs.files import atomic_path, atomic_write
from clgs.scene.camera import Camera
from clgs.scene.gaussians import OrdinaryGaussians
from clgs.train.run.load import with_points

RATES = {"means": 1.6e-4, "scales": 5e-3, "quats": 1e-3, "opacities": 5e-2, "sh": 2.5e-3}
HARMONICS = 16


def start(points: torch.Tensor, colors: torch.Tensor) -> torch.nn.ParameterDict:
    """A ball at every point, as wide as its neighbours are away."""
    count = len(points)
    near = torch.cat(
        [
            torch.cdist(part, points, compute_mode="donot_use_mm_for_euclid_dist")
            .topk(4, largest=False)
            .values[:, 1:]
            for part in points.split(256)
        ]
    )
    sh = torch.zeros(count, HARMONICS, 3)
    sh[:, 0] = (colors - 0.5) / 0.28209479
    return torch.nn.ParameterDict(
        {
            "means": points,
            "scales": near.mean(dim=1, keepdim=True).clamp(min=1e-5).log().repeat(1, 3),
            "quats": torch.tensor([[1.0, 0, 0, 0]]).repeat(count, 1),
            "opacities": torch.full((count,), -2.0),
            "sh": sh,
        }
    )


def matrices(camera: Camera) -> tuple[torch.Tensor, torch.Tensor]:
    """The viewmat (1, 4, 4) and the intrinsics (1, 3, 3) of a camera."""
    viewmat, intrinsics = torch.eye(4)[None].clone(), torch.eye(3)[None].clone()
    viewmat[0, :3, :3] = torch.tensor(camera.rotation)
    viewmat[0, :3, 3] = torch.tensor(camera.translation)
    intrinsics[0, 0, 0], intrinsics[0, 1, 1] = camera.fx, camera.fy
    intrinsics[0, 0, 2], intrinsics[0, 1, 2] = camera.cx, camera.cy
    return viewmat, intrinsics


def draw(splats: torch.nn.ParameterDict, camera: Camera, degree: int):
    """The picture (H, W, 3) of the splats, and gsplat's ``info``."""
    picture, _, info = gsplat.rasterization(
        splats["means"],
        splats["quats"],
        splats["scales"].exp(),
        splats["opacities"].sigmoid(),
        splats["sh"],
        *matrices(camera),
        camera.width,
        camera.height,
        sh_degree=degree,
    )
    return picture[0], info


def psnr(splats: torch.nn.ParameterDict, views: list) -> float:
    """Mean PSNR over views, dB."""
    found = []
    with torch.no_grad():
        for view in views:
            photo = torch.tensor(view.photo.pixels().color) / 255
            picture = draw(splats, view.camera, 3)[0].clamp(0, 1)
            found.append(-10 * (picture - photo).square().mean().log10().item())
    return sum(found) / max(len(found), 1)


def main(arguments: list[str] | None = None) -> None:
    """Train, or go on, and save."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data")
    parser.add_argument("output", type=Path)
    parser.add_argument("--steps", type=int, default=3000, help="in all, those before included")
    parser.add_argument("--minutes", type=float, default=1e9, help="of this call, before steps end")
    parser.add_argument("--downscale", type=int, default=0)
    given = parser.parse_args(arguments)
    data = with_points(clgs.load_dataset(given.data, downscale=given.downscale))
    points = torch.tensor(data.points)
    gray, found = torch.full_like(points, 0.5), data.point_colors
    splats = start(points, gray if found is None else torch.tensor(found) / 255)
    state_file, first = given.output / "state.pt", 0
    given.output.mkdir(parents=True, exist_ok=True)
    saved = torch.load(state_file, weights_only=True) if state_file.exists() else None
    if saved:
        splats = torch.nn.ParameterDict(saved["splats"])
        first = saved["step"]
    optimizers = {
        name: torch.optim.Adam([splats[name]], lr=rate * (data.radius if name == "means" else 1))
        for name, rate in RATES.items()
    }
    strategy = gsplat.DefaultStrategy()
    strategy.check_sanity(splats, optimizers)
    state = strategy.initialize_state(scene_scale=data.radius)
    if saved:
        for name, one in optimizers.items():
            one.load_state_dict(saved["optimizers"][name])
        state.update(saved["strategy"])
    begin, step = time.monotonic(), first
    while step < given.steps and time.monotonic() - begin < 60 * given.minutes:
        order = torch.randperm(
            len(data.train), generator=torch.Generator().manual_seed(step // len(data.train))
        )
        view = data.train[order[step % len(data.train)]]
        photo = torch.tensor(view.photo.pixels().color) / 255
        picture, info = draw(splats, view.camera, min(step // 1000, 3))
        strategy.step_pre_backward(splats, optimizers, state, step, info)
        loss = (picture - photo).abs().mean()
        loss.backward()
        for optimizer in optimizers.values():
            optimizer.step()
            optimizer.zero_grad(set_to_none=True)
        strategy.step_post_backward(splats, optimizers, state, step, info, packed=True)
        if step % 100 == 0:
            seconds = time.monotonic() - begin
            print(
                f"step {step}: L1 {loss.item():.4f}, {len(splats['means'])} splats, {seconds:.0f} s"
            )
        step += 1
    print(f"held out after {step} steps: PSNR {psnr(splats, data.test):.2f} dB")
    names = ("means", "scales", "quats", "opacities", "sh")
    arrays = [splats[name].detach().numpy() for name in names]
    atomic_write(
        given.output / "splats.ply", encode_ply(OrdinaryGaussians(*arrays), data.transform).data
    )
    with atomic_path(state_file) as path:
        torch.save(
            {
                "step": step,
                "splats": dict(splats.items()),
                "optimizers": {name: one.state_dict() for name, one in optimizers.items()},
                "strategy": state,
            },
            path,
        )


if __name__ == "__main__":
    main()
