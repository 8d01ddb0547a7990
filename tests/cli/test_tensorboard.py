"""TensorBoard gets what training reports."""

import pytest

from clgs.cli.commands.train import EventLog
from clgs.train.run.session import Progress
from clgs.train.run.trainer import StepResult

pytest.importorskip("tensorboard", reason='pip install "clgs[tensorboard]"')


def test_scalars_are_read_back(tmp_path):
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    log = EventLog(tmp_path)
    for step, psnr in ((1, None), (100, 21.5), (200, 24.25)):
        result = StepResult(step, "view", 0.5, 0.25, 0.75, None, 10 * step)
        log.update(Progress(result, psnr, None if psnr is None else 1000))
    events = EventAccumulator(str(tmp_path), size_guidance={"tensors": 0})
    events.Reload()
    read = {
        name: [
            (event.step, float(event.tensor_proto.float_val[0])) for event in events.Tensors(name)
        ]
        for name in events.Tags()["tensors"]
    }
    assert read["psnr/training views"] == [(100, 21.5), (200, 24.25)]
    assert read["size/anchors"] == [(100, 1000.0), (200, 2000.0)]
    assert read["size/estimated bytes"] == [(100, 1000.0), (200, 1000.0)]
    assert read["loss/l1"] == [(100, 0.25), (200, 0.25)]


def test_missing_library_is_named(monkeypatch, tmp_path, refusal):
    monkeypatch.setattr("clgs.cli.commands.train.find_spec", lambda name: None)
    said = refusal(2, "train", tmp_path, "-o", tmp_path / "run", "--tensorboard")
    assert "clgs[tensorboard]" in said
