"""TRPO beside sb3-contrib's: CartPole, the swing-up of a pendulum, and no reward.

    PYTHONPATH=. python benchmarks/sanity_trpo.py --out results/sanity_trpo.csv

It needs ``pip install sb3-contrib`` (without: ``--learners ours``). Both learn with the
same numbers: batches of 2,048 decisions of 16 environments, networks of 64 and 64 tanh
units, a bound of 0.01 nats, 10 iterations of conjugate gradients with a damping of 0.1,
a critic fitted by Adam at 0.001 in 10 passes of minibatches of 128. The pendulum's
torque is continuous. A row is a batch: the mean return of episodes that ended, or, if
nothing is paid, their mean length: random play lasts 22 decisions. ``ours, other
critic`` is ours with a critic that begins with weights as sb3-contrib's, not at 0.
"""

import argparse
import importlib
from collections.abc import Callable, Iterator
from functools import partial
from itertools import product
from pathlib import Path

import gymnasium
import torch
from gymnasium.wrappers import TransformReward
from sanity_curves import CurveTable
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torch.distributions import Categorical
from torchrl.collectors import Collector
from torchrl.envs import (
    EnvBase,
    GymWrapper,
    RewardSum,
    SerialEnv,
    StepCounter,
    TransformedEnv,
)
from torchrl.modules import MLP, IndependentNormal, ProbabilisticActor, ValueOperator

from toponav.modules import start_orthogonal
from toponav.objectives import TRPOLoss, TrustRegion

NUM_ENVS, ROLLOUT, ITERATIONS, DAMPING = 16, 128, 10, 0.1
#: Of each task: its id, decisions, and the discount.
TASKS = {"cartpole": ("CartPole-v1", 40_960, 0.99)}
TASKS["pendulum"] = ("Pendulum-v1", 122_880, 0.9)
TASKS["unpaid"] = ("CartPole-v1", 40_960, 0.99)
#: Decisions, mean return of the episodes that ended, and how many these were.
Row = tuple[int, str, int]


def make_gym(task: str) -> gymnasium.Env:
    """The environment of a task."""
    env = gymnasium.make(TASKS[task][0])
    return TransformReward(env, lambda reward: 0.0) if task == "unpaid" else env


class GaussianHead(nn.Module):
    """Mean of an action from a network; its deviation is the same everywhere."""

    def __init__(self, network: nn.Module, num_actions: int) -> None:
        super().__init__()
        self.network = network
        self.log_deviation = nn.Parameter(torch.zeros(num_actions))

    def forward(self, observation: Tensor) -> tuple[Tensor, Tensor]:
        """``[*B, D]`` to mean and deviation, ``[*B, A]``."""
        mean = self.network(observation)
        return mean, self.log_deviation.exp().expand_as(mean)


def make_mlp(
    num_inputs: int, num_outputs: int, cells: list[int], *, gain: float = 0.01
) -> MLP:
    """A network of tanh units; ``gain`` is that of the last layer's first weights."""
    network = MLP(num_inputs, num_outputs, num_cells=cells, activation_class=nn.Tanh)
    for layer in network:
        if isinstance(layer, nn.Linear):
            start_orthogonal(layer)
    with torch.no_grad():
        network[-1].weight *= gain
    return network


def make_actor(num_inputs: int, env: EnvBase, cells: list[int]) -> ProbabilisticActor:
    """A policy for numbered or for continuous actions."""
    spec = env.action_spec_unbatched
    if spec.dtype.is_floating_point:
        head = GaussianHead(make_mlp(num_inputs, spec.shape[-1], cells), spec.shape[-1])
        return ProbabilisticActor(
            TensorDictModule(head, ["observation"], ["loc", "scale"]),
            in_keys=["loc", "scale"],
            distribution_class=IndependentNormal,
            distribution_kwargs={"tanh_loc": False},
            return_log_prob=True,
        )
    return ProbabilisticActor(
        TensorDictModule(
            make_mlp(num_inputs, spec.space.n, cells), ["observation"], ["logits"]
        ),
        in_keys=["logits"],
        distribution_class=Categorical,
        return_log_prob=True,
    )


