"""What the actor-critic losses share: their networks' protocol, padding and values."""

from collections.abc import Callable
from typing import Any, Protocol, Self

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from torch import Tensor
from torchrl.modules import set_recurrent_mode
from torchrl.objectives import LossModule, ValueEstimators
from torchrl.objectives.value import GAE

from toponav.keys import IS_INIT
from toponav.parts import require_parts

#: The estimators are one recursion: TD(lambda)'s return is GAE's value target.
_LMBDAS = {
    ValueEstimators.TD0: 0.0,
    ValueEstimators.TD1: 1.0,
    ValueEstimators.TDLambda: None,
    ValueEstimators.GAE: None,
}


class RecurrentActorCritic(Protocol):
    """A policy and its critic that share a recurrent trunk, such as `ActorCritic`."""

    num_actions: int
    #: The view, the previous action and reward, ``is_init`` and the state.
    in_keys: list[NestedKey]
    #: From the LSTM's outputs to the logits of the actions and to the value.
    actor: torch.nn.Module
    critic: torch.nn.Module

    def unroll(self, tensordict: TensorDictBase) -> TensorDict:
        """Logits and values of a slice ``[*B, T]``, with gradients."""

    def unroll_lstm(self, tensordict: TensorDictBase) -> Tensor:
        """The LSTM's outputs over a slice, ``[*B, T, H]``, with gradients."""

    def next_values(self, tensordict: TensorDictBase) -> Tensor:
        """Values ``[*B, 1]`` of the states under ``"next"``, without gradients."""


def require_recurrent(network: object, name: str, *parts: str) -> None:
    """TypeError unless a network has these parts of a `RecurrentActorCritic`."""
    require_parts(network, name, "ActorCritic, a recurrent actor-critic", *parts)


def require_critic(network: object) -> None:
    """TypeError unless a critic of its own says which keys it reads."""
    require_parts(network, "critic_network", "a ValueOperator", "in_keys", "out_keys")


def require_slices(batch: TensorDictBase) -> None:
    """ValueError unless a batch is ``[*B, T]``, rows of successive decisions."""
    if batch.ndim < 2:
        raise ValueError(
            "batches must be [*B, T], rows of T successive decisions, got "
            f"{list(batch.shape)}: give one row as batch.unsqueeze(0), and rows that "
            "lie one after the other as batch.reshape(-1, T)."
        )


def padding_masks(loss: LossModule, batch: TensorDictBase) -> TensorDictBase:
    """A batch's masks alone, False in padding, where TorchRL looks for them."""
    there = batch.keys(True)
    return batch.select(*(key for key in loss._loss_mask_keys() if key in there))


def valid_decisions(loss: LossModule, batch: TensorDictBase) -> Tensor | None:
    """Which decisions, ``[*B, T]``, are no padding; ``None`` without a mask."""
    masks = padding_masks(loss, batch).values(True, True)
    valid = [mask.reshape(batch.shape) for mask in masks]
    return torch.stack(valid).all(0) if valid else None


class GAEMixin:
    """Losses whose value estimator, for `bootstrapped_advantage`, is always a GAE.

    A loss has a `RecurrentActorCritic` as ``actor_critic``, or ``None`` there and an
    ``actor_network`` and a ``critic_network``.
    """

    actor_critic: Any

    def make_value_estimator(self, value_type: Any = None, **hyperparams: Any) -> Self:
        """Choose ``TD0``, ``TD1``, ``TDLambda`` or ``GAE``, and ``gamma``, ``lmbda``.

        TD(lambda) becomes the GAE of the same lambda, which takes a ``gamma`` or
        ``lmbda`` of 0, where TorchRL's vectorised forms fail. An estimator of TorchRL
        is taken as it is; a class of them reads the values that the loss has.
        """
        loss: Any = self
        if isinstance(value_type, type):
            hyperparams.setdefault("value_network", None)
        value_type, hyperparams = loss._prepare_value_estimator_kwargs(
            value_type, **hyperparams
        )
        if value_type is not None:
            if value_type not in _LMBDAS:
                raise NotImplementedError(
                    f"value_type must be one of {[kind.name for kind in _LMBDAS]} for "
                    f"{type(loss).__name__}, got {value_type}."
                )
            fixed, given = _LMBDAS[value_type], hyperparams.get("lmbda")
            if fixed is not None and given is not None:
                name = value_type.name
                raise ValueError(f"lmbda must not be given with {name}, got {given}.")
            hyperparams["lmbda"] = given if fixed is None else fixed
            for name in ("gamma", "lmbda"):
                share = hyperparams[name] = float(hyperparams[name])
                if not 0 <= share <= 1:
                    raise ValueError(f"{name} must be in [0, 1], got {share}.")
            hyperparams.setdefault("device", loss._default_device)
            loss._value_estimator = GAE(value_network=None, **hyperparams)
        loss._forward_value_estimator_keys()
        return self

    def _keys_of_slices(self, *own: NestedKey) -> list[NestedKey]:
        """What is read of a batch: ``own`` keys, and those of networks and returns."""
        loss: Any = self
        named = loss.tensor_keys
        actor = self.actor_critic or loss.actor_network
        judge = self.actor_critic or loss.critic_network
        now = dict.fromkeys([*actor.in_keys, *judge.in_keys])
        # A recurrent network reads it of decisions but not under "next".
        left_out = [IS_INIT] if judge is actor else []
        following = [key for key in judge.in_keys if key not in left_out]
        following += [named.reward, named.done, named.terminated]
        return [*now, *own, *(under_next(key) for key in following)]

    def _judge(self, states: TensorDictBase) -> Tensor:
        """Values ``[*B, 1]`` by the critic network."""
        loss: Any = self
        critic = loss.critic_network
        # Without a value of the collector's, which a critic of another key would leave.
        judged = critic(states.select(*critic.in_keys))
        shape = (*states.shape, 1)
        return read_entry(judged, loss.tensor_keys.value, "value", shape)

    def _next_values(self, batch: TensorDictBase) -> Tensor:
        """Values ``[*B, 1]`` of the states under ``"next"``."""
        if self.actor_critic is None:
            # TorchRL's recurrent critics would take them for one sequence.
            with set_recurrent_mode(False):
                return self._judge(batch.get("next"))
        values: Tensor = self.actor_critic.next_values(batch)
        return values

    def _write_advantage(
        self, batch: TensorDictBase, state_value: Tensor, *, normalize: bool
    ) -> TensorDictBase:
        """Write advantage and value target, ``[*B, T, 1]``.

        To ``normalize`` gives the advantage mean 0 and deviation 1 outside of padding.
        """
        loss: Any = self
        advantage, value_target = bootstrapped_advantage(
            loss, batch, state_value, self._next_values
        )
        if normalize:
            valid = valid_decisions(loss, batch)
            counted = advantage if valid is None else advantage[valid]
            deviation = counted.std(correction=0).clamp_min(1e-6)
            advantage = (advantage - counted.mean()) / deviation
        batch.set(loss.tensor_keys.advantage, advantage)
        return batch.set(loss.tensor_keys.value_target, value_target)


