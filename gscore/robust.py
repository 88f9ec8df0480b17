"""Constants of robust statistics."""

SIGMA_PER_MEDIAN = 1.4826
"""Standard deviation over the median absolute deviation, of a normal distribution."""
HUBER = 1.345
"""Standard deviations beyond which Huber's weights fall (Huber 1964): 95 % efficiency on normal
errors."""