class Agent:
    """A policy over vectors, and TRPO's update of it.

    Args:
        env: whose observations and actions it is for.
        gamma: discount of rewards.
        reward: key of the reward that it learns from.
        cells: widths of the hidden layers of policy and critic.
        minibatch: decisions of a step of the critic.
        lmbda: of the advantages.
        critic_gain: gain of the critic's last layer's first weights.
    """

    def __init__(
        self,
        env: EnvBase,
        *,
        gamma: float,
        reward: str = "reward",
        cells: tuple[int, ...] = (64, 64),
        minibatch: int = 128,
        lmbda: float = 0.95,
        critic_gain: float = 0.0,
    ) -> None:
        size = env.observation_spec["observation"].shape[-1]
        self.minibatch = minibatch
        self.policy = make_actor(size, env, list(cells))
        # As that of `TRPOLearner` it begins at 0, so that no reward moves no policy.
        judge = make_mlp(size, 1, list(cells), gain=critic_gain)
        critic = ValueOperator(judge, ["observation"])
        self.loss = TRPOLoss(self.policy, critic)
        self.loss.make_value_estimator(gamma=gamma, lmbda=lmbda)
        self.loss.set_keys(reward=reward)
        parameters = self.loss.policy_parameters()
        self.region = TrustRegion(parameters, iterations=ITERATIONS, damping=DAMPING)
        self.optimizer = torch.optim.Adam(self.loss.critic_parameters(), lr=1e-3)

    def update(self, batch: TensorDictBase) -> None:
        """One step of the policy and ten passes of the critic over ``[E, T]``."""
        batch = self.loss.prepare(batch)

        def evaluate() -> tuple[Tensor, Tensor]:
            terms = self.loss.policy_terms(batch)
            return terms["loss_objective"], terms["kl"]

        self.region.step(evaluate)
        inputs = self.loss.critic_inputs(batch).reshape(-1)
        for _ in range(10):
            for rows in torch.randperm(len(inputs)).split(self.minibatch):
                self.optimizer.zero_grad()
                self.loss.critic_loss(inputs[rows]).backward()
                self.optimizer.step()


def learn_ours(task: str, seed: int, critic_gain: float = 0.0) -> Iterator[Row]:
    """`TRPOLoss` and `TrustRegion`."""
    _, decisions, gamma = TASKS[task]
    torch.manual_seed(seed)
    arguments = {} if task == "pendulum" else {"categorical_action_encoding": True}
    env = SerialEnv(NUM_ENVS, lambda: GymWrapper(make_gym(task), **arguments))
    env = TransformedEnv(env, RewardSum()).append_transform(StepCounter())
    env.set_seed(seed)
    agent = Agent(env, gamma=gamma, critic_gain=critic_gain)
    size = NUM_ENVS * ROLLOUT
    collector = Collector(
        env, agent.policy, frames_per_batch=size, total_frames=decisions
    )
    score = "step_count" if task == "unpaid" else "episode_reward"
    for number, batch in enumerate(collector, start=1):
        agent.update(batch)
        ended = batch["next", score][batch["next", "done"]].float()
        yield number * size, show_mean(float(ended.sum()), len(ended)), len(ended)
    collector.shutdown()


def show_mean(total: float, number: int) -> str:
    """The mean, or nothing if there is none."""
    return f"{total / number:.2f}" if number else ""


def learn_theirs(task: str, seed: int) -> Iterator[Row]:
    """sb3-contrib's TRPO with the same numbers."""
    _, decisions, gamma = TASKS[task]
    score = "l" if task == "unpaid" else "r"
    sb3, contrib = (
        importlib.import_module(package)
        for package in ("stable_baselines3.common", "sb3_contrib")
    )
    callbacks = importlib.import_module(f"{sb3.__name__}.callbacks")
    rows: list[Row] = []

    class Log(callbacks.BaseCallback):  # type: ignore[name-defined,misc]
        """Notes the returns of the episodes that ended in each batch."""

        ended: list[float] = []

        def _on_step(self) -> bool:
            infos = self.locals["infos"]
            ended = [info["episode"] for info in infos if "episode" in info]
            self.ended += [episode[score] for episode in ended]
            return True

        def _on_rollout_end(self) -> None:
            shown = show_mean(sum(self.ended), len(self.ended))
            rows.append((self.num_timesteps, shown, len(self.ended)))
            self.ended = []

    env_util = importlib.import_module(f"{sb3.__name__}.env_util")
    model = contrib.TRPO(
        "MlpPolicy",
        env_util.make_vec_env(partial(make_gym, task), n_envs=NUM_ENVS, seed=seed),
        n_steps=ROLLOUT,
        gamma=gamma,
        gae_lambda=0.95,
        cg_max_steps=ITERATIONS,
        cg_damping=DAMPING,
        line_search_max_iter=15,
        seed=seed,
        device="cpu",
    )
    model.learn(decisions, callback=Log())
    yield from rows


LEARNERS: dict[str, Callable[[str, int], Iterator[Row]]] = {
    "ours": learn_ours,
    "sb3-contrib": learn_theirs,
    "ours, other critic": partial(learn_ours, critic_gain=1.0),
}


def main() -> None:
    """Learn every task with every learner and seed, and write the curves."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--tasks", nargs="+", default=list(TASKS), choices=TASKS)
    parser.add_argument(
        "--learners", nargs="+", default=list(LEARNERS), choices=LEARNERS
    )
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    options = parser.parse_args()
    torch.set_num_threads(1)
    table = CurveTable(options.out, ("mean_return", "episodes"))
    for run in product(options.tasks, options.seeds, options.learners):
        task, seed, learner = run
        if not table.has(*run):
            table.add(run, LEARNERS[learner](task, seed))


if __name__ == "__main__":
    main()
