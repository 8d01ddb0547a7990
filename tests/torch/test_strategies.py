"""gsplat's own strategies run on our ``meta``, without CUDA."""

import math

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed: pip install clgs[torch]")
pytest.importorskip("gsplat", reason="gsplat is not installed: pip install gsplat")

import clgs.torch as ours  # noqa: E402
from clgs.torch.strategies import compute_relocation  # noqa: E402
from tests.render.splat_scene import scene  # noqa: E402
from tests.torch.test_torch import tensors  # noqa: E402


def train(rng, strategy, steps, after, packed=True, absgrad=False):
    """The parameters after some steps, and the last meta."""
    given = tensors(scene(rng))
    parameters = torch.nn.ParameterDict(
        {
            "means": given["means"],
            "quats": given["quats"],
            "scales": given["scales"].log(),
            "opacities": torch.logit(given["opacities"]),
            "colors": given["colors"],
        }
    )
    optimizers = {n: torch.optim.Adam([p], lr=1e-3) for n, p in parameters.items()}
    strategy.check_sanity(parameters, optimizers)
    state = strategy.initialize_state()
    for step in range(1, steps + 1):
        image, _, info = ours.rasterization(
            parameters["means"],
            parameters["quats"],
            parameters["scales"].exp(),
            parameters["opacities"].sigmoid(),
            parameters["colors"],
            *(given[name] for name in ("viewmats", "Ks", "width", "height")),
            packed=packed,
            absgrad=absgrad,
        )
        strategy.step_pre_backward(parameters, optimizers, state, step, info)
        ((image - 0.5) ** 2).mean().backward()
        for optimizer in optimizers.values():
            optimizer.step()
            optimizer.zero_grad()
        strategy.step_post_backward(parameters, optimizers, state, step, info, **after)
    return parameters, info


@pytest.mark.parametrize("absgrad", [False, True])
@pytest.mark.parametrize("packed", [False, True])
def test_default_strategy(rng, absgrad, packed):
    strategy = ours.DefaultStrategy(
        refine_start_iter=0, refine_every=2, grow_grad2d=1e-5, absgrad=absgrad, reset_every=100
    )
    parameters, info = train(rng, strategy, 4, {"packed": packed}, packed, absgrad)
    assert len(parameters["means"]) > 40
    if packed:
        ids = info["batch_ids"] * 2 + info["camera_ids"], info["gaussian_ids"]
        assert all(len(one) == len(info["means2d"]) for one in ids)
        assert not ids[0].diff().lt(0).any()


def test_mcmc_strategy(rng):
    strategy = ours.MCMCStrategy(
        cap_max=50, noise_lr=1.0, refine_start_iter=0, refine_every=2, min_opacity=0.3
    )
    parameters, _ = train(rng, strategy, 4, {"lr": 1e-3})
    assert len(parameters["means"]) == int(int(40 * 1.05) * 1.05)
    assert all(torch.isfinite(one).all() for one in parameters.values())
    assert (parameters["opacities"].sigmoid() > 0.29).all()


@pytest.mark.parametrize("smallest", [0.0, 0.1])
def test_relocation_is_equation_9(rng, smallest):
    """Every term of the double sum, as the paper has it."""
    opacities, ratios = rng.uniform(0.01, 0.99, 60), rng.integers(1, 52, 60)
    scales = rng.uniform(0.1, 2, (60, 3))
    binoms = torch.zeros(51, 51)
    given = (torch.tensor(one, dtype=torch.float32) for one in (opacities, scales))
    new, found = compute_relocation(*given, torch.tensor(ratios), binoms, smallest)
    for at, (opacity, n) in enumerate(zip(opacities, ratios, strict=True)):
        own = max(1 - (1 - opacity) ** (1 / n), smallest)
        divisor = sum(
            math.comb(i - 1, k) * (-1) ** k / math.sqrt(k + 1) * own ** (k + 1)
            for i in range(1, n + 1)
            for k in range(i)
        )
        assert abs(new[at] - own) < 1e-6
        assert np.allclose(found[at], opacity / divisor * scales[at], rtol=1e-5)
