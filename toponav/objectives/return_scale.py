"""`ReturnScale`: rewards over the deviation of their discounted return."""

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from toponav import keys
from toponav.keys import DONE, ENV_ID, INTRINSIC_REWARD, SCALED_REWARD
from toponav.objectives.actor_critic_loss import read_entry


class ReturnScale(TensorDictModuleBase):
    """Divide rewards by the running standard deviation of their discounted return.

    For each env a return ``R <- gamma R + r`` runs through its decisions and restarts
    from 0 with an episode; the deviation is taken over all of them so far. Rewards are
    not centred. Returns are kept between batches by ``env_id``, or by row without it.

    Reference:
        Burda et al., "Exploration by Random Network Distillation" (2018), section 2.4.

    Args:
        num_envs: number of envs over all workers.
        gamma: discount per decision, in [0, 1); 1 too if nothing is counted.
        clip: bound on the size of a scaled reward, above 0; ``None`` for no bound.
        enabled: if false, the reward is copied as it is and nothing is counted.
        reward, out_key: keys of the reward and of the scaled one under ``"next"``.

    Examples:
        >>> scale = ReturnScale(num_envs=2, gamma=0.5)
        >>> following = {"intrinsic_reward": torch.tensor([[[1.0], [0]], [[2], [0]]])}
        >>> following["done"] = torch.zeros(2, 2, 1, dtype=torch.bool)
        >>> batch = scale(TensorDict({"next": following}, [2, 2]))
        >>> scale.deviation ** 2  # the returns are 1, 0.5, 2, 1: 6.25 / 4 - 1.125**2
        tensor(0.2969)
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
        if not 0 <= gamma <= 1 or (enabled and gamma == 1):
            raise ValueError(f"gamma must be at least 0 and below 1, got {gamma}.")
        if clip is not None and clip <= 0:
            raise ValueError(f"clip must be above 0 or None, got {clip}.")
        self.num_envs, self.gamma, self.clip = num_envs, gamma, clip
        self.enabled = enabled
        self.in_keys = [("next", reward), ("next", DONE)]
        self.out_keys = [("next", out_key)]
        # float64: millions of returns are summed over a long run.
        zero = torch.zeros((), dtype=torch.float64)
        self.register_buffer("running_return", zero.repeat(num_envs))
        for name in ("count", "mean", "square"):
            self.register_buffer(name, zero.clone())

    @property
    def deviation(self) -> Tensor:
        """Standard deviation of the returns so far, float32; 1 before the first."""
        if not self.count:
            return torch.ones((), device=self.count.device)
        return (self.square / self.count).sqrt().float()

    @torch.no_grad()
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Count a batch ``[E, T]`` and write its scaled rewards, ``[E, T, 1]``."""
        if tensordict.ndim != 2:
            raise ValueError(
                "batches must be [E, T], a row an env, got "
                f"{list(tensordict.shape)}: give one row as batch.unsqueeze(0), and "
                "rows that lie one after the other as batch.reshape(E, -1)."
            )
        mask = tensordict.get(("collector", "mask"), None)
        if mask is not None and not mask.all():
            raise ValueError(
                "batches must be without padding, a row an env, got a mask that leaves "
                f"out {int((~mask).sum())} decisions: scale before split_trajectories."
            )
        reward_key, done_key = self.in_keys
        reward = read_entry(
            tensordict,
            reward_key,
            "reward",
            (*tensordict.shape, 1),
            named_by="ReturnScale(reward=...)",
        )
        if not self.enabled:
            return tensordict.set(self.out_keys[0], reward.clone())
        shape = tensordict.batch_size
        done = keys.read_entry(tensordict, done_key).reshape(shape)
        envs = self._envs(tensordict)
        self._count(self._returns(reward.reshape(shape).double(), done, envs))
        scaled = reward / self.deviation.clamp_min(1e-4)
        if self.clip is not None:
            scaled.clamp_(-self.clip, self.clip)
        return tensordict.set(self.out_keys[0], scaled)

    def _envs(self, tensordict: TensorDictBase) -> Tensor:
        rows = torch.arange(tensordict.batch_size[0], device=self.count.device)
        envs: Tensor = tensordict.get(ENV_ID, rows.reshape(-1, 1, 1))[:, 0].reshape(-1)
        if (highest := int(envs.max())) >= self.num_envs:
            got = f"{self.num_envs} and the env {highest}"
            raise ValueError(f"num_envs must be above every env's number, got {got}.")
        return envs

    def _returns(self, reward: Tensor, done: Tensor, envs: Tensor) -> Tensor:
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
        num, mean = returns.numel(), returns.mean()
        total, difference = self.count + num, mean - self.mean
        self.square += (returns - mean).square().sum()
        self.square += difference.square() * self.count * num / total
        self.mean += difference * num / total
        self.count.copy_(total)