def bootstrapped_advantage(
    loss: LossModule,
    batch: TensorDictBase,
    state_value: Tensor,
    next_values: Callable[[TensorDictBase], Tensor],
) -> tuple[Tensor, Tensor]:
    """Advantages and value targets, ``[*B, T, 1]``, of decisions ``[*B, T]``.

    Where a slice ends, its padding begins, or an episode is truncated, ``next_values``
    judges the state that is stored under ``"next"``. After a terminated episode the
    value is 0. With ``lmbda=1`` the value targets are the n-step returns of A3C.
    Padding is what a mask of TorchRL's is False for.

    Reference:
        Schulman et al., "High-Dimensional Continuous Control Using Generalized
        Advantage Estimation" (2015); the paper, "Asynchronous advantage actor-critic".
    """
    keys, state_value = loss.tensor_keys, state_value.detach()
    entries = {}
    for name in ("reward", "done", "terminated"):
        key = under_next(getattr(keys, name))
        entries[name] = read_entry(batch, key, name, state_value.shape)
    _require_single_decisions(loss, batch)
    # A shallow copy: the caller's batch is left alone.
    batch = batch.copy()
    done, judged = entries["done"], ~entries["terminated"]
    if (valid := valid_decisions(loss, batch)) is not None:
        # What is rolled to the slice's end is of no account: nothing follows there.
        valid = valid.unsqueeze(-1)
        done, judged = done | ~valid.roll(-1, -2), judged & valid
        batch.set(under_next(keys.done), done)
    is_last = done.clone()
    is_last[..., -1, :] = True
    following = torch.zeros_like(state_value)
    following[..., :-1, :] = state_value[..., 1:, :]
    following = following.masked_fill(is_last, 0)
    judged = (is_last & judged).squeeze(-1)
    if judged.any():
        with torch.no_grad():
            values = next_values(batch.select("next")[judged])
        following[judged] = values.to(following.dtype)
    batch.set(keys.value, state_value)
    batch.set(under_next(keys.value), following)
    estimated = loss.value_estimator(batch)
    return estimated.get(keys.advantage), estimated.get(keys.value_target)


def _require_single_decisions(loss: LossModule, batch: TensorDictBase) -> None:
    """ValueError if what is under ``"next"`` comes after several decisions."""
    key = loss.value_estimator.tensor_keys.steps_to_next_obs
    steps = batch.get(key, None)
    if steps is not None and (steps != 1).any():
        raise ValueError(
            'what is under "next" must come one decision later, got '
            f"{int(steps.max())} in {key!r}: collect without MultiStep, since TD1 or a "
            "lmbda makes value targets of many steps."
        )


def read_entry(
    tensordict: TensorDictBase,
    key: NestedKey,
    name: str,
    shape: tuple[int, ...] | None = None,
    *,
    named_by: str | None = None,
) -> Tensor:
    """An entry that a loss needs; KeyError if it is missing.

    The sentence says what names another key, ``set_keys`` unless ``named_by`` is given.
    """
    entry: Tensor | None = tensordict.get(key, None)
    if entry is None:
        raise KeyError(
            f"the tensordict must have {key!r}, the key of {name} (another is named by "
            f"{named_by or f'set_keys({name}=...)'}), got {_beside(tensordict, key)}."
        )
    if shape is not None and entry.shape != shape:
        shapes = f"{list(shape)}, got {list(entry.shape)}"
        raise ValueError(f"{key!r}, the key of {name}, must have the shape {shapes}.")
    return entry


def _beside(tensordict: TensorDictBase, key: NestedKey) -> list[str]:
    """What is there in place of an entry, such as all that is under ``"next"``."""
    above = key[:-1] if isinstance(key, tuple) else ()
    inner = tensordict.get(above, None) if above else tensordict
    if not isinstance(inner, TensorDictBase):
        above, inner = (), tensordict
    return sorted(str((*above, name) if above else name) for name in [*inner.keys()])


def under_next(key: NestedKey) -> NestedKey:
    """The key under ``"next"``."""
    return ("next", key) if isinstance(key, str) else ("next", *key)
