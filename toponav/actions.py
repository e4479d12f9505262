"""Actions as the parts of this package count them."""

from collections.abc import Sequence

from tensordict import NestedKey
from torch import Tensor
from torchrl.data import (
    Binary,
    Categorical,
    MultiCategorical,
    MultiOneHot,
    OneHot,
    TensorSpec,
)

#: Kinds of TorchRL's whose classes are among those of one choice.
_SEVERAL_CHOICES = (Binary, MultiCategorical, MultiOneHot)


def count_actions(spec: TensorSpec, key: NestedKey) -> int:
    """How many actions an env has.

    Args:
        spec: of its action.
        key: of the action, for the sentence.

    Raises:
        ValueError: unless an action is one choice of several.

    Examples:
        >>> count_actions(OneHot(4), "action"), count_actions(Categorical(3), "action")
        (4, 3)
    """
    is_one = isinstance(spec, (Categorical, OneHot))
    if not is_one or isinstance(spec, _SEVERAL_CHOICES):
        rule = f"{key!r} must be one choice of several (Categorical or OneHot)"
        raise ValueError(f"{rule}, got {type(spec).__name__}")
    return int(spec.space.n)


def as_numbers(
    action: Tensor, shape: Sequence[int], num_actions: int | None = None
) -> Tensor:
    """Numbers of actions, int64 ``[*B]``, given as such or one-hot.

    No value is looked at, so that nothing waits for a GPU.

    Args:
        action: integers or bools, ``[*B]``, ``[*B, 1]`` or one-hot ``[*B, A]``.
        shape: the batch, ``*B``.
        num_actions: A; ``None`` takes any.

    Raises:
        ValueError: for actions of another dtype or shape.

    Examples:
        >>> import torch
        >>> as_numbers(torch.tensor([[0, 0, 1], [1, 0, 0]]), [2], 3)
        tensor([2, 0])
        >>> as_numbers(torch.tensor([2, 0]), [2], 3)
        tensor([2, 0])
    """
    batch, given = tuple(shape), tuple(action.shape)
    if action.is_floating_point():
        rule = "action must be integers or bools, of discrete actions"
        raise ValueError(f"{rule}, got {action.dtype}")
    if given == batch:
        return action.long()
    if given == (*batch, 1):
        return action.squeeze(-1).long()
    if given[:-1] == batch and num_actions in (None, given[-1]):
        return action.long().argmax(-1)
    one_hot = [*batch, "A" if num_actions is None else num_actions]
    rule = f"action must be numbers {list(batch)} or one-hot {one_hot}".replace("'", "")
    raise ValueError(f"{rule}, got {list(given)}")
