"""`Walks`: the L-network's head learns on from the ways that the explorers took."""

import copy
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from torch.nn.utils import clip_grad_norm_
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from tqdm import tqdm

from toponav.builders.episode_log import Row
from toponav.builders.learner import Check
from toponav.builders.networks import Networks
from toponav.builders.run_files import write_history
from toponav.config import ExploreConfig
from toponav.data import EpisodeSampler, LPairs, SplitPairs
from toponav.keys import ACTION, ANCHOR, EMBEDDING, LOGITS, OTHER, TRAJECTORY
from toponav.objectives import LLoss

_KEPT = (EMBEDDING, ACTION, TRAJECTORY, "step_count")
_MAX_GRAD_NORM = 10.0
_WEIGHT_DECAY = 1e-3
# Updates between two rows of the log.
_ROW_EVERY = 100


class Walks:
    """What the explorers did, as embeddings, and an L-network that learns from it.

    A random walk says little about how to get anywhere: of four of its decisions on
    the way from one view to another most were for nothing. An explorer that has
    learned walks straight on. The encoder stays as it is, so that a decision takes 0.5
    kB and the head learns in minutes.

    Reference:
        The paper, "Generalization of TC-network and L-network": networks that were
        trained on random walks are trained once more while the agent explores.

    Args:
        config: settings of the run.
        networks: the L-network's head is trained in place; it must share its encoder
            with the TC-network, whose embeddings the explorers hand over.
        check: called before every step of the optimiser with the loss and the number
            of the update; raises if one is no number.

    Shape notation:
        E: environments.  T: decisions of a rollout.
    """

    def __init__(
        self, config: ExploreConfig, networks: Networks, *, check: Check
    ) -> None:
        self.config = config.locomotion
        self.head = networks.locomotion.head
        self.check = check
        self.generator = torch.Generator().manual_seed(config.seed)
        self.buffer = TensorDictReplayBuffer(
            storage=LazyTensorStorage(self.config.memory),
            sampler=EpisodeSampler(LPairs(self.config.k), trajectory_key=TRAJECTORY),
            transform=SplitPairs(EMBEDDING),
            batch_size=self.config.pairs,
        )
        self.buffer.set_rng(self.generator)
        # A run that is resumed after it learned begins once more with this head.
        self._start = copy.deepcopy(self.head.state_dict())
        # The collectors of a resumed run number their episodes from 0 again.
        self._first_episode = 0

    def add(self, batch: TensorDictBase) -> None:
        """Keep the decisions of a batch ``[E, T]``; the oldest ones give way."""
        frames = batch.select(*_KEPT).flatten()
        frames[EMBEDDING] = frames[EMBEDDING].half()
        frames[TRAJECTORY] = frames[TRAJECTORY] + self._first_episode
        self.buffer.extend(frames)

    def learn(self, folder: Path) -> None:
        """Train the head, and write loss and accuracy into ``locomotion.csv``.

        Args:
            folder: the run folder.

        Raises:
            TrainingError: from ``check``.
        """
        config = self.config
        rows: list[Row] = []
        head = TensorDictModule(self.head, [ANCHOR, OTHER], [LOGITS])
        loss = LLoss(head)
        optimizer = torch.optim.AdamW(
            self.head.parameters(), lr=config.lr, weight_decay=_WEIGHT_DECAY
        )
        schedule = torch.optim.lr_scheduler.OneCycleLR(
            optimizer, config.lr, total_steps=config.updates, pct_start=0.1
        )
        self.head.train()
        sums = torch.zeros(2)
        bar = tqdm(range(1, config.updates + 1), desc="learn to walk", unit="update")
        for update in bar:
            pairs = self.buffer.sample()
            for key in (ANCHOR, OTHER):
                pairs[key] = pairs[key].float()
            found = loss(pairs)
            optimizer.zero_grad()
            found["loss_locomotion"].backward()
            clip_grad_norm_(self.head.parameters(), _MAX_GRAD_NORM)
            sums += torch.stack(
                [found["loss_locomotion"].detach(), found["accuracy"].detach()]
            )
            self.check(
                {"loss_locomotion": float(found["loss_locomotion"].detach())}, update
            )
            optimizer.step()
            schedule.step()
            if update % _ROW_EVERY == 0 or update == config.updates:
                since = update - (int(rows[-1]["update"]) if rows else 0)
                mean_loss, accuracy = (sums / since).tolist()
                rows.append({"update": update, "loss": mean_loss, "accuracy": accuracy})
                bar.set_postfix(loss=f"{mean_loss:.2f}", accuracy=f"{accuracy:.1%}")
                sums.zero_()
        self.head.eval()
        write_history(folder / "locomotion.csv", rows)

    def state_dict(self) -> dict[str, object]:
        """What was kept, the head before it learns, and the state of the draws."""
        return {
            "head": self._start,
            "buffer": self.buffer.state_dict(),
            "generator": self.generator.get_state(),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on where `state_dict` was taken."""
        self.buffer.load_state_dict(state["buffer"])
        self.generator.set_state(state["generator"])
        # Earlier runs did not keep it.
        self._start = state.get("head", self._start)
        self.head.load_state_dict(self._start)
        if len(self.buffer):
            kept = self.buffer.storage[:][TRAJECTORY]
            self._first_episode = int(kept.max()) + 1


class NoWalks:
    """What stands for `Walks` in a run whose L-network does not learn on."""

    def add(self, batch: TensorDictBase) -> None:
        """Look away."""

    def learn(self, folder: Path) -> None:
        """Learn nothing."""

    def state_dict(self) -> None:
        """Nothing."""

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Forget the walks of a run that had some."""


def make_walks(
    config: ExploreConfig, networks: Networks, *, check: Check
) -> Walks | NoWalks:
    """`Walks` if the settings want it.

    Networks that learn online need it not, and an L-network with an encoder of its own
    cannot learn from the embeddings of the TC-network.
    """
    shares = networks.locomotion.encoder is networks.tc.encoder
    if not config.locomotion.learn or config.online.learn or not shares:
        return NoWalks()
    return Walks(config, networks, check=check)
