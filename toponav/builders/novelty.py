"""`Novelty`: the TC-network and its threshold, as collecting processes fetch them."""

import torch
from torch import Tensor, nn

from toponav.builders.networks import make_networks
from toponav.builders.processes import has_fast_bf16
from toponav.config import ModelConfig
from toponav.modules import TCNetwork
from toponav.worlds import WorldSpec


class Novelty(nn.Module):
    """A TC-network and the similarity at which a view counts as known.

    They travel together. Networks that continue training keep the threshold that was
    calibrated before exploring.

    Args:
        tc: the network; shared, not copied.
        threshold: in [0, 1).
    """

    threshold: Tensor

    def __init__(self, tc: TCNetwork, threshold: float = 0.5) -> None:
        super().__init__()
        self.tc = tc
        self.register_buffer(
            "threshold", torch.tensor(threshold, dtype=torch.float64), persistent=True
        )


def make_empty_novelty(model: ModelConfig, world: WorldSpec) -> Novelty:
    """One to be filled with published weights, in the precision to use it in."""
    novelty = Novelty(make_networks(model, world).tc)
    novelty.eval()
    return for_inference(novelty, model)


def for_inference(novelty: Novelty, model: ModelConfig) -> Novelty:
    """The same in bfloat16, in place, where that is faster; not for training.

    ResNet-18 takes half the time, the small encoder gains nothing. Casting at each
    call, as autocast does, would take a third of the gain away.
    """
    if model.encoder == "resnet18" and has_fast_bf16(torch.device("cpu")):
        novelty.tc.bfloat16()
    return novelty


def network_dtype(network: nn.Module) -> torch.dtype:
    """In which precision a network computes."""
    return next(network.parameters()).dtype
