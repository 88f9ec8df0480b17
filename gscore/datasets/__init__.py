"""Captures read for training: photos, cameras, masks, points and the split into train and test."""

from .capture import Capture, View
from .dataset import Dataset
from .folder import Folder
from .load import load_dataset
from .read import read_capture
