"""Settings of the stress tests."""

import pytest
import torch


@pytest.fixture(autouse=True)
def one_torch_thread():
    """Small tensors gain nothing from a second thread, and lose much on a busy machine."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)
