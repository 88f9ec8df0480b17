"""Drawing rules of viewers, as their published sources state them."""

import math
from dataclasses import dataclass
from typing import Literal

from ..errors import ConfigError
from ..quoting import quoted

_QUADRATIC_REACH = math.sqrt(8)
"""Standard deviations at which exp(-r^2 / 2) is exp(-4)."""


@dataclass(frozen=True, kw_only=True)
class Coding:
    """Uniform quantization of a parameter, as a viewer stores it."""

    steps: tuple[float, float, float]
    """Intervals between the lowest and the highest value, per channel or axis."""
    group: Literal["fixed", "model", "chunk", "splat"] = "fixed"
    """Values that share a range: all by `low` and `high`; those of the model, per channel; those of
    256 splats in Morton order, per channel; or those of a splat, symmetric around zero."""
    low: float = 0.0
    high: float = 1.0
    domain: Literal["", "eighth root", "centred square"] = ""
    """Values that are quantized: the parameter; its eighth root; or 0.5 + 2 x |x| of an opacity,
    x = opacity - 0.5."""


@dataclass(frozen=True, kw_only=True)
class ViewerRules:
    """Drawing rules of a viewer for splats from a 3DGS PLY, with its default settings.

    All viewers evaluate SH with the view direction at the splat's centre, clamp colours at zero and
    blend in the order of depth. Colours of a PLY are sRGB values.
    """

    name: str
    """Value of `--for-viewer`."""
    label: str
    """Name for people, with the version."""
    source: str
    """Published source of the rules."""
    linear: bool = False
    """Blend linear light: each splat's colour is converted before blending."""
    color_max: float = math.inf
    """Colours are clamped at this value before blending."""
    color_steps: float = 0.0
    """Intervals in 0 to 1 to which colours are rounded before blending; 0: not rounded."""
    eps2d: float = 0.3
    """Added to the diagonal of the 2D covariance, px^2."""
    compensated: bool = False
    """Whether opacities are compensated for `eps2d`."""
    widening: float = 1.0
    """Factor on the standard deviations in the picture, before `eps2d`."""
    reach: float = _QUADRATIC_REACH
    """Standard deviations at which a splat ends."""
    square: bool = False
    """Whether it ends at a rectangle along its axes rather than at an ellipse."""
    shifted: bool = False
    """Whether the falloff is shifted and scaled to be 0 at `reach` and 1 at the centre."""
    alpha_min: float = 0.0
    """Smaller opacities at a pixel are not drawn."""
    opacity_min: float = 0.0
    """Splats with smaller opacities are not drawn."""
    alpha_gain: float = 1.0
    """Factor on opacities at a pixel, which are then clamped at 1."""
    radial: bool = False
    """Whether the order is by the distance from the camera rather than by z."""
    half_means: bool = False
    """Whether positions are stored as 16-bit floats."""
    means: Coding | None = None
    scales: Coding | None = None
    """Coding of standard deviations: in logarithms, unless its domain is the eighth root."""
    opacities: Coding | None = None
    sh0: Coding | None = None
    """Coding of the colour 0.5 + C0 sh0."""
    shN: tuple[Coding, ...] = ()
    """Codings of the coefficients of degrees 1, 2 and 3; one for all; or none."""


_BYTES = (255.0, 255.0, 255.0)
_MODEL_BYTES = Coding(steps=_BYTES, group="model")

