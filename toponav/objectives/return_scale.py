"""`ReturnScale`: rewards in units of their own discounted return's deviation."""

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from toponav.keys import DONE, ENV_ID, INTRINSIC_REWARD, SCALED_REWARD


class ReturnScale(TensorDictModuleBase):
    """Divide rewards by the running standard deviation of their discounted return.

    For each env a return ``R <- gamma R + r`` runs through its decisions and starts
    again from 0 with an episode; the deviation is taken over all of them so far.
    Rewards are not centred: what pays goes on paying. A learner then sees values of the
    same order whatever the reward's scale, which a curiosity changes as it learns. The
    raw reward stays in the batch, the scaled one has a key of its own.

    Everything is in ``state_dict``. Each env's return waits between batches at its
    ``env_id``; batches without that entry must bring the same envs in the same rows.

    Reference:
        Burda et al., "Exploration by Random Network Distillation" (2018), section 2.4.

    Args:
        num_envs: number of envs over all workers.
        gamma: discount per decision.
        clip: bound on the size of a scaled reward; ``None`` for no bound.
        enabled: if false, the reward is copied as it is and nothing is counted.
        reward: key of the reward under ``"next"``.
        out_key: key of the scaled reward under ``"next"``.

    Raises:
        ValueError: if ``num_envs`` is below 1, ``gamma`` outside [0, 1) or ``clip`` not
            above 0; from a call, if the batch has other envs than ``num_envs`` allows.

    Examples:
        >>> from tensordict import TensorDict
        >>> scale = ReturnScale(num_envs=2, gamma=0.5)
        >>> following = {"intrinsic_reward": torch.tensor([[[1.0], [0]], [[2], [0]]])}
        >>> following["done"] = torch.zeros(2, 2, 1, dtype=torch.bool)
        >>> batch = scale(TensorDict({"next": following}, [2, 2]))
        >>> scale.deviation ** 2  # the returns are 1, 0.5, 2, 1: 6.25 / 4 - 1.125**2
        tensor(0.2969)

    Shape notation:
        E: envs of the batch.  T: decisions in the slice.
    """

    running_return: Tensor
    count: Tensor
    mean: Tensor
    square: Tensor

    def __init__(
        self,
        num_envs: int,
        *,
        gamma: float = 0.99,
        clip: float | None = 10.0,
        enabled: bool = True,
        reward: NestedKey = INTRINSIC_REWARD,
        out_key: NestedKey = SCALED_REWARD,
    ) -> None:
        super().__init__()
        if num_envs < 1:
            raise ValueError(f"num_envs must be at least 1, got {num_envs}.")
        if not 0 <= gamma < 1:
            raise ValueError(f"gamma must be at least 0 and below 1, got {gamma}.")
        if clip is not None and clip <= 0:
            raise ValueError(f"clip must be above 0 or None, got {clip}.")
        self.num_envs = num_envs
        self.gamma = gamma
        self.clip = clip
        self.enabled = enabled
        self.in_keys = [("next", reward), ("next", DONE)]
        self.out_keys = [("next", out_key)]
        # float64: millions of returns are summed over a long run.
        for name, size in (("running_return", (num_envs,)), ("count", ())):
            self.register_buffer(name, torch.zeros(size, dtype=torch.float64))
        for name in ("mean", "square"):
            self.register_buffer(name, torch.zeros((), dtype=torch.float64))

    @property
    def deviation(self) -> Tensor:
        """Standard deviation of the returns so far, float32; 1 before the first."""
        if not self.count:
            return torch.ones((), device=self.count.device)
        return (self.square / self.count).sqrt().float()

    @torch.no_grad()
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Count a batch ``[E, T]`` and write its scaled rewards, ``[E, T, 1]``."""
        reward_key, done_key = self.in_keys
        reward = tensordict.get(reward_key)
        scaled = reward.clone()
        if self.enabled:
            shape = tensordict.batch_size
            envs = self._envs(tensordict)
            self._count(
                self._returns(
                    reward.reshape(shape).double(),
                    tensordict.get(done_key).reshape(shape),
                    envs,
                )
            )
            scaled = scaled / self.deviation.clamp_min(1e-4)
            if self.clip is not None:
                scaled = scaled.clamp_(-self.clip, self.clip)
        return tensordict.set(self.out_keys[0], scaled)

    def _envs(self, tensordict: TensorDictBase) -> Tensor:
        env_id = tensordict.get(ENV_ID, None)
        if env_id is None:
            envs = torch.arange(tensordict.batch_size[0], device=self.count.device)
        else:
            envs = env_id[:, 0].reshape(-1)
        if int(envs.max()) >= self.num_envs:
            raise ValueError(
                f"num_envs must be above every env's number, got {self.num_envs} and "
                f"the env {int(envs.max())}."
            )
        return envs

    def _returns(self, reward: Tensor, done: Tensor, envs: Tensor) -> Tensor:
        """The discounted return after each decision, ``[E, T]``."""
        running = self.running_return[envs]
        returns = torch.empty_like(reward)
        keep = self.gamma * (~done).double()
        for step, column in enumerate(reward.unbind(1)):
            running = running + column
            returns[:, step] = running
            running = running * keep[:, step]
        self.running_return[envs] = running
        return returns

    def _count(self, returns: Tensor) -> None:
        """Merge the moments of a batch into those so far (Chan et al., 1979)."""
        num = returns.numel()
        mean = returns.mean()
        total = self.count + num
        away = mean - self.mean
        self.square += (returns - mean).square().sum()
        self.square += away.square() * self.count * num / total
        self.mean += away * num / total
        self.count.copy_(total)
