"""What of the networks the explorer's reward needs, and its threshold."""

import torch
from torch import Tensor, nn

from toponav.builders.devices import has_fast_bf16
from toponav.builders.networks import Networks, make_networks
from toponav.config import ModelConfig, RewardConfig, SettingsError
from toponav.modules import TCNetwork

#: Settings that stand for a calibrated threshold.
_CALIBRATED = {"auto": "reward_threshold", "tc": "tc_threshold"}


class Novelty(nn.Module):
    """A TC-network and the similarity at which a view counts as known.

    They travel together. Networks that learn on keep the threshold that was calibrated
    before exploring.

    Args:
        tc: the network.
        threshold: in [0, 1).
    """

    threshold: Tensor

    def __init__(self, tc: TCNetwork, threshold: float = 0.5) -> None:
        super().__init__()
        self.tc = tc
        self.register_buffer(
            "threshold", torch.tensor(threshold, dtype=torch.float64), persistent=True
        )


def make_novelty(networks: Networks, reward: RewardConfig) -> Novelty:
    """The networks' part in the reward; the TC-network is shared, not copied.

    Args:
        networks: with their thresholds.
        reward: says which threshold.

    Raises:
        SettingsError: if the threshold was not calibrated.
    """
    return Novelty(networks.tc, reward_threshold(networks.thresholds, reward))


def reward_threshold(thresholds: dict[str, float], reward: RewardConfig) -> float:
    """The similarity at which a view counts as known.

    Raises:
        SettingsError: if it should be a calibrated one and there is none.

    Examples:
        >>> from types import SimpleNamespace as Some
        >>> reward_threshold({"tc_threshold": 0.9}, Some(threshold="tc"))
        0.9
    """
    name = _CALIBRATED.get(reward.threshold)
    if name is None:
        return float(reward.threshold)
    if name not in thresholds:
        raise SettingsError(
            f"reward.threshold must be a number with networks that have no calibrated "
            f"{name}, got {reward.threshold}"
        )
    return min(float(thresholds[name]), 0.999)


def make_empty_novelty(model: ModelConfig) -> Novelty:
    """One to be filled from a mailbox, in the precision to use it in."""
    novelty = Novelty(make_networks(model).tc)
    novelty.eval()
    return for_use(novelty, model)


def for_use(novelty: Novelty, model: ModelConfig) -> Novelty:
    """The same in bfloat16, in place, where that is faster: not for training.

    ResNet-18 takes half the time, the small encoder gains nothing. Casting at each
    call, as autocast does, would take a third of the gain away.
    """
    if model.encoder == "resnet18" and has_fast_bf16(torch.device("cpu")):
        novelty.tc.bfloat16()
    return novelty