_EEVEE = ViewerRules(
    name="blender",
    label="Blender 5.3, EEVEE",
    source="draw_gsplat.bsl.hh, draw_gsplat_lib.bsl.hh, eevee_geom_gsplat.bsl.hh and "
    "film_filter_weight in Blender 5.3.0; filter size 1.50 px",
    linear=True,
    eps2d=(0.284 * 1.5) ** 2,
    compensated=True,
    widening=math.sqrt(9 / 8),
    square=True,
    opacity_min=1 / 255,
    alpha_gain=256 / 255,
    scales=Coding(steps=(510.0, 510.0, 510.0), group="model"),
    opacities=Coding(steps=_BYTES),
    sh0=_MODEL_BYTES,
    shN=(_MODEL_BYTES,),
)
_CYCLES = ViewerRules(
    name="blender-cycles",
    label="Blender 5.3, Cycles",
    source="kernel/geom/gsplat.h and gsplat_intersect.h in Blender 5.3.0; Blackman-Harris filter "
    "of 1.50 px",
    linear=True,
    eps2d=0.0431646,
    compensated=True,
    reach=math.inf,
)
_SPARK = ViewerRules(
    name="spark",
    label="Spark 2",
    source="sparkjsdev/spark: splatVertex.glsl and splatFragment.glsl (0703609), "
    "splatDefines.glsl (37012ce), splat_encode.rs (02d444a), defines.ts (19ddaed), "
    "SparkRenderer.ts (00782de)",
    color_max=1.0,
    color_steps=255.0,
    compensated=True,
    alpha_min=0.5 / 255,
    radial=True,
    half_means=True,
    scales=Coding(steps=(254.0, 254.0, 254.0), low=-12.0, high=9.0),
    opacities=Coding(steps=_BYTES),
    sh0=Coding(steps=_BYTES),
    shN=tuple(Coding(steps=(n, n, n), low=-1.0, high=1.0) for n in (126.0, 254.0, 62.0)),
)
_SUPERSPLAT = ViewerRules(
    name="supersplat",
    label="SuperSplat 3",
    source="playcanvas/supersplat: projected-splat-shader.ts and projected-splat-projector.ts "
    "(002b43a)",
    shifted=True,
    shN=(Coding(steps=(2047.0, 1023.0, 2047.0), group="splat"),),
)
_UNITY = ViewerRules(
    name="unity",
    label="UnityGaussianSplatting, quality Medium",
    source="aras-p/UnityGaussianSplatting: GaussianSplatAssetCreator.cs (0265bd0), "
    "SplatUtilities.compute (018b5ff), GaussianSplatting.hlsl (1a03ecd), "
    "RenderGaussianSplats.shader (25fc55d), GaussianComposite.shader (102a41a)",
    square=True,
    alpha_min=1 / 255,
    means=Coding(steps=(2047.0, 1023.0, 2047.0), group="chunk"),
    scales=Coding(steps=(2047.0, 1023.0, 2047.0), group="chunk", domain="eighth root"),
    opacities=Coding(steps=_BYTES, group="chunk", domain="centred square"),
    sh0=Coding(steps=_BYTES, group="chunk"),
    shN=(Coding(steps=(31.0, 63.0, 31.0), group="chunk"),),
)
_UNREAL = ViewerRules(
    name="unreal",
    label="NanoGaussianSplatting for Unreal",
    source="obitodaitu/NanoGaussianSplatting, Plugins/NanoGS: CalcViewData.usf (7effb86), "
    "GaussianDataTypes.ush and GaussianSplatting.ush (4392668), GaussianSplatRendering.usf "
    "(19f76fc); centimetres, without tone mapping",
    square=True,
    alpha_min=1 / 255,
    half_means=True,
    scales=Coding(
        steps=(254.0, 254.0, 254.0), low=-8.0 - math.log(100.0), high=14.0 - math.log(100.0)
    ),
    opacities=Coding(steps=_BYTES),
)
VIEWERS = {rules.name: rules for rules in (_EEVEE, _CYCLES, _SPARK, _SUPERSPLAT, _UNITY, _UNREAL)}
"""Rules by the value of `--for-viewer`."""


def rules_of(name: str) -> ViewerRules:
    """The rules of a viewer.

    Raises:
        ConfigError: no viewer has this name.
    """
    if name not in VIEWERS:
        raise ConfigError(
            f"There is no viewer {quoted(name)}; give one of {', '.join(sorted(VIEWERS))}."
        )
    return VIEWERS[name]
