"""Bytes that published coders need for known files, for comparison.

Attributes: G-PCC's attribute residual coder as the paper's code calls it. Positions: G-PCC tmc13
v23, lossless octree geometry with the paper's settings.
"""

ATTRIBUTES = {
    "iid_offset": 252375,
    "iid_feat": 588078,
    "iid_scale": 151649,
    "chan_feat": 530467,
    "zi_offset": 239515,
    "corr_weak": 556432,
    "corr_scale": 144476,
    "biker_scale_q8": 324445,
    "biker_color": 469109,
}
POSITIONS = {
    "scene_q200": 484946,
    "armadillo_sparse_1024": 51899,
    "armadillo_dense_1024": 242340,
    "bunny_4096": 464382,
    "bunny_noisy_2048": 534403,
    "biker_1628": 160897,
    "biker_407": 49801,
}
