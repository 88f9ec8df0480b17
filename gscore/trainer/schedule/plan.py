"""Plan of a run: numbers that follow from a TrainConfig and its length, for options set to 0."""

import math
from dataclasses import dataclass

from ...config import Skip, Strategy, TrainConfig
from .caps import max_splats_per_model
from .photo_sizes import photo_size_stages

_PAPER_STEPS = 30_000
_SETTLES = 0.9
"""Share of a run after which learning rates fall."""
_FEWEST_SIZES, _FEWEST_STEPS = 3, 1000
"""Sizes of small photos, and steps, from which on splats grow with the photos. Shorter runs have
too few refinements left: at 400 px it cost 0.2 to 1.4 dB in 300 and 600 steps, none in 1000."""
_KEPT_EVERY = 500
"""Fewest steps between two states for the watchdog; a tenth of the run if that is more."""
_LONG, _LONG_GRAD = 10_000, 5e-5
"""Steps from which a cut-out subject uses a lower gradient threshold of growth, and the threshold.
With the paper's threshold growth ends early where errors are small: lego stopped at a third of
300,000 splats, and gained 1.0 dB with all of them. Photos without cut-out masks gained nothing.
Shorter runs use it too with dropout, which keeps the additional splats from overfitting."""
_COARSE_SIDE = 75
"""Shorter side of a photo, px, below which a coarse picture has too little detail."""


