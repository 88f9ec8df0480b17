"""Small engine: the reference rasterizer, autograd and Adam, written by the protocol alone."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from gscore.engine import base
from gscore.engine.ensemble import merge_models
from gscore.raster.reference import SplatTensors, composite, image_loss_reference, project
from gscore.raster.request import Frustum, Settings
from gscore.splats import PARAMETERS, SH_REST_BY_DEGREE


def picture_of(columns: Any, view: Frustum, *look: Any) -> Any:
    """Leaves of autograd, the projected splats, and the picture; `look`: background, antialias."""
    leaves = {name: torch.tensor(columns[name], requires_grad=True) for name in PARAMETERS}
    view = replace(view, viewmat=torch.from_numpy(view.viewmat), K=torch.from_numpy(view.K))
    settings = Settings(antialias=look[1], sh_degree=look[2])
    drawn = project(SplatTensors(**leaves), view, settings)
    size, color = (view.width, view.height), torch.tensor(look[0])
    return leaves, drawn, composite(drawn, *size, background=color, inverse_depth=True)


class SmallModel(base.EngineModel):
    """Parameters, moments and counters in numpy, by their names in checkpoints."""

    def __init__(self, stored: dict[str, np.ndarray], adam_steps: Any) -> None:
        self.stored = stored
        self.adam_steps = dict(adam_steps)

    @property
    def widths(self) -> dict[str, tuple[int, ...]]:
        names = (*PARAMETERS, *base.counters_of(self.stored))
        return {name: self.stored[base.column_key(name)].shape[1:] for name in names}

    def __len__(self) -> int:
        return len(self.stored["param/means"])

    def column(self, name: str) -> np.ndarray:
        return self.stored[base.column_key(name)].copy()

    def edit(self, edit: base.RowEdit) -> None:
        rows = slice(None) if edit.rows is None else edit.rows
        for name, values in edit.values.items():
            self.stored[base.column_key(name)][rows] = values
        for name in edit.forget:
            self.stored[f"m1/{name}"][rows] = self.stored[f"m2/{name}"][rows] = 0
        keep = np.arange(len(self)) if edit.keep is None else edit.keep
        parents = np.zeros(0, np.int64) if edit.parents is None else edit.parents
        changes = {base.column_key(name): values for name, values in edit.changes.items()}
        for key, column in self.stored.items():
            copied = key.startswith("param/")  # but moments and counters start at zero
            if edit.moved is not None:
                column[edit.moved] = column[edit.sources] * copied
            new = changes.get(key, column[parents] * copied)
            self.stored[key] = np.concatenate([column[keep], new])

    def widen_sh(self, degree: int) -> None:
        missing = max(SH_REST_BY_DEGREE[degree] - self.widths["shN"][0], 0)
        for key in ("param/shN", "m1/shN", "m2/shN", "gathered/shN"):
            self.stored[key] = np.pad(self.stored[key], ((0, 0), (0, missing), (0, 0)))

    def clamp_runaways(self, extent: float) -> int:
        flat = [self.column(name).reshape(len(self), -1) for name in PARAMETERS]
        bad = ~(np.abs(np.concatenate(flat, axis=1)) < 1e6 * extent).all(axis=1)
        for column in self.stored.values():
            column[bad] = 0
        self.stored["param/quats"][bad], self.stored["param/opacities"][bad] = 1, -20
        return int(bad.sum())

    def save(self) -> base.Columns:
        return self.stored

    def adam(self, grads: dict[str, np.ndarray], rows: Any, request: base.StepRequest) -> None:
        """Update `rows`; the gradients of shN accumulate until their step."""
        steps, gathered = request.sh_update is base.ShUpdate.STEP, self.stored["gathered/shN"]
        gathered += grads["shN"]
        for name, grad in (grads | {"shN": gathered}).items():
            if name == "shN" and not steps:
                continue
            count = self.adam_steps[name] = self.adam_steps[name] + 1
            kinds, g = [self.stored[f"{kind}/{name}"] for kind in ("param", "m1", "m2")], grad[rows]
            m = kinds[1][rows] = 0.9 * kinds[1][rows] + 0.1 * g
            v = kinds[2][rows] = 0.999 * kinds[2][rows] + 0.001 * g**2
            scale = request.rates[name] * math.sqrt(1 - 0.999**count) / (1 - 0.9**count)
            kinds[0][rows] -= scale * m / (np.sqrt(v) + 1e-15)
        gathered *= not steps


class SmallEngine(base.Engine[SmallModel]):
    """A step is done when it returns; trains whole photos with the strategy `default`."""

    info = base.EngineInfo(
        name="small",
        numerics="float64",
        terms=frozenset({base.TermKind.L1, base.TermKind.SSIM}),
        features=frozenset(),
        cost=base.CostModel(step=1e-3, pixel=1e-6, splat=1e-5, number=0),
    )

    def __init__(self) -> None:
        self.photos: dict[int, base.StepPhoto] = {}

    def model(self, columns: base.Columns, *, counters: Any = (), frozen: Any = None) -> SmallModel:
        stored = {f"param/{name}": np.array(columns[name]) for name in PARAMETERS}
        stored |= {f"{kind}/{n}": 0 * columns[n] for n in PARAMETERS for kind in ("m1", "m2")}
        stored["gathered/shN"] = 0 * columns["shN"]
        rows = np.zeros(len(columns["means"]), np.float32)
        stored |= {base.column_key(name): rows.copy() for name in counters}
        return SmallModel(stored, dict.fromkeys(PARAMETERS, 0))

    def load(self, saved: base.Columns, adam_steps: Any, like: SmallModel) -> SmallModel:
        return SmallModel(dict(saved), adam_steps)

    def put(self, key: int, photo: base.StepPhoto) -> None:
        self.photos[key] = photo

    def step(self, model: SmallModel, request: base.StepRequest) -> base.Pending:
        photo, view = self.photos.pop(request.photo).image, request.view
        look = request.background, request.antialias, request.sh_degree
        leaves, drawn, picture = picture_of(model.part(0, len(model)), view, *look)
        drawn.means2d.retain_grad()
        weight = dict(request.terms)[base.TermKind.SSIM]
        loss, _ = image_loss_reference(picture.rgb, torch.from_numpy(photo), ssim_weight=weight)
        loss.backward()
        mse = float(np.mean((picture.rgb.detach().numpy() - photo / 255) ** 2))
        value, lost, rows = loss.item(), 0, drawn.index.numpy()
        if sane := math.isfinite(value) and mse < base.ABSURD_MSE:
            pulls = drawn.means2d.grad.numpy() * (view.width / 2, view.height / 2)
            sums = np.linalg.norm(pulls, axis=1), 1
            for name, values in zip(request.observe, sums, strict=False):
                model.stored[base.column_key(name)][rows] += values
            grads = {name: np.nan_to_num(one.grad.numpy()) for name, one in leaves.items()}
            model.adam(grads, slice(None) if request.update_hidden else rows, request)
        else:
            lost = model.clamp_runaways(request.extent)
        return base.StepNumbers(request.step, value, mse, lost_rows=lost, skipped=not sane)

    def draw(self, models: Any, view: Frustum, *, background: Any, **options: Any) -> Any:
        columns = merge_models([model.part(0, len(model)) for model in models])
        scales = columns["scales"] + np.float32(math.log(options.get("scaling", 1)))
        look = background, options["antialias"], None
        _, _, picture = picture_of({**columns, "scales": scales}, view, *look)
        pictures = picture.rgb, picture.alpha, picture.inverse_depth
        return base.DrawnPicture(*(one.detach().float().numpy() for one in pictures))
