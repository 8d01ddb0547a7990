from __future__ import annotations

from dataclasses import replace
from typing import Any

from clgs.constants import K_OFFSETS
from clgs.lab.synthetic.anchor_scene import anchor_scene
from clgs.render.frame import upload_scene, upload_view
from clgs.render.rasterise import rasterise
from clgs.scene.anchors import QuantizationScales, quantize
from clgs.scene.scene import QuantizedScene
from clgs.train.quality.score_views import count_drawn


def test_counts_each_slot_that_some_view_draws_once(device: Any) -> None:
    floats, camera = anchor_scene(2_000, 64)
    scene = QuantizedScene(quantize(floats.anchors, QuantizationScales()), floats.mlps)
    turned = replace(camera, translation=camera.translation + 0.5)
    uploaded, drawn = upload_scene(device, scene.dequantize()), set()
    for one in (camera, turned):
        frame = rasterise(device, uploaded, upload_view(device, one, scene.settings))
        slot = device.download(frame.gaussians.slot)
        visible = device.download(frame.activations.visible)
        drawn |= set((visible[slot // K_OFFSETS] * K_OFFSETS + slot % K_OFFSETS).tolist())
    assert count_drawn(device, scene, [camera, turned, camera]) == len(drawn)
    assert 0 < count_drawn(device, scene, [camera]) < len(drawn) < K_OFFSETS * len(scene.anchors)
    assert count_drawn(device, scene, []) == 0
