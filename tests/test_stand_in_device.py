"""The stand-in device refuses what a GPU refuses, and computes as the processor."""

import pytest
import torch
from torch import nn

from tests.stand_in_device import DEVICE, NAME, StandInDevice


def test_sums() -> None:
    with StandInDevice():
        ones = torch.ones(3, device=NAME)
        ones += 1
        total = (ones * torch.arange(3.0).to(NAME)).sum()  # 2 * (0 + 1 + 2)
        assert (str(ones.device), float(total)) == (NAME, 6.0)
        assert str(ones.cpu().device) == "cpu"
        assert str(torch.zeros_like(ones).device) == NAME


def test_a_network_trains_there_as_on_the_processor() -> None:
    def train(device: str) -> torch.Tensor:
        torch.manual_seed(0)
        network = nn.Linear(3, 2).to(device)
        optimizer = torch.optim.AdamW(network.parameters())
        network(torch.ones(4, 3, device=device)).square().sum().backward()
        optimizer.step()
        assert network.weight.grad is not None
        assert network.weight.grad.device == network.weight.device
        return network.weight.detach().cpu()

    with StandInDevice():
        there = train(NAME)
    torch.testing.assert_close(there, train("cpu"))


@pytest.mark.parametrize(
    "mix",
    [
        lambda here, there: here + there,
        lambda here, there: here.copy_(there) @ there,
        lambda here, there: here[there.long()],
        lambda here, there: torch.cat([here, there]),
        lambda here, there: here.index_select(0, there.long()),
        lambda here, there: there.index_put_((here.long(),), here),
        lambda here, there: torch.where(there > 0, here, here),
    ],
)
def test_two_devices_are_refused(mix) -> None:
    with StandInDevice():
        here, there = torch.zeros(3), torch.zeros(3, device=NAME)
        with pytest.raises(RuntimeError, match="same device"):
            mix(here, there)


def test_what_a_gpu_allows() -> None:
    with StandInDevice():
        here, there = torch.zeros(3), torch.ones(3, device=NAME)
        assert (there * torch.tensor(2.0)).device == torch.ones(1, device=NAME).device
        assert float(there[here.long()].sum()) == 3.0
        assert float(here.copy_(there).sum()) == 3.0
        assert DEVICE.index == 1
