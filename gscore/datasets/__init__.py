"""Captures read for training: photos, cameras, masks, points and the split into train and test."""

from .dataset import Dataset
from .load import load_dataset

__all__ = ["Dataset", "load_dataset"]
