"""`SteeringPractice`: PPO on how an agent comes along on its own map."""

from dataclasses import dataclass

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torch.distributions import Categorical
from torchrl.modules import ProbabilisticActor, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value.functional import generalized_advantage_estimate

from toponav import keys
from toponav.modules import SteeringNetwork, SteeringValue

_READ = [keys.EMBEDDING, keys.SENSES, keys.FREE_LOGITS]
_LARGEST_GRADIENT, _CRITIC_COEFF = 0.5, 0.5
#: What a decision costs, beside its progress, and what the target pays, in decisions:
#: an agent that turns on the spot must not be as well off as one that arrives.
_COST, _ARRIVAL = 0.05, 1.0
#: Decisions of progress in one that count at most: a belief may jump.
_MOST = 3.0


@dataclass(frozen=True, kw_only=True)
class PracticeRules:
    """How a `SteeringPractice` learns; PPO's numbers."""

    gamma: float
    lmbda: float
    lr: float
    epochs: int
    minibatch: int
    clip_epsilon: float
    entropy_coeff: float


class SteeringPractice:
    """Learns to steer from batches of a `PractisingNavigator`.

    What counts is progress, in decisions, by the agent's own belief about its pose: no
    ground truth and no reward of a task. PPO's clipped loss, estimators and values are
    TorchRL's.

    Reference:
        Beyond the paper. Schulman et al., "Proximal Policy Optimization Algorithms"
        (2017).

    Args:
        network: the navigator's controller, which is trained.
        temperature: at which the navigator draws actions.
        rules: PPO's numbers.
    """

    def __init__(
        self, network: SteeringNetwork, *, temperature: float, rules: PracticeRules
    ) -> None:
        self.network, self.temperature, self.rules = network, temperature, rules
        sizes = network.sizes
        value = SteeringValue(sizes["embedding_size"], sizes["senses_size"])
        actor = ProbabilisticActor(
            TensorDictModule(_Cooled(network, temperature), _READ, [keys.LOGITS]),
            in_keys=[keys.LOGITS],
            out_keys=[keys.ACTION],
            distribution_class=Categorical,
            distribution_kwargs={"validate_args": False},
            return_log_prob=True,
            log_prob_key=keys.ACTION_LOG_PROB,
        )
        self.critic = ValueOperator(
            value, in_keys=_READ[:2], out_keys=[keys.STATE_VALUE]
        )
        self.loss = ClipPPOLoss(
            actor,
            self.critic,
            clip_epsilon=rules.clip_epsilon,
            entropy_coeff=rules.entropy_coeff,
            critic_coeff=_CRITIC_COEFF,
            normalize_advantage=True,
            functional=False,
        )
        self.loss.set_keys(
            action=keys.ACTION,
            sample_log_prob=keys.ACTION_LOG_PROB,
            value=keys.STATE_VALUE,
            advantage=keys.ADVANTAGE,
            value_target=keys.VALUE_TARGET,
        )
        self.optimizer = torch.optim.Adam(self.loss.parameters(), lr=rules.lr)

    def extend(self, batch: TensorDictBase) -> dict[str, float]:
        """Learn from decisions ``[E, T]``; how the agents came along, by name."""
        steps = self._judge(batch)
        measured: dict[str, float] = {}
        for _ in range(self.rules.epochs):
            order = torch.randperm(len(steps)).split(self.rules.minibatch)
            for part in (steps[numbers] for numbers in order):
                found = self.loss(part)
                terms = [found[f"loss_{n}"] for n in ("objective", "critic", "entropy")]
                self.optimizer.zero_grad()
                torch.stack([term.mean() for term in terms]).sum().backward()
                nn.utils.clip_grad_norm_(self.loss.parameters(), _LARGEST_GRADIENT)
                self.optimizer.step()
                measured["entropy"] = float(found["entropy"])
        per = 1000 / batch.numel()
        return measured | {
            "progress": float(batch[keys.PROGRESS].mean()),
            "reached": per * float(batch[keys.REACHED].sum()),
            "given up": per * float(batch[keys.GAVE_UP].sum()),
        }

    @torch.no_grad()
    def _judge(self, batch: TensorDictBase) -> TensorDictBase:
        """Decisions ``[E (T - 1)]`` with log-probability, advantage and value target.

        How a decision went is known in the one after it, so that the last has no judge.
        """
        kept = [*_READ, keys.ACTION]
        steps, then = batch[:, :-1].select(*kept).clone(), batch[:, 1:]
        value = self.critic(batch.select(*_READ[:2]))[keys.STATE_VALUE]
        here, after = value[:, :-1], value[:, 1:]
        reached = then[keys.REACHED]
        # Another target, or another episode, says nothing about this one's.
        cut = then[keys.GAVE_UP] | then[keys.IS_INIT]
        progress = then[keys.PROGRESS].clamp(-_MOST, _MOST).masked_fill(cut, 0)
        reward = progress - _COST + _ARRIVAL * (reached & ~cut)
        advantage, target = generalized_advantage_estimate(
            self.rules.gamma,
            self.rules.lmbda,
            here,
            torch.where(cut, here, after),
            reward,
            done=reached | cut,
            terminated=reached & ~cut,
        )
        logits = self.network(*(steps[key] for key in _READ)) / self.temperature
        drawn = Categorical(logits=logits).log_prob(steps[keys.ACTION])
        steps.set(keys.ACTION_LOG_PROB, drawn)
        steps.set(keys.ADVANTAGE, advantage).set(keys.VALUE_TARGET, target)
        return steps.reshape(-1)


class _Cooled(nn.Module):
    """A network's logits at a temperature."""

    def __init__(self, network: SteeringNetwork, temperature: float) -> None:
        super().__init__()
        self.network, self.temperature = network, temperature

    def forward(self, embedding: Tensor, senses: Tensor, free: Tensor) -> Tensor:
        logits: Tensor = self.network(embedding, senses, free) / self.temperature
        return logits
