"""The one action of a decision, as the actor-critic losses read it."""

import torch
from tensordict import NestedKey
from tensordict.nn import CompositeDistribution
from torch import Tensor, nn
from torch.distributions import Categorical, Distribution
from torch.nn import functional as F  # noqa: N812
from torchrl.modules import MaskedCategorical


def require_one_action(network: object) -> NestedKey:
    """The key of the action that a policy draws; ValueError unless it is one alone."""
    actions = list(getattr(network, "dist_sample_keys", []))
    parts = network.modules() if isinstance(network, nn.Module) else ()
    kinds = [getattr(part, "distribution_class", None) for part in parts]
    if len(actions) != 1 or CompositeDistribution in kinds:
        raise ValueError(
            "actor_network must be a ProbabilisticActor of one action that is not "
            f"composite, got {type(network).__name__} with {actions}."
        )
    key: NestedKey = actions[0]
    return key


def action_numbers(
    action: Tensor,
    num_actions: int,
    shape: torch.Size,
    *,
    valid: Tensor | None = None,
) -> Tensor:
    """The numbers ``[*B]`` of actions, given as such or one-hot ``[*B, A]``.

    Of one-hot actions that are not ``valid``, ``[*B]``, all may be 0.
    """
    if action.is_floating_point():
        raise ValueError(f"action must be integers or bools, got {action.dtype}.")
    if action.shape == shape:
        if ((action < 0) | (action >= num_actions)).any():
            got = f"numbers from {int(action.min())} to {int(action.max())}"
            raise ValueError(f"action must be in [0, {num_actions}), got {got}.")
        return action.long()
    if action.shape != (*shape, num_actions):
        rule = f"numbers of the shape {list(shape)} or one-hot {[*shape, num_actions]}"
        raise ValueError(f"action must be {rule}, got {list(action.shape)}.")
    numbers = action.long().argmax(-1)
    wrong = (action != F.one_hot(numbers, num_actions)).any(-1)
    if valid is not None:
        wrong &= valid
    if wrong.any():
        raise ValueError(f"action must be one-hot, got {action[wrong][0].tolist()}.")
    return numbers


def action_log_prob(policy: Distribution, action: Tensor, shape: torch.Size) -> Tensor:
    """The log-probability of actions as the policy draws them, of the shape given."""
    # Not batch_shape and event_shape: TorchRL's one-hot policies have no latter.
    expected = policy.mode.shape
    if action.shape != expected:
        raise ValueError(
            f"action must have the shape {list(expected)} of the policy's "
            f"{type(policy).__name__}, got {list(action.shape)}."
        )
    # A sparse mask leaves fewer logits than there are actions.
    masked = isinstance(policy, MaskedCategorical)
    if isinstance(policy, Categorical) and not masked:
        action_numbers(action, policy.logits.shape[-1], policy.logits.shape[:-1])
    log_prob = policy.log_prob(action)
    if log_prob.shape != shape:
        raise ValueError(
            f"the policy's log-probabilities must have the shape {list(shape)}, one a "
            f"decision, got {list(log_prob.shape)} of {type(policy).__name__}: that of "
            "several numbers together is an IndependentNormal's."
        )
    return log_prob
