"""Training the networks further on what explorers see and do.

Reference:
    The paper, "Generalization of TC-network and L-network": networks that were trained
    on random walks are trained once more while the agent explores.
"""

import copy
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDictBase
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from tqdm import tqdm

from toponav.builders import (
    FRAME_KEYS,
    NETWORKS,
    Check,
    Consumer,
    Networks,
    RewardMethod,
    frames_that_fit,
    make_autocast,
    make_device,
)
from toponav.config import ExploreConfig
from toponav.data import (
    CompactReplay,
    EpisodeSampler,
    LPairs,
    SplitPairs,
    find_episodes,
)
from toponav.keys import ACTION, ANCHOR, EMBEDDING, OTHER, TRAJECTORY
from toponav.objectives import LLoss
from toponav.runs import write_history
from toponav.training.episode_log import mean_of
from toponav.training.pair_trainer import PairTrainer, make_pair_trainer
from toponav.training.recalibration import Recalibration

# Updates between two rows of the log of the L-network's head.
_ROW_EVERY = 100
# Share of the updates of that head in which its learning rate rises.
_RISE = 0.1


class ContinuedTraining(Consumer):
    """Trains the networks, in place, from the views of an exploration's batches.

    They are in ``train()`` mode during an update only. The settings' ``online`` says
    when and how fast to learn, ``pairs`` from what, ``device`` where. On another device
    than theirs a copy learns, and they get its weights when a new version is due. With
    each version come new thresholds for them and the ``reward``, by ``recalibrate``.
    """

    in_keys = FRAME_KEYS

    def __init__(
        self,
        settings: ExploreConfig,
        networks: Networks,
        check: Check,
        *,
        reward: RewardMethod | None = None,
        recalibrate: Recalibration | None = None,
    ) -> None:
        self.config = config = settings.online
        num_frames = frames_that_fit(
            config.buffer_gb, networks.view_size, halve=networks.model.halve
        )
        storage = LazyTensorStorage(max(num_frames, config.ahead))
        self.buffer = TensorDictReplayBuffer(storage=storage)
        self.networks = networks
        self.reward, self.recalibrate = reward, recalibrate
        self.trained = _on_device(settings, networks)
        self.trainer = make_pair_trainer(
            self.trained,
            settings.pairs,
            config,
            storage,
            seed=settings.seed,
            lr=config.lr,
            autocast=make_autocast(self.trained.device, bf16=True),
            check=check,
        )
        self._since_update = self._since_version = 0

    def extend(self, batch: TensorDictBase) -> dict[str, float]:
        """Keep the views of a batch ``[E, T]`` and make the updates that are due.

        Returns:
            Means of both losses, nothing if no update was due.
        """
        frames = batch.select(*self.in_keys).flatten()
        self.buffer.extend(frames)
        self._since_version += len(frames)
        if len(self.buffer) >= self.config.ahead:
            self._since_update += len(frames)
        measured = []
        while self._since_update >= self.config.every:
            self._since_update -= self.config.every
            measured.append(self.trainer.step())
        names = ("loss_tc", "loss_locomotion") if measured else ()
        return {name: mean_of(measured, name) for name in names}

    def updated(self) -> Collection[str]:
        """The networks, if the time for a new version has come; asking counts."""
        ready = len(self.buffer) >= self.config.ahead
        if not ready or self._since_version < self.config.publish_every:
            return ()
        self._since_version = 0
        self._hand_over()
        return (NETWORKS,)

    def finish(
        self, folder: Path, progress: Callable[[float], object] = lambda _: None
    ) -> None:
        self._hand_over()

    def state_dict(self) -> dict[str, Any]:
        """The trainer's, and the calibration; views are collected again."""
        state = self.trainer.state_dict() | {"thresholds": self.networks.thresholds}
        if self.recalibrate is not None:
            state["shares"] = self.recalibrate.shares
        return state

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        self.trainer.load_state_dict(state)
        # Earlier runs kept the thresholds that they began with.
        self.networks.thresholds.update(state.get("thresholds", {}))
        if self.recalibrate is not None:
            self.recalibrate.shares = state.get("shares", self.recalibrate.shares)
        self._hand_over()

    def _hand_over(self) -> None:
        """Give the networks the trained weights, and all the thresholds that fit."""
        self.networks.modules.load_state_dict(self.trainer.network.state_dict())
        thresholds = self.networks.thresholds
        if self.recalibrate is not None:
            thresholds.update(self.recalibrate(self.trained, thresholds))
        if self.reward is not None:
            self.reward.recalibrate(thresholds)


