"""What a policy sees beside its own state: a small view, its last action and reward."""

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torch.nn import functional as F  # noqa: N812
from torchrl.data import Bounded, Categorical, Composite, TensorSpec

from toponav import keys
from toponav.transforms.specs import KeyedTransform, Keys, ViewTransform, find_spec


class PolicyPixels(ViewTransform):
    """Writes views at another size, averaged so that nothing small flickers.

    uint8 stays uint8. Unlike TorchRL's ``Resize`` it needs no torchvision.

    Reference:
        The paper, "Model implementation": 84x84 RGB.

    Args:
        size: height and width of the copy in pixels.
        in_keys: keys of the views, ``[*B, H, W, C]``, ``pixels`` unless given.
        out_keys: keys of the copies, ``policy_pixels`` unless given.

    Examples:
        >>> from tensordict import TensorDict
        >>> views = torch.zeros(2, 24, 32, 3, dtype=torch.uint8)
        >>> data = PolicyPixels((10, 10))(TensorDict({"pixels": views}, [2]))
        >>> data["policy_pixels"].shape
        torch.Size([2, 10, 10, 3])
    """

    def __init__(
        self,
        size: tuple[int, int] = (84, 84),
        *,
        in_keys: Keys = None,
        out_keys: Keys = None,
    ) -> None:
        if len(size) != 2 or min(size) < 1:
            raise ValueError(f"size must be two numbers of at least 1, got {size}")
        super().__init__(in_keys or [keys.PIXELS], out_keys or [keys.POLICY_PIXELS])
        self.size = tuple(size)

    def _apply_transform(self, obs: Tensor) -> Tensor:
        # Channels last in memory: no pixel moves.
        planes = obs.reshape(-1, *obs.shape[-3:]).permute(0, 3, 1, 2)
        is_bytes = obs.dtype == torch.uint8
        if is_bytes and obs.device.type != "cpu":
            planes = planes.float()
        small = F.interpolate(
            planes, self.size, mode="bilinear", align_corners=False, antialias=True
        )
        if is_bytes and small.dtype != torch.uint8:
            small = small.round_().clamp_(0, 255).to(torch.uint8)
        small = small.permute(0, 2, 3, 1)
        return small.reshape(*obs.shape[:-3], *small.shape[1:]).contiguous()

    def _spec_of(self, key: NestedKey, view: TensorSpec) -> TensorSpec:
        shape = (*view.shape[:-3], *self.size, view.shape[-1])
        low, high = (0, 255) if view.dtype == torch.uint8 else (0.0, 1.0)
        return Bounded(low, high, shape, view.device, view.dtype)


class PreviousAction(KeyedTransform):
    """Writes the action that led to an observation; ``num_actions`` if there is none.

    Reference:
        The paper, "Model implementation": the LSTM is fed the previous action.

    Args:
        num_actions: how many actions the env has, at least 2.
        in_keys: key of the action, int64 ``[*B]``, ``[*B, 1]`` or one-hot.
        out_keys: key of the action before, int64 ``[*B, 1]`` in ``[0, num_actions]``.

    Examples:
        >>> from tensordict import TensorDict
        >>> env = TensorDict(batch_size=[2])
        >>> previous = PreviousAction(num_actions=4)
        >>> previous._reset(env, env.clone())["previous_action"].squeeze(-1)
        tensor([4, 4])
    """

    default_keys = [keys.ACTION], [keys.PREVIOUS_ACTION]

    def __init__(
        self, num_actions: int, *, in_keys: Keys = None, out_keys: Keys = None
    ) -> None:
        if num_actions < 2:
            raise ValueError(f"num_actions must be at least 2, got {num_actions}")
        super().__init__(in_keys, out_keys)
        self.num_actions = num_actions

    def _step(
        self, tensordict: TensorDictBase, next_tensordict: TensorDictBase
    ) -> TensorDictBase:
        action = tensordict[self.in_keys[0]]
        batch = tensordict.batch_size
        if action.shape == (*batch, self.num_actions):
            action = action.to(torch.uint8).argmax(-1)
        return next_tensordict.set(self.out_keys[0], action.reshape(*batch, 1).long())

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        # Rows that go on keep what they had: TorchRL merges this by the mask.
        shape, device = (*tensordict_reset.batch_size, 1), tensordict_reset.device
        none = torch.full(shape, self.num_actions, device=device)
        return tensordict_reset.set(self.out_keys[0], none)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        key = self.in_keys[0]
        action = find_spec(self.parent.full_action_spec, key, kind="an action")
        if (space := getattr(action.space, "n", None)) != self.num_actions:
            raise ValueError(
                f"num_actions must be that of {key!r}, {space}, got {self.num_actions}"
            )
        shape, device = (*observation_spec.shape, 1), observation_spec.device
        spec = Categorical(self.num_actions + 1, shape, device)
        return observation_spec.set(self.out_keys[0], spec)


class PreviousReward(KeyedTransform):
    """Writes the reward that came with an observation, clipped; 0 after a reset.

    Reference:
        The paper, "Model implementation": the LSTM is fed the previous reward.

    Args:
        clip: rewards are cut to ``[-clip, clip]``.
        in_keys, out_keys: keys of the reward and of the clipped one, ``[*B, 1]``.

    Examples:
        >>> from tensordict import TensorDict
        >>> step = TensorDict({"intrinsic_reward": torch.tensor([[0.2], [16.0]])}, [2])
        >>> PreviousReward()._step(TensorDict(), step)["previous_reward"].squeeze(-1)
        tensor([0.2000, 1.0000])
    """

    default_keys = [keys.INTRINSIC_REWARD], [keys.PREVIOUS_REWARD]

    def __init__(
        self, clip: float = 1.0, *, in_keys: Keys = None, out_keys: Keys = None
    ) -> None:
        if not clip > 0:
            raise ValueError(f"clip must be above 0, got {clip}")
        super().__init__(in_keys, out_keys)
        self.clip = clip

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        clipped = next_tensordict[self.in_keys[0]].clamp(-self.clip, self.clip)
        return next_tensordict.set(self.out_keys[0], clipped)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        # Rows that go on keep what they had: TorchRL merges this by the mask.
        start = self.parent.full_reward_spec[self.in_keys[0]].zero()
        return tensordict_reset.set(self.out_keys[0], start)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        specs = self.parent.full_reward_spec
        reward = find_spec(specs, self.in_keys[0], kind="a reward")
        bounds = (-self.clip, self.clip)
        spec = Bounded(*bounds, reward.shape, reward.device, reward.dtype)
        return observation_spec.set(self.out_keys[0], spec)
