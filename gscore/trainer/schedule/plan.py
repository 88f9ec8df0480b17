"""Plan of a run: schedules from a TrainConfig, with automatic values for options set to 0."""

import math
from dataclasses import dataclass

from ...config import Skip, Strategy, TrainConfig
from .caps import max_splats_per_model

_PAPER_STEPS = 30_000
_SETTLES = 0.9
"""Share of a run after which learning rates decay."""
_FEWEST_SIZES, _FEWEST_STEPS = 3, 1000
"""Least number of small photo sizes, and of steps, for the cap of splats to grow with the photos.
Shorter runs have too few refinements: at 400 px it cost 0.2 to 1.4 dB in 300 and 600 steps, none in
1000."""
_KEPT_EVERY = 500
"""Least steps between two checkpoints of the watchdog; a tenth of the run if that is more."""
_LONG, _LONG_GRAD = 10_000, 5e-5
"""Steps from which a cut-out subject has a lower gradient threshold of growth, and the threshold.
With the paper's threshold growth ends early where errors are small: lego stopped at a third of
300,000 splats, and gained 1.0 dB with all of them. Photos without cut-out masks gained nothing.
Shorter runs use it too with dropout, which keeps the additional splats from overfitting."""
_COMPARE = (0.2, 0.4, 0.6)
"""Shares of the run after which photos are compared with renders. At 0.15 the render of a sharp
photo is still soft, but less so than that of a blurred one: 6 px were found as 4 to 7."""
_COARSE_SIDE = 75
"""Shorter side of a photo, px, below which a downscaled photo has too little detail."""