class LocomotionFinetuner(Consumer):
    """Keeps embeddings and actions of an exploration, and trains the L-network's head.

    An explorer that has learned walks straight on, where most decisions of a random
    walk are for nothing. The encoder stays as it is, so that a decision takes 0.5 kB;
    the networks must share it: embeddings of explorers are the TC-network's.
    """

    in_keys = (EMBEDDING, ACTION, TRAJECTORY, "step_count")
    running = ("_first_episode",)
    finishes_beside = True

    def __init__(
        self, settings: ExploreConfig, networks: Networks, check: Check
    ) -> None:
        if networks.locomotion.encoder is not networks.tc.encoder:
            raise ValueError("networks must share one encoder, got two.")
        self.config = config = settings.locomotion
        self.settings, self.networks = settings, networks
        self.device = make_device(settings.device)
        self.head = networks.locomotion.head
        self.check = check
        self.generator = torch.Generator().manual_seed(settings.seed)
        self.buffer = CompactReplay(
            storage=LazyTensorStorage(config.memory),
            sampler=EpisodeSampler(LPairs(config.k)),
            transform=SplitPairs(EMBEDDING),
            batch_size=config.pairs,
        )
        self.buffer.set_rng(self.generator)
        # A run that is resumed after the training starts again with this head.
        self._start = copy.deepcopy(self.head.state_dict())
        # Collectors that begin new episodes number them from 0 again.
        self._first_episode = 0

    def extend(self, batch: TensorDictBase) -> dict[str, float]:
        """Keep the decisions of a batch ``[E, T]``, instead of the oldest ones."""
        frames = batch.select(*self.in_keys).flatten()
        frames[EMBEDDING] = frames[EMBEDDING].half()
        frames[TRAJECTORY] = frames[TRAJECTORY] + self._first_episode
        self.buffer.extend(frames)
        return {}

    def finish(
        self, folder: Path, progress: Callable[[float], object] = lambda _: None
    ) -> None:
        """Train the head; loss and accuracy go into ``locomotion.csv``.

        Without episodes long enough for a pair, it stays as it is.
        """
        config = self.config
        try:
            find_episodes(self.buffer.storage).require(config.k + 1, "locomotion.k")
        except ValueError as error:
            tqdm.write(f"the head of the L-network stays as it is: {error}")
            return
        head = _on_device(self.settings, self.networks).locomotion.head
        trainer = PairTrainer(
            head,
            {"l": (LLoss(head), 1.0)},
            self._draw_pairs,
            generator=self.generator,
            lr=config.lr,
            weight_decay=config.weight_decay,
            autocast=make_autocast(self.device, bf16=True),
            check=self.check,
        )
        # A tenth of ten updates is one, in which no rate can rise: a division by zero.
        rise = _RISE if config.updates > 10 else 0.3
        schedule = torch.optim.lr_scheduler.OneCycleLR(
            trainer.optimizer, config.lr, total_steps=config.updates, pct_start=rise
        )
        rows: list[dict[str, float]] = []
        sums = torch.zeros(2)
        bar = tqdm(range(1, config.updates + 1), desc="train L head", unit="update")
        for update in bar:
            measured = trainer.step()
            schedule.step()
            progress(update / config.updates)
            figures = measured["loss_locomotion"], measured["train_l_accuracy"]
            sums += torch.tensor(figures)
            if update % _ROW_EVERY == 0 or update == config.updates:
                since = update - (int(rows[-1]["update"]) if rows else 0)
                loss, accuracy = (sums / since).tolist()
                rows.append({"update": update, "loss": loss, "accuracy": accuracy})
                bar.set_postfix(loss=f"{loss:.2f}", accuracy=f"{accuracy:.1%}")
                sums.zero_()
        self.head.load_state_dict(head.state_dict())
        write_history(folder / "locomotion.csv", rows)

    def _draw_pairs(self) -> list[TensorDictBase]:
        pairs = self.buffer.sample().to(self.device)
        for key in (ANCHOR, OTHER):
            pairs[key] = pairs[key].float()
        return [pairs]

    def state_dict(self) -> dict[str, Any]:
        """What was kept, the head before its training, and the state of the draws."""
        return {
            "head": self._start,
            **self.buffer.state_dict(),
            "generator": self.generator.get_state(),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        # Earlier runs kept the buffer's state under a name of its own.
        self.buffer.load_state_dict(state.get("buffer", state))
        self.generator.set_state(state["generator"])
        # Earlier runs did not keep it.
        self._start = state.get("head", self._start)
        self.head.load_state_dict(self._start)
        if len(self.buffer):
            kept = self.buffer.storage[:][TRAJECTORY]
            self._first_episode = int(kept.max()) + 1


def _on_device(settings: ExploreConfig, networks: Networks) -> Networks:
    """The same networks, or a copy of them if ``device`` is another one."""
    device = make_device(settings.device)
    if networks.device == device:
        return networks
    copied = copy.deepcopy(networks)
    copied.modules.to(device)
    return copied
