"""What the transforms that write a reward of their own key have in common.

- `check_num_keys`: the right number of keys.
- `declare_reward`: the new key in the env's reward spec.
"""

import torch
from torchrl.data import Composite, Unbounded
from torchrl.envs.transforms import Transform


def check_num_keys(transform: Transform, num_in: int, num_out: int = 1) -> None:
    """Refuse a wrong number of keys.

    Raises:
        ValueError: unless there are ``num_in`` in_keys and ``num_out`` out_keys.
    """
    if len(transform.in_keys) != num_in or len(transform.out_keys) != num_out:
        raise ValueError(
            f"in_keys must be {num_in} and out_keys {num_out}, "
            f"got {transform.in_keys} and {transform.out_keys}"
        )


def declare_reward(transform: Transform, output_spec: Composite) -> Composite:
    """Add a transform's ``out_keys[0]`` beside the rewards that are there.

    Its shape is that of ``in_keys[0]``. For ``transform_output_spec``, where
    observations and rewards are at hand together: asking ``parent`` for them makes all
    specs anew for each transform before it, which doubles the work with every reward.

    Args:
        transform: with ``in_keys`` among the observations and rewards.
        output_spec: of the env without the transform; left alone.

    Returns:
        The spec with the new reward.

    Raises:
        ValueError: if a key is missing.
    """
    output_spec = output_spec.clone()
    reward_spec = output_spec["full_reward_spec"]
    found = {}
    for key in transform.in_keys:
        for spec in (reward_spec, output_spec["full_observation_spec"]):
            if key in spec.keys(True, True):
                found[key] = spec[key]
        if key not in found:
            raise ValueError(
                f"{key!r} must be an observation or a reward of the env, got none; "
                f"{type(transform).__name__} comes after what writes it"
            )
    model = found[transform.in_keys[0]]
    reward_spec[transform.out_keys[0]] = Unbounded(
        shape=model.shape, dtype=torch.float32, device=model.device
    )
    return output_spec
