"""What the report's page says besides figures."""

from __future__ import annotations

NOTES = {
    "head": (
        "Made by `{command}`. Scores are of the decoded `.clgs` file alone. All figures, and more "
        "of them, are in `results.csv` and `results.json` beside this page."
    ),
    "main": (
        "Means over seeds, in brackets the least and the largest. `PSNR` is one MSE over all "
        "pixels and channels of 8-bit pictures; `PSNR of channels` the mean of the three channels' "
        "PSNRs of the render before clamping and rounding."
    ),
    "bits": ("Bits per anchor, and the share of the file; `rest` is the header and the directory."),
    "time": (
        "`training` is reading the photos, training and encoding; not the scores. Times hold if "
        "one run had the machine: `at once` is the number of workers that shared it. Peak memory "
        "is that of the worker's process, the largest of the seeds."
    ),
    "baseline": (
        "BD-rate: mean difference of bytes at equal PSNR (Bjontegaard, piecewise cubic), negative "
        "is smaller; where the baseline has one point, the bytes at its PSNR."
    ),
    "ablation": (
        "Each variant changes what its name says and nothing else; changes are against the first "
        "row of the scene."
    ),
    "proxy": (
        "Bits of offsets, features and scalings together, of the decoded integers, a point a run: "
        "as they are estimated and as the encoder's level writes them. `classes`: by the "
        "frequencies of each channel in 16 classes of anchors, which training shows as the size; "
        "`entropy`: by the frequencies of each channel; `channel` and `pooled`: by Laplace laws, "
        "whose gradient training follows. The line is by least squares, the correlation Pearson's."
    ),
    "histograms": (
        "Shares of the integers of the main rows' first seeds, all channels together. The laws "
        "have the means of the integers and b = standard deviation / sqrt(2), as the proxy takes "
        "them: one for all, and the mean of one for each channel."
    ),
}