@dataclass(frozen=True, kw_only=True)
class Plan:
    """Schedules of a run: steps of events, and learning rates. Steps count from 1."""

    iterations: int
    """Last step."""
    models: int
    """Number of models trained in parallel; numbers of splats are per model."""
    max_splats: int
    """Most splats."""
    first_cap: int
    """Most splats at the first photo size; `max_splats` unless the cap grows with the photos."""
    pixels: int
    """Mean number of pixels of a photo at full size."""
    sh_degree: int
    """Highest SH degree, in use from half of the run at the latest."""
    sh_every: int
    """Steps between increments of the SH degree."""
    shN_every: int
    """Steps between two updates of shN."""
    coarse_factor: float
    """Divisor of the photos' sides at the first step."""
    coarse_until: int
    """First step with photos at full size."""
    stages: tuple[float, ...]
    """Shares of `coarse_until` at which photos become larger; see `photo_size_stages`."""
    refine_start: int
    """First step that may refine."""
    refine_stop: int
    """Last step that may refine."""
    refine_every: int
    """Steps between two refinements."""
    reset_every: int
    """Steps between two opacity resets; 0: never."""
    reset_stop: int
    """Last step that may reset."""
    means_lr: tuple[float, float]
    """Learning rate of means at the first and after the last step, training units."""
    rates: dict[str, float]
    """Learning rates of the other parameters before the decay."""
    lr_final: float
    """Factor of these rates at the last step."""
    init_opacity: float
    """Initial opacity."""
    init_scale: float
    """Initial scale in mean distances to the nearest neighbours."""
    grow_grad: float
    """Mean screen-space gradient above which `default` clones or splits a splat."""
    mcmc_growth: float
    """Share of splats that a refinement of `mcmc` adds; 0 with `default`, which uses gradients."""
    kept: float
    """Share of the splats kept after the last refinement."""
    surface_after: float
    """Last step without the surface term; infinite without it."""

    @classmethod
    def of(
        cls,
        config: TrainConfig,
        *,
        extent: float,
        points: int,
        side: int,
        pixels: int,
        subject: bool = False,
        drops: bool = False,
        sky: bool = False,
        models: int = 1,
    ) -> "Plan":
        """Resolve `config` for a capture.

        Args:
            config: The options.
            extent: Camera extent, training units.
            points: Number of splats of each model at the start.
            side: Shorter side of the smallest photo, px.
            pixels: Mean number of pixels of a photo.
            subject: Whether masks are opacity, so that only a subject is trained.
            drops: Whether dropout is used.
            sky: Whether there are splats for a sky.
            models: Number of models trained in parallel, which share `max_splats`.
        """
        n, most = config.iterations, max_splats_per_model(config, models)
        mcmc = config.strategy is Strategy.MCMC
        # Runs shorter than the paper's 30,000 steps keep its proportions, but at least 100 steps
        # before and 50 between refinements, so that splats receive gradients from enough views.
        every = config.refine_every or max(min(50, n), min(100, n // 50))
        start = config.refine_start or max(min(100, n), min(500, n // 20))
        # Higher rates compensate for fewer steps. On real captures of 200 x 150 px this gained
        # 1.1 dB on held-out views in 1,000 steps and 0.7 dB in 3000.
        boost = config.lr_boost or min(max((_PAPER_STEPS / n) ** 0.35, 1.0), 4.0)
        root = math.sqrt(boost)
        # Sky splats are large, and large splats are pruned after a reset.
        reset = config.reset_every or (3000 if n >= 6000 and not sky else -1)
        # Start splats already have detail, which coarse photos would remove. On a video of
        # 240 x 320 px, 500 steps from the previous frame ended 1.1 dB higher at full size.
        coarse = 1.0 if config.start_splats else min(max(side / _COARSE_SIDE, 1.0), 8.0)
        coarse = 1.0 if Skip.SMALL_PHOTOS in config.without else config.coarse_factor or coarse
        sizes, coarse_until = photo_size_stages(coarse), round(config.coarse_until * n)
        # If the cap grows with the photos, refinement ends soon after they reach full size.
        long_enough = len(sizes) >= _FEWEST_SIZES and n >= _FEWEST_STEPS
        coupled = config.grow_with_photos and long_enough and not mcmc
        stop = n * 5 // 6 if mcmc else n // 2
        if coupled:
            stop = min(max(n * 4 // 5, round(sizes[0] * coarse_until) + 2 * every), n)
        stop = config.refine_stop or stop
        fine = subject and (drops or n >= _LONG)
        threshold = _LONG_GRAD if fine else 2e-4 / min(boost, 2.0)
        # The cap is reached halfway through the refinements even if the run is short.
        growths = max((stop - start) // (2 * every), 1)
        growth = max(0.05, (most / max(points, 1)) ** (1 / growths) - 1)
        # Gradients of several views have less noise than one's. Held-out PSNR did not fall.
        every_shN = config.shN_every or max(1, min(8, n // 125))
        every_shN = 1 if Skip.RARE_SH in config.without else every_shN
        return cls(
            iterations=n,
            models=models,
            max_splats=most,
            first_cap=min(points, most) if coupled else most,
            pixels=pixels,
            sh_degree=config.sh_degree,
            sh_every=config.sh_every or max(1, min(1000, n // (2 * max(config.sh_degree, 1)))),
            shN_every=every_shN,
            coarse_factor=coarse,
            coarse_until=coarse_until,
            stages=sizes,
            refine_start=start,
            refine_stop=stop,
            refine_every=every,
            reset_every=max(reset, 0),
            reset_stop=config.refine_stop or n // 2,
            means_lr=(config.means_lr * extent * root, config.means_lr_final * extent * boost**2),
            rates={
                "quats": config.quats_lr * boost,
                "scales": config.scales_lr * boost,
                "opacities": (config.opacities_lr or (0.05 if mcmc else 0.025)) * root,
                "sh0": config.sh0_lr * boost,
                "shN": config.shN_lr * boost * math.sqrt(every_shN),
            },
            lr_final=config.lr_final,
            init_opacity=config.init_opacity or (0.5 if mcmc else 0.1),
            init_scale=config.init_scale or (0.1 if mcmc else 1.0),
            grow_grad=config.grow_grad or threshold,
            mcmc_growth=(config.mcmc_growth or min(growth, 1.0)) if mcmc else 0.0,
            kept=1.0 - config.prune_share,
            surface_after=config.surface_from * n if config.surface_weight > 0 else math.inf,
        )

    def means_lr_at(self, step: int) -> float:
        """Learning rate of means at `step`: exponential decay over the whole run.

        The decay depends on the length of the run, so an extended run continues at the rate that a
        run of the new length has at this step.
        """
        first, last = self.means_lr
        if first <= 0 or last <= 0:
            return first
        return first * math.exp(math.log(last / first) * min(step / self.iterations, 1.0))

    def rates_at(self, step: int, photos: int = 1) -> dict[str, float]:
        """Learning rates of the other parameters: constant, then exponential decay over the last
        tenth of the run.

        Constant rates leave parameters oscillating around their optimum by the size of a step. For
        a batch, rates are multiplied by the root of its number of `photos` (Zhao et al. 2024,
        Grendel-GS); shN accumulates `shN_every` photos anyway.
        """
        done = (step / self.iterations - _SETTLES) / (1 - _SETTLES)
        share = self.lr_final ** min(max(done, 0.0), 1.0)
        factors = dict.fromkeys(self.rates, math.sqrt(photos))
        factors["shN"] = math.sqrt(max(photos / self.shN_every, 1.0))
        return {name: share * rate * factors[name] for name, rate in self.rates.items()}

    @property
    def kept_every(self) -> int:
        """Steps between two checkpoints that the watchdog may restore."""
        return max(_KEPT_EVERY, self.iterations // 10)

    def harmonics_update_at(self, step: int, photos: int = 1) -> bool:
        """Return whether shN is updated after `step`, the last of a batch of `photos`.

        The last step updates it; a run that ends early loses the accumulated gradients.
        """
        due = step // self.shN_every > (step - photos) // self.shN_every
        return due or step >= self.iterations

    def sh_degree_at(self, step: int) -> int:
        """SH degree at `step`."""
        return min(self.sh_degree, (step - 1) // self.sh_every)

    def factor_at(self, step: int) -> float:
        """Divisor of the photos' sides at `step`: a power of the root of 2, or 1.

        Most steps are cheap, and coarse structure converges first.
        """
        done = step / max(self.coarse_until, 1)
        count = len(self.stages)
        smaller = next((k for k, share in enumerate(self.stages) if done >= share), count)
        return 1.0 if done >= 1 else 2.0 ** (smaller / 2)

    def cap_for(self, factor: float) -> int:
        """Most splats while the photos' sides are divided by `factor`."""
        first = 1 / self.factor_at(1)
        share = (1 / factor - first) / (1 - first) if first < 1 else 1.0
        return round(
            self.first_cap + min(max(share, 0.0), 1.0) * (self.max_splats - self.first_cap)
        )

    def refines_at(self, step: int) -> bool:
        """Return whether splats may be added or removed after `step`."""
        inside = self.refine_start <= step <= min(self.refine_stop, self.iterations - 1)
        return inside and step % self.refine_every == 0

    def prunes_free_space_at(self, step: int) -> bool:
        """Return whether free space is pruned and minimum scales are applied after `step`: as often
        as refinements but in the whole run, because splats keep moving."""
        return step % self.refine_every == 0 or step == self.iterations

    def prunes_free_sky_at(self, step: int) -> bool:
        """Return whether splats in front of the sky are removed after `step`: at every eighth
        refinement, because all are projected into many photos, and at the end."""
        return step % (8 * self.refine_every) == 0 or step == self.iterations

    def prunes_masked_at(self, step: int) -> bool:
        """Return whether masked splats are pruned after `step`: at the first refinement step of the
        second and of the last third. The rest of the run closes the gaps; without it, pruning costs
        a decibel."""
        now, before = (3 * at // self.iterations for at in (step, step - self.refine_every))
        return step % self.refine_every == 0 and before < now < 3

    @property
    def compare_steps(self) -> list[int]:
        """Steps after which photos are compared with renders: none just after opacities were reset,
        since the model is unfinished for a third of the steps between two resets."""
        found = []
        for share in _COMPARE:
            step = max(round(share * self.iterations), 1)
            last = min(step, self.reset_stop, self.iterations - 1)
            last -= last % self.reset_every if self.reset_every else last
            found.append(max(step, last + self.reset_every // 3) if last else step)
        return found

    def surplus_at(self, step: int, splats: int, pruned: int) -> int:
        """Number of `splats` to prune after `step` for their low contribution; `pruned` were pruned
        before.

        `pruned` counts in, so that a changed plan whose refinements end at another step does not
        prune again.
        """
        if step < min(self.refine_stop, self.iterations - 1):
            return 0
        return max(splats - max(round(self.kept * (splats + pruned)), 1), 0)

    def resets_at(self, step: int) -> bool:
        """Return whether opacities are reset after `step`."""
        inside = step <= min(self.reset_stop, self.iterations - 1)
        return self.reset_every > 0 and inside and step % self.reset_every == 0


def _side(stage: int) -> float:
    """Relative side at which stage `stage` begins: between two powers of the root of 2."""
    return 2.0 ** -(stage / 2 + 0.25)


def photo_size_stages(coarse: float) -> tuple[float, ...]:
    """Return the times at which photos become larger, relative to the time of full size.

    From entry k on, sides are divided by 2^(k / 2); before the last entry they have the first size.
    The number of pixels rises with the square of the time.

    Args:
        coarse: First divisor of the sides, at least 1.
    """
    count = round(2 * math.log2(coarse))
    if count == 0:
        return ()
    least = coarse**-2
    sides = map(_side, range(count))
    return tuple(math.sqrt(max(side**2 - least, 0.0) / (1 - least)) for side in sides)
