"""Every tensor operation on a toy capture, and a fingerprint of the results."""

import hashlib
import sys
from pathlib import Path

import numpy as np

from gscore.config import Background, DataConfig, Strategy, Switch, TrainConfig
from gscore.io.ply.splats import read_ply
from gscore.raster.api import render

_SHORT = {
    "iterations": 36,
    "max_splats": 200,
    "sh_every": 6,
    "refine_start": 5,
    "refine_stop": 32,
    "refine_every": 5,
    "reset_every": 12,
    "grow_grad": 1e-5,
    "seed": 5,
}
_RUNS = (
    TrainConfig(
        **_SHORT,
        background=Background.RANDOM,
        drop_rate=0.2,
        coarse_factor=2.0,
        prune_share=0.2,
        checkpoint_iterations=(20,),
        preview_seconds=1e-6,
    ),
    TrainConfig(
        **_SHORT,
        strategy=Strategy.MCMC,
        antialias=True,
        shN_every=3,
        depth_mode=Switch.ON,
    ),
)
"""Both strategies; between them they use every source of random numbers and every loss."""


def work(capture: Path, folder: Path) -> str:
    """Train, resume, render and differentiate; return a text that is equal where all bits are.

    Args:
        capture: With depth maps in `depths`.
        folder: New, for the results.
    """
    from gscore.trainer.run import train

    digest = hashlib.sha256()
    for i, config in enumerate(_RUNS):
        depths = "depths" if config.depth_mode is Switch.ON else ""
        data = DataConfig(source=capture, depths=depths, eval=True, test_every=4)
        out = folder / str(i)
        metrics = train(config, data, out).metrics
        digest.update(repr([row["psnr"] for row in metrics["evals"]]).encode())
        digest.update((out / "point_cloud.ply").read_bytes())
    started = next((folder / "0").glob("checkpoints/*20*"))
    data = DataConfig(source=capture, eval=True, test_every=4)
    again = train(_RUNS[0], data, folder / "again", start_checkpoint=started)
    digest.update(again.splats.means.tobytes())
    digest.update(_pictures(folder / "1/point_cloud.ply"))
    return digest.hexdigest()


def _pictures(path: Path) -> bytes:
    """Bits of a picture by numpy and by torch, of its loss and of all gradients."""
    import torch

    from gscore.raster.autograd import RasterAux, rasterize
    from gscore.raster.loss import image_loss

    splats = read_ply(path)
    K = np.array([[40.0, 0, 24], [0, 40, 20], [0, 0, 1]])
    viewmat = np.eye(4)
    viewmat[2, 3] = 3
    shown = render(splats, K, viewmat, 48, 40)
    assert shown.visible > 0 and shown.depth is not None
    names = ("means", "quats", "scales", "opacities", "sh0", "shN")
    with torch.inference_mode(False), torch.enable_grad():
        leaves = [torch.from_numpy(getattr(splats, n).copy()).requires_grad_() for n in names]
        camera = torch.from_numpy(viewmat.astype(np.float32)).requires_grad_()
        lens = torch.from_numpy(K.astype(np.float32))
        aux = RasterAux()
        out = rasterize(*leaves, camera, lens, 48, 40, raw=True, depth=True, aux=aux)
        target = torch.from_numpy((shown.rgb[::-1].clip(0, 1) * 255).astype(np.uint8))
        loss = image_loss(out.rgb, target).loss
        assert out.depth is not None
        (loss + out.depth.mean()).backward()
    found = [out.rgb, out.alpha, out.depth, loss, aux.v_means2d, camera.grad]
    found += [leaf.grad for leaf in leaves]
    tensors = [t.detach().numpy() for t in found if t is not None]
    assert len(tensors) == 12
    return b"".join(a.tobytes() for a in (shown.rgb, shown.depth, *tensors))


if __name__ == "__main__":
    import locale
    import warnings

    import scipy.spatial  # noqa: F401 - warnings of others are not ours to mend

    import gscore.datasets
    import gscore.trainer  # noqa: F401

    locale.setlocale(locale.LC_ALL, "")
    warnings.simplefilter("error")
    sys.stdout.write(work(Path(sys.argv[1]), Path(sys.argv[2])))
