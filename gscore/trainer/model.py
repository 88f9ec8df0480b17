"""The model in training: parameters, Adam moments and per-splat counters, whose rows move
together."""

from collections.abc import Mapping

import torch

from .params import NAMES

_BETAS = (0.9, 0.999)
_EPS = 1e-15


class Model:
    """N splats with everything that is kept for each of them.

    Rows are added, removed and overwritten by `strategy.ops` only, so that parameters, moments and
    counters cannot get out of step. SH coefficients are stored up to the degree in use.
    """

    def __init__(self, tensors: Mapping[str, torch.Tensor]) -> None:
        """Start with zero moments from raw float32 tensors as in `Splats`."""
        self.params: dict[str, torch.Tensor] = {}
        self.rows: dict[str, torch.Tensor] = {}
        """[N] float32 counters that the strategy keeps."""
        for name in NAMES:
            self.params[name] = tensors[name].detach().clone().contiguous().requires_grad_()
        # Fused is the fastest Adam of torch on a CPU (5 times foreach at 200 000 splats) and, being
        # element by element, gives the same bits for any number of threads.
        groups = [{"params": [self.params[name]], "name": name, "lr": 0.0} for name in NAMES]
        self.optimizer = torch.optim.Adam(groups, betas=_BETAS, eps=_EPS, fused=True)
        for name in NAMES:
            p = self.params[name].detach()
            self._set_state(name, torch.zeros_like(p), torch.zeros_like(p), steps=0)

    def __len__(self) -> int:
        return len(self.params["means"])

    @property
    def arguments(
        self,
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
        """The parameters in the order in which `rasterize` takes them."""
        means, quats, scales, opacities, sh0, shN = (self.params[name] for name in NAMES)
        return means, quats, scales, opacities, sh0, shN

    @property
    def sh_degree(self) -> int:
        """Degree of the SH coefficients stored, 0 to 3."""
        return round((self.params["shN"].shape[1] + 1) ** 0.5) - 1

    def moments(self, name: str) -> tuple[torch.Tensor, torch.Tensor]:
        """First and second moment of a parameter, same shape."""
        state = self.optimizer.state[self.params[name]]
        return state["exp_avg"], state["exp_avg_sq"]

    def steps(self, name: str) -> int:
        """Adam steps that a parameter has taken."""
        return int(self.optimizer.state[self.params[name]]["step"].item())

    def replace(
        self,
        name: str,
        value: torch.Tensor,
        moment1: torch.Tensor,
        moment2: torch.Tensor,
        *,
        steps: int | None = None,
    ) -> None:
        """Put another tensor, with its moments, in the place of a parameter."""
        steps = self.steps(name) if steps is None else steps
        old = self.params[name]
        new = value.detach().contiguous().requires_grad_()
        del self.optimizer.state[old]
        group = next(g for g in self.optimizer.param_groups if g["name"] == name)
        group["params"] = [new]
        self.params[name] = new
        self._set_state(name, moment1, moment2, steps=steps)

    def set_rates(self, rates: Mapping[str, float]) -> None:
        """Set learning rates by parameter name."""
        for group in self.optimizer.param_groups:
            group["lr"] = rates[group["name"]]

    def step(self) -> None:
        """One Adam step with the gradients in the parameters, which are dropped."""
        if self.params["shN"].numel() == 0:
            self.params["shN"].grad = None
        self.optimizer.step()
        self.drop_gradients()

    def drop_gradients(self) -> None:
        """Forget the gradients."""
        self.optimizer.zero_grad(set_to_none=True)

    def _set_state(
        self, name: str, moment1: torch.Tensor, moment2: torch.Tensor, *, steps: int
    ) -> None:
        self.optimizer.state[self.params[name]] = {
            "step": torch.tensor(float(steps)),
            "exp_avg": moment1.contiguous(),
            "exp_avg_sq": moment2.contiguous(),
        }
