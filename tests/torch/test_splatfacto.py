"""nerfstudio's splatfacto, its rendering call as it is but for the import, draws what gsplat draws.

How to install it: docs/reference/rasterization.md.
"""

from types import SimpleNamespace

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed: pip install clgs[torch]")
pytest.importorskip("gsplat", reason="gsplat is not installed: pip install gsplat")
splatfacto = pytest.importorskip(
    "nerfstudio.models.splatfacto",
    reason="nerfstudio is not installed: pip install nerfstudio",
    exc_type=ImportError,
)

import clgs.torch as ours  # noqa: E402
from tests.torch import gsplat_reference as theirs  # noqa: E402

COUNT, WIDTH, HEIGHT = 60, 37, 29


def model(mode):
    """A splatfacto model with random weights, without its metrics, whose weights it downloads."""
    torch.manual_seed(3)
    made = splatfacto.SplatfactoModel.__new__(splatfacto.SplatfactoModel)
    torch.nn.Module.__init__(made)
    made.config = splatfacto.SplatfactoModelConfig(rasterize_mode=mode, sh_degree=3)
    values = {
        "means": torch.rand(COUNT, 3) * 2 - 1,
        "scales": torch.log(0.05 + 0.2 * torch.rand(COUNT, 3)),
        "quats": splatfacto.random_quat_tensor(COUNT),
        "features_dc": torch.rand(COUNT, 3),
        "features_rest": 0.1 * torch.randn(COUNT, 15, 3),
        "opacities": torch.randn(COUNT, 1),
    }
    made.gauss_params = torch.nn.ParameterDict(
        {name: torch.nn.Parameter(value) for name, value in values.items()}
    )
    made.strategy = SimpleNamespace(absgrad=True)
    made.crop_box, made.step = None, 30_000
    made.background_color = torch.tensor([0.1, 0.2, 0.3])
    made.device_indicator_param = torch.nn.Parameter(torch.empty(0))
    return made.eval()


def camera():
    pose = torch.tensor([[[1.0, 0, 0, 0.1], [0, 1, 0, -0.2], [0, 0, 1, 4.0]]])
    return splatfacto.Cameras(pose, 40.0, 42.0, 18.0, 15.0, WIDTH, HEIGHT)


def reference(**given):
    """gsplat's PyTorch code in float64, for the same call."""
    ignored = ("packed", "near_plane", "far_plane", "sparse_grad", "absgrad")
    kept = {name: value for name, value in given.items() if name not in ignored}
    wide = {n: v.double() if isinstance(v, torch.Tensor) else v for n, v in kept.items()}
    return (*(one.float() for one in theirs.rasterization(**wide)), {})


@pytest.mark.parametrize("mode", ["classic", "antialiased"])
def test_draws_what_gsplat_draws(monkeypatch, mode):
    # splatfacto 1.1.5 moves its intrinsics to a card, without asking for one
    monkeypatch.setattr(torch.Tensor, "cuda", lambda self: self)
    monkeypatch.setattr(splatfacto, "get_viewmat", viewmat_of(splatfacto))
    drawn = model(mode)
    found = []
    for function in (ours.rasterization, reference):
        monkeypatch.setattr(splatfacto, "rasterization", function)
        drawn.zero_grad()
        outputs = drawn.get_outputs(camera())
        (outputs["rgb"].square().sum() + outputs["depth"].sum()).backward()
        gradients = {name: one.grad.clone() for name, one in drawn.gauss_params.items()}
        found.append((outputs, gradients))
    (outputs, gradients), (wanted, expected) = found
    assert outputs["rgb"].shape == (HEIGHT, WIDTH, 3)
    assert np.ptp(wanted["rgb"].detach().numpy()) > 0.3
    for name in ("rgb", "accumulation"):
        assert (outputs[name] - wanted[name]).abs().max() < 1e-4
    for name, gradient in expected.items():
        assert (gradients[name] - gradient).norm() < 1e-4 * gradient.norm(), name


def viewmat_of(module):
    """Its function without torch.compile, which would need a C++ compiler."""
    return getattr(module.get_viewmat, "_torchdynamo_orig_callable", module.get_viewmat)
