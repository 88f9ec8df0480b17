"""Depth maps of a capture: prediction, reading, and alignment with the SfM points."""

from .fit import Fit
from .priors import DepthPrior, Priors, load_priors
