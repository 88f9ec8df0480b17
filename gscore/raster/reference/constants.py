"""Reference constants: the numbers of the rasterizer's definition."""

ALPHA_MIN = 1.0 / 255.0
"""Minimum alpha with which a splat contributes to a pixel."""
ALPHA_MAX = 0.99
"""Maximum alpha, so the transmittance never reaches zero."""
TRANSMITTANCE_MIN = 1e-4
"""A pixel stops before the splat that would bring its transmittance to this or below."""
STOP_AT = TRANSMITTANCE_MIN * (1 + 1e-9)
"""The same limit with a tolerance: two splats capped at 0.99 leave exactly 1e-4, which must stop
the
pixel although (1 - 0.99)^2 rounds to slightly more."""
COMPENSATION_MIN = 0.005
"""Floor of the anti-aliasing factor on the opacity."""
JACOBIAN_MARGIN = 0.3
"""Margin around the image beyond which the projection's Jacobian is clamped, in tan(fov / 2)."""
QUAT_NORM2_MIN = 1e-16
"""Minimum squared length of a quaternion; below it the splat is not drawn."""
COLOR_MAX = 1e9
"""Maximum of a colour channel; above it the splat is not drawn."""