@dataclass(frozen=True, kw_only=True)
class Plan:
    """Schedules of a run: steps of events, and learning rates. Steps count from 1."""

    iterations: int
    """Last step."""
    models: int
    """Models trained in parallel; numbers of splats are those of each."""
    max_splats: int
    """Most splats."""
    first_cap: int
    """Splats that small photos may grow to; `max_splats` unless the number rises with them."""
    pixels: int
    """Of a photo at full size, on average."""
    sh_degree: int
    """Degree in use from half of the run on."""
    sh_every: int
    """Steps between two SH degrees."""
    shN_every: int
    """Steps between two of the higher SH coefficients."""
    coarse_factor: float
    """Divisor of the photos' sides at the first step."""
    coarse_until: int
    """From this step on photos are used at full size."""
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
    """Learning rate of positions at the first and after the last step, training units."""
    rates: dict[str, float]
    """Learning rates of the other parameters, until they fall."""
    lr_final: float
    """What is left of these at the last step."""
    init_opacity: float
    """Opacity of the first splats."""
    init_scale: float
    """Size of the first splats in mean distances to their neighbours."""
    grow_grad: float
    """Mean screen-space gradient above which `default` clones or splits a splat."""
    mcmc_growth: float
    """Share of splats that a refinement of `mcmc` adds; 0 with `default`, which uses gradients."""
    kept: float
    """Share of the splats that remain after the last refinement."""

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
        models: int = 1,
    ) -> "Plan":
        """Resolve `config` for a capture.

        Args:
            config: The options.
            extent: Camera extent, training units.
            points: Number of splats at the start, of each model.
            side: Shorter side of the smallest photo, pixels.
            pixels: Of a photo, on average.
            subject: Whether masks are opacity, so that there is nothing but a subject.
            drops: Whether splats are left out of its steps.
            models: How many are trained side by side, which share `max_splats`.
        """
        n, most = config.iterations, max_splats_per_model(config, models)
        mcmc = config.strategy is Strategy.MCMC
        # Runs shorter than the paper's 30,000 steps keep its proportions where a splat still sees
        # enough views between two decisions: at least 100 steps at the start, 50 in between.
        every = config.refine_every or max(min(50, n), min(100, n // 50))
        start = config.refine_start or max(min(100, n), min(500, n // 20))
        # Fewer steps have to go as far. On real captures of 200 x 150 px this gained 1.1 dB on
        # held-out views in 1,000 steps and 0.7 dB in 3000.
        boost = config.lr_boost or min(max((_PAPER_STEPS / n) ** 0.35, 1.0), 4.0)
        root = math.sqrt(boost)
        # What is far is large, and large splats go after a reset. Given splats get no sky.
        sky = config.sky and not config.start_splats
        reset = config.reset_every or (3000 if n >= 6000 and not sky else -1)
        # Given splats hold their detail already; coarse photos would wear it off. On a video of
        # 240 x 320 px, 500 steps from the frame before ended 1.1 dB higher at full size.
        coarse = 1.0 if config.start_splats else min(max(side / _COARSE_SIDE, 1.0), 8.0)
        coarse = 1.0 if Skip.SMALL_PHOTOS in config.without else config.coarse_factor or coarse
        sizes, coarse_until = photo_size_stages(coarse), round(config.coarse_until * n)
        # With the photos, splats grow until these are at full size, and a little beyond it.
        long_enough = len(sizes) >= _FEWEST_SIZES and n >= _FEWEST_STEPS
        coupled = config.grow_with_photos and long_enough and not mcmc
        stop = n * 5 // 6 if mcmc else n // 2
        if coupled:
            stop = min(max(n * 4 // 5, round(sizes[0] * coarse_until) + 2 * every), n)
        stop = config.refine_stop or stop
        fine = subject and (drops or n >= _LONG)
        pull = _LONG_GRAD if fine else 2e-4 / min(boost, 2.0)
        # The cap is reached halfway through the refinements even if the run is short.
        growths = max((stop - start) // (2 * every), 1)
        growth = max(0.05, (most / max(points, 1)) ** (1 / growths) - 1)
        # Gradients of several views point the way better than one's. Held-out PSNR did not fall.
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
            grow_grad=config.grow_grad or pull,
            mcmc_growth=(config.mcmc_growth or min(growth, 1.0)) if mcmc else 0.0,
            kept=1.0 - config.prune_share,
        )

    def means_lr_at(self, step: int) -> float:
        """Exponential from the first to the last rate over the whole run.

        The curve belongs to the length of the run, so a run that is extended goes on at the rate
        that a longer run has at this step.
        """
        first, last = self.means_lr
        if first <= 0 or last <= 0:
            return first
        return first * math.exp(math.log(last / first) * min(step / self.iterations, 1.0))

    def rates_at(self, step: int, photos: int = 1) -> dict[str, float]:
        """Rates of the other parameters: constant, then exponential over the last tenth of the run.

        Constant rates leave the parameters jumping about their best by as much as a step. Those of
        a step that takes many photos are multiplied by the root of their number (Zhao et al. 2024,
        Grendel-GS). The higher SH coefficients take `shN_every` photos at once anyway.
        """
        done = (step / self.iterations - _SETTLES) / (1 - _SETTLES)
        share = self.lr_final ** min(max(done, 0.0), 1.0)
        factors = dict.fromkeys(self.rates, math.sqrt(photos))
        factors["shN"] = math.sqrt(max(photos / self.shN_every, 1.0))
        return {name: share * rate * factors[name] for name, rate in self.rates.items()}

    @property
    def kept_every(self) -> int:
        """Steps between two states that a run which diverges may go back to."""
        return max(_KEPT_EVERY, self.iterations // 10)

    def rest_moves_at(self, step: int, photos: int = 1) -> bool:
        """Whether the higher SH coefficients take a step after `step`, which took so many photos at
        once.

        The last step is one; a run that ends before the end it planned loses what has gathered.
        """
        due = step // self.shN_every > (step - photos) // self.shN_every
        return due or step >= self.iterations

    def sh_degree_at(self, step: int) -> int:
        """SH degree in use at `step`."""
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
        """Most splats that photos may lead to whose sides are divided by `factor`."""
        first = 1 / self.factor_at(1)
        share = (1 / factor - first) / (1 - first) if first < 1 else 1.0
        return round(
            self.first_cap + min(max(share, 0.0), 1.0) * (self.max_splats - self.first_cap)
        )

    def refines_at(self, step: int) -> bool:
        """Whether splats may be added or removed after `step`."""
        inside = self.refine_start <= step <= min(self.refine_stop, self.iterations - 1)
        return inside and step % self.refine_every == 0

    def prunes_free_space_at(self, step: int) -> bool:
        """Whether the free space around cameras is cleared, and axes that are too fine are widened,
        after `step`: as often as splats are refined, but all along, for those that stay move."""
        return step % self.refine_every == 0 or step == self.iterations

    def prunes_masked_at(self, step: int) -> bool:
        """Whether splats that masks hide are taken out after `step`: at the first refinement step
        of the second third and of the last. The rest of the run closes the gaps; without it that
        costs a decibel."""
        now, before = (3 * at // self.iterations for at in (step, step - self.refine_every))
        return step % self.refine_every == 0 and before < now < 3

    def surplus_at(self, step: int, splats: int, pruned: int) -> int:
        """How many of `splats` are one too many after `step`, where `pruned` went as such before.

        Those are counted in, so that a plan whose refinements end later than was thought, or
        sooner, does not prune again.
        """
        if step < min(self.refine_stop, self.iterations - 1):
            return 0
        return max(splats - max(round(self.kept * (splats + pruned)), 1), 0)

    def resets_at(self, step: int) -> bool:
        """Whether opacities are reset after `step`."""
        inside = step <= min(self.reset_stop, self.iterations - 1)
        return self.reset_every > 0 and inside and step % self.reset_every == 0
