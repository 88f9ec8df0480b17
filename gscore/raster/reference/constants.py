"""Reference constants: the numbers of the rasterizer's definition."""

ALPHA_MIN = 1.0 / 255.0
"""A splat contributes to a pixel exactly where its alpha is at least this."""
ALPHA_MAX = 0.99
"""Alpha never exceeds this, so the transmittance never reaches zero."""
TRANSMITTANCE_MIN = 1e-4
"""A pixel stops before the splat that would bring its transmittance to this or below."""
STOP_AT = TRANSMITTANCE_MIN * (1 + 1e-9)
"""The same limit as compared with: two splats capped at 0.99 leave exactly 1e-4, which must stop
the pixel although (1 - 0.99)^2 rounds to a little more."""
COMPENSATION_MIN = 0.005
"""Floor of the anti-aliasing factor on the opacity."""
JACOBIAN_MARGIN = 0.3
"""How far beyond the image the projection's Jacobian follows a splat, in units of tan(fov / 2)."""
QUAT_NORM2_MIN = 1e-16
"""A quaternion with a smaller squared length has no direction: the splat is dead."""
COLOR_MAX = 1e9
"""A splat with a channel above this is broken and not drawn."""
